//! No command overwrites its inputs, another of its outputs, or a file of another kind.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use palpate_tests::write_beam_scene;

use crate::{MR, refusal, run};

const GRID: &str = "radius_m = 0.01\nspacing_m = 0.01";
/// A real organ with every method.
const BLOB: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../firmware-like-core/golden/organ-514.blob");

/// A folder with a file of every kind that a command reads.
struct Bench {
    folder: tempfile::TempDir,
}

impl Bench {
    fn new() -> Self {
        let bench = Self { folder: tempfile::tempdir().expect("a folder") };
        write_beam_scene(bench.folder.path(), MR, GRID, 100.0);
        bench.put("in.csv", b"x_m,y_m,z_m\n0,0,0.001\n");
        std::fs::copy(BLOB, bench.at("a.blob")).expect("copied");
        bench.succeeds("precompute beam.toml --out a.space");
        bench.succeeds(&format!("{RUN} --seconds 0.1 --frame-rate 0 --record a.mcap"));
        bench
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn put(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.at(name), bytes).expect("the folder can be written");
    }

    fn palpate(&self, line: &str) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
        run(command.current_dir(self.folder.path()).args(line.split(' ')))
    }

    fn succeeds(&self, line: &str) {
        let output = self.palpate(line);
        assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    }

    /// Every file with its content, and every folder, except the files that SQLite creates to read a space.
    fn content(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let (mut content, mut folders) = (BTreeMap::new(), vec![self.folder.path().to_path_buf()]);
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).expect("a folder") {
                let path = entry.expect("an entry").path();
                if path.is_dir() && !path.is_symlink() {
                    folders.push(path.clone());
                    content.insert(path, Vec::new());
                } else if !path.to_string_lossy().ends_with(".space-shm")
                    && !path.to_string_lossy().ends_with(".space-wal")
                {
                    let bytes = std::fs::read(&path).expect("readable");
                    content.insert(path, bytes);
                }
            }
        }
        content
    }

    /// The command ends with exit code 2 and one line that contains every word, and it changes no file.
    fn refuses(&self, line: &str, words: &[&str]) {
        let before = self.content();
        let output = self.palpate(line);
        refusal(&output, 2, words);
        assert!(self.content() == before, "{line}: touched something");
    }
}

const RUN: &str = "run a.blob --uncertified --headless";
const PATH: &str = "path beam.toml --direction=0,0,-1 --steps 1";
const COMPARE: &str = "paper compare beam.toml --direction=0,0,-1 --length-mm 1";

/// Commands whose last argument is the one output, and their inputs.
const COMMANDS: [(&str, &[&str]); 17] = [
    ("pack a.space --no-certificate --out", &["a.space"]),
    ("precompute beam.toml --out", &["beam.toml", "beam.msh"]),
    ("precompute beam.toml --salvage --out", &["beam.toml", "beam.msh"]),
    ("paper held-out beam.toml --out", &["beam.toml", "beam.msh"]),
    ("inspect a.space --csv", &["a.space"]),
    ("inspect a.space --held-out", &["a.space"]),
    ("inspect a.space --picture", &["a.space"]),
    ("inspect a.space --vtu", &["a.space"]),
    ("inspect a.mcap --csv", &["a.mcap"]),
    ("query a.blob --method energy --points in.csv --csv", &["a.blob", "in.csv"]),
    ("path beam.toml --direction=0,0,-1 --steps 1 --csv", &["beam.toml", "beam.msh"]),
    ("paper compare beam.toml --direction=0,0,-1 --length-mm 1 --csv", &["beam.toml", "beam.msh"]),
    ("plan beam.toml --out", &["beam.toml", "beam.msh"]),
    ("run a.blob --uncertified --headless --seconds 0.1 --frame-rate 0 --histograms", &["a.blob"]),
    ("run a.blob --uncertified --headless --seconds 0.1 --frame-rate 0 --record", &["a.blob"]),
    ("bench core --grids 514 --rounds 1 --blob a.blob --csv", &["a.blob"]),
    ("bench core --rounds 1 --blob a.blob --points in.csv --json --csv", &["a.blob", "in.csv"]),
];

