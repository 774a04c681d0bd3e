//! A full disk, and signals, while a command writes tables and pictures.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use super::disk::Mount;
use super::{SMALL, output, palpate, precompute, scene, succeeds};
use crate::text;

fn command(arguments: &[&str]) -> Command {
    let mut command = palpate();
    command.args(arguments);
    command
}

/// Every file below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

/// Ends with exit code 1 and a line that names the file and the full disk.
fn reports_a_full_disk(command: Command, file: &str) {
    let shown = format!("{command:?}");
    let ended = output(command);
    let said = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(1), "{shown}: {said}");
    let last = said.lines().last().unwrap_or_default();
    assert!(last.contains(file) && last.to_lowercase().contains("no space left"), "{shown}: {said}");
    assert!(!last.contains("check the name"), "{shown}: {said}");
}

#[test]
fn a_full_disk_is_reported_as_such_and_no_part_of_a_file_is_left() {
    let folder = tempfile::tempdir().expect("a folder");
    let (scene, space) = (scene(folder.path(), SMALL), folder.path().join("a.space"));
    succeeds(precompute(&scene, &space, 2));
    let [blob, points] = ["a.blob", "in.csv"].map(|name| folder.path().join(name));
    let (scene, space, blob, points) = (text(&scene), text(&space), text(&blob), text(&points));
    std::fs::write(points, "x_m,y_m,z_m\n0,0,0.001\n").expect("written");
    succeeds(command(&["pack", space, "--method", "energy", "--no-certificate", "--out", blob]));
    let path = ["path", scene, "--direction=0,0,-1", "--steps", "2"];
    let query = ["query", blob, "--method", "energy", "--points", points, "--csv", "/dev/full"];
    // /dev/full is always full and needs no rights.
    reports_a_full_disk(command(&query), "/dev/full");
    reports_a_full_disk(command(&[&path[..], &["--csv", "/dev/full"]].concat()), "/dev/full");
    let mut to_stdout = command(&path);
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").expect("a device");
    let ended = to_stdout.stdout(full).output().expect("runs");
    assert_eq!(ended.status.code(), Some(1), "{}", String::from_utf8_lossy(&ended.stderr));

    let Some(disk) = Mount::tmpfs(&folder.path().join("disk"), "size=4k") else { return };
    std::fs::write(disk.0.join("filler"), [0; 4096]).expect("it takes one page");
    let at = |name: &str| text(&disk.0.join(name)).to_string();
    let compare = ["paper", "compare", scene, "--direction=0,0,-1", "--length-mm", "1"];
    let run = ["run", blob, "--uncertified", "--headless", "--seconds", "0.3"];
    let writers: [(&[&str], &[&str], &str); 14] = [
        (&path, &["--csv"], "a.csv"),
        (&path, &["--displacements"], "moved.csv"),
        (&path, &["--displacements"], "moved.pvd"),
        (&query[..6], &["--csv"], "a.csv"),
        (&compare, &["--out"], "a.png"),
        (&["inspect", space], &["--csv"], "a.csv"),
        (&["inspect", space], &["--held-out"], "truth.csv"),
        (&["inspect", space], &["--picture"], "a.png"),
        (&["inspect", space], &["--vtu"], "a.vtu"),
        (&["pack", space, "--method", "energy", "--no-certificate"], &["--out"], "b.blob"),
        (&run, &["--frame-rate", "0", "--histograms"], "times.csv"),
        (&run, &["--pictures"], "shots"),
        (&run, &["--frame-rate", "0", "--record"], "a.mcap"),
        (&["bench", "core", "--grids", "514", "--rounds", "1"], &["--csv"], "a.csv"),
    ];
    for (arguments, option, name) in writers {
        let mut command = command(arguments);
        command.args(option).arg(at(name)).current_dir(folder.path());
        reports_a_full_disk(command, name);
        let left: Vec<PathBuf> =
            files(&disk.0).into_iter().filter(|file| !file.ends_with("filler")).collect();
        // The recording of a session cannot be repeated, so the part before the error is kept.
        if name == "a.mcap" {
            assert_eq!(left, [disk.0.join(name)]);
            std::fs::remove_file(&left[0]).expect("removed");
        } else {
            assert!(left.is_empty(), "{arguments:?} {option:?} {name}: {left:?}");
        }
    }
    // The rows of a path are kept if there is room for them, even if its displacements cannot be written.
    let csv = folder.path().join("kept.csv");
    let rows = ["--csv", text(&csv), "--displacements", &at("moved.csv")];
    reports_a_full_disk(command(&[&path[..], &rows].concat()), "moved.csv");
    assert_eq!(std::fs::read_to_string(&csv).expect("written").lines().count(), 3);
}

