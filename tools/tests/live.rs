//! Tests `palpate live`: touch without a precomputation, with the solver as a process of its own.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use crate::{palpate, quiet, refused, text};

/// The bundled organ, held at its nodes.
const SCENE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/liver-small.toml");
/// A capsule over a lump, and its way.
const PROBE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/scenes/probe.toml");
const PROBE_WAY: &str = concat!("sim:", env!("CARGO_MANIFEST_DIR"), "/../assets/scenes/probe.csv");
/// No pictures.
const UNSEEN: [&str; 3] = ["--headless", "--frame-rate", "0"];

fn figures(output: &Output) -> serde_json::Value {
    let said = String::from_utf8_lossy(&output.stderr);
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {said}"))
}

/// A probe presses, turns by a quarter and rocks; its replay has the same bits, which need the orientation.
#[test]
fn a_probe_is_turned_on_a_lump() {
    let folder = tempfile::tempdir().expect("a folder");
    let recording = folder.path().join("probe.mcap");
    let session = ["live", PROBE, "--device", PROBE_WAY, "--seconds", "6.5", "--check", "60", "--json"];
    let output = {
        let _alone = quiet();
        let record = ["--record", text(&recording)];
        Command::new(env!("CARGO_BIN_EXE_palpate"))
            .args(session)
            .args(record)
            .args(UNSEEN)
            .output()
            .expect("it runs")
    };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let figures = figures(&output);
    println!("{:#}", figures["live"]);
    let number = |value: &serde_json::Value| value.as_f64().unwrap_or_else(|| panic!("{figures:#}"));
    assert!(number(&figures["live"]["checked"]) >= 15.0, "{figures:#}");
    assert!(number(&figures["live"]["not_felt_share"]) > 0.95, "{figures:#}");
    let touch = &figures["session"]["touch"];
    assert!((3e-3..2e-2).contains(&number(&touch["peak_reaction_n_m"])), "{touch:#}");
    assert!(number(&touch["largest_step_n"]) < 0.05, "{touch:#}");

    let replay = format!("replay:{}", text(&recording));
    let output = palpate(&[&["live", PROBE, "--device", &replay][..], &UNSEEN].concat());
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("all forces bit-identical"), "{said}");
    refused(&[&["live", PROBE, "--second", "sim"][..], &UNSEEN].concat(), &["--second", "\"sphere\""]);
    let way = folder.path().join("way.csv");
    std::fs::write(&way, "t_s,x_m,y_m,z_m,rx_rad\n0,0,0,0,0\n").expect("writable");
    let device = format!("sim:{}", text(&way));
    refused(&[&["live", PROBE, "--device", &device][..], &UNSEEN].concat(), &["ry_rad"]);
}

/// The path of a probe has the moment of its contact, and the turn changes it.
#[test]
fn a_path_turns_a_probe() {
    let folder = tempfile::tempdir().expect("a folder");
    let centres = folder.path().join("centres.csv");
    std::fs::write(&centres, "x_m,y_m,z_m\n0.022,0,0.056\n0.022,0,0.05\n0.022,0,0.046\n").expect("writable");
    let moments = |more: &[&str]| -> Vec<f64> {
        let path = ["path", PROBE, "--controls", text(&centres), "--details"];
        let output = palpate(&[&path[..], more].concat());
        let table = String::from_utf8_lossy(&output.stdout).into_owned();
        let last = table.lines().last().unwrap_or_else(|| panic!("{output:?}")).to_owned();
        let solve_s: f64 = last.rsplit(',').next().expect("a cell").parse().expect("a number");
        assert!(solve_s > 0.0, "{last}");
        last.split(',').rev().skip(1).take(3).map(|cell| cell.parse().expect("a number")).collect()
    };
    let [straight, turned] = [moments(&[]), moments(&["--turn", "0,0,1.5708"])];
    // Along x the skin falls away, and the probe is turned about y; across, nearly not.
    assert!(straight[1] < -4e-3 && turned[1].abs() < 1e-3, "z y x: {straight:?} {turned:?} N m");
    refused(&["path", PROBE, "--controls", text(&centres), "--active", "A1"], &["--active", "capsule"]);
}