#[test]
fn no_output_replaces_an_input_under_any_name() {
    let bench = Bench::new();
    std::os::unix::fs::symlink("beam.toml", bench.at("to-beam.toml")).expect("a link");
    for (command, inputs) in COMMANDS {
        for input in inputs {
            let (link, hard) = (format!("link-to-{input}"), format!("hard-{input}"));
            std::os::unix::fs::symlink(input, bench.at(&link)).expect("a link");
            std::fs::hard_link(bench.at(input), bench.at(&hard)).expect("a link");
            let absolute = bench.at(input);
            for name in [*input, absolute.to_str().expect("plain"), &link, &hard] {
                bench.refuses(&format!("{command} {name}"), &[name, input]);
                if !command.contains(".toml --out") && !command.contains("--salvage") {
                    bench.refuses(&format!("{command} {name} --force"), &[name, input]);
                }
            }
            for name in [link, hard] {
                std::fs::remove_file(bench.at(&name)).expect("removed");
            }
        }
    }
    // Options that require an extension.
    std::fs::hard_link(bench.at("beam.msh"), bench.at("mesh.csv")).expect("a link");
    bench.refuses(&format!("{PATH} --displacements mesh.csv"), &["mesh.csv", "beam.msh"]);
    // The files that a scene names are also inputs.
    let scene = std::fs::read_to_string(bench.at("beam.toml")).expect("the scene");
    bench.put("sets.csv", b"{\"F\": [0, 1, 2, 3, 4, 5]}");
    let fixed = scene.lines().find(|line| line.starts_with("nodes = ")).expect("fixed nodes");
    bench.put("sets.toml", scene.replace(fixed, "file = \"sets.csv\"\nkey = \"F\"").as_bytes());
    bench.refuses(
        "path sets.toml --direction=0,0,-1 --steps 1 --csv sets.csv --force",
        &["sets.csv: is the input"],
    );
}

/// Outputs that no option names: the steps of a series, the tables of a report, the spaces of the protocol.
#[test]
fn outputs_with_names_of_their_own_are_looked_at_too() {
    let bench = Bench::new();
    bench.succeeds(&format!("{PATH} --displacements a.pvd"));
    bench.succeeds(&format!("{PATH} --displacements a.pvd"));
    let scene = std::fs::read_to_string(bench.at("beam.toml")).expect("the scene");
    bench.put("step.toml", scene.replace("beam.msh", "a/step_0001.vtu").as_bytes());
    let path = "path step.toml --direction=0,0,-1 --steps 1 --displacements";
    bench.refuses(&format!("{path} a.pvd"), &["a/step_0001.vtu", "is the input"]);
    bench.put("b.pvd", b"my notes\n");
    bench.refuses(&format!("{PATH} --displacements b.pvd"), &["b.pvd", "a text file"]);

    std::fs::create_dir(bench.at("out")).expect("a folder");
    std::fs::hard_link(bench.at("beam.toml"), bench.at("out/methods.csv")).expect("a link");
    bench.refuses("report beam.toml --small --out out --force", &["out/methods.csv", "beam.toml"]);
    std::fs::remove_file(bench.at("out/methods.csv")).expect("removed");
    bench.put("out/report.html", b"my notes\n");
    bench.refuses("report beam.toml --small --out out", &["out/report.html", "a text file", "--force"]);

    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets");
    for name in ["liver-small.toml", "liver-small.msh"] {
        std::fs::copy(assets.join(name), bench.at(name)).expect("copied");
    }
    std::fs::hard_link(bench.at("liver-small.msh"), bench.at("out/liver-small-F2.space")).expect("a link");
    bench.refuses(
        "paper protocol liver-small.toml --out out",
        &["out/liver-small-F2.space", "liver-small.msh"],
    );
    std::fs::create_dir(bench.at("demo")).expect("a folder");
    bench.put("demo/summary.json", b"my notes\n");
    bench.refuses("demo --headless --out demo", &["demo/summary.json", "a text file", "--force"]);
}

