//! The demo as it begins: touch at once, certificate afterwards.

use std::path::Path;

use palpate_precompute::scene::Scene;
use serde_json::json;

use super::super::live::{self, Compared, Ended};
use super::{Args, Organ};
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output};
use crate::output::{self, Csv};
use crate::{summary, touch};

/// Number of positions at which the force is checked.
const CHECKS: usize = 60;

/// Runs the command in its folder, which holds the scene.
pub(super) fn run(args: &Args, files: &mut Files, bundled: &Organ) -> Result<(), Failure> {
    let mut at = |name: &str, kind| files.write("--out", &args.out.join(name), kind);
    let (forces, figures) = (at("forces.csv", FileKind::Table)?, at("summary.json", FileKind::Json)?);
    let (scene, frames) = (bundled.put()?, args.out.join("frames"));
    eprintln!("palpate: a second process solves the model where the hand goes; nothing is precomputed");
    let ended = live::session(&live::Args::checked(scene, args.seconds, &frames, args.headless, CHECKS))?;
    touch::judge(&ended.touched.summary)?;
    write_forces(&forces, &ended)?;
    let session = summary::session(&ended.touched.summary, ended.touched.frames);
    let found = json!({ "seconds": args.seconds, "live": ended.certificate, "session": session });
    let text = serde_json::to_string_pretty(&found).map_err(Failure::work)?;
    figures.put(text.as_bytes())?;
    if args.json {
        return output::line(text);
    }
    output::line(in_words(args, scene, &ended)?)
}

fn in_words(args: &Args, scene: &Path, ended: &Ended) -> Result<String, Failure> {
    let resolved = Scene::load(scene)?.resolve()?;
    let (nodes, tets) = (resolved.mesh.nodes_m.len(), resolved.mesh.tets.len());
    let law = resolved.materials[0].material.name();
    let (headline, out) = (summary::headline(&ended.touched.summary), args.out.display());
    let (verdict, lines) = (ended.certificate.verdict(), ended.certificate.lines().join("\n"));
    let scene = scene.display();
    Ok(format!(
        "{verdict}\n\norgan        {}: {nodes} nodes, {tets} tetrahedra, {law}\ntouched      {headline}\n{lines}\n\n\
         in {out}/: forces.csv (felt and true force), summary.json, frames/\n\
         touch it yourself: palpate live {scene} --device mouse\n\
         with tables instead of a solver: palpate demo --precomputed",
        resolved.name
    ))
}

/// The felt force and that of the full solution at every position that was checked.
fn write_forces(file: &Output, ended: &Ended) -> Result<(), Failure> {
    let columns =
        ["x_m", "y_m", "z_m", "felt_fx_n", "felt_fy_n", "felt_fz_n", "fe_fx_n", "fe_fy_n", "fe_fz_n"];
    let mut table = Csv::new(columns.map(String::from))?;
    for Compared { visit, true_n } in &ended.checked.compared {
        table.row((visit.control_m, visit.felt_n, true_n))?;
    }
    file.put(&table.finish()?)
}
