//! `palpate map` through the binary: its figures, its files, and what it refuses.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;

use crate::{palpate, refused, text};

fn bundled(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/scenes").join(name);
    path.canonicalize().expect("a bundled file")
}

/// The scene `lump` with linear elements, and this tool.
fn lump(folder: &Path, tool: &str) -> PathBuf {
    let scene = fs::read_to_string(bundled("lump.toml")).expect("text");
    let (before, rest) = scene.split_once("[tool]").expect("a tool");
    let (_, after) = rest.split_once("[[active]]").expect("places");
    let scene = format!("{before}{tool}\n[[active]]{after}")
        .replace("\"lump.msh\"", &format!("{:?}", bundled("lump.msh")))
        .replace("order = 2", "order = 1");
    let path = folder.join("lump.toml");
    fs::write(&path, scene).expect("writable");
    path
}

const FINGER: &str = "[tool]\nshape = \"fingertip\"\nradius_m = 0.01\nstiffness_pa_m = 2e6\n";

/// The rows of a table by the names of its columns.
fn rows(table: &Path) -> Vec<BTreeMap<String, String>> {
    let mut reader = csv::Reader::from_path(table).expect("a table");
    reader.deserialize().map(|row| row.expect("a row")).collect()
}

fn number(row: &BTreeMap<String, String>, column: &str) -> f64 {
    row[column].parse().unwrap_or_else(|_| panic!("{column} is no number: {row:?}"))
}

#[test]
fn the_files_of_a_map_have_the_figures_that_it_prints() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = lump(folder.path(), FINGER);
    let [csv, vtu, png] = ["map.csv", "map.vtu", "map.png"].map(|name| folder.path().join(name));
    let map = ["map", text(&scene), "--inclusion", "lump", "--points", "40", "--force-n", "0.3"];
    let files = ["--csv", text(&csv), "--vtu", text(&vtu), "--picture", text(&png), "--json"];
    let output = palpate(&[&map[..], &files].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let figures: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let rows = rows(&csv);
    assert_eq!((rows.len() as u64, figures["places"].as_u64()), (40, Some(40)));
    let column = |name: &str| rows.iter().map(|row| number(row, name)).collect::<Vec<_>>();
    let largest = |name: &str| column(name).into_iter().fold(f64::MIN, f64::max);
    assert_eq!(Some(largest("stiffness_n_m")), figures["stiffness_n_m"]["largest"].as_f64());
    assert_eq!(Some(largest("depth_m")), figures["depth_m"]["largest"].as_f64());
    let felt = &figures["inclusion"];
    assert_eq!(Some(largest("detectability")), felt["detectability"]["largest"].as_f64());
    for row in &rows {
        assert_eq!(row["status"], "reached");
        let [force, without] = ["force_n", "force_without_n"].map(|name| number(row, name));
        assert!((force - 0.3).abs() < 1e-6, "{row:?}");
        let expected = (force - without).abs() / (0.07 * without).max(0.02);
        assert!((number(row, "detectability") - expected).abs() < 1e-9, "{row:?}");
    }
    let area = |row: &&BTreeMap<String, String>| number(row, "area_m2");
    let whole: f64 = rows.iter().map(|row| area(&row)).sum();
    let above: f64 = rows.iter().filter(|row| number(row, "detectability") > 1.0).map(|row| area(&row)).sum();
    assert!((felt["area_share"].as_f64().expect("a share") - above / whole).abs() < 1e-9);
    // The place that is felt most is above the lump, at x = 22 mm.
    assert!(felt["position_m"][0].as_f64().is_some_and(|x| x > 0.005), "{felt}");
    let grid = fs::read_to_string(&vtu).expect("text");
    for name in ["stiffness_n_m", "depth_m", "detectability", "pushed", "jnd"] {
        assert!(grid.contains(&format!("Name=\"{name}\"")), "{name}");
    }
    assert!(fs::read(&png).expect("a picture").starts_with(b"\x89PNG"));
    // The same again, whatever the threads.
    let again = palpate(&[&map[..], &["--threads", "1", "--json"]].concat());
    assert_eq!(again.stdout, output.stdout);
}

#[test]
fn a_map_without_an_inclusion_has_a_summary_and_a_point_tool_a_warning() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = lump(folder.path(), "");
    let of_nodes = fs::read_to_string(&scene).expect("text").replace("\npoint = ", "\nnearest = ");
    fs::write(&scene, of_nodes).expect("writable");
    let output = palpate(&["map", text(&scene), "--points", "5", "--force-n", "0.1"]);
    let (said, warned) = (
        String::from_utf8_lossy(&output.stdout).into_owned(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    );
    assert!(output.status.success(), "{warned}");
    for words in ["lump: 5 places on ", "point tool, P1", "stiffness at rest, N/m", "depth at 0.1 N, mm"] {
        assert!(said.contains(words), "`{words}` is not in: {said}");
    }
    assert!(!said.contains("detectability") && warned.contains("depend on the mesh"), "{said}{warned}");
    let finger = palpate(&["map", text(&scene), "--points", "2", "--force-n", "0.1", "--fingertip-mm", "10"]);
    let said = String::from_utf8_lossy(&finger.stdout);
    assert!(finger.status.success() && said.contains("fingertip of 10 mm, P1"), "{said}");
}

