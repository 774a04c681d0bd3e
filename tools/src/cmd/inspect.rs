//! `palpate inspect`: what a mesh, a scene, a space or a blob holds.

use std::path::{Path, PathBuf};

use clap::Args as ClapArgs;
use palpate_core::Method;
use palpate_precompute::blob_writer::write_atomically;
use palpate_precompute::configuration_space::{Record, SpaceGrid, Store};
use palpate_precompute::mesh::{LengthUnit, MeshReport, TetMesh, doubtful_for_pressure};
use serde_json::json;

use crate::failure::Failure;
use crate::output;
use crate::workbench::Workbench;

/// Show what a mesh, scene (.toml), space (.space) or blob (.blob) holds.
///
/// Of a mesh, alone or in a scene: counts, size, groups, the quality of its tets with a histogram of their smallest
/// dihedral angles, and warnings with the mend.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// The file
    file: PathBuf,
    /// Of a .space: write one row per configuration to this CSV file, sorted, full precision
    #[arg(long)]
    csv: Option<PathBuf>,
    /// Of a mesh: its unit of length, m, cm or mm (a scene says its own) [default: m]
    #[arg(long, value_parser = unit)]
    unit: Option<LengthUnit>,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

fn unit(text: &str) -> Result<LengthUnit, String> {
    LengthUnit::from_name(text).ok_or_else(|| "use m, cm or mm".into())
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let kind = args.file.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    if args.csv.is_some() && kind != "space" {
        return Err(Failure::input(format!("{}: --csv is for .space files", args.file.display())));
    }
    if args.unit.is_some() && matches!(kind.as_str(), "space" | "blob" | "toml") {
        return Err(Failure::input(format!("{}: --unit is for mesh files", args.file.display())));
    }
    let (text, figures) = match kind.as_str() {
        "space" => space(&args.file, args.csv.as_deref())?,
        "blob" => blob(&args.file)?,
        "toml" => scene(&args.file)?,
        _ => mesh(&args.file, args.unit.unwrap_or_default())?,
    };
    if args.json {
        output::line(serde_json::to_string_pretty(&figures).map_err(Failure::work)?)?;
    } else {
        output::line(text)?;
    }
    Ok(())
}

type Shown = (String, serde_json::Value);

fn mesh(path: &Path, unit: LengthUnit) -> Result<Shown, Failure> {
    let mesh = palpate_precompute::mesh::read(path, unit)?;
    describe_mesh(&mesh)
}

fn describe_mesh(mesh: &TetMesh) -> Result<Shown, Failure> {
    let report = MeshReport::of(mesh);
    let mut figures = serde_json::to_value(&report).map_err(Failure::work)?;
    figures["warnings"] = json!(report.warnings());
    Ok((report.to_string(), figures))
}

fn scene(path: &Path) -> Result<Shown, Failure> {
    let bench = Workbench::load(path)?;
    let scene = &bench.scene;
    let (mesh_text, mesh_figures) = describe_mesh(&scene.mesh)?;
    let active: Vec<String> = scene.active.iter().map(|a| format!("{} (node {})", a.name, a.node)).collect();
    let grid = scene.grid.map(|_| bench.grid()).transpose()?;
    let grid_text = grid.map_or("none".into(), |g| {
        format!("{} points, r_G {} m, spacing {} m", g.lattice.count(), g.radius_m, g.spacing_m)
    });
    let doubts = doubtful_for_pressure(&scene.mesh, &scene.fixed);
    let doubts_text =
        doubts.warning().map_or_else(String::new, |line| format!("\nif incompressible: {line}"));
    let text = format!(
        "scene   {}\nlaw     {}\nfixed   {} nodes\nactive  {}\ngrid    {grid_text}\nf_max   {} N\n\n{mesh_text}{doubts_text}",
        scene.name,
        bench.body.law_names(),
        scene.fixed.len(),
        active.join(", "),
        scene.max_force_n
    );
    let figures = json!({
        "name": scene.name, "law": bench.body.law_names(), "fixed": scene.fixed.len(), "active": scene.active,
        "grid": scene.grid, "points": grid.map(|g| g.lattice.count()), "max_force_n": scene.max_force_n,
        "mesh": mesh_figures, "pressure_doubts": doubts,
    });
    Ok((text, figures))
}

