//! Read-only folders and files.

use std::path::Path;
use std::process::Command;

use super::disk::Mount;
use super::{LARGE, SMALL, dump, fails, kept, palpate, precompute, rows, scene, succeeds, undisturbed};
use crate::text;

fn inspect(space: &Path) -> Command {
    let mut command = palpate();
    command.arg("inspect").arg(space);
    command
}

#[test]
fn a_folder_that_may_not_be_written_is_one_line_and_its_stores_can_be_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path(), SMALL);
    let expected = undisturbed(&scene, folder.path());
    let Some(disk) = Mount::tmpfs(&folder.path().join("100% shelf?"), "16m") else { return };
    let space = disk.0.join("a #1.space");
    succeeds(precompute(&scene, &space, 2));
    disk.make_read_only();
    fails(
        precompute(&scene, &disk.0.join("new.space"), 2),
        2,
        &["new.space", "cannot be opened", "is writable"],
    );
    fails(precompute(&scene, &space, 2), 2, &["a #1.space", "cannot be opened", "is writable"]);
    let mut salvage = precompute(&scene, &space, 2);
    salvage.arg("--salvage");
    fails(salvage, 2, &["a #1.space", "Read-only file system"]);
    succeeds(inspect(&space));
    assert_eq!(dump(&space, folder.path()), expected);
    let mut pack = palpate();
    pack.arg("pack").arg(&space).arg("--out").arg(folder.path().join("a.blob")).arg("--no-certificate");
    succeeds(pack);
}

/// The log of a killed run on a read-only disk: it can only be read if SQLite may create its index.
#[test]
fn a_store_with_a_log_left_over_is_read_whole_or_not_at_all() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path(), LARGE);
    let Some(disk) = Mount::tmpfs(&folder.path().join("shelf"), "64m") else { return };
    let space = disk.0.join("a.space");
    let mut run = precompute(&scene, &space, 1);
    let mut run = run.stdout(std::process::Stdio::null()).spawn().expect("runs");
    // At least one commit, so that the log holds rows that the database file does not.
    while kept(&space, folder.path()).is_empty() {
        assert!(run.try_wait().expect("a state").is_none(), "it kept nothing before its end");
    }
    run.kill().expect("SIGKILL");
    run.wait().expect("reaped");
    let whole = rows(&space, folder.path(), true);
    assert!(whole.len() > 1 && disk.0.join("a.space-wal").exists(), "{} rows", whole.len());
    // With its index beside it ...
    disk.make_read_only();
    assert_eq!(rows(&space, folder.path(), true), whole);
    // ... and without.
    disk.make_writable();
    std::fs::remove_file(disk.0.join("a.space-shm")).expect("removed");
    disk.make_read_only();
    fails(inspect(&space), 2, &["a.space", "a.space-wal", "copy both files"]);
    let own = folder.path().join("a.space");
    for suffix in ["", "-wal"] {
        let from = format!("{}{suffix}", text(&space));
        std::fs::copy(from, format!("{}{suffix}", text(&own))).expect("copied");
    }
    assert_eq!(rows(&own, folder.path(), true), whole, "what the line says to do helps");
}
