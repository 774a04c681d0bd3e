//! `palpate run`: the 1 kHz loop on a blob and a device.

use std::path::{Path, PathBuf};

use clap::Args as ClapArgs;
use palpate_core::{Method, Organ};
use palpate_host::Device;
use palpate_host::device::polhem::{Polhem, PolhemConfig};
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};

use super::inspect::certificate;
use super::pack::method;
use crate::blob;
use crate::failure::Failure;
use crate::output;
use crate::touch;
use crate::workbench::stop_flag;

/// Touch the organ in a blob: the 1 kHz loop, a device and the viewer.
///
/// Without a display (or with --headless) PNG frames are written instead of a window. A real device is armed by its
/// button or by the window's key, never by starting. Ctrl-C ends the session with zero force.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// The .blob file
    blob: PathBuf,
    /// The device: sim (a simulated hand), or polhem:PORT (Polhem / WoodenHaptics on a serial port)
    #[arg(long, default_value = "sim")]
    device: String,
    /// Interpolation method; if not given the first that the blob holds of energy, hermite, tricubic, rbf-cubic, rbf-linear,
    /// hybrid, trilinear
    #[arg(long, value_parser = method)]
    method: Option<Method>,
    /// Seconds to run; until Ctrl-C if not given
    #[arg(long)]
    seconds: Option<f64>,
    /// PNG frames instead of a window
    #[arg(long)]
    headless: bool,
    /// Run a blob that nobody measured: without a certificate nothing says how far its forces are from finite elements
    #[arg(long)]
    uncertified: bool,
    /// Folder for frames and screenshots
    #[arg(long, default_value = "palpate-frames")]
    pictures: PathBuf,
}

fn open_device(name: &str, organ: &Organ<'_>) -> Result<Box<dyn Device>, Failure> {
    match name.split_once(':') {
        None if name == "sim" => Ok(Box::new(SimulatedHand::new(organ, SimulatedConfig::default()))),
        Some(("polhem", port)) => {
            let device = Polhem::open(port, PolhemConfig::default());
            Ok(Box::new(
                device.map_err(|error| Failure::input(format!("{port}: {error}; check port and power")))?,
            ))
        }
        _ => Err(Failure::input(format!("no device `{name}`; choose sim or polhem:PORT"))),
    }
}

/// Without --method: the most accurate that costs the same whatever the grid, then the others.
const PREFERENCE: [Method; 7] = [
    Method::Energy,
    Method::Hermite,
    Method::Tricubic,
    Method::RbfCubic,
    Method::RbfLinear,
    Method::Hybrid,
    Method::Trilinear,
];

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let file = blob::load(&args.blob)?;
    let organ = blob::organ(&args.blob, &file)?;
    let packed = || PREFERENCE.into_iter().find(|m| organ.spaces.iter().all(|s| s.has(*m)));
    let method = args.method.or_else(packed).ok_or_else(|| {
        Failure::input(format!(
            "{}: holds no method for all its active nodes; pack again",
            args.blob.display()
        ))
    })?;
    if !args.uncertified {
        check_certificate(&args.blob, &organ, method)?;
    }
    let show = touch::Show { seconds: args.seconds, headless: args.headless, pictures: &args.pictures };
    let stop = stop_flag()?;
    let summary = touch::run(&organ, method, show, &stop, || open_device(&args.device, &organ), |_| ())?;
    output::line(format!("method       {}\n{summary}", method.name()))?;
    touch::judge(&summary)
}

/// Refuses a blob that nobody measured with this method, or only where no position could speak for the others.
fn check_certificate(path: &Path, organ: &Organ<'_>, method: Method) -> Result<(), Failure> {
    let path_name = path.display();
    let Some(certificate) = certificate::of(path, organ)? else {
        return Err(Failure::input(format!(
            "{path_name}: has no certificate, so nothing says how far its forces are from the organ's; pack it without \
             --no-certificate, or run it with --uncertified"
        )));
    };
    for space in &certificate.spaces {
        let measured = space.methods.iter().find(|m| m.method == method.name());
        if measured.is_none_or(|m| m.uniform.count == 0) {
            return Err(Failure::input(format!(
                "{path_name}: its certificate has no position of {} away from folds for {}, so it says nothing about its forces; pack it \
                 on a finer grid or a smaller radius, or run it with --uncertified",
                space.active,
                method.name()
            )));
        }
    }
    Ok(())
}
