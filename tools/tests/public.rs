//! Tests `palpate bench public`: the page shows every figure of the JSON, forces are judged as by hand, another
//! system gets the same figures for the same forces, and a second run solves nothing.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use palpate_core::{Method, Organ};
use palpate_host::BlobFile;
use serde_json::Value;

use crate::{palpate, refused, text};

fn assets() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets")
}

fn figures(out: &Path) -> Value {
    let bytes = std::fs::read(out.join("figures.json")).expect("the figures are written");
    serde_json::from_slice(&bytes).expect("JSON")
}

/// The tables of the JSON by their keys.
fn tables(figures: &Value) -> BTreeMap<String, Value> {
    let sections = figures["sections"].as_array().expect("sections").iter();
    let tables = sections.flat_map(|section| section["tables"].as_array().expect("tables"));
    tables.map(|table| (table["key"].as_str().expect("a key").to_owned(), table.clone())).collect()
}

/// A value of a table; `None` for an empty cell.
#[track_caller]
fn value(table: &Value, row: &str, column: &str) -> Option<f64> {
    let columns = table["columns"].as_array().expect("columns");
    let column = columns.iter().position(|name| name == column).unwrap_or_else(|| panic!("no {column}"));
    let mut rows = table["rows"].as_array().expect("rows").iter();
    let row = rows.find(|one| one["key"] == row).unwrap_or_else(|| panic!("no {row}"));
    row["values"][column].as_f64()
}

/// The number that a cell of the page shows.
fn shown(cell: &str) -> Option<f64> {
    if cell.is_empty() {
        return None;
    }
    let plain: String =
        cell.chars().filter(|c| *c != ',').map(|c| if c == '\u{2212}' { '-' } else { c }).collect();
    let raised = "\u{2070}\u{b9}\u{b2}\u{b3}\u{2074}\u{2075}\u{2076}\u{2077}\u{2078}\u{2079}";
    let exponent = |text: &str| -> i32 {
        let digits: String = text
            .chars()
            .map(|c| match raised.chars().position(|r| r == c) {
                Some(digit) => char::from_digit(digit as u32, 10).expect("a digit"),
                None => '-',
            })
            .collect();
        digits.parse().expect("an exponent")
    };
    let is_raised = |c: char| raised.contains(c) || c == '\u{207b}';
    let (digits, power) = match plain.split_once('\u{b7}') {
        Some((digits, power)) => (digits, exponent(power.trim_start_matches("10"))),
        None if plain.starts_with("10") && plain.chars().last().is_some_and(is_raised) => {
            ("1", exponent(plain.trim_start_matches("10")))
        }
        None => (plain.as_str(), 0),
    };
    Some(digits.parse::<f64>().unwrap_or_else(|_| panic!("`{cell}` is no number")) * 10f64.powi(power))
}

/// Every cell of every table of the JSON is on the page, in the same place.
fn check_page(out: &Path) {
    let text = std::fs::read_to_string(out.join("page.html")).expect("the page is written");
    let options = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
    let page = roxmltree::Document::parse_with_options(&text, options).expect("the page is well-formed");
    let figures = figures(out);
    let mut on_page = page.descendants().filter(|node| node.has_tag_name("table"));
    let mut compared = 0;
    for section in figures["sections"].as_array().expect("sections") {
        for table in section["tables"].as_array().expect("tables") {
            let key = table["key"].as_str().expect("a key");
            let drawn = on_page.next().unwrap_or_else(|| panic!("no table for {key}"));
            let body = drawn.descendants().find(|node| node.has_tag_name("tbody")).expect("a body");
            let rows: Vec<_> = body.children().filter(|node| node.has_tag_name("tr")).collect();
            let wanted = table["rows"].as_array().expect("rows");
            assert_eq!(rows.len(), wanted.len(), "{key}");
            for (row, wanted) in rows.iter().zip(wanted) {
                let cells: Vec<&str> = row
                    .children()
                    .filter(|node| node.has_tag_name("td"))
                    .map(|cell| cell.text().unwrap_or_default())
                    .collect();
                let values = wanted["values"].as_array().expect("values");
                assert_eq!(cells.len(), 1 + values.len(), "{key}: {cells:?}");
                assert_eq!(cells[0], wanted["name"], "{key}");
                for (cell, value) in cells[1..].iter().zip(values) {
                    match (shown(cell), value.as_f64()) {
                        (None, None) => {}
                        // Powers of ten have two digits, other numbers three.
                        (Some(found), Some(value)) => assert!(
                            (found - value).abs() <= 0.055 * value.abs() && (found == 0.0) == (value == 0.0),
                            "{key}, {}: {cell} for {value}",
                            cells[0]
                        ),
                        other => panic!("{key}, {}: {other:?}", cells[0]),
                    }
                    compared += 1;
                }
            }
        }
    }
    assert!(on_page.next().is_none() && compared > 50, "{compared} cells");
    for link in page.descendants().filter_map(|node| node.attribute("href")) {
        match link.strip_prefix('#') {
            Some(id) => assert!(page.descendants().any(|node| node.attribute("id") == Some(id)), "no {id}"),
            None => assert!(out.join(link).is_file(), "{link} is not there"),
        }
    }
}