/// A started command that catches SIGINT.
struct Started(Child);

impl Started {
    fn of(arguments: &[&str]) -> Self {
        let mut command = command(arguments);
        let mut run = Self(command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("runs"));
        let status = format!("/proc/{}/status", run.0.id());
        run.wait_until("it caught SIGINT", || {
            let status = std::fs::read_to_string(&status).expect("Linux");
            let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).expect("a mask").trim();
            u64::from_str_radix(caught, 16).expect("a mask") & (1 << (Signal::SIGINT as u32 - 1)) != 0
        });
        run
    }

    fn wait_until(&mut self, what: &str, mut seen: impl FnMut() -> bool) {
        while !seen() {
            assert!(self.0.try_wait().expect("the state of a child").is_none(), "ended before {what}");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Sends `signal`. The command ends with exit code 1 and this last line.
    fn ends_with(self, signal: Signal, line: &str) {
        kill(Pid::from_raw(self.0.id() as i32), signal).expect("it is there");
        let ended = self.0.wait_with_output().expect("reaped");
        let said = String::from_utf8_lossy(&ended.stderr);
        assert_eq!(ended.status.code(), Some(1), "{:?}: {said}", ended.status);
        assert!(said.lines().last().is_some_and(|last| last.starts_with(line)), "{said}");
    }
}

#[test]
fn an_interrupted_path_keeps_its_rows_and_its_series() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path(), SMALL);
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        let [csv, pvd, third] =
            ["a.csv", "a.pvd", "a/step_0003.vtu"].map(|name| folder.path().join(signal.as_str()).join(name));
        std::fs::create_dir(folder.path().join(signal.as_str())).expect("a folder");
        let path = ["path", text(&scene), "--direction=0,0,-1", "--step-mm", "1e-6", "--steps", "1000000"];
        let outputs = ["--csv", text(&csv), "--displacements", text(&pvd)];
        let mut run = Started::of(&[&path[..], &outputs].concat());
        run.wait_until("a third step", || third.exists());
        run.ends_with(signal, "palpate: interrupted before step ");
        let rows = std::fs::read_to_string(&csv).expect("the rows so far");
        assert!(rows.lines().count() > 3 && rows.lines().skip(1).all(|row| row.ends_with(",ok")), "{rows}");
        let series = std::fs::read_to_string(&pvd).expect("the steps so far");
        // The series contains rest. The table has no row for rest, but a header, so the counts agree.
        assert_eq!(series.matches("<DataSet").count(), rows.lines().count());
    }
}

#[test]
fn an_interrupted_comparison_keeps_its_rows() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path(), SMALL);
    let csv = folder.path().join("laws.csv");
    let pull = ["paper", "compare", text(&scene), "--direction=1,0,0", "--length-mm", "10000"];
    let outputs = ["--laws", "linear,mooney-rivlin", "--csv", text(&csv)];
    Started::of(&[&pull[..], &outputs].concat())
        .ends_with(Signal::SIGINT, "palpate: interrupted; the rows so far");
    let rows = std::fs::read_to_string(&csv).expect("the rows so far");
    assert!(rows.lines().last().is_some_and(|row| row.contains(",interrupted,")), "{rows}");
}

#[test]
fn a_choice_of_contact_points_ends_at_once_and_leaves_no_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/scenes/anywhere.toml");
    let space = folder.path().join("a.space");
    let run = Started::of(&["precompute", text(&scene), "--out", text(&space), "--threads", "1"]);
    run.ends_with(Signal::SIGTERM, "palpate: interrupted before the first result");
    assert_eq!(files(folder.path()), [] as [PathBuf; 0]);
}

#[test]
fn an_interrupted_plan_ends_at_once() {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/liver-small.toml");
    Started::of(&["plan", text(&scene)]).ends_with(Signal::SIGTERM, "palpate: interrupted");
}
