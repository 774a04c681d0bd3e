//! The table of a sweep: detectability of a ball by depth, size and stiffness.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use palpate_precompute::map::{Goal, Place, Sweep, SweepRow};
use palpate_precompute::scene::ResolvedScene;
use palpate_precompute::spec::Tolerance;
use serde_json::json;

use super::{Args, with_progress};
use crate::failure::Failure;
use crate::files::Output;
use crate::output::{self, Csv};
use crate::words::{figure, milli, percent};

/// Columns of the table as CSV.
const COLUMNS: &str = "cover_m,radius_m,ratio,status,tets,volume_share,stiffness_n_m,stiffness_without_n_m,depth_m,force_n,\
                       force_without_n,detectability";

/// Solves and prints the table.
pub(super) fn run(
    args: &Args,
    scene: &ResolvedScene,
    (goal, jnd): (&Goal, &Tolerance),
    stop: &Arc<AtomicBool>,
    csv: Option<&Output>,
) -> Result<(), Failure> {
    let place = place(args, scene)?;
    let metres = |values: &[f64]| values.iter().map(|mm| 1e-3 * mm).collect();
    let sweep = Sweep {
        covers_m: metres(&args.covers_mm),
        radii_m: metres(&args.radii_mm),
        ratios: args.ratios.clone(),
    };
    let total = sweep.covers_m.len() * sweep.radii_m.len() * sweep.ratios.len();
    let rows = with_progress(args, scene, ("sweep", "balls", total), stop, |work| {
        sweep.run(scene, &place, goal, work)
    })?;
    if let Some(file) = csv {
        file.put(&table(&rows, jnd)?)?;
    }
    if args.json {
        let rows: Vec<_> = rows.iter().map(|row| as_json(row, jnd)).collect();
        return output::json(&json!({
            "scene": scene.name, "under": place.active.name, "force_n": goal.force_n, "max_depth_m": goal.max_depth_m,
            "jnd_share": jnd.relative, "jnd_least_n": jnd.absolute_n, "rows": rows,
        }));
    }
    let tool = scene
        .tool
        .fingertip()
        .map_or("a point tool".into(), |tip| format!("a fingertip of {} mm", milli(tip.radius_m)));
    output::line(format!(
        "{}: change of force in just noticeable differences ({}, at least {} N) by a ball under \"{}\",\nwhere {tool} \
         pushes to {} N or {} mm; felt above 1.\n",
        scene.name,
        percent(jnd.relative),
        figure(jnd.absolute_n),
        place.active.name,
        figure(goal.force_n),
        milli(goal.max_depth_m)
    ))?;
    output::line(grid(&sweep, &rows, jnd))?;
    output::line(footnotes(&rows))
}

/// The place that `--under` names.
fn place(args: &Args, scene: &ResolvedScene) -> Result<Place, Failure> {
    let shown = args.scene.display();
    let name = args.under.as_deref();
    let Some(active) = scene.active.iter().find(|active| name.is_none_or(|name| active.name == name)) else {
        let known: Vec<&str> = scene.active.iter().map(|active| active.name.as_str()).collect();
        return Err(Failure::input(match (name, known.is_empty()) {
            (_, true) => {
                format!("{shown}: --sweep needs a place; add [[active]] with name and point to the scene")
            }
            (name, false) => {
                format!(
                    "{shown}: --under {}: no such place; it has {}",
                    name.unwrap_or_default(),
                    known.join(", ")
                )
            }
        }));
    };
    Place::named(scene, active).ok_or_else(|| {
        Failure::input(format!("{shown}: \"{}\" is not on the skin; name another place", active.name))
    })
}

fn detectability(row: &SweepRow, jnd: &Tolerance) -> Option<f64> {
    row.found?.compared.map(|compared| compared.detectability(jnd))
}

