//! Damaged pages, tested with the binary, with intermediate states in the file.

use std::path::Path;

use palpate_precompute::num::EnergyJet;
use palpate_precompute::space::Store;
use palpate_precompute::spec::GridIndex;

use super::{Draws, dump, fails, palpate, precompute, scene, succeeds};

const PAGE: usize = 4096;
const WITH_PARTS: &str = "radius_m = 0.01\nspacing_m = 0.005\ncomplete_cells = false\nincrements = 3";

fn intermediate(space: &Path) -> Vec<(GridIndex, u32, EnergyJet)> {
    Store::open(space).and_then(|store| store.intermediate(0)).expect("intact")
}

#[test]
fn salvage_keeps_the_states_on_the_way_and_ends_as_if_nothing_had_been() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path(), WITH_PARTS);
    let whole = folder.path().join("whole.space");
    succeeds(precompute(&scene, &whole, 2));
    let (expected, on_the_way) = (dump(&whole, folder.path()), intermediate(&whole));
    assert_eq!(on_the_way.len(), 2 * 32);
    let bytes = std::fs::read(&whole).expect("checkpointed");
    // A page without content, of an empty table, cannot be damaged.
    let middle = |page: usize| page * PAGE + 100..page * PAGE + PAGE - 100;
    let pages: Vec<usize> =
        (0..bytes.len() / PAGE).filter(|&page| bytes[middle(page)].iter().any(|&b| b != 0)).collect();
    let (mut saved, mut solved_again) = (0, 0);
    let mut draws = Draws(7);
    for _ in 0..12 {
        let page = pages[draws.next() as usize % pages.len()];
        let torn = folder.path().join(format!("torn{page}.space"));
        let mut bytes = bytes.clone();
        for byte in &mut bytes[middle(page)] {
            *byte ^= 0x5a;
        }
        std::fs::write(&torn, bytes).expect("written");
        let mut command = precompute(&scene, &torn, 2);
        command.args(["--salvage", "--json"]);
        let output = super::output(command);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "page {page}: {said}");
        let figures: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let again = figures["solved_now"].as_u64().expect("a number");
        (saved, solved_again) = (saved + 33_u64.saturating_sub(again), solved_again + again);
        assert_eq!(dump(&torn, folder.path()), expected, "page {page}");
        assert_eq!(intermediate(&torn), on_the_way, "page {page}");
    }
    println!("12 damaged files: {saved} tries saved, {solved_again} solved again");
    assert!(saved > 10 * 20 && solved_again > 0, "{saved} saved, {solved_again} solved again");
}

/// One flipped bit of one number, which SQLite does not detect. The row's checksum detects it, in the run and
/// in the salvage, whether or not the run needs that row.
#[test]
fn a_single_flipped_bit_is_noticed_and_mended() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path(), WITH_PARTS);
    let space = folder.path().join("a.space");
    succeeds(precompute(&scene, &space, 2));
    let (expected, on_the_way) = (dump(&space, folder.path()), intermediate(&space));
    let records = Store::open(&space).and_then(|store| store.records(0)).expect("intact");
    // SQLite stores a REAL with the high byte first; Palpate's binary columns have the low byte first.
    let energy = records[20].equilibrium().expect("solved").energy_j.to_be_bytes().to_vec();
    let force_on_the_way = on_the_way[40].2.force_n[2].to_le_bytes().to_vec();
    let store = Store::open(&space).expect("intact");
    let moved = store.displacements(0, records[25].index, records[25].attempt).expect("its state");
    drop(store);
    let far = moved.iter().position(|u| u.iter().all(|x| *x != 0.0)).expect("a node that moves");
    let state: Vec<u8> = moved[far].iter().flat_map(|x| x.to_le_bytes()).collect();
    for (number, lowest) in [(energy, 7), (force_on_the_way, 0), (state, 4)] {
        let mut bytes = std::fs::read(&space).expect("checkpointed");
        // A page split may leave a copy in the free space of another page, which is never read.
        let found = bytes.windows(number.len()).enumerate().filter(|(_, window)| *window == number);
        let places: Vec<usize> = found.map(|(at, _)| at).collect();
        assert!((1..4).contains(&places.len()), "the number is there {} times", places.len());
        for at in places {
            bytes[at + lowest] ^= 1;
        }
        std::fs::write(&space, &bytes).expect("written");
        fails(precompute(&scene, &space, 2), 2, &["a.space", "is damaged", "--salvage"]);
        let mut inspect = palpate();
        inspect.arg("inspect").arg(&space);
        fails(inspect, 2, &["a.space", "is damaged", "--salvage"]);
        let mut salvage = precompute(&scene, &space, 2);
        salvage.args(["--salvage", "--json"]);
        let output = super::output(salvage);
        let figures: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(figures["solved_now"], 1, "the one that was damaged: {said}");
        assert_eq!(
            (dump(&space, folder.path()), intermediate(&space)),
            (expected.clone(), on_the_way.clone())
        );
    }
}

