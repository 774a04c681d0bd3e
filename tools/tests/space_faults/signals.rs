//! SIGINT, as Ctrl-C sends it: finished work is kept, the last line states how to continue, and long walks
//! are abandoned.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use palpate_precompute::space::{Kind, Store};

use super::{Draws, LARGE, SMALL, dump, kept, palpate, precompute, scene, succeeds, undisturbed};

/// A started command whose standard error is read at its end.
struct Started(Child);

impl Started {
    fn of(mut command: Command) -> Self {
        Self(command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("runs"))
    }

    fn is_running(&mut self) -> bool {
        self.0.try_wait().expect("the state of a child").is_none()
    }

    fn interrupt(&self) {
        kill(Pid::from_raw(self.0.id() as i32), Signal::SIGINT).expect("SIGINT is sent");
    }

    /// Waits until `seen`, which must occur before the command ends.
    fn wait_until(&mut self, what: &str, mut seen: impl FnMut() -> bool) {
        while !seen() {
            assert!(self.is_running(), "ended before {what}");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Exit status and the lines of standard error.
    fn end(mut self) -> (ExitStatus, Vec<String>) {
        let mut said = String::new();
        self.0.stderr.take().expect("piped").read_to_string(&mut said).expect("text");
        (self.0.wait().expect("reaped"), said.lines().map(String::from).collect())
    }

    /// The command was interrupted: exit code 1, and the last line states what is kept and how to continue,
    /// followed by `more`. At most one line before it states that the command is stopping.
    fn ends_interrupted(self, kept: &str, more: &str) {
        let (status, lines) = self.end();
        assert_eq!(status.code(), Some(1), "{lines:?}");
        let last = lines.last().expect("it says something");
        let expected = format!(
            "palpate: interrupted; every finished {kept} is kept, run the same command to continue{more}"
        );
        assert_eq!(*last, expected, "{lines:?}");
        let stopping = lines.iter().filter(|line| line.contains(": stopping: ")).count();
        assert!(stopping <= 1, "once on a pipe: {lines:?}");
    }
}

/// Repeats SIGINT, each after some progress of the store, until the command ends by itself. Returns the
/// number of interrupted runs.
fn interrupted_again_and_again(
    command: impl Fn() -> Command,
    kept: &str,
    mut progress: impl FnMut() -> usize,
    draws: &mut Draws,
) -> usize {
    let mut interrupts = 0;
    loop {
        let (mut run, before) = (Started::of(command()), progress());
        let more = 1 + draws.next() as usize % 16;
        while run.is_running() && progress() < before + more {
            std::thread::sleep(Duration::from_millis(1));
        }
        if run.is_running() {
            run.interrupt();
        }
        let (status, lines) = run.end();
        let after = progress();
        assert!(after >= before, "{before} were kept, now {after}");
        if status.success() {
            return interrupts;
        }
        assert_eq!(status.code(), Some(1), "{lines:?}");
        let line = format!("every finished {kept} is kept, run the same command to continue");
        assert!(lines.last().is_some_and(|last| last.contains(&line)), "{lines:?}");
        interrupts += 1;
        assert!(interrupts < 200, "it does not get on");
    }
}

#[test]
fn an_interrupted_precompute_keeps_what_is_finished_and_goes_on_to_the_same_bits() {
    let folder = tempfile::tempdir().expect("a folder");
    let (scene, space) = (scene(folder.path(), LARGE), folder.path().join("a.space"));
    let expected = undisturbed(&scene, folder.path());
    let mut run = Started::of(precompute(&scene, &space, 2));
    run.wait_until("anything was kept", || rows_of(&space) > 20);
    let before = kept(&space, folder.path());
    run.interrupt();
    run.ends_interrupted("configuration", "");
    let after = kept(&space, folder.path());
    assert!(before.iter().all(|row| after.binary_search(row).is_ok()), "what was there is still there");
    // The next run solves only what is missing.
    let mut rest = precompute(&scene, &space, 2);
    rest.arg("--json");
    let rest = super::output(rest);
    let figures: serde_json::Value = serde_json::from_slice(&rest.stdout).expect("JSON");
    let again = figures["solved_now"].as_u64().expect("a number") as usize;
    assert!(again > 0, "it was interrupted when all was done");
    // All rows after the header.
    assert_eq!(after.len() + again, expected[1].len() - 1);
    assert_eq!(dump(&space, folder.path()), expected);
}

/// Two active nodes share the store: neither uses the other's points.
#[test]
fn interrupts_of_a_store_of_two_nodes_change_no_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = with_second_node(&scene(folder.path(), "radius_m = 0.01\nspacing_m = 0.003"));
    let space = folder.path().join("a.space");
    let expected = undisturbed(&scene, folder.path());
    let mut draws = Draws(11);
    let interrupts = interrupted_again_and_again(
        || precompute(&scene, &space, 2),
        "configuration",
        || rows_of(&space),
        &mut draws,
    );
    assert!(interrupts >= 2, "{interrupts} interrupts");
    assert_eq!(dump(&space, folder.path()), expected);
    println!("{interrupts} interrupts of a store of two nodes");
}

/// Rows of a store that another process writes, of all its nodes.
fn rows_of(space: &Path) -> usize {
    let Ok(store) = Store::open(space) else { return 0 };
    let nodes = store.active().map_or(0, |nodes| nodes.len());
    (0..nodes).map(|active| store.attempts(active).map_or(0, |rows| rows.len())).sum()
}

/// Held-out walks of a store that another process writes, of all its nodes.
fn walks_of(space: &Path) -> usize {
    let Ok(store) = Store::open(space) else { return 0 };
    let nodes = store.active().map_or(0, |nodes| nodes.len());
    (0..nodes).map(|active| store.walks_done(active).map_or(0, |walks| walks.len())).sum()
}

/// The beam with a second active node.
fn with_second_node(scene: &Path) -> PathBuf {
    let (mesh, ..) = palpate_tests::soft_beam(palpate_tests::mooney_rivlin());
    let node = palpate_tests::nearest_node(&mesh, [0.06, 0.0, 0.0]);
    let mut text = std::fs::read_to_string(scene).expect("there");
    text.push_str(&format!("[[active]]\nname = \"B\"\nnode = {node}\n"));
    std::fs::write(scene, text).expect("written");
    scene.to_path_buf()
}

fn held_out(scene: &Path, space: &Path, more: &[&str]) -> Command {
    let mut command = palpate();
    command
        .args(["paper", "held-out"])
        .arg(scene)
        .arg("--out")
        .arg(space)
        .args(["--threads", "2"])
        .args(more);
    command
}

/// The bundled organ: its walks are millimetres long, with some milliseconds per step.
fn protocol(out: &Path, more: &[&str]) -> Command {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/liver-small.toml");
    let mut command = palpate();
    command.args(["paper", "protocol"]).arg(scene).arg("--out").arg(out).args(["--threads", "2"]).args(more);
    command
}

/// Every held-out row of a store except its last column, the seconds.
fn truth(space: &Path, aside: &Path) -> Vec<String> {
    let csv = aside.join("truth.csv");
    let mut command = palpate();
    command.arg("inspect").arg(space).arg("--held-out").arg(&csv);
    succeeds(command);
    let table = std::fs::read_to_string(&csv).expect("the table is written");
    let head = table.lines().next().expect("a head");
    assert!(head.ends_with(",seconds"), "{head}");
    table.lines().map(|row| row.rsplit_once(',').expect("columns").0.to_string()).collect()
}

/// Walks that take minutes end within moments and store nothing. A partial walk would be read as one that
/// ended there.
#[test]
fn long_walks_are_given_up_when_interrupted() {
    let folder = tempfile::tempdir().expect("a folder");
    let (scene, space) = (scene(folder.path(), SMALL), folder.path().join("a.space"));
    // 26 short walks, then two of 100,000 steps, 100 m long.
    let long = ["--regular-mm", "2", "--random", "2", "--random-steps", "100000", "--uniform", "0"];
    let mut run = Started::of(held_out(&scene, &space, &long));
    run.wait_until("the short walks were kept", || walks_of(&space) == 26);
    std::thread::sleep(Duration::from_millis(300));
    assert!(run.is_running(), "the long walks ended");
    let asked = Instant::now();
    run.interrupt();
    run.ends_interrupted("path", "");
    let took = asked.elapsed();
    assert!(took < Duration::from_secs(2), "{took:?} to give up a walk");
    let store = Store::open(&space).expect("whole");
    let done = store.walks_done(0).expect("read");
    assert_eq!(done.len(), 26);
    assert!(done.keys().all(|(kind, _)| *kind == Kind::Regular), "{done:?}");

    let out = folder.path().join("out");
    let space = out.join("liver-small-F1.space");
    let mut run = Started::of(protocol(&out, &["--active-nodes", "2", "--step-mm", "0.002", "--again"]));
    run.wait_until("the store was there", || Store::open(&space).is_ok());
    std::thread::sleep(Duration::from_millis(500));
    let asked = Instant::now();
    run.interrupt();
    // The same command would delete what it keeps now.
    run.ends_interrupted("path", "; omit --again, which would delete them");
    let took = asked.elapsed();
    assert!(took < Duration::from_secs(2), "{took:?} to give up a walk");
    assert_eq!(walks_of(&space), 0);
}

#[test]
fn interrupted_walks_go_on_to_the_same_bits() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut draws = Draws(12);
    let scene_file = with_second_node(&scene(folder.path(), SMALL));
    let [whole, torn] = ["whole", "torn"].map(|name| folder.path().join(name).with_extension("space"));
    for space in [&whole, &torn] {
        succeeds(precompute(&scene_file, space, 2));
    }
    let walks = ["--regular-mm", "5", "--random", "60", "--random-steps", "50", "--uniform", "150"];
    succeeds(held_out(&scene_file, &whole, &walks));
    let expected = truth(&whole, folder.path());
    let heeded = interrupted_again_and_again(
        || held_out(&scene_file, &torn, &walks),
        "path",
        || walks_of(&torn),
        &mut draws,
    );
    assert!(heeded >= 2, "{heeded} interrupts of held-out");
    assert_eq!(truth(&torn, folder.path()), expected);

