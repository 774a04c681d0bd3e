//! `palpate proxy`: the process that holds the maker's library, or the connection to its service, of a session's device.

use clap::Args as ClapArgs;
use palpate_host::device::maker::serve_stdin;

use crate::failure::Failure;

/// Hold the maker's library or service of the device of `palpate run`, and zero its force if that process ends, stops or hangs.
///
/// `palpate run` starts it with a socket as its standard input. Ctrl-C and SIGTERM do not end it; it ends with
/// its session.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {}

/// Runs the command.
pub(crate) fn run(_args: &Args) -> Result<(), Failure> {
    serve_stdin()
        .map_err(|error| Failure::input(format!("{error}: proxy is started by `palpate run`, not by hand")))
}
