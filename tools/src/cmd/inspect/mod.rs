//! `palpate inspect`: the content of a mesh, a scene, a space, a blob or a recording.

pub(crate) mod certificate;
mod columns;
mod held_out;
mod map;
pub(crate) mod overview;
mod recording;
pub(crate) mod scattered;
mod space;
mod summarised;
mod timeline;
mod trace;

use std::path::{Path, PathBuf};

use clap::Args as ClapArgs;
use palpate_core::{Method, Organ, Space};
use palpate_precompute::mesh::{LengthUnit, MeshReport, TetMesh, doubtful_for_pressure};
use palpate_precompute::scene::{Scene, Unreachable, doubt_of_size};
use palpate_precompute::space::Store;
use palpate_precompute::spec::{Lattice, Sampling, Scattered, Tolerance};
use palpate_viewer::map::Side;
use serde_json::json;

use crate::analysis;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Replace};
use crate::friction;
use crate::output;
pub(crate) use map::side;
use timeline::Window;

/// Show what a mesh, scene, space, blob or recording holds.
///
/// Of a space: points by tag, failures by reason, retries, branch jumps (between neighbours), inverted and
/// unstable states, forces, iterations and seconds.
///
/// Of a blob: its content and its certificate: verdict (green, yellow, red) with the reasons, and errors at
/// positions that no fit uses; with --verbose all tables and the ledger of omissions.
///
/// Of a recording: device, method, length, contacts, peak forces, faults, timing, and what is missing.
///
/// Of a mesh, alone or in a scene: counts, size, groups, the quality of its tets with a histogram of their
/// smallest dihedral angles (--verbose), and warnings with the fix.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// A mesh, .toml, .space, .blob or .mcap file
    file: PathBuf,
    /// Print everything: whole certificate, all nodes, histograms
    #[arg(long)]
    verbose: bool,
    /// Of a .space or .mcap: a row per configuration or tick
    ///
    /// Sorted, with full precision.
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
    /// With --csv: a row per attempt, also superseded ones
    #[arg(long, requires = "csv")]
    all_tries: bool,
    /// Of a .space: its configurations as points for ParaView
    ///
    /// One file per active node: FILE-NAME.vtu if there are several.
    #[arg(long, value_name = "FILE.vtu")]
    vtu: Option<PathBuf>,
    /// Of a .space: its held-out solutions, a row per position
    #[arg(long, value_name = "FILE.csv")]
    held_out: Option<PathBuf>,
    /// Of a .space or .mcap: a picture, a .png or a .svg
    ///
    /// Of a .space: the organ coloured by its stiffness at rest and by the configurations of its nodes.
    ///
    /// Of a .mcap: force for the hand, displacement and speed of the tool over time, and when the force was
    /// extrapolated, limited or zero. Where several ticks share a column, it shows their smallest and largest value.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Of a .mcap: the seconds that the --picture shows, such as 0.5,2 [default: all]
    #[arg(long, value_name = "FROM,UNTIL", requires = "picture", value_parser = Window::parse, allow_hyphen_values = true)]
    window: Option<Window>,
    /// Sides of the --picture of a .space, a row each [default: front,back]
    ///
    /// front, back, left, right, above or below; the long axis is across the front.
    #[arg(long, value_name = "SIDE,..", value_delimiter = ',', requires = "picture", value_parser = map::side)]
    from: Vec<Side>,
    /// Of a mesh: its unit, m, cm or mm (a scene states its own) [default: m]
    #[arg(long)]
    unit: Option<LengthUnit>,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    replace: Replace,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let kind = args.file.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    let of_spaces = args.vtu.is_some() || args.held_out.is_some() || !args.from.is_empty() || args.all_tries;
    let of_both = args.csv.is_some() || args.picture.is_some();
    if kind != "space" && (of_spaces || (of_both && kind != "mcap")) {
        let what = "--vtu, --held-out, --from and --all-tries are for .space files, --csv and --picture for .space and .mcap files";
        return Err(Failure::input(format!("{}: {what}", args.file.display())));
    }
    if kind != "mcap" && args.window.is_some() {
        return Err(Failure::input(format!("{}: --window is for .mcap files", args.file.display())));
    }
    if args.unit.is_some() && matches!(kind.as_str(), "space" | "blob" | "toml" | "mcap") {
        return Err(Failure::input(format!("{}: --unit is for mesh files", args.file.display())));
    }
    let mut files = Files::new(args.replace);
    let (text, figures) = match kind.as_str() {
        "space" => space::show(args, &mut files)?,
        "blob" => blob(&args.file, args.verbose)?,
        "mcap" => {
            files.read(&args.file);
            let csv =
                args.csv.as_ref().map(|path| files.write("--csv", path, FileKind::Table)).transpose()?;
            let picture = args
                .picture
                .as_ref()
                .map(|path| files.write("--picture", path, FileKind::Svg))
                .transpose()?;
            let window = args.window.unwrap_or(Window::ALL);
            recording::show(&args.file, csv.as_ref(), picture.as_ref().map(|file| (file, window)))?
        }
        "toml" => scene(&args.file, args.verbose)?,
        _ => mesh(&args.file, args.unit, args.verbose)?,
    };
    if args.json { output::json(&figures) } else { output::line(text) }
}

