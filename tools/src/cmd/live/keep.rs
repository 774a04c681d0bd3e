//! `--keep`: what a session has touched becomes a configuration space.
//!
//! The jets of a session depend on its timing, and their solves stop early. So none of them is stored: the visited
//! positions are solved again to the full tolerance, as the first ones of an adaptive sampling, which then goes on
//! until its predictions hold. The result depends on the visited positions alone.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use palpate_core::Organ;
use palpate_precompute::num::{distance, norm};
use palpate_precompute::pipeline::Run;
use palpate_precompute::scene::{ResolvedScene, Scene, VisitedContact, VisitedPlace};
use serde::Serialize;

use super::super::live_solver::scene;
use super::Model;
use super::visits::Visit;
use crate::analysis::{self, open_space, threads};
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output};
use crate::progress::WorkProgress;

/// Smallest distance of two kept positions of a contact, and from rest, m.
const APART_M: f64 = 5e-3;
/// Most positions of a contact.
const MOST: usize = 64;
/// A contact counts as touched where its weight in the blend is at least this.
const WEIGHT: f32 = 0.3;

/// What was kept.
#[derive(Debug, Serialize)]
pub(super) struct Kept {
    contacts: usize,
    /// Visited positions, and all configurations of the space.
    visited: usize,
    configurations: usize,
    seconds: f64,
    /// Whether the user ended the solves.
    is_cut: bool,
}

/// The file of `--keep`, which must not exist. The scene must allow adaptive sampling.
pub(super) fn output(files: &mut Files, path: &Path, scene: &Scene) -> Result<Output, Failure> {
    let file = files.write("--keep", path, FileKind::Space)?;
    if path.exists() {
        let shown = path.display();
        return Err(Failure::input(format!(
            "--keep {shown}: already exists; `palpate precompute {shown}` continues it, or choose another name"
        )));
    }
    // What the scene lacks is told before the touch.
    let resolved = scene.resolve()?;
    let node = *resolved.active.first().map_or(&0, |active| &active.node);
    let contact = VisitedContact { name: "A".into(), place: VisitedPlace::Node(node), visited_m: Vec::new() };
    if resolved.tool.fingertip().is_none() {
        scene.with_visits(&[contact], REACH_M)?.resolve()?;
    }
    Ok(file)
}

/// Radius of the sampling in a scene without a grid, m.
const REACH_M: f64 = 0.03;

impl Kept {
    /// Solves the contacts of these visits of the first model into a new space. Without a touch there is none.
    pub(super) fn of<const N: usize>(
        model: &Model<'_>,
        organ: &Organ<'_, N>,
        visits: &[Visit],
        file: &Output,
        stop: &AtomicBool,
    ) -> Result<Option<Self>, Failure> {
        let (path, begun) = (model.scene, Instant::now());
        let scene = scene(path, &model.settings(0))?;
        let contacts = visited(organ, &scene.resolve()?, visits);
        if contacts.is_empty() {
            eprintln!("palpate: nothing was touched, so there is no {}", file.path().display());
            return Ok(None);
        }
        let visited = contacts.iter().map(|contact| contact.visited_m.len()).sum();
        let bench = analysis::of_scene(path, scene.with_visits(&contacts, REACH_M)?.resolve()?)?;
        let store = open_space(&bench, file, false)?;
        let all: Vec<usize> = (0..contacts.len()).collect();
        let mut progress = WorkProgress::new("keep", "solves");
        let run = Run { threads: threads(None)?, stop };
        let solved = bench.solve(&all, &store, run, |p| progress.spaces(p));
        progress.finish();
        let (is_cut, configurations) = match solved {
            Ok(counts) => (false, counts.iter().map(|counts| counts.solved()).sum()),
            Err(_) if stop.load(std::sync::atomic::Ordering::Relaxed) => (true, 0),
            Err(error) => return Err(error.into()),
        };
        Ok(Some(Self {
            contacts: contacts.len(),
            visited,
            configurations,
            seconds: begun.elapsed().as_secs_f64(),
            is_cut,
        }))
    }

    /// The lines of the report.
    pub(super) fn lines(&self, file: &Path) -> Vec<String> {
        let Self { contacts, visited, configurations, seconds, .. } = self;
        let shown = file.display();
        let next = if self.is_cut { "continue with `palpate precompute" } else { "next: `palpate pack" };
        let end = if self.is_cut {
            "`".into()
        } else {
            format!(" --out {}`", file.with_extension("blob").display())
        };
        let count =
            if self.is_cut { "interrupted".into() } else { format!("{configurations} configurations") };
        vec![
            format!(
                "kept         {shown}: {contacts} contacts, {visited} visited positions, {count} in {seconds:.1} s"
            ),
            format!("             {next} {shown}{end}"),
        ]
    }
}

/// The touched contacts in the order of their first touch, each with visited positions that lie apart.
fn visited<const N: usize>(
    organ: &Organ<'_, N>,
    scene: &ResolvedScene,
    visits: &[Visit],
) -> Vec<VisitedContact> {
    let mut found: Vec<(u16, Vec<[f64; 3]>)> = Vec::new();
    for visit in visits.iter().filter(|visit| visit.changes == 0) {
        let at_m = visit.control_m.map(f64::from);
        for node in visit.weights.iter().filter(|node| node.weight >= WEIGHT) {
            let index = found.iter().position(|(contact, _)| *contact == node.space).unwrap_or_else(|| {
                found.push((node.space, Vec::new()));
                found.len() - 1
            });
            let kept = &mut found[index].1;
            let is_apart = norm(at_m) > APART_M && kept.iter().all(|other| distance(*other, at_m) > APART_M);
            if is_apart && kept.len() < MOST {
                kept.push(at_m);
            }
        }
    }
    found.retain(|(_, visited_m)| !visited_m.is_empty());
    let contact = |(contact, visited_m): (u16, Vec<[f64; 3]>)| {
        let node = organ.spaces[usize::from(contact)].active.node;
        let own = scene.active.iter().find(|active| active.node == node && active.patch.is_empty());
        let place = match scene.tool.fingertip() {
            Some(_) => VisitedPlace::Point(scene.mesh.nodes_m[node as usize]),
            None => VisitedPlace::Node(node),
        };
        let own = own.filter(|_| scene.tool.fingertip().is_none());
        let name = own.map_or_else(|| format!("N{node}"), |active| active.name.clone());
        VisitedContact { name, place, visited_m }
    };
    found.into_iter().map(contact).collect()
}
