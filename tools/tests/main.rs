//! Tests of the command line through the binary `palpate`.

mod command_line;
mod doctor;
mod documents;
mod extremes;
mod figures;
mod fingertip;
mod force_dimension;
mod guard;
mod haply;
mod identify;
mod live;
mod maker;
mod map;
mod outputs;
mod paper;
mod plan;
mod progress;
mod public;
mod recording;
mod records;
mod report;
mod scenes;
mod second;
mod session_kills;
mod space_faults;
mod touch;

use std::path::Path;
use std::process::{Command, Output};
use std::sync::{PoisonError, RwLock, RwLockWriteGuard};
use std::thread::JoinHandle;

use palpate_host::sys::{self, RtRequest};

/// Held for reading while a command runs, and for writing by a test that measures time: a solve or another
/// loop on the same cores would starve its loop.
static QUIET: RwLock<()> = RwLock::new(());

/// Waits until the commands of other tests have ended, and holds back new ones.
fn quiet() -> RwLockWriteGuard<'static, ()> {
    QUIET.write().unwrap_or_else(PoisonError::into_inner)
}

/// A device does not depend on this machine's scheduler: its thread has a higher priority than the loop if permitted.
fn device_thread<T: Send + 'static>(body: impl FnOnce() -> T + Send + 'static) -> JoinHandle<T> {
    std::thread::spawn(move || {
        let above = RtRequest { fifo_priority: Some(52), ..RtRequest::none() };
        let (_, _held) = sys::enter_real_time(&above);
        body()
    })
}

/// Runs a command to its end, except while another test measures time.
fn run(command: &mut Command) -> Output {
    let _beside_others = QUIET.read().unwrap_or_else(PoisonError::into_inner);
    command.output().expect("the program runs")
}

/// A number that `tests/kills` gives to a test through the environment.
fn number_of(variable: &str, otherwise: u64) -> u64 {
    let given = std::env::var(variable).ok();
    given.map_or(otherwise, |given| {
        given.parse().unwrap_or_else(|_| panic!("{variable} = {given} is no number"))
    })
}

fn palpate(arguments: &[&str]) -> Output {
    run(Command::new(env!("CARGO_BIN_EXE_palpate")).args(arguments))
}

/// Runs a command that must be refused with exit code 2 and one line that contains every word.
#[track_caller]
fn refused(arguments: &[&str], words: &[&str]) {
    refusal(&palpate(arguments), 2, words);
}

/// The line of a command that ended with `code` and one line that contains every word. Warnings do not count.
#[track_caller]
fn refusal(output: &Output, code: i32, words: &[&str]) -> String {
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{said}");
    assert_eq!(said.lines().filter(|line| !line.contains("warning")).count(), 1, "one line, not: {said}");
    for word in words {
        assert!(said.contains(word), "`{word}` is not in: {said}");
    }
    said.trim().to_owned()
}

/// Material and lattice of most scenes here: 124 points, a tenth of a second.
const MR: &str = "law = \"mooney-rivlin\"\nc10_pa = 1300.0\nc01_pa = 1280.0";
const GRID: &str = "radius_m = 0.01\nspacing_m = 0.005";

fn text(path: &Path) -> &str {
    path.to_str().expect("the folder's name is plain")
}