fn status(row: &SweepRow) -> &'static str {
    match row.found {
        None => "does not fit",
        Some(found) if found.compared.is_none() => "failed",
        Some(found) if found.reached => "reached",
        Some(_) => "below",
    }
}

/// A row for each cover and radius, a column for each ratio.
fn grid(sweep: &Sweep, rows: &[SweepRow], jnd: &Tolerance) -> String {
    let ratios = sweep.ratios.iter().map(|ratio| format!("{}x", figure(*ratio)));
    let mut lines =
        vec![["cover, mm".into(), "radius, mm".into()].into_iter().chain(ratios).collect::<Vec<String>>()];
    for cells in rows.chunks(sweep.ratios.len().max(1)) {
        let values = cells.iter().map(|row| match (row.found, detectability(row, jnd)) {
            (_, Some(value)) => format!("{value:.2}"),
            (None, _) => "-".into(),
            (Some(_), None) => "failed".into(),
        });
        lines.push([milli(cells[0].cover_m), milli(cells[0].radius_m)].into_iter().chain(values).collect());
    }
    let widths: Vec<usize> = (0..lines[0].len())
        .map(|column| lines.iter().map(|line| line[column].len()).max().unwrap_or(0))
        .collect();
    let pad = |line: &Vec<String>| {
        let cells: Vec<String> =
            line.iter().zip(&widths).map(|(cell, width)| format!("{cell:>width$}")).collect();
        cells.join("  ")
    };
    lines.iter().map(pad).collect::<Vec<_>>().join("\n")
}

/// What the table leaves out: how well the tets make up the balls, and pushes that stay below the force.
fn footnotes(rows: &[SweepRow]) -> String {
    let found = || rows.iter().filter_map(|row| row.found);
    let off = found().map(|found| (found.volume_share - 1.0).abs()).fold(0.0, f64::max);
    let tets = found().map(|found| found.tets).min().unwrap_or(0);
    let mut notes = vec![format!(
        "A ball is made of whole tets, at least {tets}; their volume differs from the ball's by up to {}.",
        percent(off)
    )];
    if rows.iter().any(|row| row.found.is_none()) {
        notes.push("- marks a ball that does not fit into the body.".into());
    }
    let below = found().filter(|found| !found.reached).count();
    if below > 0 {
        notes.push(format!("At {below} of {} balls the push ends below the force.", rows.len()));
    }
    format!("\n{}", notes.join("\n"))
}

fn table(rows: &[SweepRow], jnd: &Tolerance) -> Result<Vec<u8>, Failure> {
    let mut table = Csv::new(COLUMNS.split(','))?;
    for row in rows {
        let (found, compared) = (row.found, row.found.and_then(|found| found.compared));
        let ball = (row.cover_m, row.radius_m, row.ratio, status(row));
        let body = (found.map(|f| f.tets), found.map(|f| f.volume_share), found.map(|f| f.stiffness_n_m));
        let push = (compared.map(|c| c.stiffness_without_n_m), compared.map(|c| c.depth_m));
        let forces = (compared.map(|c| c.force_n), compared.map(|c| c.without_n), detectability(row, jnd));
        table.row((ball, body, push, forces))?;
    }
    table.finish()
}

fn as_json(row: &SweepRow, jnd: &Tolerance) -> serde_json::Value {
    let (found, compared) = (row.found, row.found.and_then(|found| found.compared));
    json!({
        "cover_m": row.cover_m, "radius_m": row.radius_m, "ratio": row.ratio, "status": status(row),
        "tets": found.map(|f| f.tets), "volume_share": found.map(|f| f.volume_share),
        "stiffness_n_m": found.map(|f| f.stiffness_n_m),
        "stiffness_without_n_m": compared.map(|c| c.stiffness_without_n_m),
        "depth_m": compared.map(|c| c.depth_m), "force_n": compared.map(|c| c.force_n),
        "force_without_n": compared.map(|c| c.without_n), "detectability": detectability(row, jnd),
    })
}
