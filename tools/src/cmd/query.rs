//! `palpate query`: evaluates a blob at given displacements, as the real-time loop does.

use std::path::PathBuf;

use clap::Args as ClapArgs;
use palpate_core::{Method, Organ, Space};

use super::pack::method;
use crate::blob;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Replace};

/// Evaluate the force of a blob at given displacements of an active node.
///
/// Input: CSV with the header x_m,y_m,z_m. Output: x_m,y_m,z_m,fx_n,fy_n,fz_n,coverage, where coverage is
/// cell, supercell or scattered if data of the method surround the point, else extrapolated. The force is
/// always finite.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// The .blob file
    blob: PathBuf,
    /// Active node; the first if not given
    #[arg(long)]
    active: Option<String>,
    /// Interpolation method
    #[arg(long, value_parser = method)]
    method: Method,
    /// CSV file with the displacements
    #[arg(long)]
    points: PathBuf,
    /// CSV file to write
    #[arg(long)]
    csv: PathBuf,
    /// Also write dh/dd (sxx_n_m .. szz_n_m, nine columns, sxy = dhx/dy) and, where the force is its
    /// gradient, the energy
    #[arg(long)]
    stiffness: bool,
    /// Also write the displacement of every visual node: columns uN_x_m, uN_y_m, uN_z_m, N the mesh node
    #[arg(long)]
    displacements: bool,
    #[command(flatten)]
    replace: Replace,
}

/// The space named `name`, or the first.
pub(crate) fn find_space<'o, 'a>(organ: &'o Organ<'a>, name: Option<&str>) -> Option<&'o Space<'a>> {
    organ.spaces.iter().find(|s| name.is_none_or(|name| s.active.name == name))
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let mut files = Files::new(args.replace);
    files.read(&args.blob);
    files.read(&args.points);
    let csv = files.write("--csv", &args.csv, FileKind::Table)?;
    let file = blob::load(&args.blob)?;
    let organ = blob::organ(&args.blob, &file)?;
    let space = find_space(&organ, args.active.as_deref()).ok_or_else(|| {
        let names: Vec<&str> = organ.spaces.iter().map(|s| s.active.name.as_str()).collect();
        Failure::input(format!("{}: no such active node; it has {}", args.blob.display(), names.join(", ")))
    })?;
    if !space.has(args.method) {
        return Err(Failure::input(format!(
            "{}: {} was not packed; run `palpate pack` with --method {}",
            args.blob.display(),
            args.method.name(),
            args.method.name()
        )));
    }
    if args.displacements && space.displacement().is_none() {
        return Err(Failure::input(format!(
            "{}: contains no displacements; set visual = true under [needs], run `palpate precompute` (no point is solved again) and pack again",
            args.blob.display()
        )));
    }
    let points = read_points(&args.points)?;
    let mut table = String::from("x_m,y_m,z_m,fx_n,fy_n,fz_n,coverage");
    if args.stiffness {
        table.push_str(",sxx_n_m,sxy_n_m,sxz_n_m,syx_n_m,syy_n_m,syz_n_m,szx_n_m,szy_n_m,szz_n_m,energy_j");
    }
    if args.displacements {
        for node in organ.surface.node {
            table.push_str(&format!(",u{node}_x_m,u{node}_y_m,u{node}_z_m"));
        }
    }
    table.push('\n');
    let mut moved = vec![[0.0f32; 3]; organ.surface.node.len()];
    for point in points {
        let [x, y, z] = point;
        // Finite values beyond the range of f32 are clamped, which gives the force at the rim. Infinity would
        // be an invalid position.
        let at = point.map(|v| {
            if v.is_finite() { v.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32 } else { v as f32 }
        });
        let found = space.force(args.method, at).ok_or_else(|| Failure::work("the method vanished"))?;
        let [fx, fy, fz] = found.force_n;
        table.push_str(&format!("{x:?},{y:?},{z:?},{fx:?},{fy:?},{fz:?},{}", found.coverage.name()));
        if args.stiffness {
            let found =
                space.estimate(args.method, at).ok_or_else(|| Failure::work("the method vanished"))?;
            for value in found.stiffness_n_m.as_flattened() {
                table.push_str(&format!(",{value:?}"));
            }
            table.push_str(&found.energy_j.map_or(",".into(), |energy| format!(",{energy:?}")));
        }
        if args.displacements {
            space.displacement_into(at, &mut moved);
            for [ux, uy, uz] in &moved {
                table.push_str(&format!(",{ux:?},{uy:?},{uz:?}"));
            }
        }
        table.push('\n');
    }
    csv.put(table.as_bytes())
}

fn read_points(path: &PathBuf) -> Result<Vec<[f64; 3]>, Failure> {
    let at = |line: u64, what: String| {
        Failure::input(format!(
            "{}:{line}: {what}; the header is x_m,y_m,z_m, one point a line",
            path.display()
        ))
    };
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_path(path)
        .map_err(|error| Failure::input(format!("{}: {error}; check the name", path.display())))?;
    let header = reader.headers().map_err(|error| at(1, error.to_string()))?;
    let column = |name: &str| header.iter().position(|h| h == name);
    let (Some(x), Some(y), Some(z)) = (column("x_m"), column("y_m"), column("z_m")) else {
        return Err(at(1, "columns x_m, y_m and z_m are required".into()));
    };
    let mut points = Vec::new();
    for (row, record) in reader.records().enumerate() {
        let line = row as u64 + 2;
        let record = record.map_err(|error| at(line, error.to_string()))?;
        let number = |column: usize| -> Result<f64, Failure> {
            let text = record.get(column).unwrap_or("");
            let finite = text.parse().ok().filter(|number: &f64| number.is_finite());
            finite.ok_or_else(|| at(line, format!("`{text}` is not a finite number")))
        };
        points.push([number(x)?, number(y)?, number(z)?]);
    }
    Ok(points)
}