    let [whole, torn] = ["whole", "torn"].map(|name| folder.path().join(name));
    let short = ["--active-nodes", "2", "--length-mm", "4", "--step-mm", "1"];
    succeeds(protocol(&whole, &short));
    let stores = |out: &Path| ["F1", "F2"].map(|fixed| out.join(format!("liver-small-{fixed}.space")));
    let of_both = |out: &Path| stores(out).iter().map(|space| walks_of(space)).sum();
    let heeded_there =
        interrupted_again_and_again(|| protocol(&torn, &short), "path", || of_both(&torn), &mut draws);
    assert!(heeded_there >= 2, "{heeded_there} interrupts of the protocol");
    for (one, other) in stores(&whole).iter().zip(stores(&torn)) {
        assert_eq!(truth(one, folder.path()), truth(&other, folder.path()), "{}", other.display());
    }
    println!("{heeded} interrupts of held-out, {heeded_there} of the protocol");
}

/// The command waits for a solve of many seconds, unless a second signal arrives that is not an echo of the
/// first.
#[test]
fn a_later_second_signal_ends_at_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets");
    let text = std::fs::read_to_string(assets.join("liver-large.toml")).expect("the scene");
    let mesh = format!("file = {:?}", assets.join("liver-large.msh"));
    let text = text.replace("file = \"liver-large.msh\"", &mesh);
    // A transition in a hundred equal increments.
    let text = text.replace("radius_m = 0.05", "increments = 100\nradius_m = 0.05");
    let scene = folder.path().join("large.toml");
    std::fs::write(&scene, text).expect("written");
    let space = folder.path().join("large.space");
    let mut run = Started::of(precompute(&scene, &space, 2));
    run.wait_until("the rest point was kept", || rows_of(&space) > 0);
    std::thread::sleep(Duration::from_millis(300));
    run.interrupt();
    std::thread::sleep(Duration::from_millis(500));
    run.interrupt();
    std::thread::sleep(Duration::from_millis(1700));
    assert!(run.is_running(), "a second signal within two seconds is taken for an echo");
    let asked = Instant::now();
    run.interrupt();
    let (status, lines) = run.end();
    assert!(asked.elapsed() < Duration::from_secs(1), "{:?}", asked.elapsed());
    assert_eq!(status.code(), Some(130), "{lines:?}");
    assert_eq!(lines.last().map(String::as_str), Some("palpate: ended at once"));
    let stopping = lines.iter().filter(|line| line.contains(": stopping: 2 solves in hand are waited for"));
    assert_eq!(stopping.count(), 1, "{lines:?}");
    assert!(rows_of(&space) > 0, "the store can be read");
}