/// A session of which every visited position is compared with a full solution, then its replay.
#[test]
fn a_scene_is_touched_at_once_certified_recorded_and_replayed() {
    let folder = tempfile::tempdir().expect("a folder");
    let recording = folder.path().join("live.mcap");
    let session = ["live", SCENE, "--seconds", "6", "--check", "60", "--json", "--record", text(&recording)];
    let output = {
        let _alone = quiet();
        Command::new(env!("CARGO_BIN_EXE_palpate")).args(session).args(UNSEEN).output().expect("it runs")
    };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let figures = figures(&output);
    let live = &figures["live"];
    println!("{live:#}");
    let number = |value: &serde_json::Value| value.as_f64().unwrap_or_else(|| panic!("{live:#}"));
    assert!(number(&live["checked"]) >= 15.0 && number(&live["unsolved"]) == 0.0, "{live:#}");
    assert!(number(&live["not_felt_share"]) > 0.95, "{live:#}");
    assert!(number(&live["error_mn"]["mean"]) < 20.0, "{live:#}");
    assert!(number(&live["error_mn"]["max"]) >= number(&live["error_mn"]["p99"]), "{live:#}");
    assert!(number(&live["jets"]) > 10.0 && number(&live["lost"]) == 0.0, "{live:#}");
    assert!((0.0..1.0).contains(&number(&live["solver_busy_share"])), "{live:#}");
    assert!(number(&live["first_force_s"]) < 5.0, "{live:#}");
    assert!(number(&live["extrapolated_share"]) < 0.2, "{live:#}");
    assert!(number(&live["handover_max_mn"]) < 100.0, "{live:#}");
    assert!(number(&figures["session"]["touch"]["peak_reaction_n"]) > 0.5, "{figures:#}");

    let replay = format!("replay:{}", text(&recording));
    let output = palpate(&[&["live", SCENE, "--device", &replay][..], &UNSEEN].concat());
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    assert!(said.contains("all forces bit-identical"), "{said}");
    let inspected = palpate(&["inspect", text(&recording), "--json"]);
    assert_eq!(self::figures(&inspected)["method"], "jets");
    // A blob has other forces, and another scene another body.
    let demo = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/demo.toml");
    refused(&[&["live", demo, "--device", &replay][..], &UNSEEN].concat(), &["is of the scene"]);
}

