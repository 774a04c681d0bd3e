//! `palpate identify`: outputs, bad input and interruption. The numerics have their tests in the crates.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use roxmltree::Document;
use serde_json::Value;

use crate::{palpate, refused, run, text};

/// Five rows of the GetFEM push on the small organ, in millimetres.
const DATA: &str = "# by GetFEM\ntest,dx_mm,dy_mm,dz_mm,fx_n,fy_n,fz_n\n";

/// A scene with a guess in a folder of its own, and a table.
fn inputs(rows: &str) -> (tempfile::TempDir, PathBuf, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets").canonicalize().expect("assets");
    let scene = folder.path().join("guess.toml");
    let words = format!(
        "name = \"guess\" # a comment\n[mesh]\nfile = \"{}/liver-small.msh\"\n[material]\nlaw = \"mooney-rivlin\"\n\
         c10_pa = 1700.0\nc01_pa = 900.0\n[fixed]\ngroup = \"F1\"\n[[active]]\nname = \"A1\"\nnode = 199\n",
        assets.display()
    );
    std::fs::write(&scene, words).expect("writable");
    let data = folder.path().join("data.csv");
    std::fs::write(&data, rows).expect("writable");
    (folder, scene, data)
}

/// The rows of the push and the side test that GetFEM solved, every `step`th.
fn golden(step: usize) -> String {
    let all = include_str!("../../tests/peers/golden/indentation.csv");
    let mut lines = all.lines();
    let header = lines.next().expect("a header").to_owned();
    let rows = lines.filter(|line| !line.starts_with("pull")).skip(step - 1).step_by(step);
    rows.fold(header, |table, row| table + "\n" + row) + "\n"
}

#[test]
fn the_constants_are_in_words_json_scene_drawing_and_table() {
    let (folder, scene, data) = inputs(&golden(4));
    let [out, plot, csv] = ["fitted.toml", "fit.svg", "fit.csv"].map(|name| folder.path().join(name));
    let base = ["identify", text(&scene), "--data", text(&data), "--free", "c10_pa,c01_pa"];
    let files = ["--out", text(&out), "--plot", text(&plot), "--csv", text(&csv)];
    let output = palpate(&[&base[..], &files].concat());
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{said} {}", String::from_utf8_lossy(&output.stderr));
    for words in [
        "c10_pa    1300.0",
        "c01_pa    1280.0",
        "95 % interval",
        "correlation of c10_pa and c01_pa: -0.99",
        "fitted.toml",
    ] {
        assert!(said.contains(words), "`{words}` is not in: {said}");
    }
    let fitted = std::fs::read_to_string(&out).expect("written");
    assert!(fitted.contains("# a comment") && !fitted.contains("1700"), "{fitted}");
    let drawing = std::fs::read_to_string(&plot).expect("written");
    let drawing = Document::parse(&drawing).expect("SVG");
    let lines = drawing.descendants().filter(|node| node.has_tag_name("polyline")).count();
    assert_eq!(lines, 2, "a line for each test");
    let table = std::fs::read_to_string(&csv).expect("written");
    assert!(
        table.starts_with("line,test,dx_m,dy_m,dz_m,fx_n,fy_n,fz_n,model_x_n,model_y_n,model_z_n\n2,push,"),
        "{table}"
    );
    assert_eq!(table.lines().count(), 11);
    // The fitted scene is a scene, and its constants are the solution.
    let again = ["identify", text(&out), "--data", text(&data), "--free", "c10_pa,c01_pa", "--json"];
    let found: Value = serde_json::from_slice(&palpate(&again).stdout).expect("JSON");
    let parameters = found["parameters"].as_array().expect("parameters");
    for (parameter, (name, truth)) in parameters.iter().zip([("c10_pa", 1300.0), ("c01_pa", 1280.0)]) {
        let number = |key: &str| parameter[key].as_f64().expect("a number");
        assert_eq!(parameter["name"], name);
        assert!((number("value") - truth).abs() < 1e-5 && number("low") <= number("value"), "{parameter}");
        assert!(number("value") <= number("high"), "{parameter}");
    }
}

