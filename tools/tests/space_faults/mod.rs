//! Faults that a long precomputation must survive, injected around the real binary: kills, signals, a full
//! disk, read-only folders, damaged pages, an edited scene, a second writer. After each fault the same
//! command ends with the same bits.

mod columns;
mod damage;
mod disk;
mod kills;
mod outputs;
mod read_only;
mod refusals;
mod signals;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use palpate_precompute::num::{SPLIT_MIX_STEP, split_mix, unit_interval};
use palpate_tests::write_beam_scene;

use crate::GRID as SMALL;

/// 1014 points: half a second.
const LARGE: &str = "radius_m = 0.01\nspacing_m = 0.002";

fn scene(folder: &Path, grid: &str) -> PathBuf {
    write_beam_scene(folder, crate::MR, grid, 100.0)
}

fn palpate() -> Command {
    Command::new(env!("CARGO_BIN_EXE_palpate"))
}

/// `palpate precompute`, not yet started.
fn precompute(scene: &Path, space: &Path, threads: usize) -> Command {
    let mut command = palpate();
    command.arg("precompute").arg(scene).arg("--out").arg(space).args(["--threads", &threads.to_string()]);
    command
}

fn output(mut command: Command) -> Output {
    crate::run(&mut command)
}

fn succeeds(command: Command) {
    let output = output(command);
    assert!(output.status.success(), "{:?}: {}", output.status, String::from_utf8_lossy(&output.stderr));
}

/// Runs a command that must end with `code` and one line that contains every word. Returns the line.
fn fails(command: Command, code: i32, words: &[&str]) -> String {
    crate::refusal(&output(command), code, words)
}

/// `palpate inspect --csv` of a store, every attempt or only those that count, as sorted rows. The table is
/// written to `aside`.
fn rows(space: &Path, aside: &Path, all_tries: bool) -> Vec<String> {
    let csv = aside.join("rows.csv");
    let mut command = palpate();
    command.arg("inspect").arg(space).arg("--csv").arg(&csv);
    if all_tries {
        command.arg("--all-tries");
    }
    succeeds(command);
    let table = std::fs::read_to_string(&csv).expect("the table is written");
    let mut rows: Vec<String> = table.lines().map(String::from).collect();
    // All rows after the header.
    rows[1..].sort_unstable();
    rows
}

/// The rows of every attempt that a run kept, sorted; none if it stopped before it created its tables.
fn kept(space: &Path, aside: &Path) -> Vec<String> {
    if !space.exists() {
        return Vec::new();
    }
    let mut probe = palpate();
    probe.arg("inspect").arg(space);
    let probe = output(probe);
    if !probe.status.success() {
        let said = String::from_utf8_lossy(&probe.stderr);
        assert!(said.contains("contains no configuration yet"), "{said}");
        return Vec::new();
    }
    let mut rows = rows(space, aside, true);
    // `counts` and the `jump_` columns of a row change with its neighbours.
    let head: Vec<String> = rows.remove(0).split(',').map(String::from).collect();
    let of_the_row = |column: usize| head[column] != "counts" && !head[column].starts_with("jump_");
    let mut rows: Vec<String> = rows
        .iter()
        .map(|row| {
            let cells = row.split(',').enumerate().filter(|(column, _)| of_the_row(*column));
            cells.map(|(_, cell)| cell).collect::<Vec<_>>().join(",")
        })
        .collect();
    rows.sort_unstable();
    rows
}

/// The content of a store except the wall-clock seconds: the rows that count, then those of every attempt.
fn dump(space: &Path, aside: &Path) -> [Vec<String>; 2] {
    [false, true].map(|all_tries| {
        let rows = rows(space, aside, all_tries);
        let seconds = rows[0].split(',').position(|name| name == "seconds").expect("the column is there");
        let cut = |row: &String| {
            let cells = row.split(',').enumerate().filter(|(column, _)| *column != seconds);
            cells.map(|(_, cell)| cell).collect::<Vec<_>>().join(",")
        };
        rows.iter().map(cut).collect()
    })
}

/// The dump of a space without interruptions.
fn undisturbed(scene: &Path, folder: &Path) -> [Vec<String>; 2] {
    let space = folder.join("undisturbed.space");
    succeeds(precompute(scene, &space, 2));
    dump(&space, folder)
}

/// SplitMix64 (Steele, Lea and Flood 2014).
pub(super) struct Draws(pub(super) u64);

impl Draws {
    pub(super) fn next(&mut self) -> u64 {
        let random = split_mix(self.0);
        self.0 = self.0.wrapping_add(SPLIT_MIX_STEP);
        random
    }

    /// Uniform in [0, 1).
    pub(super) fn unit(&mut self) -> f64 {
        unit_interval(self.next())
    }
}
