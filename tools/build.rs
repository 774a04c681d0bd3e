//! Passes compiler, target and commit to the program, for `--version` and the footers of reports.

use std::path::Path;
use std::process::Command;

/// The trimmed standard output of a program that succeeds and prints something.
fn said(program: &str, arguments: &[&str]) -> Option<String> {
    let output =
        Command::new(program).args(arguments).output().ok().filter(|output| output.status.success())?;
    let text = String::from_utf8(output.stdout).ok()?.trim().to_owned();
    (!text.is_empty()).then_some(text)
}

/// The commit of these sources, or an empty text outside of their repository.
fn commit() -> String {
    let git = |arguments: &[&str]| said("git", arguments);
    // Sources without their history may lie inside another repository, whose commit would be wrong.
    let is_ours = git(&["rev-parse", "--show-prefix"]).as_deref() == Some("tools/");
    let Some(commit) = git(&["rev-parse", "--short=12", "HEAD"]).filter(|_| is_ours) else {
        return String::new();
    };
    // The log of HEAD changes with every commit and checkout; HEAD itself only with the branch.
    for name in ["logs/HEAD", "HEAD"] {
        if let Some(path) = git(&["rev-parse", "--git-path", name]).filter(|path| Path::new(path).exists()) {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    commit
}

fn main() {
    let rustc = std::env::var("RUSTC").unwrap_or_else(|_| "rustc".into());
    let version = said(&rustc, &["--version"]).unwrap_or_else(|| "rustc of unknown version".into());
    println!("cargo::rustc-env=PALPATE_RUSTC={version}");
    let target = std::env::var("TARGET").expect("cargo names the target");
    println!("cargo::rustc-env=PALPATE_TARGET={target}");
    println!("cargo::rustc-env=PALPATE_COMMIT={}", commit());
    println!("cargo::rerun-if-changed=build.rs");
}
