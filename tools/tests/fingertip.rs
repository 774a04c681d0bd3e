//! The fingertip through the command line: from a scene to a hand that slides over contact points.

use std::path::Path;

use palpate_tests::write_beam_scene;

use crate::{MR, palpate, refused, text};

/// The beam under a fingertip; `active` says where.
fn scene(folder: &Path, active: &str) -> std::path::PathBuf {
    let scene = write_beam_scene(folder, MR, "radius_m = 0.01\ncannot_be_felt = true", 4.0);
    let written = std::fs::read_to_string(&scene).expect("written");
    let (head, rest) = written.split_once("[[active]]").expect("an active node");
    let (_, tail) = rest.split_once("\n[").expect("a table after it");
    let tool = "[tool]\nshape = \"fingertip\"\nradius_m = 0.02\nstiffness_pa_m = 1e6\n";
    std::fs::write(&scene, format!("{head}[[active]]\n{active}\n\n[{tail}\n{tool}")).expect("written");
    scene
}

fn ok(arguments: &[&str]) -> String {
    let output = palpate(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// A table of controls gives one row each, and those of a straight line the rows of the straight path.
#[test]
fn a_table_of_controls_is_a_path() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path(), "name = \"T\"\npoint = [0.055, 0.017, 0.05]");
    let table = folder.path().join("controls.csv");
    std::fs::write(&table, "x_m,y_m,z_m\n0,0,-0.001\n0,0,-0.002\n0,0,-0.003\n").expect("written");
    let straight = ok(&["path", text(&scene), "--direction=0,0,-1", "--steps", "3"]);
    let listed = ok(&["path", text(&scene), "--controls", text(&table)]);
    assert_eq!(listed, straight);
    assert_eq!(listed.lines().count(), 4);
    let force = |line: &str| line.split(',').nth(6).expect("fz_n").parse::<f64>().expect("a number");
    assert!(listed.lines().skip(1).all(|line| force(line) < -0.05), "{listed}");
    let both = ["path", text(&scene), "--direction=0,0,-1", "--controls", text(&table)];
    refused(&both, &["cannot be used with"]);
    std::fs::write(&table, "x_m,y_m\n0,0\n").expect("written");
    refused(&["path", text(&scene), "--controls", text(&table)], &["z_m", "required"]);
    std::fs::write(&table, "x_m,y_m,z_m\n").expect("written");
    refused(&["path", text(&scene), "--controls", text(&table)], &["--controls", "no row"]);
}

#[test]
fn a_scene_without_a_tool_refuses_a_point() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path(), "name = \"T\"\npoint = [0.055, 0.017, 0.05]");
    let written = std::fs::read_to_string(&scene).expect("written");
    let (without, _) = written.split_once("[tool]").expect("the tool");
    std::fs::write(&scene, without).expect("written");
    refused(&["inspect", text(&scene)], &["`point` of \"T\"", "tool with a size", "[tool]"]);
}

/// The skin of the beam is covered by contact points; a resumed run and a pack use those of the space, and a
/// hand slides over their triangles.
#[test]
fn the_skin_is_covered_and_touched_anywhere() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path(), "name = \"skin\"\ngroup = \"surface\"");
    let at = |name: &str| folder.path().join(name);
    let (space, blob) = (at("a.space"), at("a.blob"));
    ok(&["precompute", text(&scene), "--out", text(&space)]);
    let again = ok(&["precompute", text(&scene), "--out", text(&space)]);
    assert!(again.contains(" 0 solved now"), "{again}");
    ok(&["pack", text(&space), "--out", text(&blob), "--uniform", "3"]);
    let shown: serde_json::Value =
        serde_json::from_str(&ok(&["inspect", text(&blob), "--json"])).expect("JSON");
    let points = shown["spaces"].as_array().expect("spaces").len();
    let (slides, of) = (&shown["sliding"]["triangles"], &shown["sliding"]["of"]);
    println!("{points} contact points, {slides} triangles");
    // The skin without its fixed end, 33 of 42 nodes, under a pad as large as an element, and more near the edges of
    // the beam, where the force changes within an element.
    assert!((33..300).contains(&points), "{points}");
    // The error of the discretisation is measured once and kept in the space.
    let mesh = &shown["certificate"]["discretisation"];
    assert_eq!(
        (mesh["elements"].as_str(), mesh["positions"].as_array().map(Vec::len)),
        (Some("P1/P1"), Some(6))
    );
    let again = palpate(&["pack", text(&space), "--out", text(&at("b.blob")), "--uniform", "3"]);
    let (said, errors) = (String::from_utf8_lossy(&again.stdout), String::from_utf8_lossy(&again.stderr));
    assert!(again.status.success() && !errors.contains("more accurate elements"), "{errors}");
    assert!(said.contains("P1/P1, h = ") && said.contains("% too stiff"), "{said}");
    assert!(slides == of && slides.as_u64() > Some(8), "{slides} of {of}");
    let stiffness = shown["fingertip"]["stiffness_n_m"].as_f64().expect("a number");
    assert!((stiffness / (1e6 * std::f64::consts::PI * 4e-4 / 3.0) - 1.0).abs() < 1e-6, "{stiffness}");
    let touched = ok(&[
        "run",
        text(&blob),
        "--uncertified",
        "--headless",
        "--frame-rate",
        "0",
        "--seconds",
        "2",
        "--json",
    ]);
    let session: serde_json::Value = serde_json::from_str(&touched).expect("JSON");
    let contacts = session["session"]["touch"]["contacts"].as_u64();
    assert!(contacts > Some(0) && session["session"]["fault"].is_null(), "{touched}");
}