/// Maximum number of spaces shown without --verbose.
const MAX_SPACES: usize = 4;
/// Maximum number of active nodes whose names are shown without --verbose.
const MAX_NAMES: usize = 8;

type Shown = (String, serde_json::Value);

fn mesh(path: &Path, unit: Option<LengthUnit>, verbose: bool) -> Result<Shown, Failure> {
    let mesh = palpate_precompute::mesh::read(path, unit.unwrap_or_default())?;
    let (mut text, mut figures) = describe_mesh(&mesh, verbose)?;
    if unit.is_none()
        && let Some(doubt) = doubt_of_size(&mesh, None)
    {
        text = format!("warning: {doubt}, or inspect it with --unit\n{text}");
        figures["warnings"].as_array_mut().expect("a list").insert(0, doubt.into());
    }
    Ok((text, figures))
}

/// The warnings, then the figures; with `verbose` also the histogram.
fn describe_mesh(mesh: &TetMesh, verbose: bool) -> Result<Shown, Failure> {
    let report = MeshReport::of(mesh);
    let mut figures = serde_json::to_value(&report).map_err(Failure::work)?;
    figures["warnings"] = json!(report.warnings());
    Ok((if verbose { format!("{report:#}") } else { report.to_string() }, figures))
}

fn scene(path: &Path, verbose: bool) -> Result<Shown, Failure> {
    let bench = analysis::load(path)?;
    let scene = &bench.scene;
    let (mesh_text, mesh_figures) = describe_mesh(&scene.mesh, verbose)?;
    let active: Vec<String> = scene.active.iter().map(|a| format!("{} (node {})", a.name, a.node)).collect();
    let grid_text = scene.grid.map_or("none".into(), |sampling| match sampling {
        Sampling::Lattice(Lattice { grid, .. }) => {
            format!(
                "{} points, r_G {} m, spacing {} m",
                grid.lattice.points().count(),
                grid.radius_m,
                grid.spacing_m
            )
        }
        Sampling::Scattered(scattered) => in_words(&scattered),
    });
    let points = scene.grid.and_then(|sampling| Some(sampling.lattice()?.grid.lattice.points().count()));
    let grid_figures = match scene.grid {
        Some(Sampling::Lattice(Lattice { grid, complete_cells, increments })) => json!({
            "radius_m": grid.radius_m, "spacing_m": grid.spacing_m, "complete_cells": complete_cells,
            "increments": increments,
        }),
        Some(Sampling::Scattered(scattered)) => json!(scattered),
        None => json!(null),
    };
    let doubts = doubtful_for_pressure(&scene.mesh, &scene.fixed);
    let doubts_text =
        doubts.warning().map_or_else(String::new, |line| format!("if incompressible: {line}\n"));
    let more = active.len().saturating_sub(MAX_NAMES);
    let more = if more > 0 && !verbose { format!(" and {more} more") } else { String::new() };
    let shown = if verbose { &active[..] } else { &active[..active.len().min(MAX_NAMES)] };
    let refined =
        scene.unrefined.map_or_else(String::new, |_| format!("mesh            {}\n", scene.size_in_words()));
    let (warnings, mesh_text) = mesh_text.split_once("\nnodes ").unwrap_or_default();
    // Those of the scene are printed already.
    let warnings =
        if scene.warnings.is_empty() { warnings } else { warnings.trim_start_matches("no warnings\n") };
    let text = format!(
        "{warnings}\n{doubts_text}\nscene           {}\nlaw             {}\nfixed           {} nodes\nactive          {}{more}{}\n\
         grid            {grid_text}\nf_max           {} N\n{refined}nodes {mesh_text}",
        scene.name,
        bench.body.law_names(),
        scene.fixed.len(),
        shown.join(", "),
        left_out(&scene.unreachable),
        scene.max_force_n
    );
    let figures = json!({
        "name": scene.name, "law": bench.body.law_names(), "fixed": scene.fixed.len(), "active": scene.active,
        "unreachable": scene.unreachable, "grid": grid_figures, "points": points, "max_force_n": scene.max_force_n,
        "mesh": mesh_figures, "unrefined": scene.unrefined, "pressure_doubts": doubts, "warnings": scene.warnings,
    });
    Ok((text, figures))
}

/// The active nodes that no tool can reach, as text; empty if there are none.
fn left_out(unreachable: &Unreachable) -> String {
    if unreachable.any() { format!("; {unreachable}") } else { String::new() }
}

/// The same from a store, which contains the scene.
fn left_out_of(store: &Store) -> Result<Unreachable, Failure> {
    let (mesh, fixed) = store.body()?;
    Ok(Scene::parse(store.path(), store.identity()?.scene)?.resolve_in(mesh, fixed)?.unreachable)
}

