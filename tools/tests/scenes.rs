//! Tests the bundled scenes from file to certificate: each has the result that it states, and the scene that
//! must not be used is reported as such.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::run;

/// Runs `palpate`, which must succeed. Returns its output as JSON.
fn palpate(args: &[&str]) -> Value {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
    let output = run(command.current_dir(root).args(args));
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap_or(Value::Null)
}

/// Solves, packs and measures at this number of new positions. Returns the spaces of the certificate.
fn certified(scene: &str, uniform: &str) -> Vec<Value> {
    let folder = tempfile::tempdir().expect("a folder");
    let [space, blob] = ["space", "blob"].map(|end| folder.path().join(scene).with_extension(end));
    let [space, blob] = [&space, &blob].map(|path| path.to_str().expect("plain"));
    let scene = format!("assets/scenes/{scene}.toml");
    palpate(&["precompute", &scene, "--out", space]);
    let pack = ["pack", space, "--out", blob, "--uniform", uniform, "--discretisation", "2", "--json"];
    let certificate = palpate(&pack);
    certificate["spaces"].as_array().expect("spaces").clone()
}

fn verdict(space: &Value) -> (&str, String) {
    let reasons = space["health"]["reasons"].as_array().expect("reasons");
    let words: Vec<&str> = reasons.iter().filter_map(|reason| reason["what"].as_str()).collect();
    (space["health"]["verdict"].as_str().expect("a verdict"), words.join("; "))
}

/// The errors at independent positions of the method that `run` selects.
fn uniform(space: &Value) -> &Value {
    let methods = space["methods"].as_array().expect("some");
    &methods.iter().find(|of| of["method"] == "energy").expect("it is packed")["uniform"]
}

/// The force errors are below the just-noticeable difference.
#[test]
fn the_seven_scenes_cannot_be_felt_and_none_is_red() {
    // Solves with quadratic elements take ten times as long.
    for (scene, nodes, positions, exceptions) in [
        ("palpation", 1, 20, 1),
        ("deep-push", 1, 60, 2),
        ("long-pull", 1, 60, 2),
        ("tumour", 2, 20, 1),
        ("fibres", 1, 60, 2),
        ("gravity", 1, 60, 2),
        ("lump", 2, 20, 1),
    ] {
        let spaces = certified(scene, &positions.to_string());
        assert_eq!(spaces.len(), nodes, "{scene}");
        for space in spaces {
            let (colour, why) = verdict(&space);
            println!("{scene} {}: {colour} {why}", space["active"]);
            assert_ne!(colour, "red", "{scene}: {why}");
            let uniform = uniform(&space);
            let [count, below_jnd] =
                ["count", "below_jnd"].map(|key| uniform[key].as_u64().expect("a number"));
            // One position in a hundred may exceed it; more of so few are improbable.
            assert!(
                3 * count >= 2 * positions && below_jnd + exceptions >= count,
                "{scene}: {below_jnd} of {count}"
            );
            // With a fingertip the elements are good enough, with nodes they cannot be.
            let has_size = scene != "long-pull";
            assert_eq!(why.contains("the tool holds nodes"), !has_size, "{scene}: {why}");
            assert!(!why.contains("too stiff"), "{scene}: {why}");
        }
    }
}

/// The force of the fingertip on a straight path, N, by depth in steps of 2 mm, and the iterations of each step.
fn pushed(active: &str, direction: &str) -> Vec<(f64, u32)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
    command.current_dir(root).args(["path", "assets/scenes/lump.toml", "--active", active]);
    command.arg(format!("--direction={direction}"));
    let output = run(command.args(["--step-mm", "2", "--steps", "6", "--csv", "-"]));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let table = String::from_utf8_lossy(&output.stdout).into_owned();
    let rows = table.lines().skip(1).map(|line| line.split(',').collect::<Vec<_>>());
    let number = |row: &[&str], column: usize| row[column].parse::<f64>().expect("a number");
    rows.map(|row| ((4..7).map(|k| number(&row, k).powi(2)).sum::<f64>().sqrt(), number(&row, 8) as u32))
        .collect()
}

/// The lump is ten times as stiff as its surroundings; at half the depth it is felt as well.
#[test]
fn a_fingertip_feels_the_lump() {
    let [lump, beside] =
        [("lump", "-0.3,0,-0.954"), ("beside", "0.3,0,-0.954")].map(|(name, inward)| pushed(name, inward));
    println!("{lump:?} {beside:?}");
    assert_eq!((lump.len(), beside.len()), (6, 6));
    for (over, away) in lump.iter().zip(&beside) {
        assert!(over.0 > 1.2 * away.0 && over.1 <= 6 && away.1 <= 6, "{over:?} {away:?}");
    }
    // Smooth to 1.2 radii of the pad: each step adds a like force.
    for forces in [lump, beside] {
        assert!(forces.windows(2).all(|pair| pair[1].0 > pair[0].0 + 0.7 * forces[0].0), "{forces:?}");
    }
}

#[test]
fn a_light_touch_is_linear_and_palpation_is_not() {
    let spaces = certified("light-touch", "30");
    let linear = &spaces[0]["linear"];
    let uniform = uniform(&spaces[0]);
    println!("{linear} {uniform}");
    assert!(linear["tests"] == 10 && linear["worst"].as_f64().is_some_and(|worst| worst < 1.0), "{linear}");
    assert!(uniform["count"] == uniform["below_jnd"] && spaces[0]["health"]["verdict"] == "green");
    assert!(certified("palpation", "5")[0]["linear"].is_null());
}

#[test]
fn a_strip_that_buckles_is_red() {
    let spaces = certified("buckling-strip", "20");
    let (colour, why) = verdict(&spaces[0]);
    assert_eq!(colour, "red", "{why}");
    assert!(why.contains("branch jump") && why.contains("two stable solutions"), "{why}");
}
