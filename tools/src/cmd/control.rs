//! `palpate control`: disarms, resets, changes or ends a session that has no window.

use std::path::PathBuf;

use clap::Args as ClapArgs;

use crate::control::{self, Request};
use crate::failure::Failure;
use crate::output;
use crate::setting::split;

/// Ask a session for its status, disarm, reset, change or end it.
///
/// The session was started with `palpate run --control SOCKET`. The answer is one line of JSON. No request arms:
/// that takes the button of the device.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// The socket of the session
    socket: PathBuf,
    /// What to do
    request: Request,
    /// With set: KEY=VALUE of the scene, for example material.c10_pa=2600
    #[arg(value_name = "KEY=VALUE", required_if_eq("request", "set"))]
    setting: Option<String>,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let socket = args.socket.display();
    if let Some(setting) = &args.setting {
        if args.request != Request::Set {
            return Err(Failure::input(format!("`{setting}` has no effect without set")));
        }
        split(setting)?;
    }
    let (answer, is_refused) = control::request(&args.socket, args.request, args.setting.as_deref())
        .map_err(|error| {
            Failure::input(format!("{socket}: {error}; give the --control of a session that runs"))
        })?;
    output::line(answer)?;
    if is_refused {
        return Err(Failure::work(format!("{socket}: the session did not do it")));
    }
    Ok(())
}