#[test]
fn an_intact_file_is_not_salvaged() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path(), WITH_PARTS);
    let space = folder.path().join("a.space");
    succeeds(precompute(&scene, &space, 2));
    let expected = (dump(&space, folder.path()), intermediate(&space));
    let mut command = precompute(&scene, &space, 2);
    command.arg("--salvage");
    fails(command, 2, &["a.space", "is not damaged", "without --salvage"]);
    assert_eq!((dump(&space, folder.path()), intermediate(&space)), expected);
    assert!(!folder.path().join("a.damaged-1.space").exists());
}

/// A program with the text of the schema, an archive of a space, and a database with tables of the same names.
#[test]
fn files_that_only_contain_the_text_of_a_space_are_not_salvaged() {
    let folder = tempfile::tempdir().expect("a folder");
    let (scene, space) = (scene(folder.path(), super::SMALL), folder.path().join("a.space"));
    succeeds(precompute(&scene, &space, 2));
    let archive = [vec![b'x'; 512], std::fs::read(&space).expect("checkpointed")].concat();
    let program = std::fs::read(env!("CARGO_BIN_EXE_palpate")).expect("the program");
    let database = folder.path().join("d.sqlite");
    let connection = rusqlite::Connection::open(&database).expect("created");
    let tables = "CREATE TABLE meta (a); CREATE TABLE configuration (a); CREATE TABLE state (a);";
    connection.execute_batch(tables).expect("written");
    drop(connection);
    for bytes in [archive, program, std::fs::read(&database).expect("closed")] {
        let other = folder.path().join("other");
        std::fs::write(&other, &bytes).expect("written");
        let mut command = precompute(&scene, &other, 1);
        command.arg("--salvage");
        fails(command, 2, &["other", "not a space"]);
        assert!(std::fs::read(&other).expect("there") == bytes, "the file is unchanged");
    }
}

#[test]
fn salvage_leaves_alone_what_is_of_another_scene_or_not_there() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene_file = scene(folder.path(), super::SMALL);
    let space = folder.path().join("a.space");
    let mut absent = precompute(&scene_file, &space, 1);
    absent.arg("--salvage");
    fails(absent, 2, &["a.space", "No such file"]);
    assert!(!space.exists(), "nothing is made where nothing can be saved");
    succeeds(precompute(&scene_file, &space, 2));
    let before = dump(&space, folder.path());
    scene(folder.path(), "radius_m = 0.01\nspacing_m = 0.004");
    let mut other = precompute(&scene_file, &space, 1);
    other.arg("--salvage");
    fails(other, 2, &["a.space", "different scene or mesh", "spacing_m = 0.005", "0.004", "--out"]);
    assert_eq!(dump(&space, folder.path()), before, "the good file stays where it is");
    let mut inspect = palpate();
    inspect.arg("inspect").arg(&space);
    succeeds(inspect);
}
