//! `palpate guard`: the process that guards the device of a `palpate run`.

use clap::Args as ClapArgs;
use palpate_host::guard::guard_stdin;

use crate::failure::Failure;

/// Guard the device of `palpate run`: zero its force if that process ends, stops or hangs.
///
/// `palpate run` starts it with a socket as its standard input. Ctrl-C and SIGTERM do not end it; it ends with
/// its session.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {}

/// Runs the command.
pub(crate) fn run(_args: &Args) -> Result<(), Failure> {
    guard_stdin()
        .map(|_| ())
        .map_err(|error| Failure::input(format!("{error}: guard is started by `palpate run`, not by hand")))
}
