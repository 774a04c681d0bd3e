//! Time to the first touch: from the command to the first force, as a new process.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

use super::figures::{Best, Others, Row, Section, Table};
use super::organs::Ready;
use super::run::{Context, WORK, finished};
use super::scenes::ORGANS;
use crate::failure::Failure;

/// Name of the section.
pub(super) const KEY: &str = "start";

/// Its table.
pub(super) const TABLE: &str = "start.first_touch";
/// Columns of the table.
pub(super) const COLUMNS: [&str; 2] = ["live", "blob"];
/// What live touches: key of the row, name, and scene in the folder of the assets.
const LIVE: [(&str, &str, &str); 3] = [
    ("small", "liver, 498 nodes, linear", "liver-small.toml"),
    ("large", "liver, 2,030 nodes, linear", "liver-large.toml"),
    ("demo", "liver, 498 nodes, quadratic, fingertip", "demo.toml"),
];
/// Scenes of the assets that it uses beside those of the organs.
pub(super) const SCENES: [&str; 3] = [LIVE[0].2, LIVE[1].2, LIVE[2].2];

/// Keys of the rows.
pub(super) fn rows() -> Vec<String> {
    let keys = LIVE.iter().map(|live| live.0).chain(ORGANS.iter().map(|organ| organ.name));
    keys.map(|key| format!("{key}_s")).collect()
}

/// Commands per organ; the median counts.
const REPEATS: [usize; 2] = [5, 1];

/// Runs this program with `args` and returns the number at a path of its JSON report.
fn number(args: &[&str], at: &str) -> Result<f64, Failure> {
    let program = std::env::current_exe().map_err(Failure::work)?;
    let said = Command::new(program)
        .args(args)
        .args(["--headless", "--frame-rate", "0", "--json"])
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .map_err(Failure::work)?;
    let shown = args.join(" ");
    if !said.status.success() {
        return Err(Failure::work(format!("`palpate {shown}` failed; run it to see why")));
    }
    let report: serde_json::Value = serde_json::from_slice(&said.stdout).map_err(Failure::work)?;
    let found = report.pointer(at).and_then(serde_json::Value::as_f64);
    found.ok_or_else(|| Failure::work(format!("`palpate {shown}` reports no {at}")))
}

/// Measures the section.
pub(super) fn section(assets: &Path, organs: &[Ready], context: &Context<'_>) -> Result<Section, Failure> {
    let start = Instant::now();
    let live = |scene: &str| (assets.join(scene), ["live", "--seconds", "3"], "/live/first_force_s");
    let mut cases: Vec<_> = LIVE.iter().map(|(key, name, scene)| (*key, *name, live(scene))).collect();
    for ready in organs {
        let words = if ready.scene.name == "point" {
            "blob of \u{201c}point\u{201d}"
        } else {
            "blob of \u{201c}fingertip\u{201d}"
        };
        let run = ["run", "--seconds", "1"];
        cases.push((ready.scene.name, words, (ready.blob_path.clone(), run, "/start_s")));
    }
    let mut table = Table::new(
        TABLE,
        "From the command to the first force",
        "Seconds from the start of the program to the first force, without the way of the hand. \u{201c}live\u{201d} reads scene and mesh \
         and solves; \u{201c}blob\u{201d} reads a table that was made before.",
        "organ",
        COLUMNS.map(String::from).to_vec(),
    );
    table.others = Others::Declared;
    for (key, name, (path, [command, option, seconds], at)) in cases {
        let mut times = Vec::new();
        for _ in 0..REPEATS[usize::from(context.quick)] {
            context.go_on()?;
            let path = path.to_string_lossy();
            let mut args = vec![command, &*path, option, seconds];
            if command == "run" {
                args.push("--uncertified");
            }
            times.push(number(&args, at)?);
        }
        times.sort_by(f64::total_cmp);
        let median = times[times.len() / 2];
        let values = if command == "live" { vec![median, f64::NAN] } else { vec![f64::NAN, median] };
        table.rows.push(Row::new(format!("{key}_s"), format!("{name}, s"), Best::None, values));
    }
    Ok(finished(
        context,
        KEY,
        "Time to the first touch",
        &["How long a person waits between the command and the first force."],
        &[
            "palpate live ASSETS/liver-small.toml --seconds 3 --headless --frame-rate 0 --json",
            &format!(
                "palpate run OUT/{WORK}/point.blob --uncertified --seconds 1 --headless --frame-rate 0 --json"
            ),
        ],
        start.elapsed().as_secs_f64(),
        vec![table],
    ))
}