/// What a session touched becomes a space, a certified blob, and what the next session knows from its start.
#[test]
fn what_was_touched_is_kept_and_known_the_next_time() {
    let folder = tempfile::tempdir().expect("a folder");
    let [space, blob] = ["a.space", "a.blob"].map(|name| folder.path().join(name));
    let live = |more: &[&str]| {
        let _alone = quiet();
        let session = ["live", SCENE, "--seconds", "4", "--json", "--check", "20"];
        let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
        let output = command.args(session).args(more).args(UNSEEN).output().expect("it runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        (figures(&output), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (first, _) = live(&["--keep", text(&space)]);
    let kept = &first["kept"];
    let number = |value: &serde_json::Value| value.as_u64().unwrap_or_else(|| panic!("{first:#}"));
    assert!(number(&kept["contacts"]) >= 1 && kept["is_cut"] == false, "{first:#}");
    let (visited, all) = (number(&kept["visited"]), number(&kept["configurations"]));
    assert!(visited >= 5 && all > visited, "{first:#}");
    refused(&["live", SCENE, "--keep", text(&space)], &["a.space", "already exists", "palpate precompute"]);
    // The space holds its scene, and its solves do not depend on the session: they are those of the scene alone.
    let output = palpate(&["precompute", text(&space), "--json"]);
    assert_eq!((figures(&output)["solved_now"].as_u64(), output.status.code()), (Some(0), Some(0)));
    refused(&["precompute", text(&space), "--out", "b.space"], &["continued where it is"]);

    let output = palpate(&["pack", text(&space), "--out", text(&blob), "--uniform", "60"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let (again, said) = live(&["--blob", text(&blob)]);
    assert!(said.contains("contacts are known"), "{said}");
    assert!(again["live"]["not_felt_share"].as_f64().expect("a share") > 0.95, "{again:#}");

    let other = ["live", SCENE, "--blob", text(&blob), "--set"];
    let with = |setting| [&other[..], &[setting]].concat();
    refused(&with("material.c10_pa=2600.0"), &["a.blob", "another stiffness"]);
    let demo = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/demo.toml");
    refused(&["live", demo, "--blob", text(&blob)], &["a.blob", "another"]);
}

/// A session in its own process, its log, and its solver's process.
struct Session {
    child: Child,
}

impl Session {
    fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
        command.arg("live").args(arguments).args(UNSEEN);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        Self { child: command.spawn().expect("it starts") }
    }

    /// Waits for a line on standard error.
    fn wait_for(&mut self, what: &str) {
        let stderr = self.child.stderr.take().expect("piped");
        let mut lines = BufReader::new(stderr);
        let mut line = String::new();
        while lines.read_line(&mut line).expect("readable") > 0 {
            if line.contains(what) {
                self.child.stderr = Some(lines.into_inner());
                return;
            }
            line.clear();
        }
        panic!("it ended without `{what}`");
    }

    /// The process that solves.
    fn solver(&self) -> Pid {
        let children = format!("/proc/{0}/task/{0}/children", self.child.id());
        let children = std::fs::read_to_string(children).expect("readable");
        let of = |pid: &str| {
            let words = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            String::from_utf8_lossy(&words).contains("live-solver")
        };
        let pid = children.split_whitespace().find(|pid| of(pid)).expect("a solver");
        Pid::from_raw(pid.parse().expect("a number"))
    }

    /// Exit code, and both streams.
    fn end(self) -> (Option<i32>, String, String) {
        let output = self.child.wait_with_output().expect("it ends");
        let [stdout, stderr] =
            [output.stdout, output.stderr].map(|s| String::from_utf8_lossy(&s).into_owned());
        (output.status.code(), stdout, stderr)
    }
}

/// The solver dies in the middle of a touch: the force fades and the session ends with its fault.
#[test]
fn the_death_of_the_solver_is_a_fault() {
    let _alone = quiet();
    for signal in [Signal::SIGKILL, Signal::SIGSTOP] {
        let mut session = Session::start(&[SCENE, "--seconds", "20"]);
        session.wait_for("haptic thread");
        std::thread::sleep(Duration::from_millis(1_500));
        let solver = session.solver();
        kill(solver, signal).expect("it lives");
        std::thread::sleep(Duration::from_secs(3));
        kill(Pid::from_raw(session.child.id() as i32), Signal::SIGINT).expect("it lives");
        let (code, told, said) = session.end();
        assert_eq!(code, Some(1), "{told}{said}");
        assert!(said.contains("safe zero: solver"), "{told}{said}");
        assert!(kill(solver, None).is_err(), "the solver ends with its session");
    }
}

/// A core that is stolen for 200 ms does not end the touch.
#[test]
fn a_pause_of_the_solver_is_no_fault() {
    let _alone = quiet();
    let mut session = Session::start(&[SCENE, "--seconds", "4", "--json"]);
    session.wait_for("haptic thread");
    let solver = session.solver();
    for _ in 0..5 {
        std::thread::sleep(Duration::from_millis(300));
        kill(solver, Signal::SIGSTOP).expect("it lives");
        std::thread::sleep(Duration::from_millis(200));
        kill(solver, Signal::SIGCONT).expect("it lives");
    }
    let (code, told, said) = session.end();
    assert_eq!(code, Some(0), "{told}{said}");
    let figures: serde_json::Value = serde_json::from_str(&told).expect("JSON");
    assert!(figures["session"]["fault"].is_null(), "{figures:#}");
    let share = figures["live"]["extrapolated_share"].as_f64().expect("a number");
    assert!(share < 0.5, "{figures:#}");
}

/// The material is changed at the start, and again while the hand touches, over the socket: the touch goes on.
#[test]
fn the_scene_changes_while_a_hand_touches() {
    let alone = quiet();
    let folder = tempfile::tempdir().expect("a folder");
    let socket = folder.path().join("control");
    let session = [
        SCENE,
        "--seconds",
        "7",
        "--json",
        "--control",
        text(&socket),
        "--set",
        "material.c10_pa=2000.0",
        "--check",
        "30",
    ];
    let mut session = Session::start(&session);
    session.wait_for("haptic thread");
    let set = |setting: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_palpate"));
        let mut output = output;
        output.args(["control", text(&socket), "set", setting]).output().expect("it runs")
    };
    std::thread::sleep(Duration::from_millis(1_500));
    let asked = set("material.c10_pa=3000.0");
    assert!(asked.status.success(), "{}", String::from_utf8_lossy(&asked.stderr));
    std::thread::sleep(Duration::from_millis(500));
    set("material.c99_pa=1.0");
    assert_eq!(set("nonsense").status.code(), Some(2));
    std::thread::sleep(Duration::from_millis(1_000));
    set("fixed.group=F2");
    let (code, told, said) = session.end();
    assert_eq!(code, Some(0), "{told}{said}");
    assert!(said.contains("material.c10_pa=3000.0 (") && said.contains("fixed.group=F2 ("), "{said}");
    assert!(said.contains("unknown key `c99_pa`"), "{said}");
    let figures: serde_json::Value = serde_json::from_str(&told).expect("JSON");
    // The check knows which model was felt.
    let live = &figures["live"];
    assert!(live["checked"].as_u64().is_some_and(|checked| checked >= 15), "{live:#}");
    assert!(live["not_felt_share"].as_f64().is_some_and(|share| share > 0.95), "{live:#}");
    let step_n = figures["session"]["touch"]["largest_step_n"].as_f64().expect("a number");
    assert!(step_n < 0.2, "{figures:#}");
    drop(alone);
    refused(&["live", SCENE, "--set", "material.c10_pa"], &["material.c10_pa", "KEY=VALUE"]);
    refused(&["live", SCENE, "--set", "material.c99_pa=1"], &["unknown key `c99_pa`"]);
}

/// Ctrl-C ends a session, also while the body is built, and its solver with it.
#[test]
fn ctrl_c_ends_it_at_once() {
    let _alone = quiet();
    let large = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/liver-large.toml");
    let interrupt = |session: Session, what: &str| {
        let interrupted = Instant::now();
        kill(Pid::from_raw(session.child.id() as i32), Signal::SIGINT).expect("it lives");
        let (code, told, said) = session.end();
        let took = interrupted.elapsed();
        println!("{what} ended in {took:?}");
        assert!(took < Duration::from_secs(2), "{what}: {took:?}: {said}");
        (code, told)
    };
    for (scene, after_ms) in [(large, 60), (SCENE, 1_500)] {
        let session = Session::start(&[scene]);
        std::thread::sleep(Duration::from_millis(after_ms));
        interrupt(session, &format!("{after_ms} ms after the start it"));
    }
    // Also a check, which then reports what it has.
    let mut session = Session::start(&[large, "--seconds", "4", "--check", "1000"]);
    session.wait_for("check: full solutions");
    let (code, told) = interrupt(session, "a check");
    assert!(code == Some(0) && told.contains("ended by Ctrl-C"), "{told}");
    // And the solves of what was touched, which go on with the file.
    let folder = tempfile::tempdir().expect("a folder");
    let space = folder.path().join("a.space");
    let mut session = Session::start(&[large, "--seconds", "3", "--keep", text(&space)]);
    session.wait_for("keep: ");
    std::thread::sleep(Duration::from_millis(300));
    let (code, told) = interrupt(session, "the solves to keep");
    assert!(code == Some(0) && told.contains("continue with `palpate precompute"), "{told}");
}

#[test]
fn what_cannot_be_touched_live_is_refused_in_one_line() {
    refused(&["live", "/nowhere/scene.toml"], &["/nowhere/scene.toml", "check the path"]);
    let folder = tempfile::tempdir().expect("a folder");
    let bundled = std::fs::read_to_string(SCENE).expect("it is there");
    let mesh = Path::new(SCENE).with_file_name("liver-small.msh");
    let bundled = bundled.replace("\"liver-small.msh\"", &format!("{:?}", text(&mesh)));
    let scene = |name: &str, from: &str, to: &str| {
        assert!(bundled.contains(from), "{from}");
        let path = folder.path().join(name);
        std::fs::write(&path, bundled.replace(from, to)).expect("writable");
        path
    };
    let law = scene("law.toml", "\"mooney-rivlin\"", "\"mooney\"");
    refused(&["live", text(&law)], &["law.toml", "mooney"]);
    let tool = "[tool]\nshape = \"fingertip\"\nradius_m = 0.015\n\n[fixed]";
    let near = scene("near.toml", "order = 1", "order = \"tool\"");
    let text_of = std::fs::read_to_string(&near).expect("it is there");
    std::fs::write(&near, text_of.replace("[fixed]", tool)).expect("writable");
    refused(&["live", text(&near)], &["near.toml", "order = \"tool\"", "use `order = 1`"]);
    refused(&["live-solver", SCENE], &["not by hand"]);
}
