//! Tests `palpate report`: the page parses, every file that it names exists, its numbers are those of the
//! certificates in the blobs, and a second run solves nothing.

use std::collections::BTreeMap;
use std::path::Path;

use palpate_core::Organ;
use palpate_host::BlobFile;
use palpate_tests::write_beam_scene;
use serde_json::Value;

use crate::{GRID, MR, palpate, text};

fn rows(csv: &Path) -> Vec<BTreeMap<String, String>> {
    let mut reader = csv::Reader::from_path(csv).expect("the table is there");
    reader.deserialize().map(|row| row.expect("as many cells as the header has")).collect()
}

fn number(row: &BTreeMap<String, String>, column: &str) -> f64 {
    row[column].parse().unwrap_or_else(|_| panic!("{column} is `{}`", row[column]))
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).expect("the file is there")).expect("JSON")
}

/// The certificate inside a blob.
fn certificate(blob: &Path) -> Value {
    let file = BlobFile::load(blob).expect("the blob is there");
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("the blob is sound");
    serde_json::from_slice(organ.certificate.expect("it is certified")).expect("JSON")
}

/// The page is well-formed, every linked file exists, every anchor has its target, every plot has marks and
/// two named axes.
fn check_page(folder: &Path) {
    let page = std::fs::read_to_string(folder.join("report.html")).expect("the page is written");
    let options = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
    let page = roxmltree::Document::parse_with_options(&page, options).expect("the page is well-formed");
    let named = |name: &'static str| page.descendants().filter(move |node| node.has_tag_name(name));
    let links: Vec<&str> = named("a").filter_map(|a| a.attribute("href")).collect();
    assert!(links.len() > 20, "the page links to its tables: {links:?}");
    for link in links {
        match link.strip_prefix('#') {
            Some(id) => assert!(page.descendants().any(|node| node.attribute("id") == Some(id)), "no {id}"),
            None => assert!(folder.join(link).is_file(), "{link} is not there"),
        }
    }
    let plots: Vec<_> = named("svg").filter(|svg| svg.attribute("class") != Some("swatch")).collect();
    assert!(plots.len() >= 15, "{} plots", plots.len());
    for plot in plots {
        let title = plot.attribute("aria-label").expect("a name for screen readers");
        let labels = plot.descendants().filter(|node| node.attribute("class") == Some("label")).count();
        let marks = plot.descendants().filter(|n| n.has_tag_name("path") || n.has_tag_name("rect")).count();
        assert!(labels == 2 && marks > 0, "{title}: {labels} labels, {marks} marks");
        // No coordinate of a drawing may be NaN or infinite.
        let numbers = ["x", "y", "d", "points", "height"];
        for node in plot.descendants() {
            for value in numbers.iter().filter_map(|name| node.attribute(*name)) {
                assert!(!value.contains("NaN") && !value.contains("inf"), "{title}: {value}");
            }
        }
    }
}

