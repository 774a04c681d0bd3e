//! A maker's shared library, found and loaded at run time.
//!
//! Nothing of a maker is linked or shipped. A library stays loaded: those of haptic devices run threads of their own, which may
//! still be in its code.
#![allow(unsafe_code)]

use core::fmt;
use libloading::os::unix::{Library as Loaded, RTLD_LOCAL, RTLD_NOW};
use std::ffi::CStr;
use std::path::{Path, PathBuf};

/// A loaded library.
#[derive(Debug, Clone, Copy)]
pub struct Library {
    loaded: &'static Loaded,
}

/// Why a library does not serve, in one line with the fix.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LibraryError {
    /// No file of these names is found.
    Missing {
        /// Name of the library for the user.
        what: &'static str,
        /// What the loader says of the first name.
        why: String,
    },
    /// A file is found and cannot be loaded.
    Broken {
        /// Name of the library for the user.
        what: &'static str,
        /// What the loader says.
        why: String,
    },
    /// A function is missing: the library is another one, or too old.
    Symbol {
        /// The library's file.
        file: PathBuf,
        /// The function.
        symbol: &'static str,
    },
}

impl fmt::Display for LibraryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing { what, why } => {
                let fix = "install it from its maker, or give its file after the device and a colon";
                write!(f, "{what} is not there ({why}); {fix}")
            }
            Self::Broken { what, why } => {
                write!(f, "{what} cannot be loaded ({why}); install what it needs, or another version of it")
            }
            Self::Symbol { file, symbol } => {
                write!(f, "{}: it has no `{symbol}`; install a newer version from its maker", file.display())
            }
        }
    }
}

impl core::error::Error for LibraryError {}

/// What the loader says of an error.
fn words(error: &libloading::Error) -> String {
    core::error::Error::source(error).map_or_else(|| error.to_string(), ToString::to_string)
}

impl Library {
    /// Loads the file that the user gives, or the first of `names` that the system's loader finds.
    pub fn load(
        what: &'static str,
        given: Option<&Path>,
        names: &[PathBuf],
    ) -> Result<(Self, PathBuf), LibraryError> {
        let given: Vec<PathBuf> = given.map(Path::to_path_buf).into_iter().collect();
        let names = if given.is_empty() { names } else { &given };
        let mut missing: Option<String> = None;
        for name in names {
            // SAFETY: loading runs the initialisers of a library that the user has installed for this purpose. NOW shows
            // missing dependencies here, and LOCAL keeps its symbols to itself.
            let why = match unsafe { Loaded::open(Some(name), RTLD_NOW | RTLD_LOCAL) } {
                Ok(loaded) => return Ok((Self { loaded: Box::leak(Box::new(loaded)) }, name.clone())),
                Err(error) => words(&error),
            };
            // Of a library that it needs, the loader gives the name of that one.
            let is_missing = why.starts_with(&*name.to_string_lossy()) && why.contains("No such file");
            if !is_missing {
                return Err(LibraryError::Broken { what, why });
            }
            missing.get_or_insert(why);
        }
        Err(LibraryError::Missing { what, why: missing.unwrap_or_else(|| "no name to look for".into()) })
    }

    /// The address of a function.
    ///
    /// # Safety
    ///
    /// `F` is the type of the function's pointer, with the signature that the library documents.
    pub(super) unsafe fn symbol<F: Copy>(&self, name: &CStr) -> Option<F> {
        // SAFETY: the caller's; the library is never unloaded.
        unsafe { self.loaded.get::<F>(name.to_bytes_with_nul()) }.ok().map(|symbol| *symbol)
    }
}

/// A table of a library's functions, filled once: `load` finds them all, or names the first that is missing.
macro_rules! functions {
    ($(#[$doc:meta])* $table:ident { $($field:ident: $symbol:ident($($argument:ty),*) $(-> $result:ty)?;)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy)]
        #[allow(unreachable_pub, reason = "as public as its module")]
        pub struct $table {
            $(#[doc = concat!("`", stringify!($symbol), "`")]
            pub $field: unsafe extern "C" fn($($argument),*) $(-> $result)?,)*
        }

        impl $table {
            /// The functions of a library.
            fn find(library: &Library, file: &Path) -> Result<Self, LibraryError> {
                Ok(Self {
                    $($field: {
                        const NAME: &CStr = match CStr::from_bytes_with_nul(
                            concat!(stringify!($symbol), "\0").as_bytes()
                        ) {
                            Ok(name) => name,
                            Err(_) => panic!("a name without a zero"),
                        };
                        // SAFETY: the type is that of the maker's header for this name.
                        let found = unsafe { library.symbol(NAME) };
                        found.ok_or_else(|| LibraryError::Symbol {
                            file: file.to_path_buf(),
                            symbol: stringify!($symbol),
                        })?
                    },)*
                })
            }
        }
    };
}
pub(super) use functions;

#[cfg(test)]
mod tests {
    use super::*;
    use core::ffi::c_int;

    functions! {
        /// Of the C library.
        Absolute { absolute: abs(c_int) -> c_int; }
    }

    functions! {
        /// Of no library.
        Nowhere { nothing: palpate_has_no_such_function(c_int) -> c_int; }
    }

    #[test]
    fn functions_are_found_or_the_first_that_is_missing_is_named() {
        let names = ["libnothing-of-ours.so.9", "libc.so.6"].map(PathBuf::from);
        let (library, file) = Library::load("the C library", None, &names).expect("it is there");
        let table = Absolute::find(&library, &file).expect("it has it");
        // SAFETY: abs of C, for a number whose absolute value exists.
        assert_eq!((unsafe { (table.absolute)(-3) }, file.to_str()), (3, Some("libc.so.6")));
        let missing = Nowhere::find(&library, &file)
            .map(|table| table.nothing as usize)
            .expect_err("none has it")
            .to_string();
        assert!(
            missing.contains("libc.so.6") && missing.contains("palpate_has_no_such_function"),
            "{missing}"
        );
    }

    #[test]
    fn what_is_no_library_is_an_error_with_the_fix() {
        let missing =
            Library::load("OpenHaptics", None, &["libnothing-of-ours.so".into()]).expect_err("none");
        let line = missing.to_string();
        assert!(
            line.contains("OpenHaptics is not there (libnothing-of-ours.so") && line.contains("install"),
            "{line}"
        );
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("text.so");
        std::fs::write(&file, "no library").expect("written");
        let broken = Library::load("OpenHaptics", Some(&file), &[]).expect_err("text").to_string();
        assert!(broken.contains("OpenHaptics cannot be loaded (") && broken.contains("text.so"), "{broken}");
    }
}