#[test]
fn a_sweep_has_a_row_for_each_ball() {
    let folder = tempfile::tempdir().expect("a folder");
    let (scene, csv) = (lump(folder.path(), FINGER), folder.path().join("sweep.csv"));
    let sweep =
        ["map", text(&scene), "--sweep", "--under", "beside", "--force-n", "0.3", "--csv", text(&csv)];
    let balls = ["--covers-mm", "4,10,80", "--radii-mm", "5", "--ratios", "2,8"];
    let output = palpate(&[&sweep[..], &balls].concat());
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let rows = rows(&csv);
    let states: Vec<&str> = rows.iter().map(|row| row["status"].as_str()).collect();
    assert_eq!(states, ["reached", "reached", "reached", "reached", "does not fit", "does not fit"]);
    let felt: Vec<f64> = rows[..4].iter().map(|row| number(row, "detectability")).collect();
    assert!(felt[1] > felt[0] && felt[1] > felt[3] && felt[3] > felt[2], "{felt:?}");
    let line = said.lines().find(|line| line.trim_start().starts_with("4 ")).expect("a row of the table");
    assert!(line.contains(&format!("{:.2}", felt[0])) && line.contains(&format!("{:.2}", felt[1])), "{line}");
    assert!(said.contains("whole tets") && said.contains("does not fit"), "{said}");
}

#[test]
fn what_has_no_map_is_refused_in_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = lump(folder.path(), FINGER);
    let map = ["map", text(&scene)];
    let refused = |more: &[&str], words: &[&str]| refused(&[&map[..], more].concat(), words);
    refused(&["--inclusion", "lumps"], &["no group \"lumps\"", "lump, tissue"]);
    refused(&["--ball-mm", "200,0,0,5"], &["outside of the body"]);
    refused(&["--ball-mm", "-20,0,40,8"], &["reaches through the skin"]);
    refused(&["--ball-mm", "1,2,3"], &["4 numbers"]);
    refused(&["--force-n", "0"], &["--force-n", "positive"]);
    refused(&["--jnd", "2"], &["--jnd", "0.07"]);
    refused(&["--points", "0"], &["--points"]);
    refused(&["--fingertip-mm", "500"], &["--fingertip-mm 500", "quarter"]);
    refused(&["--sweep", "--under", "here"], &["--under here", "lump, beside"]);
    refused(&["--inclusion", "lump", "--csv", text(&scene)], &["would be overwritten"]);
    // A group without a material of its own.
    let whole = folder.path().join("whole.toml");
    let text_of = fs::read_to_string(&scene).expect("text");
    let (before, rest) = text_of.split_once("[[material]]").expect("materials");
    let (_, after) = rest.split_once("[fixed]").expect("a fixed part");
    let one = "[material]\nlaw = \"neo-hookean\"\nmu_pa = 1400.0\nlambda_pa = 12600.0\n";
    fs::write(&whole, format!("{before}{one}[fixed]{after}")).expect("writable");
    crate::refused(&["map", text(&whole), "--inclusion", "lump"], &["no [[material]] of its own"]);
    let sphere = lump(folder.path(), "[tool]\nshape = \"sphere\"\nradius_m = 0.01\n");
    let without_places = fs::read_to_string(&sphere).expect("text");
    let (before, _) = without_places.split_once("[[active]]").expect("places");
    fs::write(&sphere, before).expect("writable");
    crate::refused(&["map", text(&sphere)], &["slides on the skin", "--fingertip-mm"]);
}

/// Ctrl-C in the middle: one line, and no file.
#[test]
fn an_interrupted_map_writes_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let [csv, png] = ["map.csv", "map.png"].map(|name| folder.path().join(name));
    let scene = bundled("tumour.toml");
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
    command.args([
        "map",
        text(&scene),
        "--inclusion",
        "tumour",
        "--csv",
        text(&csv),
        "--picture",
        text(&png),
    ]);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the program runs");
    let mut lines =
        BufReader::new(child.stderr.take().expect("a pipe")).lines().map(|line| line.expect("text"));
    // The first line of progress.
    let first =
        lines.by_ref().find(|line| line.contains(" of ") && line.contains(" places, ")).expect("a line");
    assert!(first.starts_with("tumour: map, "), "{first}");
    kill(Pid::from_raw(child.id().cast_signed()), Signal::SIGINT).expect("it runs");
    let rest: Vec<String> = lines.filter(|line| !line.starts_with("tumour: map, ")).collect();
    assert_eq!(rest, ["palpate: interrupted; nothing is written"]);
    assert_eq!(child.wait().expect("it ends").code(), Some(1));
    assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 0);
}
