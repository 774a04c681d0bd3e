//! Runs every command that README and guide print, in order, in a folder with the content of a clone.

use std::ffi::OsString;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Command, Stdio};

use palpate_tests::documents;

use crate::run;

fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("a folder");
    for entry in fs::read_dir(from).expect("readable") {
        let entry = entry.expect("readable");
        let target = to.join(entry.file_name());
        if entry.file_type().expect("readable").is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).expect("copied");
        }
    }
}

/// Runs every command of the document's `sh` blocks that is not marked `no-run`. Panics at the first command
/// whose exit code is not the stated one. Returns the number of commands.
fn run_commands_of(name: &str) -> usize {
    let clone = tempfile::tempdir().expect("a folder");
    copy_folder(&documents::root().join("assets"), &clone.path().join("assets"));
    let bin = tempfile::tempdir().expect("a folder");
    symlink(env!("CARGO_BIN_EXE_palpate"), bin.path().join("palpate")).expect("linked");
    let mut path = OsString::from(bin.path());
    path.push(":");
    path.push(std::env::var_os("PATH").unwrap_or_default());

    let document = fs::read_to_string(documents::root().join(name)).expect("it is there");
    let blocks = documents::blocks(&document).into_iter().filter(|b| b.language == "sh" && !b.no_run);
    let commands: Vec<_> = blocks.flat_map(|block| documents::commands(&block)).collect();
    for command in &commands {
        let mut shell = Command::new("sh");
        shell.args(["-c", &command.text]).current_dir(clone.path()).env("PATH", &path);
        let output = run(shell.env_remove("DISPLAY").stdin(Stdio::null()));
        assert_eq!(
            output.status.code(),
            Some(command.exit_code),
            "{name}:{}: `{}`: {}",
            command.line,
            command.text,
            String::from_utf8_lossy(&output.stderr)
        );
    }
    commands.len()
}

#[test]
fn the_commands_of_the_readme_run_as_printed() {
    assert!(run_commands_of("README.md") >= 5);
}

#[test]
fn the_commands_of_the_guide_run_as_printed() {
    assert!(run_commands_of("docs/guide.md") >= 18);
}

#[test]
fn the_scene_of_the_guide_is_the_file() {
    let guide = fs::read_to_string(documents::root().join("docs/guide.md")).expect("it is there");
    let scene = documents::blocks(&guide).into_iter().find(|block| block.language == "toml");
    let file = fs::read_to_string(documents::root().join("assets/liver.toml")).expect("it is there");
    assert_eq!(scene.expect("the guide shows its scene").text, file);
}
