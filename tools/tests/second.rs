//! Tests `palpate live --second`: two hands on one body, each with a session of its own.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;

use crate::{palpate, quiet, refused, text};

const SCENES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/scenes");
const UNSEEN: [&str; 3] = ["--headless", "--frame-rate", "0"];

/// The command of the bundled pinch.
fn pinch(more: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
    command.args(["live", &format!("{SCENES}/pinch.toml")]).args(UNSEEN);
    command.args(["--device", &format!("sim:{SCENES}/pinch-1.csv")]);
    command.args(["--second", &format!("sim:{SCENES}/pinch-2.csv")]).args(more);
    command
}

/// Both hands feel the body that the other one deforms, and what they felt is recorded and replayed.
#[test]
fn two_hands_pinch_a_lump() {
    let folder = tempfile::tempdir().expect("a folder");
    let recording = folder.path().join("a.mcap");
    let output = {
        let _alone = quiet();
        let session = ["--seconds", "5", "--check", "100", "--json", "--record", text(&recording)];
        pinch(&session).output().expect("it runs")
    };
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("palpate: second tool: haptic thread"), "{said}");
    let first: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let second = &first["second"]["report"];
    for of in [&first, second] {
        let number = |value: &Value| value.as_f64().unwrap_or_else(|| panic!("{of:#}"));
        println!("{:#}", of["live"]);
        assert!(number(&of["live"]["checked"]) >= 10.0, "{of:#}");
        assert!(number(&of["live"]["not_felt_share"]) > 0.9, "{of:#}");
        assert!(number(&of["session"]["touch"]["peak_reaction_n"]) > 0.4, "{of:#}");
        assert!(number(&of["session"]["touch"]["largest_step_n"]) < 0.15, "{of:#}");
    }
    let scene = format!("{SCENES}/pinch.toml");
    for name in ["a.mcap", "a-second.mcap"] {
        let replay = format!("replay:{}", text(&folder.path().join(name)));
        let output = palpate(&[&["live", &scene, "--device", &replay][..], &UNSEEN].concat());
        let told = String::from_utf8_lossy(&output.stdout);
        assert!(
            told.contains("all forces bit-identical"),
            "{told}{}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
}

/// The first session is killed: the second one ends, and with it its device.
#[test]
fn a_second_session_ends_with_the_first_one() {
    let _alone = quiet();
    let mut first = pinch(&[]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it starts");
    std::thread::sleep(Duration::from_secs(2));
    let children = format!("/proc/{0}/task/{0}/children", first.id());
    let children = std::fs::read_to_string(children).expect("readable");
    let is_second = |pid: &&str| {
        let words = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        String::from_utf8_lossy(&words).contains("--beside")
    };
    let second = children.split_whitespace().find(is_second).expect("a second session");
    let second = Pid::from_raw(second.parse().expect("a number"));
    first.kill().expect("it lives");
    first.wait().expect("it has ended");
    let begun = Instant::now();
    while kill(second, None).is_ok() && begun.elapsed() < Duration::from_secs(20) {
        // A process that nobody waits for stays as a name.
        let state = std::fs::read_to_string(format!("/proc/{second}/stat")).unwrap_or_default();
        if state.contains(") Z ") || state.is_empty() {
            return;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    let lives = kill(second, Signal::SIGKILL).is_ok();
    assert!(!lives, "the second session lives on");
}

#[test]
fn a_second_tool_that_cannot_be_is_refused() {
    let scene = format!("{SCENES}/pinch.toml");
    let live = |more: &[&str], words: &[&str]| {
        refused(&[&["live", &scene, "--seconds", "1"][..], &UNSEEN, more].concat(), words);
    };
    live(&["--second", "mouse"], &["--second", "no window"]);
    live(&["--second", "nothing"], &["no device `nothing`"]);
    live(&["--second-profile", "falcon"], &["--second"]);
    live(&["--second", "link:/dev/no-such-port"], &["second tool", "/dev/no-such-port"]);
    live(&["--device", "link:/dev/a", "--second", "link:/dev/a"], &["--device and --second", "two devices"]);
    live(&["--check", "3", "--friction", "0.3"], &["--check", "--friction"]);
    live(
        &["--second", "sim", "--set", "tool.radius_m=0.007", "--set", "tool.radius_m=0.009"],
        &["--set", "one value"],
    );
    live(&["--beside"], &["--second"]);
    let held = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/liver-small.toml");
    refused(&[&["live", held, "--second", "sim"][..], &UNSEEN].concat(), &["sphere"]);
    let folder = tempfile::tempdir().expect("a folder");
    let way = folder.path().join("way.csv");
    for (rows, words) in [
        ("x_m,y_m,z_m\n0,0,0\n", ["column t_s is required", "t_s,x_m,y_m,z_m"]),
        ("t_s,x_m,y_m,z_m\n0,0,0,0\n0.1,1,0,0\n", ["way.csv", "0.8 m/s"]),
        ("t_s,x_m,y_m,z_m\n0,0,nan,0\n", ["way.csv:2", "finite"]),
    ] {
        std::fs::write(&way, rows).expect("writable");
        live(&["--device", &format!("sim:{}", text(&way))], &words);
    }
}