#[test]
fn a_file_is_no_folder_of_outputs() {
    let bench = Bench::new();
    bench.put("notes", b"my notes\n");
    let run = format!("{RUN} --pictures notes");
    for line in ["demo --headless --out notes", "report beam.toml --small --out notes", &run] {
        bench.refuses(line, &["notes: is a file; give a folder"]);
    }
    bench.refuses("inspect nowhere", &["nowhere: cannot read the file", "; check the path\n"]);
}

#[test]
fn two_outputs_of_a_command_are_two_files() {
    let bench = Bench::new();
    std::os::unix::fs::symlink("new.csv", bench.at("link.csv")).expect("a link");
    // `content` cannot read a dangling link, so this closure checks only its target.
    let refuses = |line: &str, words: &[&str]| {
        let output = bench.palpate(line);
        refusal(&output, 2, words);
        assert!(!bench.at("new.csv").exists(), "{line}");
    };
    for name in ["new.csv", "./new.csv", "link.csv"] {
        refuses(
            &format!("inspect a.space --csv new.csv --held-out {name}"),
            &["--held-out", "--csv new.csv"],
        );
        refuses(
            &format!("{PATH} --csv new.csv --displacements {name}"),
            &["--displacements", "--csv new.csv"],
        );
        let run = format!("{RUN} --seconds 0.1 --histograms {name} --record new.csv");
        refuses(&run, &["--histograms", "--record new.csv"]);
    }
    bench.succeeds("inspect a.space --csv /dev/null --held-out /dev/null");
}

#[test]
fn only_force_replaces_a_file_of_another_kind_and_nothing_stands_in_the_way_of_the_same() {
    let bench = Bench::new();
    bench.put("notes.csv", b"Hello, world\n");
    bench.put("other.db", &foreign_database(&bench.at("made.db")));
    std::fs::remove_file(bench.at("made.db")).expect("removed");
    let query = "query a.blob --method energy --points in.csv --csv";
    for (name, kind) in [
        ("beam.toml", "TOML"),
        ("beam.msh", "a mesh"),
        ("a.space", "a space"),
        ("a.mcap", "MCAP"),
        ("notes.csv", "a text file"),
        ("other.db", "a database of another program"),
    ] {
        bench.refuses(&format!("{query} {name}"), &[name, kind, "a table (CSV)", "--force"]);
        bench.refuses(
            &format!("pack a.space --no-certificate --out {}", swap(name)),
            &[swap(name), "--force"],
        );
    }
    bench.refuses("plan beam.toml --out notes.csv", &["notes.csv", "a text file", "a JSON file", "--force"]);
    bench.refuses(&format!("{query} nowhere/out.csv"), &["nowhere/out.csv", "check the name, the folder"]);
    bench.refuses(&format!("{query} ."), &["is a folder"]);
    // A space never replaces another file: rows are added to an existing space.
    for name in ["notes.csv", "a.blob", "a.mcap", "other.db"] {
        for more in ["", " --salvage"] {
            bench.refuses(&format!("precompute beam.toml --out {name}{more}"), &[name, "not a space"]);
        }
        bench.refuses(&format!("paper held-out beam.toml --out {name}"), &[name, "not a space"]);
    }
    bench.succeeds(&format!("{query} notes.csv --force"));
    // The same commands twice, with every kind of output.
    for _ in 0..2 {
        bench.succeeds(&format!("{query} out.csv"));
        bench.succeeds("pack a.space --method energy --no-certificate --out own.blob");
        bench
            .succeeds("inspect a.space --csv all.csv --held-out truth.csv --picture map.png --vtu cloud.vtu");
        bench.succeeds("inspect a.mcap --csv ticks.csv");
        bench.succeeds(&format!("{PATH} --csv path.csv --displacements moved.csv"));
        bench.succeeds(&format!("{COMPARE} --csv laws.csv"));
        bench.succeeds(&format!("{RUN} --seconds 0.1 --frame-rate 0 --histograms times.csv"));
        bench.succeeds("precompute beam.toml --out a.space");
    }
}

/// A file that `pack` does not read.
fn swap(name: &str) -> &str {
    if name == "a.space" { "in.csv" } else { name }
}

