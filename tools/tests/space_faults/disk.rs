//! A disk that is full, at every stage. The disk is a small tmpfs: mounting it needs root, so elsewhere the tests say that they
//! were skipped.

use std::path::{Path, PathBuf};
use std::process::Command;

use super::{LARGE, dump, kept, output, precompute, scene, succeeds, undisturbed};

/// A tmpfs mounted at a folder, taken away at the end.
pub(super) struct Mount(pub(super) PathBuf);

impl Mount {
    /// `None`, and a loud line, where this process may not mount.
    pub(super) fn tmpfs(at: &Path, options: &str) -> Option<Self> {
        std::fs::create_dir_all(at).expect("a folder");
        let mounted = run("mount", &["-t", "tmpfs", "-o", options, "palpate-test", text(at)]);
        if mounted {
            return Some(Self(at.to_path_buf()));
        }
        // Straight to the terminal: the test harness swallows what a passing test prints.
        let loud = "SKIPPED: a test that needs a small disk may not mount one here; run it as root\n";
        use std::io::Write;
        let _ = std::io::stderr().write_all(loud.as_bytes());
        None
    }

    pub(super) fn remount(&self, options: &str) {
        assert!(
            run("mount", &["-o", &format!("remount,{options}"), text(&self.0)]),
            "remounts with {options}"
        );
    }
}

impl Drop for Mount {
    fn drop(&mut self) {
        run("umount", &["-l", text(&self.0)]);
    }
}

fn run(program: &str, arguments: &[&str]) -> bool {
    Command::new(program).args(arguments).output().is_ok_and(|o| o.status.success())
}

pub(super) fn text(path: &Path) -> &str {
    path.to_str().expect("a plain name")
}

/// Disks from one that takes not even an empty store to one that takes nearly all of it: each run stops with one line and exit
/// code 1, and with room it goes on to the same bits.
#[test]
fn a_full_disk_is_one_clear_line_and_the_store_goes_on_when_there_is_room() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path(), LARGE);
    let expected = undisturbed(&scene, folder.path());
    let Some(disk) = Mount::tmpfs(&folder.path().join("disk"), "size=4k") else { return };
    let (mut early, mut late, mut found) = (0, 0, 0);
    for kib in [4, 12, 20, 36, 52, 68, 100, 200, 400, 1500, 2500, 3500] {
        disk.remount(&format!("size={kib}k"));
        let space = disk.0.join("a.space");
        let stopped = output(precompute(&scene, &space, 2));
        let line = String::from_utf8_lossy(&stopped.stderr).trim().to_string();
        assert_eq!(stopped.status.code(), Some(1), "{kib} KiB: {line}");
        assert_eq!(line.lines().count(), 1, "{kib} KiB: {line}");
        assert!(line.contains("a.space: the disk is full; "), "{kib} KiB: {line}");
        assert!(line.contains("make room and run the same command again"), "{kib} KiB: {line}");
        // Still full: still the same.
        assert_eq!(output(precompute(&scene, &space, 1)).status.code(), Some(1), "{kib} KiB, again");
        disk.remount("size=16m");
        let rows = kept(&space, folder.path()).len();
        *(if rows == 0 { &mut early } else { &mut late }) += 1;
        found += rows;
        succeeds(precompute(&scene, &space, 2));
        assert_eq!(dump(&space, folder.path()), expected, "{kib} KiB");
        for file in std::fs::read_dir(&disk.0).expect("the disk is there") {
            std::fs::remove_file(file.expect("an entry").path()).expect("removed");
        }
    }
    println!(
        "{early} disks full before the first configuration was kept, {late} later, {found} configurations kept"
    );
    assert!(early > 0 && late > 0, "{early} early, {late} late: the sizes miss something");
}