#[test]
fn a_depth_along_a_direction_is_enough() {
    let (_folder, scene, data) = inputs("depth_mm,force_mn\n2,390\n4,791.6\n6,1206\n8,1636\n10,2080\n");
    let output = palpate(&[
        "identify",
        text(&scene),
        "--data",
        text(&data),
        "--free",
        "c10_pa",
        "--direction",
        "0.05,-0.13,-0.99",
        "--json",
    ]);
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(found["rows"][0]["measured_n"].as_array().map(Vec::len), Some(1), "{found}");
    assert!(
        found["parameters"][0]["value"].as_f64().is_some_and(|value| (1400.0..2000.0).contains(&value)),
        "{found}"
    );
}

#[test]
fn bad_input_is_one_line_and_writes_nothing() {
    let (folder, scene, data) = inputs(DATA);
    let out = folder.path().join("fitted.toml");
    let with = |rows: &str, free: &str, more: &[&str], words: &[&str]| {
        std::fs::write(&data, rows).expect("writable");
        let base = ["identify", text(&scene), "--data", text(&data), "--free", free, "--out", text(&out)];
        refused(&[&base[..], more].concat(), words);
        assert!(!out.exists(), "nothing is written");
    };
    let row = "dx_m,dy_m,dz_m,fx_n,fy_n,fz_n\n0,0,-0.004,-0.2,-0.1,-0.8\n";
    with(
        "dx,dy,dz,fx_n,fy_n,fz_n\n0,0,-0.004,0,0,-1\n",
        "c10_pa",
        &[],
        &["data.csv:1:", "states no unit", "dx_m or dx_mm"],
    );
    with(&row.replace("-0.8", "nan"), "c10_pa", &[], &["data.csv:2:", "fz_n = `nan` is not a finite number"]);
    with(
        &row.replace("-0.8", "0.8"),
        "c10_pa",
        &[],
        &["data.csv:2: the forces point against those of the model", "change the sign"],
    );
    with("depth_m,force_n\n0.01,1\n", "c10_pa", &[], &["needs its direction"]);
    let short = "depth_m,force_n\n0.01,1\n0.02,2\n";
    with(short, "c10_pa,c01_pa", &["--direction=0,0,-1"], &["2 measured force components for 2 constants"]);
    with(row, "c10_pa,c01_pa", &[], &["1 measured places for 2 constants", "measure at more places"]);
    with(&row.replace("-0.2,-0.1,-0.8", "0,0,0"), "c10_pa", &[], &["all forces are zero"]);
    with(&row.replace(',', ";"), "c10_pa", &[], &["separated by \";\"", "commas"]);
    with(row, "young_pa", &[], &["guess.toml:", "no material has the constant `young_pa`", "c10_pa, c01_pa"]);
    with(
        row,
        "c10_pa",
        &["--bounds", "c10_pa=2000:"],
        &["is not within its bounds 2000 to inf", "begin within them"],
    );
    with(row, "c10_pa", &["--bounds", "c10_pa"], &["NAME=LOW:HIGH"]);
    with(row, "c10_pa", &["--active", "B7"], &["no active node \"B7\"", "A1"]);
    refused(
        &["identify", text(&scene), "--data", "none.csv", "--free", "c10_pa"],
        &["none.csv", "check the path"],
    );
    let base = ["identify", text(&scene), "--data", text(&data), "--free", "c10_pa", "--out", text(&scene)];
    refused(&base, &["is the input", "choose another name"]);
}

#[test]
fn an_interrupted_fit_writes_nothing() {
    let (folder, scene, data) = inputs(&golden(1));
    let out = folder.path().join("fitted.toml");
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
    let mut base = vec!["identify", text(&scene), "--data", text(&data), "--free", "c10_pa,c01_pa"];
    base.extend(["--out", text(&out), "--threads", "1"]);
    let child =
        command.args(&base).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program runs");
    std::thread::sleep(Duration::from_millis(300));
    kill(Pid::from_raw(child.id() as i32), Signal::SIGINT).expect("it lives");
    let output = child.wait_with_output().expect("it ends");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    // Lines of progress may come before.
    assert_eq!(said.lines().last(), Some("palpate: interrupted; nothing is written"), "{said}");
    assert!(!out.exists(), "{said}");
    // The same command then does its work.
    assert!(run(Command::new(env!("CARGO_BIN_EXE_palpate")).args(&base)).status.success());
    assert!(out.exists());
}