/// The bytes of an SQLite database that is not a space.
fn foreign_database(path: &Path) -> Vec<u8> {
    let connection = rusqlite::Connection::open(path).expect("made");
    connection.execute_batch("CREATE TABLE meta (key TEXT); INSERT INTO meta VALUES ('x')").expect("filled");
    drop(connection);
    std::fs::read(path).expect("there")
}

/// Only a damaged space is salvaged. Salvage is not suggested for a file that never was a space.
#[test]
fn what_never_was_a_space_is_not_salvaged() {
    let bench = Bench::new();
    std::fs::copy(bench.at("a.space"), bench.at("b.space")).expect("copied");
    bench.put("notes.space", b"CREATE TABLE configuration ( is what a space has\n");
    bench.put("other.space", &foreign_database(&bench.at("made.db")));
    std::fs::remove_file(bench.at("made.db")).expect("removed");
    std::fs::copy(bench.at("beam.toml"), bench.at("beam.space")).expect("copied");
    std::fs::copy(bench.at("beam.msh"), bench.at("mesh.space")).expect("copied");
    std::fs::copy(bench.at("a.mcap"), bench.at("session.space")).expect("copied");
    for name in ["notes.space", "other.space", "beam.space", "mesh.space", "session.space"] {
        for line in [
            format!("precompute beam.toml --out {name}"),
            format!("precompute beam.toml --out {name} --salvage"),
            format!("inspect {name}"),
            format!("pack {name} --out new.blob"),
            format!("plan --check {name} --prediction plan.json"),
        ] {
            bench.refuses(&line, &[name, "not a"]);
            let said = bench.palpate(&line).stderr;
            assert!(
                !String::from_utf8_lossy(&said).contains("salvage"),
                "{}",
                String::from_utf8_lossy(&said)
            );
        }
    }
    bench.put("empty.space", b"");
    bench.refuses(
        "precompute beam.toml --out empty.space --salvage",
        &["empty.space", "no configuration yet"],
    );
    // A space without its magic number, and one without its first page.
    let whole = std::fs::read(bench.at("b.space")).expect("there");
    for lost in [16, 4096] {
        let mut bytes = whole.clone();
        bytes[..lost].fill(0x5a);
        bench.put("b.space", &bytes);
        bench.refuses("inspect b.space", &["b.space", "damaged", "--salvage"]);
        bench.succeeds("precompute beam.toml --out b.space --salvage");
    }
}

#[test]
fn sessions_never_replace_each_others_pictures() {
    let bench = Bench::new();
    let frames = format!("{RUN} --seconds 0.4 --frame-rate 10 --pictures shots");
    bench.succeeds(&frames);
    let before = bench.content();
    bench.succeeds(&frames);
    let after = bench.content();
    assert!(
        before.iter().all(|(path, bytes)| after.get(path) == Some(bytes)),
        "the first session's pictures"
    );
    let count = |all: &BTreeMap<PathBuf, Vec<u8>>| {
        all.keys().filter(|path| path.starts_with(bench.at("shots"))).count()
    };
    assert!(
        count(&before) >= 3 && count(&after) >= count(&before) + 2,
        "{} then {}",
        count(&before),
        count(&after)
    );
    bench.refuses(&format!("{RUN} --seconds 0.1 --record a.mcap --force"), &["a.mcap", "already exists"]);
}

/// A write that bypasses [`Files`] bypasses its checks.
#[test]
fn no_command_opens_a_file_for_writing_by_itself() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut folders = vec![source.clone()];
    let mut found = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let text = std::fs::read_to_string(&path).expect("text");
            // The test module is the last item of a file.
            let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
            for word in
                ["fs::write", "File::create", "OpenOptions", "fs::rename", "fs::copy", "write_atomically"]
            {
                let is_kernel = word == "fs::write" && code.contains("fs::write(\"/proc/");
                if code.contains(word) && !is_kernel && !path.starts_with(source.join("files")) {
                    found.push(format!("{}: {word}", path.display()));
                }
            }
        }
    }
    assert!(found.is_empty(), "take an `Output` of `Files` instead: {found:#?}");
}
