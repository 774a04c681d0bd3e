//! Tests of the command line through the binary `palpate`.

mod command_line;
mod doctor;
mod documents;
mod extremes;
mod guard;
mod outputs;
mod paper;
mod plan;
mod progress;
mod recording;
mod report;
mod scenes;
mod space_faults;

use std::path::Path;
use std::process::{Command, Output};
use std::sync::{PoisonError, RwLock, RwLockWriteGuard};

/// Held for reading while a command runs, and for writing by a test that measures time: a solve or another
/// loop on the same cores would starve its loop.
static QUIET: RwLock<()> = RwLock::new(());

/// Waits until the commands of other tests have ended, and holds back new ones.
fn quiet() -> RwLockWriteGuard<'static, ()> {
    QUIET.write().unwrap_or_else(PoisonError::into_inner)
}

/// Runs a command to its end, except while another test measures time.
fn run(command: &mut Command) -> Output {
    let _beside_others = QUIET.read().unwrap_or_else(PoisonError::into_inner);
    command.output().expect("the program runs")
}

fn palpate(arguments: &[&str]) -> Output {
    run(Command::new(env!("CARGO_BIN_EXE_palpate")).args(arguments))
}

fn text(path: &Path) -> &str {
    path.to_str().expect("the folder's name is plain")
}
