//! `palpate demo`: the main job on the bundled organ, without hardware or display.

mod live;
mod precomputed;

use std::path::{Path, PathBuf};

use clap::Args as ClapArgs;
use palpate_core::Method;

use crate::failure::Failure;
use crate::files::{FileKind, Files, Output, Replace};

/// Start here: touch the bundled organ, then check the force.
///
/// A simulated hand touches a liver-like phantom (incompressible Mooney-Rivlin, quadratic elements) with a fingertip
/// at 1 kHz, while a second process solves the model where the hand goes. Afterwards the positions that it visited
/// are solved fully, and the forces are compared. With --precomputed the configuration spaces of two places are solved and packed before the
/// touch. All files stay in the output folder.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Seconds of palpation
    #[arg(long, value_name = "S", default_value_t = 10.0)]
    seconds: f64,
    /// PNG frames instead of a window, even with a display
    #[arg(long)]
    headless: bool,
    /// Output folder
    #[arg(long, value_name = "DIR", default_value = "palpate-demo")]
    out: PathBuf,
    /// First solve the spaces of two places and pack them, then touch with the tables alone
    ///
    /// The way for a real-time PC without a solver, and for the lowest cost of a tick. A second run uses the
    /// solved spaces in the folder.
    #[arg(long)]
    precomputed: bool,
    /// Solve the spaces again even if the folder holds them
    #[arg(long, requires = "precomputed")]
    again: bool,
    /// Interpolation method of the tables
    #[arg(long, value_name = "M", default_value = "energy", value_parser = super::pack::method, requires = "precomputed")]
    method: Method,
    /// Print the figures as JSON (they are always in summary.json)
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    replace: Replace,
}

const SCENE: &str = include_str!("../../../../assets/demo.toml");
const MESH: &str = include_str!("../../../../assets/liver-small.msh");

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    if !(args.seconds > 0.0 && args.seconds.is_finite()) {
        return Err(Failure::input(format!("--seconds {}: give a positive number", args.seconds)));
    }
    let mut files = Files::new(args.replace);
    let folder = files.folder("--out", &args.out, |_| None)?;
    Files::not_a_file("--out", &args.out.join("frames"))?;
    let mut at = |name: &str, kind| files.write("--out", &folder.path().join(name), kind);
    let organ =
        Organ { scene: at("demo.toml", FileKind::Toml)?, mesh: at("liver-small.msh", FileKind::Mesh)? };
    if args.precomputed {
        precomputed::run(args, &mut files, &organ)
    } else {
        live::run(args, &mut files, &organ)
    }
}

/// The files of the bundled organ.
#[derive(Debug)]
struct Organ {
    scene: Output,
    mesh: Output,
}

impl Organ {
    /// Writes them, once no file of the demo is refused; the path of the scene.
    fn put(&self) -> Result<&Path, Failure> {
        self.mesh.put(MESH.as_bytes())?;
        self.scene.put(SCENE.as_bytes())?;
        Ok(self.scene.path())
    }
}
