//! The numbers of the documents that a command makes in a second are those that it makes today. `docs/remake --check`
//! compares the others.

use std::ffi::OsString;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Command, Stdio};

use palpate_tests::{documents, figures};

use crate::run;

/// Runs an entry's commands in a folder with the content of a clone.
fn remade(commands: &str, folder: &Path) {
    for name in ["assets", "docs", "firmware-like-core", "tests"] {
        symlink(documents::root().join(name).canonicalize().expect("there"), folder.join(name))
            .expect("linked");
    }
    let bin = tempfile::tempdir().expect("a folder");
    symlink(env!("CARGO_BIN_EXE_palpate"), bin.path().join("palpate")).expect("linked");
    let mut path = OsString::from(bin.path());
    path.push(":");
    path.push(std::env::var_os("PATH").unwrap_or_default());
    let mut shell = Command::new("sh");
    shell.args(["-euc", commands]).current_dir(folder).env("PATH", path).env_remove("DISPLAY");
    let output = run(shell.stdin(Stdio::null()));
    assert!(output.status.success(), "{commands}: {}", String::from_utf8_lossy(&output.stderr));
    fs::write(folder.join("output"), output.stdout).expect("written");
}

#[test]
fn numbers_that_are_fast_to_make_are_those_of_the_documents() {
    let figures = figures::all().unwrap_or_else(|error| panic!("{error}"));
    let mut compared = 0;
    let mut differences = Vec::new();
    for figure in figures.iter().filter(|figure| figure.test) {
        let folder = tempfile::tempdir().expect("a folder");
        remade(&figure.run, folder.path());
        for place in &figure.places {
            match place.differences(folder.path()) {
                Ok(found) => differences.extend(found),
                Err(error) => differences.push(format!("{}: {error}", place.what())),
            }
            compared += place.expected();
        }
    }
    assert!(differences.is_empty(), "docs/remake NAME --write corrects:\n{}", differences.join("\n"));
    assert!(compared > 20, "only {compared} numbers were compared");
}
