//! Atomic writing of files.

use std::path::Path;

/// Writes a temporary file in the same folder and renames it, so that a partial file never has the final
/// name.
///
/// A symbolic link is followed. A path that is no regular file (a device, a pipe) is written directly,
/// because a rename would replace it by a file.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let path = &path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    if path.metadata().is_ok_and(|there| !there.is_file()) {
        return std::fs::write(path, bytes);
    }
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.part", std::process::id()));
    let temporary = path.with_file_name(name);
    let written = std::fs::write(&temporary, bytes).and_then(|()| std::fs::rename(&temporary, path));
    if written.is_err() {
        // The write error is returned; an error of the removal is ignored.
        let _ = std::fs::remove_file(&temporary);
    }
    written
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn links_and_devices_stay_what_they_are() {
        let folder = tempfile::tempdir().expect("a folder");
        let [link, sink, real] = ["link", "sink", "real"].map(|name| folder.path().join(name));
        std::os::unix::fs::symlink(&real, &link).expect("a link");
        std::os::unix::fs::symlink("/dev/null", &sink).expect("a link");
        for (path, times) in [(&real, 2), (&link, 2), (&sink, 2)] {
            for n in 0..times {
                write_atomically(path, &[n; 5]).expect("written");
            }
        }
        assert_eq!(std::fs::read(&real).expect("there"), [1; 5]);
        assert!(link.is_symlink() && sink.is_symlink());
        assert!(!Path::new("/dev/null").metadata().expect("there").is_file());
        assert_eq!(std::fs::read_dir(&folder).expect("there").count(), 3, "no part file is left");
    }
}
