//! `palpate query`: evaluates a blob at given displacements, as the real-time loop does.

use std::path::{Path, PathBuf};

use clap::Args as ClapArgs;
use palpate_core::{Coverage, Method, Organ, Space};

use super::pack::method;
use crate::failure::Failure;
use crate::files::{Files, Replace, STANDARD};
use crate::output::Csv;
use crate::points::read_points;
use crate::{blob, output};

/// Evaluate the force of a blob at given displacements.
///
/// They are displacements of an active node from rest.
///
/// Input: CSV with the header x_m,y_m,z_m. Output: x_m,y_m,z_m,fx_n,fy_n,fz_n,coverage, where coverage is
/// cell, supercell or scattered if data of the method surround the point, else extrapolated. The force is
/// always finite.
///
/// Example: printf 'x_m,y_m,z_m\n0,0,-0.01\n' | palpate query liver.blob
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// The .blob file
    blob: PathBuf,
    /// Active node; the first if not given
    #[arg(long, value_name = "NAME")]
    active: Option<String>,
    /// Interpolation method; the blob's most accurate if not given
    #[arg(long, value_name = "M", value_parser = method)]
    method: Option<Method>,
    /// CSV file with the displacements; standard input if not given, or -
    #[arg(long, value_name = "FILE.csv", default_value = STANDARD, hide_default_value = true)]
    points: PathBuf,
    /// CSV file to write; standard output if not given, or -
    #[arg(long, value_name = "FILE.csv", default_value = STANDARD, hide_default_value = true)]
    csv: PathBuf,
    /// Also write dh/dd, and the energy where the force is its gradient
    ///
    /// Nine columns sxx_n_m .. szz_n_m, sxy = dhx/dy, and energy_j.
    #[arg(long)]
    stiffness: bool,
    /// Also write the displacement of every visual node
    ///
    /// Columns uN_x_m, uN_y_m, uN_z_m, N the mesh node.
    #[arg(long)]
    displacements: bool,
    #[command(flatten)]
    replace: Replace,
}

const COLUMNS: [&str; 7] = ["x_m", "y_m", "z_m", "fx_n", "fy_n", "fz_n", "coverage"];
/// Additional columns of --stiffness.
const STIFFNESS: [&str; 10] = [
    "sxx_n_m", "sxy_n_m", "sxz_n_m", "syx_n_m", "syy_n_m", "syz_n_m", "szx_n_m", "szy_n_m", "szz_n_m",
    "energy_j",
];

/// The space named `name`, or the first.
pub(crate) fn find_space<'o, 'a>(organ: &'o Organ<'a>, name: Option<&str>) -> Option<&'o Space<'a>> {
    organ.spaces.iter().find(|s| name.is_none_or(|name| s.active.name == name))
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let mut files = Files::new(args.replace);
    files.read(&args.blob);
    if args.points != Path::new(STANDARD) {
        files.read(&args.points);
    }
    let csv = files.table("--csv", Some(&args.csv))?;
    let file = blob::load(&args.blob)?;
    let organ = blob::organ(&args.blob, &file)?;
    let space = find_space(&organ, args.active.as_deref()).ok_or_else(|| {
        let names: Vec<&str> = organ.spaces.iter().map(|s| s.active.name.as_str()).collect();
        Failure::input(format!("{}: no such active node; it has {}", args.blob.display(), names.join(", ")))
    })?;
    let method = args.method.or_else(|| blob::preferred(&[&organ])).unwrap_or(Method::Energy);
    if !space.has(method) {
        let (blob, name) = (args.blob.display(), method.name());
        return Err(Failure::input(format!(
            "{blob}: {name} was not packed; run `palpate pack` with --method {name}"
        )));
    }
    if args.displacements && space.displacement().is_none() {
        return Err(Failure::input(format!(
            "{}: contains no displacements; set visual = true under [needs], run `palpate precompute` (no point is solved again) and pack again",
            args.blob.display()
        )));
    }
    let points = read_points(&args.points, "--points")?;
    let (table, extrapolated) = answers(args, &organ, space, method, &points)?;
    output::table(csv.as_ref(), &table)?;
    if let Some(file) = &csv {
        let (file, count, method) = (file.path().display(), points.len(), method.name());
        output::line(format!("{file}: {count} points by {method}, {extrapolated} of them extrapolated"))?;
    }
    Ok(())
}

/// The table, and the number of extrapolated points.
fn answers(
    args: &Args,
    organ: &Organ<'_>,
    space: &Space<'_>,
    method: Method,
    points: &[[f64; 3]],
) -> Result<(Vec<u8>, usize), Failure> {
    let nodes = organ.surface.node.iter().filter(|_| args.displacements);
    let displacements = nodes.flat_map(|node| ["x", "y", "z"].map(|axis| format!("u{node}_{axis}_m")));
    let stiffness = STIFFNESS.iter().filter(|_| args.stiffness).map(ToString::to_string);
    let columns = COLUMNS.iter().map(ToString::to_string).chain(stiffness).chain(displacements);
    let mut table = Csv::new(columns)?;
    let mut moved = vec![[0.0f32; 3]; organ.surface.node.len()];
    let mut extrapolated = 0;
    let vanished = || Failure::work("the method vanished");
    for &point in points {
        // Finite values beyond the range of f32 are clamped, which gives the force at the rim. Infinity would
        // be an invalid position.
        let at = point.map(|v| {
            if v.is_finite() { v.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32 } else { v as f32 }
        });
        let found = space.force(method, at).ok_or_else(vanished)?;
        extrapolated += usize::from(found.coverage == Coverage::Extrapolated);
        let estimate = args.stiffness.then(|| space.estimate(method, at).ok_or_else(vanished)).transpose()?;
        let stiffness = estimate.map(|found| (found.stiffness_n_m, found.energy_j));
        let displacements = if args.displacements {
            space.displacement_into(at, &mut moved);
            &moved[..]
        } else {
            &[]
        };
        let row = (point, found.force_n, found.coverage.name());
        // A missing option would be an empty cell.
        match stiffness {
            Some(stiffness) => table.row((row, stiffness, displacements))?,
            None => table.row((row, displacements))?,
        }
    }
    Ok((table.finish()?, extrapolated))
}