#[test]
fn a_small_report_is_whole_and_agrees_with_its_certificates() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write_beam_scene(folder.path(), MR, GRID, 100.0);
    let out = folder.path().join("report");
    let arguments = ["report", text(&scene), "--small", "--out", text(&out), "--threads", "2"];
    let output = palpate(&arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    let steps: Vec<&str> = said.lines().filter(|line| line.contains("step ")).collect();
    let last = steps.last().expect("steps are counted");
    let (done, total) =
        last.split_once("step ").and_then(|(_, s)| s.split_once(':')?.0.split_once(" of ")).unwrap();
    assert_eq!((done, steps.len()), (total, total.parse().unwrap()), "{said}");
    check_page(&out);

    let methods = rows(&out.join("methods.csv"));
    assert_eq!(methods.len(), 2 * 7, "two grids and every method");
    for row in &methods {
        let (grid, method) = (&row["grid"], &row["method"]);
        let blob = out.join(format!("work/beam-{grid}-{method}.blob"));
        let certificate = certificate(&blob);
        let space = &certificate["spaces"][0];
        // Tables of one method may also serve another.
        let of_blob = space["methods"].as_array().expect("a list");
        let of_method = of_blob.iter().find(|m| m["method"] == method.as_str()).expect("the method");
        let uniform = &of_method["uniform"];
        assert!(number(row, "positions") > 30.0, "{row:?}");
        for (column, figure) in [
            ("positions", &uniform["count"]),
            ("mean_n", &uniform["mean_n"]),
            ("p50_n", &uniform["p50_n"]),
            ("p95_n", &uniform["p95_n"]),
            ("p99_n", &uniform["p99_n"]),
            ("max_n", &uniform["max_n"]),
            ("below_jnd_certified", &of_method["below_jnd_certified"]),
            ("branch_jump_positions", &of_method["at_branch_jumps"]["count"]),
            ("seam_n", &of_method["probe"]["seam_n"]),
            ("work_mean_share", &of_method["probe"]["work"]["mean"]),
            ("configurations", &space["cost"]["configurations"]),
            ("solve_seconds", &space["cost"]["seconds"]),
        ] {
            assert_eq!(Some(number(row, column)), figure.as_f64(), "{column} of {method} on {grid}");
        }
        let size = std::fs::metadata(&blob).expect("the blob is there").len() as f64;
        assert!(
            number(row, "blob_bytes") == size
                && number(row, "table_bytes") > 100.0
                && number(row, "table_bytes") < size
        );
        assert!(number(row, "nanoseconds") > 0.0);
    }
    let error = |method: &str, grid: &str| {
        let row = methods.iter().find(|row| row["method"] == method && row["grid"] == grid).expect("a row");
        number(row, "mean_n")
    };
    assert!(error("energy", "122") < error("trilinear", "122") / 10.0);

    // The same rows as JSON, path means from the paths, and every certificate.
    let in_json = json(&out.join("methods.json"));
    assert_eq!(in_json.as_array().map(Vec::len), Some(methods.len()));
    assert_eq!(in_json[0]["mean_n"].as_f64(), Some(number(&methods[0], "mean_n")));
    assert_eq!(json(&out.join("certificates.json")).as_array().map(Vec::len), Some(methods.len()));
    let paths = rows(&out.join("paths.csv"));
    for mean in rows(&out.join("means.csv")) {
        let of: Vec<f64> = paths
            .iter()
            .filter(|p| p["grid"] == mean["grid"] && p["method"] == mean["method"] && p["positions"] != "0")
            .map(|p| number(p, "mean_n"))
            .collect();
        let (expected, found) = (of.iter().sum::<f64>() / of.len() as f64, number(&mean, "mean_n"));
        assert!((found - expected).abs() <= 1e-12 * expected, "{mean:?}");
    }
    // A second run solves and fits nothing, and changes only times.
    let written = |name: &str| std::fs::metadata(out.join(name)).and_then(|m| m.modified()).expect("a time");
    let kept = ["work/beam-122-energy.blob", "work/beam-32-energy.blob"];
    let before = kept.map(written);
    let output = palpate(&arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(kept.map(written), before);
    for (old, new) in methods.iter().zip(rows(&out.join("methods.csv"))) {
        let but = |row: &BTreeMap<String, String>| {
            let mut row = row.clone();
            row.remove("nanoseconds");
            row
        };
        assert_eq!(but(old), but(&new));
    }

    // The existing space refuses another scene with the same name.
    write_beam_scene(folder.path(), MR, GRID, 1.0);
    let output = palpate(&arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.lines().last().is_some_and(|line| line.contains("beam-32.space")), "{said}");
}

#[test]
fn nonsense_is_refused_in_one_line_before_anything_is_solved() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write_beam_scene(folder.path(), MR, GRID, 100.0);
    let other = folder.path().join("other.toml");
    std::fs::copy(&scene, &other).expect("copied");
    let bare = folder.path().join("bare.toml");
    let whole = std::fs::read_to_string(&scene).expect("the scene");
    std::fs::write(&bare, whole.replace(&format!("[grid]\n{GRID}\n"), "")).expect("written");
    let out = folder.path().join("report");
    let (scene, other, bare, out_name) = (text(&scene), text(&other), text(&bare), text(&out));
    let refused = |arguments: &[&str], words: &[&str]| {
        crate::refused(&[&["report"][..], arguments, &["--out", out_name]].concat(), words);
        assert!(!out.exists(), "{arguments:?} left a folder behind");
    };
    refused(&[scene, "--grids", "500"], &["--grids 500", "514", "14146"]);
    refused(&[scene, other], &["other.toml", "second scene", "beam"]);
    refused(&[bare], &["bare.toml", "[grid]"]);
    refused(&[scene, "--active", "Z"], &["no active node `Z`", "A"]);
    refused(&[scene, "--radius-mm", "-3"], &["--radius-mm -3", "positive"]);
    refused(&["missing.toml"], &["missing.toml"]);
    let output = palpate(&["report", scene, "--method", "magic", "--out", out_name]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("energy"));
    let file = folder.path().join("file");
    std::fs::write(&file, "a file").expect("written");
    let output = palpate(&["report", scene, "--out", text(&file)]);
    assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
}
