//! A copy of the stand-in for makers' libraries, loaded as a user's library is, with a device of its own.

use super::cable::Cable;
use libloading::os::unix::{Library, Symbol};
use nix::sys::memfd::{MFdFlags, memfd_create};
use std::error::Error;
use std::ffi::{CString, c_char};
use std::fs::File;
use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// Why there is no copy.
type Failed = Box<dyn Error + Send + Sync>;

/// The file that cargo builds.
const NAME: &str = "libpalpate_maker_stub.so";

/// Copies that no rig uses: a library stays loaded, and has one device.
static FREE: Mutex<Vec<Loaded>> = Mutex::new(Vec::new());

#[derive(Debug)]
struct Loaded {
    /// The library as a file in memory, and the file of its device.
    library: OwnedFd,
    device: OwnedFd,
    attach: Symbol<unsafe extern "C" fn(*const c_char)>,
    step: Symbol<unsafe extern "C" fn()>,
    /// Both symbols are its.
    _loaded: Library,
}

/// A copy with a new device. It goes back to the free ones when this is dropped.
#[derive(Debug)]
pub struct Stub {
    copy: Option<Loaded>,
    /// The emulator's end.
    pub cable: Cable,
}

fn path_of(fd: &OwnedFd) -> PathBuf {
    format!("/proc/self/fd/{}", fd.as_raw_fd()).into()
}

/// The file of the stand-in: beside this program, or where cargo puts the libraries of its tests.
fn built() -> Result<PathBuf, Failed> {
    let program = std::env::current_exe()?;
    let folder = program.parent().ok_or("the program has no folder")?;
    let places = [folder.join(NAME), folder.join("deps").join(NAME)];
    let found = places.iter().find(|place| place.exists()).cloned();
    found.ok_or_else(|| format!("{NAME} is not beside this program; run it with cargo").into())
}

impl Loaded {
    fn new() -> Result<Self, Failed> {
        let memory = |name| memfd_create(name, MFdFlags::MFD_CLOEXEC).map_err(io::Error::from);
        let (library, device) = (memory(c"maker-stub")?, memory(c"device")?);
        io::copy(&mut File::open(built()?)?, &mut File::from(library.try_clone()?))?;
        // SAFETY: a library of ours, whose initialisers do nothing.
        let loaded = unsafe { Library::new(path_of(&library)) }?;
        // SAFETY: the signatures of these functions.
        let attach = unsafe { loaded.get(b"palpate_fake_attach\0") }?;
        // SAFETY: as above.
        let step = unsafe { loaded.get(b"palpate_fake_step\0") }?;
        Ok(Self { library, device, attach, step, _loaded: loaded })
    }
}

impl Stub {
    /// A device that was just plugged in, stepped.
    pub fn new() -> Result<Self, Failed> {
        let free = FREE.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let copy = free.map_or_else(Loaded::new, Ok)?;
        let device = path_of(&copy.device);
        let cable = Cable::renew(&device)?;
        let path = CString::new(device.as_os_str().as_bytes())?;
        // SAFETY: a text that outlives the call.
        unsafe { (copy.attach)(path.as_ptr()) };
        Ok(Self { copy: Some(copy), cable })
    }

    /// The library's file, for its driver.
    #[must_use]
    pub fn library(&self) -> PathBuf {
        self.copy.as_ref().map_or_else(PathBuf::new, |copy| path_of(&copy.library))
    }

    /// One cycle of the library's scheduler and of the firmware.
    pub fn step(&self) {
        if let Some(copy) = &self.copy {
            // SAFETY: no argument; the driver of this copy is on the same thread.
            unsafe { (copy.step)() };
        }
    }
}

impl Drop for Stub {
    fn drop(&mut self) {
        FREE.lock().unwrap_or_else(PoisonError::into_inner).extend(self.copy.take());
    }
}
