//! Stores that must not be continued: of an edited scene, of another solver, or with a writer.

use std::process::Stdio;

use super::{LARGE, SMALL, dump, fails, precompute, scene, succeeds};

#[test]
fn a_scene_edited_between_runs_is_refused_and_the_line_names_what_differs() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = scene(folder.path(), SMALL);
    let space = folder.path().join("a.space");
    succeeds(precompute(&file, &space, 2));
    let before = dump(&space, folder.path());
    let text = std::fs::read_to_string(&file).expect("the scene");
    let mesh_file = folder.path().join("beam.msh");
    let mesh = std::fs::read_to_string(&mesh_file).expect("the mesh");
    let edits = [
        ("c10_pa = 1300.0", "c10_pa = 1400.0"),
        ("spacing_m = 0.005", "spacing_m = 0.004"),
        ("max_force_n = 100.0", "max_force_n = 90.0"),
    ];
    for (old, new) in edits {
        std::fs::write(&file, text.replace(old, new)).expect("written");
        let differs = format!("({old}, now {new})");
        fails(precompute(&file, &space, 2), 2, &["a.space", "different scene or mesh", &differs, "--out"]);
    }
    // Inserted and deleted lines move the other lines. A new name is not a difference.
    let limit = "[device]\nmax_force_n = 100.0\n";
    let weight = "[body_force]\nforce_n_per_m3 = [0.0, 0.0, -1.0]\n";
    let moves = [
        ("[grid]\n", "[grid]\nincrements = 3\n", "(nothing, now increments = 3)"),
        ("[grid]\n", "[grid]\ncomplete_cells = false\n", "(nothing, now complete_cells = false)"),
        (limit, "", "(max_force_n = 100.0, now nothing)"),
        (limit, &format!("{limit}{weight}"), "(nothing, now force_n_per_m3 = [0.0, 0.0, -1.0])"),
    ];
    for (old, new, differs) in moves {
        for name in ["beam", "other"] {
            let edited = text.replacen(old, new, 1).replacen("\"beam\"", &format!("{name:?}"), 1);
            assert_ne!(edited, text, "{old} is there");
            std::fs::write(&file, edited).expect("written");
            fails(precompute(&file, &space, 2), 2, &["a.space", "different scene or mesh", differs, "--out"]);
        }
    }
    std::fs::write(&file, &text).expect("written");
    // The last corner of the box, moved outwards by 0.1 mm.
    std::fs::write(&mesh_file, mesh.replace(" 0.08 0.04 0.04\n", " 0.0801 0.04 0.04\n")).expect("written");
    fails(precompute(&file, &space, 2), 2, &["a.space", "different scene or mesh (mesh ", "--out"]);
    std::fs::write(&mesh_file, &mesh).expect("written");
    // A change that affects no number is accepted.
    std::fs::write(&file, format!("# a remark\n{text}")).expect("written");
    succeeds(precompute(&file, &space, 2));
    assert_eq!(dump(&space, folder.path()), before);
}

#[test]
fn a_store_of_another_solver_is_refused_by_that_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = scene(folder.path(), SMALL);
    let space = folder.path().join("a.space");
    succeeds(precompute(&file, &space, 2));
    // The version is text in the file; another one of the same length replaces it.
    let mut bytes = std::fs::read(&space).expect("checkpointed");
    let version = concat!(env!("CARGO_PKG_VERSION"), ".").as_bytes();
    let at =
        bytes.windows(version.len()).position(|w| w == version).expect("the solver's version is in the file");
    bytes[at] = b'9';
    std::fs::write(&space, &bytes).expect("written");
    fails(precompute(&file, &space, 2), 2, &["a.space", "different version of the solver (9.", "--out"]);
    let mut salvage = precompute(&file, &space, 2);
    salvage.arg("--salvage");
    fails(salvage, 2, &["different version of the solver"]);
}

#[test]
fn a_second_process_may_not_write_and_does_no_harm() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = scene(folder.path(), LARGE);
    let space = folder.path().join("a.space");
    let mut first = precompute(&file, &space, 1);
    let mut first = first.stdout(Stdio::null()).spawn().expect("runs");
    let log = folder.path().join("a.space-wal");
    while log.metadata().map_or(0, |log| log.len()) == 0 {
        assert!(first.try_wait().expect("a state").is_none(), "it wrote no log");
    }
    fails(precompute(&file, &space, 1), 2, &["a.space", "another process is writing it"]);
    let mut salvage = precompute(&file, &space, 1);
    salvage.arg("--salvage");
    fails(salvage, 2, &["a.space", "another process is writing it"]);
    assert!(first.try_wait().expect("a state").is_none(), "the first was still at it");
    assert!(first.wait().expect("reaped").success());
    let found = dump(&space, folder.path());
    assert_eq!(found, super::undisturbed(&file, folder.path()));
}
