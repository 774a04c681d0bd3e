//! Tests `palpate plan` on the bundled organ: its table and figures, and its predictions for a scattered
//! space within a factor of two. Seconds are printed, not asserted, because the machine may be shared.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

fn palpate(arguments: &[&str]) -> String {
    let output =
        Command::new(env!("CARGO_BIN_EXE_palpate")).args(arguments).output().expect("the binary runs");
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("text")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("the folder's name is plain")
}

/// The bundled organ with the error in place of the spacing, touched at one node.
fn scene(folder: &Path) -> PathBuf {
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets");
    let written = std::fs::read_to_string(assets.join("liver-small.toml")).expect("the bundled scene");
    let mesh = assets.join("liver-small.msh").canonicalize().expect("the bundled mesh");
    let mut lines: Vec<String> = Vec::new();
    let mut in_second = false;
    for line in written.lines() {
        if line.starts_with('[') {
            in_second = false;
        }
        if line == "[[active]]" && lines.iter().any(|line| line == "[[active]]") {
            in_second = true;
        }
        if !in_second {
            lines.push(line.replace("spacing_m = 0.01", "cannot_be_felt = true"));
        }
    }
    let whole = lines.join("\n").replace("\"liver-small.msh\"", &format!("{:?}", text(&mesh)));
    let path = folder.join("organ.toml");
    std::fs::write(&path, whole).expect("the scene is written");
    path
}

#[test]
fn what_is_foretold_happens_within_a_factor_of_two() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path());
    let [space, blob] = ["organ.space", "organ.blob"].map(|name| folder.path().join(name));
    let table = palpate(&["plan", text(&scene)]);
    println!("{table}");
    assert!(table.contains("Recommended: P1/P1, scattered positions, energy"), "{table}");
    assert!(table.contains("P2/P1") && table.contains("lattice 10.00 mm"), "{table}");

    palpate(&["precompute", text(&scene), "--out", text(&space)]);
    palpate(&["pack", text(&space), "--out", text(&blob), "--no-certificate"]);
    let checked = palpate(&["plan", text(&scene), "--check", text(&space), "--blob", text(&blob), "--json"]);
    let figures: Value = serde_json::from_str(&checked).expect("JSON");
    let mut asserted = 0;
    for compared in figures["check"].as_array().expect("what happened") {
        println!("{compared}");
        let what = compared["what"].as_str().expect("a name");
        if what.ends_with("configurations") || what == "blob" {
            assert_eq!(compared["holds"], Value::Bool(true), "{compared}");
            asserted += 1;
        }
    }
    assert_eq!(asserted, 2);
    assert_eq!(figures["recommended"]["recommended"], Value::Bool(true));
    assert!(figures["rows"].as_array().expect("rows").len() > 10);
}

#[test]
fn a_space_of_another_scene_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path());
    let missing = folder.path().join("missing.space");
    let output = Command::new(env!("CARGO_BIN_EXE_palpate"))
        .args(["plan", text(&scene), "--check", text(&missing)])
        .output()
        .expect("the binary runs");
    assert_eq!(output.status.code(), Some(2));
}
