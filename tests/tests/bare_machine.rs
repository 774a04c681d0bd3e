//! `cargo test --workspace` needs only Rust, gcc and git: no test, example or build script starts a program
//! that Debian does not install with its essential packages.
//!
//! Every `Command::new(..)` of the workspace must be listed here, with the reason why its program is present
//! or is not needed.

use std::path::PathBuf;

use cargo_metadata::{MetadataCommand, Package};
use palpate_tests::rust_files;

/// Programs by the expression that names them, in any file.
const ANYWHERE: [(&str, &str); 5] = [
    ("env!(\"CARGO_BIN_EXE_palpate\")", "built by cargo for the tests of its package"),
    ("env!(\"CARGO_BIN_EXE_palpate-hil\")", "built by cargo for the tests of its package"),
    ("std::env::current_exe()?", "the running program"),
    ("std::env::current_exe().expect(\"a test has a file\")", "the running program"),
    ("std::env::current_exe().map_err(Failure::work)?", "the running program"),
];

/// Programs by file and expression.
const HERE: [(&str, &str, &str); 21] = [
    (
        "host/tests/live/process.rs",
        "std::env::current_exe().expect(\"a test has a file\")",
        "the test itself",
    ),
    ("host/tests/live/start.rs", "\"/nonexistent/palpate\"", "absent on purpose"),
    ("tools/build.rs", "rustc", "the compiler that cargo names in RUSTC"),
    ("tools/build.rs", "program", "git, which may be absent, and the compiler"),
    ("tools/src/cmd/completions.rs", "command.get_name()", "an argument parser, no program"),
    ("tools/src/cmd/completions.rs", "\"palpate\"", "an argument parser, no program"),
    ("host/src/sys/process.rs", "\"cat\"", "coreutils, essential"),
    ("tools/src/cmd/bench/fem.rs", "\"/usr/bin/python3\"", "the peer of `bench fem`, which no test asks for"),
    ("tests/tests/read_blob.rs", "PYTHON", "ignored tests, run by tests/peers/numpy"),
    ("tests/tests/records.rs", "PYTHON", "an ignored test, run by tests/peers/numpy"),
    ("tests/tests/stored_fit.rs", "this", "the test itself"),
    ("host/tests/no_allocation.rs", "this", "the test itself"),
    ("host/tests/soak.rs", "this", "the test itself"),
    ("tools/tests/guard.rs", "program", "a copy of palpate"),
    ("tools/src/cmd/bench/public/first_touch.rs", "program", "the running program"),
    ("hil/src/hosts/process.rs", "program", "palpate-hil, and /bin/false of coreutils, essential"),
    ("hil/src/bin/falcon-guest/killed_hosts.rs", "program", "the running program"),
    ("tools/tests/command_line.rs", "\"bash\"", "essential"),
    ("tools/tests/documents.rs", "\"sh\"", "dash, essential"),
    ("tools/tests/figures.rs", "\"sh\"", "dash, essential"),
    ("tools/src/machine.rs", "\"sh\"", "dash, essential"),
];

/// The expressions in `Command::new(..)` of a source file.
fn programs(source: &str) -> Vec<&str> {
    const CALL: &str = "Command::new(";
    let calls = source.match_indices(CALL).filter(|(at, _)| {
        // `MetadataCommand::new()` is another type.
        !source[..*at].ends_with(|c: char| c.is_alphanumeric() || c == '_')
    });
    calls
        .map(|(at, _)| {
            let rest = &source[at + CALL.len()..];
            let mut depth = 1;
            let end = rest.find(|c| {
                depth += i32::from(c == '(') - i32::from(c == ')');
                depth == 0
            });
            rest[..end.unwrap_or(rest.len())].trim()
        })
        .collect()
}

/// Whether the program of a call is in the list.
fn is_listed(file: &str, program: &str) -> bool {
    ANYWHERE.iter().any(|(known, _)| *known == program)
        || HERE.iter().any(|(at, known, _)| (*at, *known) == (file, program))
}

#[test]
fn no_test_starts_a_program_that_a_bare_machine_lacks() {
    let metadata = MetadataCommand::new().no_deps().exec().expect("cargo metadata runs in this workspace");
    let root = metadata.workspace_root.as_std_path();
    let folder = |package: &Package| package.manifest_path.parent().expect("a folder").to_owned();
    let mut files: Vec<PathBuf> =
        metadata.packages.iter().flat_map(|package| rust_files(folder(package).as_std_path())).collect();
    files.sort();
    files.dedup();
    let (mut calls, mut unlisted) = (0, Vec::new());
    for path in files.iter().filter(|path| !path.ends_with(file!())) {
        let source = std::fs::read_to_string(path).expect("a source file");
        let file = path.strip_prefix(root).expect("in the workspace").to_str().expect("a plain name");
        for program in programs(&source) {
            calls += 1;
            if !is_listed(file, program) {
                unlisted.push(format!("{file}: Command::new({program})"));
            }
        }
    }
    assert!(calls > 10, "{calls} calls: the search misses them");
    assert!(unlisted.is_empty(), "say here why a bare machine has this program:\n{}", unlisted.join("\n"));
}

#[test]
fn a_call_is_found_however_it_is_written() {
    let source = r#"
        Command::new("kill").arg("-INT");
        std::process::Command::new( env!("CARGO_BIN_EXE_palpate") );
        MetadataCommand::new();
        Command::new(name.unwrap_or_else(|| "ps".into()))
    "#;
    let found = programs(source);
    assert_eq!(
        found,
        ["\"kill\"", "env!(\"CARGO_BIN_EXE_palpate\")", "name.unwrap_or_else(|| \"ps\".into())"]
    );
    let listed: Vec<bool> =
        found.iter().map(|program| is_listed("tools/tests/space_faults/signals.rs", program)).collect();
    assert_eq!(listed, [false, true, false]);
}