/// The errors of a blob at the positions of a folder of questions: mean and largest |h - h~|, mN.
fn errors_by_hand(questions: &Path, blob: &Path, method: Method) -> (f64, f64) {
    let file = BlobFile::load(blob).expect("the blob is there");
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("the blob is sound");
    let mut reader = csv::Reader::from_path(questions.join("positions.csv")).expect("positions");
    let mut errors = Vec::new();
    for row in reader.deserialize::<BTreeMap<String, f64>>() {
        let row = row.expect("numbers");
        let d = ["dx_m", "dy_m", "dz_m"].map(|column| row[column] as f32);
        let h = ["hx_n", "hy_n", "hz_n"].map(|column| row[column]);
        assert!(row["residual_n"] < 1e-6, "the reference is converged");
        let found = organ.spaces[0].force(method, d).expect("the method is packed").force_n;
        let squared: f64 = h.iter().zip(found).map(|(h, f)| (h - f64::from(f)).powi(2)).sum();
        errors.push(1e3 * squared.sqrt());
    }
    (errors.iter().sum::<f64>() / errors.len() as f64, errors.iter().copied().fold(0.0, f64::max))
}

#[test]
fn a_quick_benchmark_is_whole_and_judges_another_system_by_the_same_code() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("public");
    let assets = assets();
    let common = ["bench", "public", "--quick", "--only", "force,energy", "--threads", "2"];
    let places = ["--assets", text(&assets), "--out", text(&out)];
    let arguments = [&common[..], &places].concat();
    let output = palpate(&arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    check_page(&out);
    let page = std::fs::read_to_string(out.join("page.html")).expect("the page is written");
    for words in ["the tool is smaller than its elements", "no limit under refinement"] {
        assert!(page.contains(words), "the page does not say what the reference is: {words}");
    }
    let first = figures(&out);
    let ours = tables(&first);
    assert_eq!(
        ours.keys().collect::<Vec<_>>(),
        ["energy.fingertip", "energy.point", "force.fingertip", "force.point"]
    );
    for (key, table) in &ours {
        assert_eq!(value(table, "answered_percent", "energy"), Some(100.0), "{key}");
        assert_eq!(value(table, "answered_percent", "your system"), None, "{key}: there are no answers");
    }
    for organ in ["point", "fingertip"] {
        let table = &ours[&format!("force.{organ}")];
        for method in [Method::Energy, Method::Trilinear] {
            let blob = out.join(format!("work/{organ}-quick.blob"));
            let (mean, largest) = errors_by_hand(&out.join("questions").join(organ), &blob, method);
            for (row, wanted) in [("mean_mn", mean), ("max_mn", largest)] {
                let found = value(table, row, method.name()).expect("a figure");
                assert!(
                    (found - wanted).abs() <= 1e-9 * wanted,
                    "{organ}, {}: {found} for {wanted}",
                    method.name()
                );
            }
        }
    }

    // A copy of the own answers has the same figures to the last bit; a planted error and a gap show.
    let wrong = folder.path().join("wrong");
    std::fs::create_dir_all(wrong.join("point")).expect("a folder");
    let answers =
        std::fs::read_to_string(out.join("answers/energy/point/positions.csv")).expect("own answers");
    let mut lines: Vec<String> = answers.lines().map(String::from).collect();
    let cells: Vec<String> = lines[3].split(',').map(String::from).collect();
    let planted: f64 = cells[1].parse::<f64>().expect("a force") + 0.5;
    lines[3] = format!("{},{planted},{},{}", cells[0], cells[2], cells[3]);
    lines.pop();
    std::fs::write(wrong.join("point/positions.csv"), lines.join("\n") + "\n").expect("written");
    std::fs::write(wrong.join("system.toml"), "about = \"planted\"\n").expect("written");
    let copy = format!("copy={}", out.join("answers/energy").display());
    let planted = format!("planted={}", wrong.display());
    let output = palpate(&[&arguments[..], &["--answers", &copy, "--answers", &planted]].concat());
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert_eq!(said.matches(" is finished").count(), 2, "sections are measured again: {said}");
    let solves = ["hands by finite elements", "held-out positions,", "live in simulated time"];
    assert!(!solves.iter().any(|words| said.contains(words)), "it solves again: {said}");
    check_page(&out);
    let second = figures(&out);
    for (a, b) in ["force", "energy"].iter().zip(0..) {
        let seconds = |figures: &Value| figures["sections"][b]["seconds"].as_f64();
        assert_eq!(seconds(&first), seconds(&second), "{a} is kept");
    }
    for (key, table) in tables(&second) {
        for row in table["rows"].as_array().expect("rows") {
            let row = row["key"].as_str().expect("a key");
            assert_eq!(value(&table, row, "copy"), value(&table, row, "energy"), "{key}, {row}");
            if key != "force.point" {
                assert_eq!(value(&table, row, "planted"), None, "{key}, {row}: not answered");
            }
        }
    }
    let table = &tables(&second)["force.point"];
    let largest = value(table, "max_mn", "planted").expect("judged");
    assert!((largest - 500.0).abs() < 1.0, "{largest} mN for a planted error of 500 mN");
    let asked = answers.lines().count() as f64 - 1.0;
    let answered = value(table, "answered_percent", "planted").expect("judged");
    assert!(
        (answered - 100.0 * (asked - 1.0) / asked).abs() < 1e-9,
        "{answered} % with one of {asked} missing"
    );

    // The questions alone, elsewhere.
    let questions = folder.path().join("questions");
    let output = palpate(&[&arguments[..], &["--questions", text(&questions)]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    for file in
        ["README.txt", "point/positions.csv", "point/tets.csv", "fingertip/place.csv", "fingertip/scene.toml"]
    {
        let copied = std::fs::read(questions.join(file)).expect("copied");
        assert_eq!(copied, std::fs::read(out.join("questions").join(file)).expect("there"), "{file}");
    }
}

/// What finite elements feel, every method and live feel too, and a stiffer loop comes to rest at a higher rate.
#[test]
fn the_nodules_and_the_z_width_have_every_method_and_live() {
    let folder = tempfile::tempdir().expect("a folder");
    let (out, assets) = (folder.path().join("public"), assets());
    let common = ["bench", "public", "--quick", "--only", "zwidth,nodule", "--threads", "2"];
    let output = palpate(&[&common[..], &["--assets", text(&assets), "--out", text(&out)]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    check_page(&out);
    let tables = tables(&figures(&out));
    let systems: Vec<&str> = Method::ALL.iter().map(|method| method.name()).chain(["live"]).collect();
    for (place, is_felt) in [("shallow", true), ("beside", false), ("middle", true), ("deep", true)] {
        let of = |system: &str| {
            value(&tables["nodule.nodules"], &format!("{place}.detectability"), system).expect("measured")
        };
        let exact = of("finite elements");
        assert_eq!(exact > 1.0, is_felt, "{place}: {exact}");
        for system in &systems {
            let found = of(system);
            assert!((found - exact).abs() < 0.15, "{place}: {found} by {system} for {exact}");
        }
    }
    // A higher rate and more damping of the device allow a stiffer loop.
    let table = &tables["zwidth.damping"];
    let columns = ["plain wall", "guarded"];
    for system in systems.into_iter().filter(|system| *system != "kernel").chain(columns) {
        let of = |row: &str| value(table, row, system).unwrap_or_else(|| panic!("{system}: {row}"));
        assert!(of("500_hz.1") > 1000.0 && of("1000_hz.1") > 1.2 * of("500_hz.1"), "{system}");
        assert!(of("2000_hz.1") > of("1000_hz.1") && of("4000_hz.1") > of("2000_hz.1"), "{system}");
        assert!(of("1000_hz.4") > 1.5 * of("1000_hz.1"), "{system}: damping");
    }
    // Without friction the wall is as stiff as the formula says.
    for row in table["rows"].as_array().expect("rows") {
        let row = row["key"].as_str().expect("a key");
        let of = |column| value(table, row, column).expect("measured");
        let share = of("plain wall") / of("bound");
        assert!((0.88..1.05).contains(&share), "{row}: {share} of the bound");
    }
}

#[test]
fn wrong_options_are_refused_before_any_work() {
    refused(
        &["bench", "public", "--only", "force,smell", "--out", "/dev/null/x"],
        &["--only smell", "zwidth"],
    );
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("public");
    let none = format!("mine={}", folder.path().join("none").display());
    refused(
        &["bench", "public", "--out", text(&out), "--answers", &none],
        &["mine", "no folder", "docs/formats.md"],
    );
    let theirs = folder.path().join("theirs");
    std::fs::create_dir_all(theirs.join("point")).expect("a folder");
    let answers = |name: &str| format!("{name}={}", theirs.display());
    let (mine, again, ours) = (answers("mine"), answers("Mine"), answers("energy"));
    let given = ["bench", "public", "--out", text(&out), "--answers"];
    refused(&[&given[..], &[&mine]].concat(), &["mine", "neither a force nor a figure"]);
    std::fs::write(theirs.join("system.toml"), "[figures.\"cost.point\"]\nbytes = -5\n").expect("written");
    refused(
        &[&given[..], &[&mine]].concat(),
        &["system.toml", "bytes = -5", "is negative; correct it or remove it"],
    );
    std::fs::write(theirs.join("system.toml"), "[figures.\"cost.point\"]\nbites = 5\n").expect("written");
    refused(&[&given[..], &[&mine]].concat(), &["system.toml", "no row bites", "query_ns"]);
    refused(&[&given[..], &[&ours]].concat(), &["energy", "one of Palpate's columns"]);
    refused(&[&given[..], &[&mine, "--answers", &again]].concat(), &["Mine", "given twice"]);
    std::fs::rename(theirs.join("point"), theirs.join("liver")).expect("renamed");
    refused(&[&given[..], &[&mine]].concat(), &["liver", "this is not read", "fingertip"]);
    assert!(!out.exists(), "nothing is begun");
}