fn space(path: &Path, csv: Option<&Path>) -> Result<Shown, Failure> {
    let store = Store::open(path)?;
    let identity = store.identity()?;
    let grid = SpaceGrid::new(identity.spacing_m, identity.radius_m).map_err(Failure::input)?;
    let total = grid.lattice.count();
    let mut text = format!(
        "scene   {} ({})\ngrid    {total} points, r_G {} m, spacing {} m, f_max {} N\nsolver  {}\n",
        identity.scene_name,
        identity.law,
        identity.radius_m,
        identity.spacing_m,
        identity.max_force_n,
        store.meta("solver")?
    );
    let mut spaces = Vec::new();
    let mut table = format!("{CSV_HEADER}\n");
    for (active, (name, node)) in store.active()?.into_iter().enumerate() {
        let records = store.records(active)?;
        let count = |tag: &str| records.iter().filter(|r| r.tag.name() == tag && r.index != [0; 3]).count();
        let (expandable, terminating, failed) = (count("expandable"), count("terminating"), count("failed"));
        let solved: Vec<&Record> =
            records.iter().filter(|r| r.tag.is_solved() && r.index != [0; 3]).collect();
        let most = |value: fn(&Record) -> f64| solved.iter().map(|r| value(r)).fold(0.0, f64::max);
        let iterations: u32 = solved.iter().map(|r| r.iterations).sum();
        let seconds: f64 = records.iter().map(|r| r.seconds).sum();
        let inverted = solved.iter().filter(|r| r.inverted > 0).count();
        let unknown = total.saturating_sub(expandable + terminating + failed);
        let largest = most(Record::force_norm_n);
        let residual = most(|r| r.residual_n);
        text.push_str(&format!(
            "\n{name} (node {node})\n  {expandable} expandable, {terminating} terminating, {failed} failed, \
             {unknown} unknown\n  {inverted} with inverted elements\n  |h| up to {largest:.3} N, residual up to \
             {residual:.1e} N\n  {:.2} Newton iterations a configuration, {seconds:.1} s of solving\n",
            f64::from(iterations) / solved.len().max(1) as f64
        ));
        spaces.push(json!({
            "name": name, "node": node, "expandable": expandable, "terminating": terminating, "failed": failed,
            "unknown": unknown, "inverted": inverted, "max_force_n": largest, "max_residual_n": residual,
            "iterations": iterations, "seconds": seconds,
        }));
        for record in &records {
            table.push_str(&csv_row(&name, &grid, record));
        }
    }
    if let Some(csv) = csv {
        write_atomically(csv, table.as_bytes()).map_err(|error| Failure::file(csv, &error))?;
    }
    let figures = json!({
        "scene": identity.scene_name, "law": identity.law, "points": total, "radius_m": identity.radius_m,
        "spacing_m": identity.spacing_m, "max_force_n": identity.max_force_n, "spaces": spaces,
    });
    Ok((text.trim_end().into(), figures))
}

const CSV_HEADER: &str = "active,i,j,k,x_m,y_m,z_m,tag,round,parent_i,parent_j,parent_k,failure,energy_j,fx_n,fy_n,fz_n,\
                          sxx_n_m,syy_n_m,szz_n_m,sxy_n_m,sxz_n_m,syz_n_m,residual_n,min_jacobian,inverted,volume_m3,\
                          iterations,increments,seconds";

fn csv_row(active: &str, grid: &SpaceGrid, r: &Record) -> String {
    let ([i, j, k], [x, y, z]) = (r.index, grid.displacement_m(r.index));
    let parent = r.parent.map_or(",,".into(), |[i, j, k]| format!("{i},{j},{k}"));
    let head = format!(
        "{active},{i},{j},{k},{x:?},{y:?},{z:?},{},{},{parent},{}",
        r.tag.name(),
        r.round,
        r.failure.as_deref().unwrap_or("")
    );
    let tail = format!("{},{},{:?}\n", r.iterations, r.increments, r.seconds);
    if !r.tag.is_solved() {
        return format!("{head},,,,,,,,,,,{:?},,,,{tail}", r.residual_n);
    }
    let ([fx, fy, fz], s) = (r.force_n, &r.stiffness_n_m);
    format!(
        "{head},{:?},{fx:?},{fy:?},{fz:?},{:?},{:?},{:?},{:?},{:?},{:?},{:?},{:?},{},{:?},{tail}",
        r.energy_j,
        s[(0, 0)],
        s[(1, 1)],
        s[(2, 2)],
        s[(0, 1)],
        s[(0, 2)],
        s[(1, 2)],
        r.residual_n,
        r.min_jacobian,
        r.inverted,
        r.volume_m3
    )
}

fn blob(path: &Path) -> Result<Shown, Failure> {
    let file = crate::blob::load(path)?;
    let organ = crate::blob::organ(path, &file)?;
    let mut text = format!(
        "scene    {} ({})\nsize     {} bytes\nsurface  {} vertices, {} triangles\nf_max    {} N\n",
        organ.scene,
        organ.law,
        file.bytes().len(),
        organ.surface.node.len(),
        organ.surface.triangles.len(),
        organ.max_force_n
    );
    let mut spaces = Vec::new();
    for space in &organ.spaces {
        let methods: Vec<&str> = Method::ALL.iter().filter(|m| space.has(**m)).map(|m| m.name()).collect();
        let solved = space.flags.iter().filter(|f| **f & palpate_core::flags::SOLVED != 0).count();
        text.push_str(&format!(
            "\n{} (node {})\n  {} slots, {solved} solved, r_G {} m, spacing {} m\n  {}{}\n",
            space.name,
            space.node,
            space.lattice.slots(),
            space.lattice.radius_m(),
            space.lattice.spacing_m(),
            methods.join(", "),
            if space.displacement.is_some() { ", displacements" } else { "" }
        ));
        spaces.push(json!({
            "name": space.name.as_str(), "node": space.node, "slots": space.lattice.slots(), "solved": solved,
            "radius_m": space.lattice.radius_m(), "spacing_m": space.lattice.spacing_m(), "methods": methods,
            "displacements": space.displacement.is_some(),
        }));
    }
    let figures = json!({
        "scene": organ.scene.as_str(), "law": organ.law.as_str(), "bytes": file.bytes().len(),
        "surface_vertices": organ.surface.node.len(), "triangles": organ.surface.triangles.len(),
        "max_force_n": organ.max_force_n, "spaces": spaces,
    });
    Ok((text.trim_end().into(), figures))
}
