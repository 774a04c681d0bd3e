//! `--keep`: what a session has touched becomes a configuration space.
//!
//! The jets of a session depend on its timing, and their solves stop early. So none of them is stored: the visited
//! positions are solved again to the full tolerance, as the first ones of an adaptive sampling, which then goes on
//! until its predictions hold. The result depends on the visited positions alone.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use palpate_core::Organ;
use palpate_precompute::num::{distance, norm};
use palpate_precompute::pipeline::Run;
use palpate_precompute::scene::{ResolvedScene, Scene, VisitedContact, VisitedPlace};
use palpate_precompute::space::TagCounts;
use serde::Serialize;

use super::super::live_solver::scene;
use super::Model;
use super::visits::Visit;
use crate::analysis::{self, open_space, threads};
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output};
use crate::progress::WorkProgress;

/// How often the wait for the solves looks at the stop flag.
const LOOK: Duration = Duration::from_millis(20);
/// Smallest distance of two kept positions of a contact, and from rest: this share of the farthest one, at most so much,
/// m.
const APART: f64 = 0.2;
const MAX_APART_M: f64 = 5e-3;
/// The sampling reaches this much farther than the hand, in whole tenths of a millimetre.
const MARGIN: f64 = 1.2;
const TENTH_M: f64 = 1e-4;
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
    if resolved.tool.sphere().is_some() {
        return Err(Failure::input("--keep: the visits of a sphere make no space; leave it out"));
    }
    let node = *resolved.active.first().map_or(&0, |active| &active.node);
    let contact = VisitedContact { name: "A".into(), place: VisitedPlace::Node(node), visited_m: Vec::new() };
    if resolved.tool.fingertip().is_none() {
        scene.with_visits(&[contact], TENTH_M)?.resolve()?;
    }
    Ok(file)
}

impl Kept {
    /// Solves the contacts of these visits of the first model into a new space. Without a touch there is none.
    pub(super) fn of<const N: usize>(
        model: &Model<'_>,
        organ: &Organ<'_, N>,
        visits: &[Visit],
        file: &Output,
        stop: &Arc<AtomicBool>,
    ) -> Result<Option<Self>, Failure> {
        let (path, begun) = (model.scene, Instant::now());
        let scene = scene(path, &model.settings(0))?;
        let contacts = visited(organ, &scene.resolve()?, visits);
        if contacts.is_empty() {
            let shown = file.path().display();
            eprintln!("palpate: nothing was touched before a change of the scene, so there is no {shown}");
            return Ok(None);
        }
        let (count, visited) = (contacts.len(), contacts.iter().map(|contact| contact.visited_m.len()).sum());
        let all_m = contacts.iter().flat_map(|contact| &contact.visited_m);
        let farthest_m = all_m.map(|at_m| norm(*at_m)).fold(0.0, f64::max);
        let radius_m = TENTH_M * (MARGIN * farthest_m / TENTH_M).ceil();
        let bench = analysis::of_scene(path, scene.with_visits(&contacts, radius_m)?.resolve()?)?;
        let store = open_space(&bench, file, false)?;
        let all: Vec<usize> = (0..contacts.len()).collect();
        let (threads, flag) = (threads(None)?, Arc::clone(stop));
        let (sender, result) = channel();
        // A solve is not interrupted, so its thread is left behind when the user ends it: what is solved is saved.
        std::thread::spawn(move || {
            let mut progress = WorkProgress::new("keep", "solves");
            let solved = bench.solve(&all, &store, Run { threads, stop: &flag }, |p| progress.spaces(p));
            progress.finish();
            // Nobody may wait any more.
            let _ = sender.send(solved);
        });
        let solved = loop {
            match result.recv_timeout(LOOK) {
                Ok(solved) => break Some(solved),
                Err(RecvTimeoutError::Timeout) if !stop.load(Ordering::Relaxed) => {}
                Err(_) => break None,
            }
        };
        let (is_cut, configurations) = match solved {
            Some(Ok(counts)) => (false, counts.iter().map(TagCounts::solved).sum()),
            Some(Err(error)) if !stop.load(Ordering::Relaxed) => return Err(error.into()),
            Some(Err(_)) => (true, 0),
            None if stop.load(Ordering::Relaxed) => (true, 0),
            None => return Err(Failure::work("the solves ended without a result")),
        };
        Ok(Some(Self {
            contacts: count,
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
        for node in visit.weights.iter().filter(|node| node.weight >= WEIGHT) {
            let index = found.iter().position(|(contact, _)| *contact == node.space).unwrap_or_else(|| {
                found.push((node.space, Vec::new()));
                found.len() - 1
            });
            found[index].1.push(visit.control_m.map(f64::from));
        }
    }
    for (_, all_m) in &mut found {
        *all_m = apart(all_m);
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

/// The farthest of some positions, and those that lie apart from it, from rest and from each other.
fn apart(all_m: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let farthest = all_m.iter().copied().max_by(|a, b| norm(*a).total_cmp(&norm(*b)));
    let Some(farthest) = farthest.filter(|at_m| norm(*at_m) > 0.0) else { return Vec::new() };
    let apart_m = (APART * norm(farthest)).min(MAX_APART_M);
    let mut kept = vec![farthest];
    for &at_m in all_m {
        let is_apart = norm(at_m) > apart_m && kept.iter().all(|other| distance(*other, at_m) > apart_m);
        if is_apart && kept.len() < MOST {
            kept.push(at_m);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_light_touch_is_kept_too() {
        let press = |deepest_m: f64| -> Vec<[f64; 3]> {
            (0..=100).map(|n| [0.0, 0.0, -0.01 * f64::from(n) * deepest_m]).collect()
        };
        for (deepest_m, count) in [(8e-4, 4), (0.02, 4), (0.05, 9), (0.0, 0)] {
            let kept = apart(&press(deepest_m));
            assert!(kept.len().abs_diff(count) <= 1, "{deepest_m}: {kept:?}");
            assert!(kept.first().is_none_or(|first| (first[2] + deepest_m).abs() < 1e-12));
        }
    }
}
