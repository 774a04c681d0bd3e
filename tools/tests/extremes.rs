//! Valid scenes with extreme parameters: the result is correct or one line with exit code 2, never a panic.

use std::path::{Path, PathBuf};
use std::process::Command;

use palpate_tests::write_beam_scene;

use crate::{GRID, MR, palpate, run, text};

const ADAPTIVE: &str = "radius_m = 0.01\ncannot_be_felt = true";

/// Ends with `code`; a refusal is one line that contains every word. Warnings and progress are ignored.
fn ends(arguments: &[&str], code: i32, words: &[&str]) {
    let output = palpate(arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
    if code == 0 {
        return;
    }
    let is_refusal = |line: &&str| line.starts_with("palpate: ") && !line.starts_with("palpate: warning");
    let lines: Vec<&str> = said.lines().filter(is_refusal).collect();
    assert!(lines.len() == 1 && said.trim_end().ends_with(lines[0]), "{arguments:?}: {said}");
    for word in words {
        assert!(lines[0].contains(word), "`{word}` is not in: {}", lines[0]);
    }
}

/// A folder with a scene and the names of the files made from it.
struct Bench {
    folder: tempfile::TempDir,
    scene: PathBuf,
}

impl Bench {
    fn new(law: &str, grid: &str, max_force_n: f64) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let scene = write_beam_scene(folder.path(), law, grid, max_force_n);
        Self { folder, scene }
    }

    fn plan(&self, code: i32, words: &[&str]) {
        ends(&["plan", text(&self.scene), "--threads", "1"], code, words);
    }

    fn precompute(&self, code: i32, words: &[&str]) {
        let space = self.folder.path().join("a.space");
        ends(&["precompute", text(&self.scene), "--out", text(&space), "--threads", "2"], code, words);
    }

    fn pack(&self, methods: &str, code: i32, words: &[&str]) {
        let [space, blob] = ["a.space", "a.blob"].map(|name| self.folder.path().join(name));
        let arguments = ["--no-certificate", "--method", methods, "--out", text(&blob)];
        ends(&[&["pack", text(&space)][..], &arguments].concat(), code, words);
        assert_eq!(blob.exists(), code == 0, "a blob is there if and only if it was packed");
        if code == 0 {
            ends(&["inspect", text(&blob)], 0, &[]);
        }
    }
}

/// The largest force moves the node by 30 um, a 300th of the radius: it is solved like any other.
#[test]
fn a_stiff_node_is_sampled_within_its_reach() {
    let bench = Bench::new(&MR.replace("1300.0", "4e6"), ADAPTIVE, 8.0);
    bench.plan(0, &[]);
    bench.precompute(0, &[]);
    bench.pack("energy,kernel", 0, &[]);
    let csv = bench.folder.path().join("a.csv");
    let space = bench.folder.path().join("a.space");
    ends(&["inspect", text(&space), "--csv", text(&csv)], 0, &[]);
    let table = std::fs::read_to_string(&csv).expect("the table is written");
    let head: Vec<&str> = table.lines().next().expect("a head").split(',').collect();
    let column = |name: &str| head.iter().position(|found| *found == name).expect("the column is there");
    let force = [column("fx_n"), column("fy_n"), column("fz_n")];
    let forces_n: Vec<f64> = table
        .lines()
        .skip(1)
        .map(|row| {
            let cells: Vec<&str> = row.split(',').collect();
            force.iter().map(|&at| cells[at].parse::<f64>().expect("a number").powi(2)).sum::<f64>().sqrt()
        })
        .collect();
    let largest_n = forces_n.iter().copied().fold(0.0, f64::max);
    assert!(forces_n.len() > 8 && (6.0..10.0).contains(&largest_n), "{forces_n:?}");
}

/// At four million times the stiffness, the displacement of the node is less than the distance between
/// positions.
#[test]
fn a_node_that_the_device_cannot_move_is_refused() {
    let bench = Bench::new(&MR.replace("1300.0", "4e10"), ADAPTIVE, 8.0);
    let words = ["beam.toml", "active node A", "um at most", "max_force_n"];
    bench.plan(2, &words);
    bench.precompute(2, &words);
    bench.pack("energy", 2, &["a.space", "No such file"]);
}

#[test]
fn a_radius_that_is_no_length_of_an_organ_is_refused() {
    for radius in ["1e-300", "1e-7", "1e4", "1e300"] {
        for grid in ["cannot_be_felt = true", "spacing_m = 1e-4"] {
            let bench = Bench::new(MR, &format!("radius_m = {radius}\n{grid}"), 8.0);
            let words = ["beam.toml:", "`radius_m`", "is not from 0.00001 to 1000", "metres"];
            bench.plan(2, &words);
            bench.precompute(2, &words);
        }
    }
}

