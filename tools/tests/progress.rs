//! Tests the progress lines of `palpate precompute` on a pipe, at a strip that buckles: its search stagnates
//! and a lattice takes over.

use std::path::Path;

use crate::{palpate, text};

/// The strip with adaptive sampling within 2 cm: about 12 configurations a second.
fn strip(folder: &Path) -> std::path::PathBuf {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/scenes");
    let mesh = scenes.join("strip.msh").canonicalize().expect("the bundled mesh");
    let text = format!(
        "name = \"strip\"\n[mesh]\nfile = {mesh:?}\n[material]\nlaw = \"neo-hookean\"\nyoung_pa = 300000.0\npoisson = 0.4\n\
         [fixed]\nbox = {{ min = [-0.001, -1.0, -1.0], max = [0.0001, 1.0, 1.0] }}\n\
         [[active]]\nname = \"tip\"\nnearest = [0.1, 0.0067, 0.005]\n\
         [grid]\nradius_m = 0.02\ncannot_be_felt = true\n[device]\nmax_force_n = 8.0\n"
    );
    let path = folder.join("strip.toml");
    std::fs::write(&path, text).expect("the scene is written");
    path
}

#[test]
fn a_lattice_that_takes_over_is_in_the_progress_lines() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = strip(folder.path());
    let space = folder.path().join("strip.space");
    let output = palpate(&["precompute", text(&scene), "--out", text(&space)]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let line = said
        .lines()
        .find(|line| line.starts_with("strip: node 1 of 1: lattice took over the search, "))
        .unwrap_or_else(|| panic!("no line of the lattice in:\n{said}"));
    // Attempts so far, the new total, time so far and time left.
    let (_, counts) = line.split_once("search, ").expect("counts");
    let numbers: Vec<usize> = counts.split(' ').filter_map(|word| word.parse().ok()).collect();
    assert!(numbers[0] >= 80 && numbers[1] > numbers[0] + 300, "{line}");
    assert!(line.contains(" s elapsed, about ") && line.ends_with(" left"), "{line}");
}
