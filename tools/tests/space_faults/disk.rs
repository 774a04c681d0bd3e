//! A full disk, at every stage. The disk is a small tmpfs. Mounting it needs root; without root the tests
//! report that they were skipped.

use std::path::{Path, PathBuf};

use nix::mount::{MntFlags, MsFlags, mount, umount2};

use super::{LARGE, dump, kept, output, precompute, scene, succeeds, undisturbed};

/// A tmpfs mounted at a folder, unmounted when dropped.
pub(super) struct Mount(pub(super) PathBuf);

impl Mount {
    /// `None`, and a line on the terminal, if this process may not mount.
    pub(super) fn tmpfs(at: &Path, size: &str) -> Option<Self> {
        std::fs::create_dir_all(at).expect("a folder");
        let size = format!("size={size}");
        let source = Some("palpate-test");
        if mount(source, at, Some("tmpfs"), MsFlags::empty(), Some(size.as_str())).is_ok() {
            return Some(Self(at.to_path_buf()));
        }
        // Directly to the terminal: the test harness hides the output of a test that passes.
        let loud = "SKIPPED: a test that needs a small disk may not mount one here; run it as root\n";
        use std::io::Write;
        let _ = std::io::stderr().write_all(loud.as_bytes());
        None
    }

    pub(super) fn resize(&self, size: &str) {
        self.remount(MsFlags::empty(), Some(&format!("size={size}")));
    }

    pub(super) fn make_read_only(&self) {
        self.remount(MsFlags::MS_RDONLY, None);
    }

    pub(super) fn make_writable(&self) {
        self.remount(MsFlags::empty(), None);
    }

    fn remount(&self, flags: MsFlags, options: Option<&str>) {
        mount(None::<&str>, &self.0, None::<&str>, MsFlags::MS_REMOUNT | flags, options).expect("remounts");
    }
}

impl Drop for Mount {
    fn drop(&mut self) {
        let _ = umount2(&self.0, MntFlags::MNT_DETACH);
    }
}

/// Disks from one without room for an empty store to one with room for nearly all of it. Each run stops with
/// one line and exit code 1; with room it continues to the same bits.
#[test]
fn a_full_disk_is_one_clear_line_and_the_store_goes_on_when_there_is_room() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path(), LARGE);
    let expected = undisturbed(&scene, folder.path());
    let Some(disk) = Mount::tmpfs(&folder.path().join("disk"), "4k") else { return };
    let (mut early, mut late, mut found) = (0, 0, 0);
    for kib in [4, 12, 20, 36, 52, 68, 100, 200, 400, 1500, 2500, 3500] {
        disk.resize(&format!("{kib}k"));
        let space = disk.0.join("a.space");
        let stopped = output(precompute(&scene, &space, 2));
        let line = String::from_utf8_lossy(&stopped.stderr).trim().to_string();
        assert_eq!(stopped.status.code(), Some(1), "{kib} KiB: {line}");
        assert_eq!(line.lines().count(), 1, "{kib} KiB: {line}");
        assert!(line.contains("a.space: the disk is full; "), "{kib} KiB: {line}");
        assert!(line.contains("free some space and run the same command again"), "{kib} KiB: {line}");
        // Still full: the same error.
        assert_eq!(output(precompute(&scene, &space, 1)).status.code(), Some(1), "{kib} KiB, again");
        disk.resize("16m");
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
