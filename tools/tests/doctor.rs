//! Tests `palpate doctor`, and the timing options of `palpate run`. No result depends on the performance of
//! this PC.

use std::path::Path;

use crate::palpate;

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("text")
}

/// Share of the ticks in the last row of a quantity, and the number of ticks.
fn rows(csv: &str, quantity: &str) -> (f64, u64) {
    assert_eq!(csv.lines().next(), Some("quantity,ns,count,share"));
    let of = csv.lines().filter(|line| line.split(',').next() == Some(quantity));
    of.fold((0.0, 0), |(_, sum), line| {
        let cells: Vec<&str> = line.split(',').collect();
        (cells[3].parse().expect("a share"), sum + cells[2].parse::<u64>().expect("a count"))
    })
}

#[test]
fn it_looks_without_measuring() {
    let shown = palpate(&["doctor", "--seconds", "0"]);
    assert!(shown.status.success(), "{}", text(&shown.stderr));
    let table = text(&shown.stdout);
    assert!(
        table.contains("kernel") && table.contains("priority") && !table.contains("wake-up late"),
        "{table}"
    );
    let json = palpate(&["doctor", "--seconds", "0", "--json", "--cpu", "0"]);
    let figures: serde_json::Value = serde_json::from_slice(&json.stdout).expect("JSON");
    // A guard was started, and none remains.
    let guard = figures["checks"].as_array().and_then(|checks| {
        checks.iter().find(|check| check["name"] == "guard").map(|check| check.to_string())
    });
    let guard = guard.expect("a check");
    let is_started = guard.contains("starts within") && guard.contains("10 ms after the last tick");
    assert!(is_started && !guard.contains("\"bad\"") && table.contains("guard"), "{guard}");
    assert!(figures["checks"].as_array().is_some_and(|checks| checks.len() >= 15));
    assert_eq!((&figures["cpu"], &figures["measured"]), (&0.into(), &serde_json::Value::Null));
}

#[test]
fn a_measurement_has_its_histogram() {
    let folder = tempfile::tempdir().expect("a temporary directory");
    let csv = folder.path().join("wake.csv");
    let file = csv.to_str().expect("text");
    let args =
        ["doctor", "--measure", "0.2", "--fifo", "0", "--period-us", "2000", "--json", "--histograms", file];
    let measured = palpate(&args);
    // 1 if this machine is currently too busy for 1 kHz.
    assert!(matches!(measured.status.code(), Some(0 | 1)), "{}", text(&measured.stderr));
    let figures: serde_json::Value = serde_json::from_slice(&measured.stdout).expect("JSON");
    let of = &figures["measured"];
    let ticks = of["lateness_ns"]["count"].as_u64().expect("ticks");
    assert_eq!(ticks + of["missed_deadlines"].as_u64().expect("a count"), 100);
    assert_eq!((&of["policy"], &of["period_us"]), (&"SCHED_OTHER".into(), &2000.into()));
    let table = std::fs::read_to_string(&csv).expect("written");
    let (share, counted) = rows(&table, "wake");
    assert!((share - 1.0).abs() < 1e-9 && counted == ticks, "{share} {counted}");
}

#[test]
fn a_run_shows_what_was_granted_and_its_histograms() {
    let folder = tempfile::tempdir().expect("a temporary directory");
    let blob = Path::new(env!("CARGO_MANIFEST_DIR")).join("../firmware-like-core/golden/organ-514.blob");
    let (blob, csv) = (blob.to_str().expect("text"), folder.path().join("run.csv"));
    let file = csv.to_str().expect("text");
    let mut args = vec!["run", blob, "--uncertified", "--headless", "--frame-rate", "0", "--seconds", "0.3"];
    args.extend(["--cpu", "999999", "--fifo", "0", "--spin-us", "0", "--verbose", "--histograms", file]);
    let run = palpate(&args);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let (out, err) = (text(&run.stdout), text(&run.stderr));
    assert!(err.contains("haptic thread: SCHED_OTHER") && err.contains("refused: CPU pinning"), "{err}");
    for line in
        ["scheduler    not asked", "CPU pinning  refused", "kernel       ", "governor", "device       "]
    {
        assert!(out.contains(line), "{line} in {out}");
    }
    assert!(out.contains("wake-up lateness") && out.contains('\u{2588}') && !out.contains("frames"), "{out}");
    let table = std::fs::read_to_string(&csv).expect("written");
    let counts: Vec<u64> = ["wake", "device", "compute"].map(|quantity| rows(&table, quantity).1).to_vec();
    assert!(counts[0] > 0 && counts.iter().all(|count| *count == counts[0]), "{counts:?}");
}

#[test]
fn nonsense_is_refused() {
    for args in [["doctor", "--fifo", "98"], ["doctor", "--period-us", "50"], ["doctor", "--seconds", "-1"]] {
        let refused = palpate(&args);
        assert_eq!(refused.status.code(), Some(2), "{args:?}: {}", text(&refused.stderr));
    }
}