#[test]
fn a_force_that_the_tolerance_swallows_is_refused() {
    for force in [1e-300, 0.001, 0.02] {
        let bench = Bench::new(MR, ADAPTIVE, force);
        let words = ["beam.toml:", "0.02 N", "no force would be perceptible", "max_force_n"];
        bench.plan(2, &words);
        bench.precompute(2, &words);
    }
    Bench::new(MR, "radius_m = 0.01\ntolerance_n = 0.0001", 0.001).precompute(0, &[]);
}

/// Forces of a million tonnes exceed the range of the core. A limit that is zero in f32 is no limit.
#[test]
fn a_blob_that_the_core_would_refuse_is_not_written() {
    let words = ["could not be read", "is not written", "units"];
    let stiff = Bench::new(&MR.replace("1300.0", "1e14"), GRID, 8.0);
    stiff.precompute(0, &[]);
    for methods in ["energy", "trilinear"] {
        stiff.pack(methods, 2, &words);
    }
    let faint = Bench::new(MR, GRID, 1e-300);
    faint.plan(0, &[]);
    faint.precompute(0, &[]);
    faint.pack("energy", 2, &words);
}

#[test]
fn a_number_of_threads_is_bounded_alike_everywhere() {
    let bench = Bench::new(MR, GRID, 8.0);
    let folder = bench.folder.path();
    let [space, blob, out] = ["a.space", "a.blob", "out"].map(|name| folder.join(name));
    bench.precompute(0, &[]);
    let (scene, space, blob, out) = (text(&bench.scene), text(&space), text(&blob), text(&out));
    let commands: [&[&str]; 6] = [
        &["plan", scene],
        &["precompute", scene, "--out", space],
        &["paper", "held-out", scene, "--out", space],
        &["paper", "protocol", scene, "--out", out],
        &["pack", space, "--out", blob],
        &["report", "--out", out],
    ];
    for command in commands {
        for threads in ["0", "1025", "100000"] {
            let arguments = [command, &["--threads", threads]].concat();
            ends(&arguments, 2, &[&format!("--threads {threads}: give 1 to 1024")]);
        }
    }
    assert!(!Path::new(out).exists() && !Path::new(blob).exists(), "nothing is written");
}

/// The operating system provides no thread with a stack of sixteen terabytes.
#[test]
fn threads_that_do_not_start_are_one_line() {
    let bench = Bench::new(MR, GRID, 8.0);
    let second = "[[active]]\nname = \"B\"\nnode = 43\n";
    let scene = std::fs::read_to_string(&bench.scene).expect("the scene");
    std::fs::write(&bench.scene, scene + second).expect("written");
    bench.precompute(0, &[]);
    let [space, blob] = ["a.space", "a.blob"].map(|name| bench.folder.path().join(name));
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
    command.args(["pack", text(&space), "--out", text(&blob), "--no-certificate", "--threads", "2"]);
    let output = run(command.env("RUST_MIN_STACK", (1_u64 << 44).to_string()));
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    let lines: Vec<&str> = stderr.trim().lines().filter(|line| !line.starts_with("pack: ")).collect();
    let [line] = lines[..] else { panic!("one line beside progress: {stderr}") };
    assert!(line.contains("2 worker threads cannot be started"), "{line}");
    assert!(!blob.exists());
}

/// A random path of the paper's steps of 1 mm would leave this ball with its first step.
#[test]
fn held_out_paths_of_a_ball_smaller_than_their_steps() {
    let bench = Bench::new(MR, "radius_m = 0.0008\ncannot_be_felt = true", 2.0);
    let space = bench.folder.path().join("a.space");
    bench.precompute(0, &[]);
    let held_out = |more: &[&str], code: i32, words: &[&str]| {
        let fixed = ["paper", "held-out", text(&bench.scene), "--out", text(&space), "--threads", "2"];
        let few = ["--random", "2", "--random-steps", "20", "--uniform", "3"];
        ends(&[&fixed[..], &few[..], more].concat(), code, words);
    };
    let before = std::fs::read(&space).expect("the space");
    held_out(&["--step-mm", "1"], 2, &["steps of 1 mm", "radius 0.8 mm", "--step-mm 0.08", "--random 0"]);
    assert_eq!(std::fs::read(&space).expect("the space"), before, "nothing is solved");
    held_out(&[], 0, &[]);
}