/// The parameters of adaptive sampling, as text.
fn in_words(scattered: &Scattered) -> String {
    let Scattered { radius_m, tolerance: Tolerance { relative, absolute_n }, only_push, workspace_m } =
        scattered;
    let contact = if *only_push { ", where the tool presses" } else { "" };
    let within = workspace_m
        .map_or_else(String::new, |[low, high]| format!(", in the workspace from {low:?} to {high:?} m"));
    format!(
        "adaptive sampling within r_G {radius_m} m{contact}{within}, error at most the larger of {} % of |h| and {} mN",
        certificate::significant(1e2 * relative),
        certificate::significant(1e3 * absolute_n)
    )
}

fn blob(path: &Path, verbose: bool) -> Result<Shown, Failure> {
    let file = crate::blob::load(path)?;
    let organ = crate::blob::organ(path, &file)?;
    let spaces: Vec<_> = organ.spaces.iter().map(space_figures).collect();
    let sliding = sliding(&organ);
    let certificate = certificate::of(path, &organ)?;
    let mut text = match &certificate {
        Some(certificate) => overview::headline(certificate),
        None => "no certificate: the error of its forces against finite elements is unknown".into(),
    };
    let f_max = if organ.max_force_n < f32::MAX { format!("{} N", organ.max_force_n) } else { "none".into() };
    text.push_str(&format!(
        "\n\nscene    {} ({}), f_max {f_max}\nsize     {} bytes; surface of {} vertices, {} triangles\n",
        organ.scene,
        organ.law,
        file.bytes().len(),
        organ.surface.node.len(),
        organ.surface.triangles.len(),
    ));
    let shown = if verbose { organ.spaces.len() } else { MAX_SPACES };
    organ.spaces.iter().take(shown).for_each(|space| text.push_str(&space_in_words(space)));
    if let Some(space) = organ.spaces.first() {
        let displacements = if space.displacement().is_some() { ", displacements" } else { "" };
        text.push_str(&format!("tables   {}{displacements}\n", contents(space).1.join(", ")));
    }
    if organ.spaces.len() > shown {
        text.push_str(&format!("         and {} more nodes\n", organ.spaces.len() - shown));
    }
    if let Some(tip) = organ.tool.fingertip() {
        text.push_str(&format!(
            "tool     fingertip, pad of {:.1} mm radius and {:.0} N/m\n",
            1e3 * tip.radius_m,
            tip.stiffness_n_m
        ));
    } else {
        text.push_str("tool     holds nodes: the force of a single one depends on the mesh and goes to zero under refinement\n");
    }
    if let Some((triangles, all)) = sliding {
        text.push_str(&format!("sliding  over {triangles} of {all} triangles\n"));
    }
    if let Some(certificate) = &certificate {
        text.push('\n');
        if verbose {
            text.push_str(&certificate::as_text(certificate));
        } else {
            text.push_str(&overview::overview(certificate));
            text.push_str(&format!(
                "\n\nthe whole certificate: palpate inspect {} --verbose",
                path.display()
            ));
        }
    }
    let figures = json!({
        "certificate": certificate,
        "scene": organ.scene.as_str(), "law": organ.law.as_str(), "bytes": file.bytes().len(),
        "surface_vertices": organ.surface.node.len(), "triangles": organ.surface.triangles.len(),
        "max_force_n": organ.max_force_n, "spaces": spaces,
        "sliding": sliding.map(|(triangles, all)| json!({ "triangles": triangles, "of": all })),
        "fingertip": organ.tool.fingertip().map(|tip| json!({ "radius_m": tip.radius_m, "stiffness_n_m": tip.stiffness_n_m })),
    });
    Ok((text.trim_end().into(), figures))
}

/// The number of solved configurations of a space, and the names of its methods.
fn contents(space: &Space<'_>) -> (usize, Vec<&'static str>) {
    let is_solved = |flags: &&u8| **flags & palpate_core::flags::SOLVED != 0;
    let methods = Method::ALL.iter().filter(|method| space.has(**method)).map(|method| method.name());
    (space.planes().flags.iter().filter(is_solved).count(), methods.collect())
}

fn space_in_words(space: &Space<'_>) -> String {
    format!(
        "{:<8} node {}, r_G {} m, {} of {} slots {} m apart solved\n",
        space.active.name,
        space.active.node,
        space.lattice().radius_m(),
        contents(space).0,
        space.lattice().slots(),
        space.lattice().spacing_m()
    )
}

fn space_figures(space: &Space<'_>) -> serde_json::Value {
    let (solved, methods) = contents(space);
    json!({
        "name": space.active.name.as_str(), "node": space.active.node, "slots": space.lattice().slots(), "solved": solved,
        "radius_m": space.lattice().radius_m(), "spacing_m": space.lattice().spacing_m(), "methods": methods,
        "displacements": space.displacement().is_some(),
    })
}

/// Triangles that the tool slides over, and all triangles that it can meet; `None` if it slides nowhere.
fn sliding(organ: &Organ<'_>) -> Option<(usize, usize)> {
    let triangles = friction::slid_over(organ).len();
    (triangles > 0).then_some((triangles, organ.met().triangles.len()))
}
