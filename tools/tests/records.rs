//! What `tests/peers/records` reads from `palpate bench`: the force that other finite-element codes must reach,
//! and the forces of every interpolant at given displacements.

use std::path::Path;

use serde_json::Value;

use crate::{palpate, refused, text};

/// Forces of GetFEM on the bodies of `bench fem` (`tests/peers/golden/bodies.csv`), N.
const BODIES: &str = include_str!("../../tests/peers/golden/bodies.csv");
const ASSETS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets");
/// A real organ with every method.
const BLOB: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../firmware-like-core/golden/organ-514.blob");

fn json(arguments: &[&str]) -> Value {
    let output = palpate(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// Three numbers of a table's row from a column on.
fn three(cells: &[&str], first: usize) -> [f64; 3] {
    [0, 1, 2].map(|n| cells[first + n].parse().expect("a number"))
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

fn array(value: &Value) -> [f64; 3] {
    [0, 1, 2].map(|n| value[n].as_f64().expect("a number"))
}

#[test]
fn the_force_of_the_benchmark_is_that_of_getfem() {
    let cases = "stvk-p1-small,mr-p1p1-small";
    let rows = json(&["bench", "fem", "--assets", ASSETS, "--cases", cases, "--repetitions", "1", "--json"]);
    for name in cases.split(',') {
        let row = BODIES.lines().find(|line| line.starts_with(name)).expect("the case is in the table");
        let exact = three(&row.split(',').collect::<Vec<_>>(), 1);
        let found = rows.as_array().and_then(|rows| rows.iter().find(|row| row["case"] == name));
        let found = array(&found.expect("the case is measured")["force_n"]);
        let size = apart(exact, [0.0; 3]);
        assert!(size > 1.0 && apart(found, exact) < 1e-9 * size, "{name}: {found:?}, GetFEM {exact:?}");
    }
}

#[test]
fn the_answers_of_the_benchmark_are_the_forces_of_the_blob() {
    let folder = tempfile::tempdir().expect("a folder");
    let [points, csv] = ["points.csv", "forces.csv"].map(|name| folder.path().join(name));
    let rows: String = (1..60)
        .map(|n| [1.3, 2.9, 4.7].map(|by| 0.028 * f64::sin(f64::from(n) * by)))
        .map(|[x, y, z]| format!("{x},{y},{z}\n"))
        .collect();
    std::fs::write(&points, format!("x_m,y_m,z_m\n{rows}")).expect("written");
    let figures =
        json(&["bench", "core", "--blob", BLOB, "--points", text(&points), "--rounds", "1", "--json"]);
    let measured = figures["rows"].as_array().expect("rows");
    let mut largest = 0.0f64;
    for row in measured {
        let method = row["method"].as_str().expect("a name");
        if row["instructions"] == "peer" {
            continue;
        }
        let query = ["query", BLOB, "--method", method, "--points", text(&points), "--force", "--csv"];
        assert!(palpate(&[&query[..], &[text(&csv)]].concat()).status.success(), "{method}");
        let table = std::fs::read_to_string(&csv).expect("the forces");
        let answers = row["answers"].as_array().expect("answers");
        assert_eq!(answers.len(), 59, "{method}");
        for (answer, line) in answers.iter().zip(table.lines().skip(1)) {
            let exact = three(&line.split(',').collect::<Vec<_>>(), 3);
            assert!(apart(array(answer), exact) < 2e-5, "{row}: {line}");
            largest = largest.max(apart(exact, [0.0; 3]));
        }
    }
    assert!(measured.len() >= 7 && largest > 0.5, "{} rows, {largest} N", measured.len());
}

#[test]
fn answers_need_a_blob_and_json() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml");
    for arguments in [
        &["bench", "core", "--points", text(&here), "--json"][..],
        &["bench", "core", "--blob", BLOB, "--points", text(&here)],
    ] {
        assert_eq!(palpate(arguments).status.code(), Some(2), "{arguments:?}");
    }
    refused(&["bench", "core", "--blob", BLOB, "--points", text(&here), "--json"], &["Cargo.toml", "x_m"]);
}
