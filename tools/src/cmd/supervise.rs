//! `palpate supervise`: the process that holds a device for `palpate run`.

use clap::Args as ClapArgs;
use palpate_host::supervisor::serve_stdin;
use palpate_host::sys::{self, RtRequest};

use crate::failure::Failure;
use crate::hardware::{self, Hardware};

/// Hold a device for `palpate run`, and zero its force if that process ends, stops or hangs.
///
/// `palpate run` starts it with a socket as its standard input. Ctrl-C and SIGTERM do not end it; it ends
/// with its host.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// polhem:PORT or falcon[:FIRMWARE]
    device: String,
    /// Capabilities of the device: a bundled profile, or a file that ends in .toml
    #[arg(long, value_name = "NAME|FILE.toml")]
    profile: Option<String>,
    /// SCHED_FIFO priority, 1 to 98; ordinary scheduling if not given
    #[arg(long, value_name = "PRIORITY", value_parser = clap::value_parser!(i32).range(1..=98))]
    fifo: Option<i32>,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    // A signal to the host's process group ends the host; this process must then zero the force, so it
    // ignores it.
    ctrlc::set_handler(|| ()).map_err(|error| Failure::work(format!("cannot ignore Ctrl-C: {error}")))?;
    let request = RtRequest { fifo_priority: args.fifo, ..RtRequest::default() };
    let (report, _held) = sys::enter_real_time(&request);
    let open = || {
        let profile = hardware::profile(&args.device, args.profile.as_deref())?;
        match (Hardware::named(&args.device), profile) {
            (Some(hardware), Some(profile)) => Ok(hardware.open(&profile, args.fifo)?.into_device()),
            _ => Err(Failure::input(format!("no device with motors is called `{}`", args.device))),
        }
    };
    serve_stdin(report.policy, || open().map_err(|failure: Failure| failure.line())).map(|_| ()).map_err(
        |error| Failure::input(format!("{error}: supervise is started by `palpate run`, not by hand")),
    )
}
