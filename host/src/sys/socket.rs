//! A Unix socket that only its owner and one group may connect to.

use nix::sys::stat::{Mode, umask};
use nix::unistd::{Group, chown};
use std::fs::{self, Permissions};
use std::io::{self, ErrorKind};
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;

/// Creates a socket file with mode 0660 for `group`, or with mode 0600 if that group does not exist or this
/// user may not give it files. A socket that a dead process left behind is replaced.
///
/// # Errors
///
/// [`ErrorKind::AddrInUse`] if a process listens there; [`ErrorKind::AlreadyExists`] for any other file; an
/// error of the file system.
pub fn listen(path: &Path, group: &str) -> io::Result<UnixListener> {
    remove_stale(path)?;
    // From the first moment no other user may connect.
    let before = umask(Mode::from_bits_truncate(0o177));
    let bound = UnixListener::bind(path);
    umask(before);
    let listener = bound?;
    if gives_to_group(path, group) {
        fs::set_permissions(path, Permissions::from_mode(0o660))?;
    }
    Ok(listener)
}

fn remove_stale(path: &Path) -> io::Result<()> {
    let file_type = match fs::symlink_metadata(path) {
        Ok(metadata) => metadata.file_type(),
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error),
    };
    if !file_type.is_socket() {
        return Err(ErrorKind::AlreadyExists.into());
    }
    match UnixStream::connect(path) {
        Ok(_) => Err(ErrorKind::AddrInUse.into()),
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => fs::remove_file(path),
        Err(error) => Err(error),
    }
}

fn gives_to_group(path: &Path, group: &str) -> bool {
    let Ok(Some(group)) = Group::from_name(group) else { return false };
    // A service whose own group it is needs no right to change it.
    fs::metadata(path).is_ok_and(|metadata| metadata.gid() == group.gid.as_raw())
        || chown(path, None, Some(group.gid)).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nix::unistd::getgid;

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).expect("there").mode() & 0o777
    }

    #[test]
    fn only_the_owner_and_the_group_may_connect() {
        let folder = tempfile::tempdir().expect("a folder");
        let [private, shared] = ["private", "shared"].map(|name| folder.path().join(name));
        let _listener = listen(&private, "no-such-group").expect("bound");
        assert_eq!(mode(&private), 0o600);
        let own = Group::from_gid(getgid()).expect("readable").expect("this user's group has a name");
        let _listener = listen(&shared, &own.name).expect("bound");
        assert_eq!(mode(&shared), 0o660);
    }

    #[test]
    fn a_stale_socket_is_replaced_and_anything_else_stays() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("control");
        drop(listen(&path, "no-such-group").expect("bound"));
        let listener = listen(&path, "no-such-group").expect("the old one listens no more");
        let refused = listen(&path, "no-such-group").expect_err("in use");
        assert_eq!(refused.kind(), ErrorKind::AddrInUse);
        drop(listener);
        let file = folder.path().join("file");
        fs::write(&file, "mine").expect("written");
        assert_eq!(listen(&file, "no-such-group").expect_err("a file").kind(), ErrorKind::AlreadyExists);
        assert_eq!(fs::read_to_string(&file).expect("kept"), "mine");
    }
}
