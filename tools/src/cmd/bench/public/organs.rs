//! The organs of the questions: their scenes, spaces, blobs and reference forces.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

use nalgebra::Vector3;
use palpate_core::{Method, Organ};
use palpate_host::BlobFile;
use palpate_precompute::certificate::answers;
use palpate_precompute::live::{LiveSolver, Truth};
use palpate_precompute::pack::{PackOptions, pack};
use palpate_precompute::pipeline::{Analysis, Run, solve_held_out_positions};
use palpate_precompute::space::{Kind, Store};

use super::questions::{Position, Questions, Vec3, Way};
use super::scenes::OrganScene;
use super::ways::Frame;
use crate::cmd::bench::live::simulation::touch;
use crate::failure::Failure;
use crate::files::Folder;
use crate::progress::WorkProgress;
use crate::{analysis, blob};

/// How much is asked.
#[derive(Debug, Clone, Copy)]
pub(super) struct Amount {
    /// Whether it is that of a quick run.
    quick: bool,
    /// Independent positions.
    pub(super) positions: u32,
    /// Closed loops.
    pub(super) loops: usize,
    /// Time between reference forces along a hand, ms.
    pub(super) every_ms: usize,
}

impl Amount {
    /// Of a full run, or of a quick one.
    pub(super) const fn of(quick: bool) -> Self {
        if quick {
            Self { quick, positions: 40, loops: 3, every_ms: 100 }
        } else {
            Self { quick, positions: 299, loops: 10, every_ms: 20 }
        }
    }
}

/// An organ that is ready to be asked.
#[derive(Debug)]
pub(super) struct Ready {
    /// Its scene.
    pub(super) scene: &'static OrganScene,
    /// The questions.
    pub(super) questions: Questions,
    /// Its space.
    pub(super) space: PathBuf,
    /// Its blob with every method.
    pub(super) blob: BlobFile,
    /// Path of the blob.
    pub(super) blob_path: PathBuf,
    /// The scene with its body.
    pub(super) analysis: Analysis,
    /// Wall time of all solves, s; `None` if an earlier run made some.
    solved_s: Option<f64>,
}

/// Folders of the command.
#[derive(Debug)]
pub(super) struct Rooms {
    /// Questions: a folder for each organ.
    pub(super) questions: Folder,
    /// Spaces, blobs and finished sections.
    pub(super) work: Folder,
}

/// Seed of the loops.
const SEED: u64 = 2027;

impl Ready {
    /// Solves what is missing: the space, the reference forces, and the blob.
    pub(super) fn prepare(
        scene: &'static OrganScene,
        rooms: &Rooms,
        folder: &Folder,
        amount: Amount,
        run: Run<'_>,
    ) -> Result<Self, Failure> {
        let name = if amount.quick { format!("{}-quick", scene.name) } else { scene.name.to_owned() };
        let space = rooms.work.path().join(format!("{name}.space"));
        let blob_name = format!("{name}.blob");
        let blob_path = rooms.work.path().join(&blob_name);
        let analysis = analysis::load(&folder.path().join(super::scenes::SCENE))?;
        let (started, is_new) = (Instant::now(), !space.exists());
        let store = analysis.store(&space)?;
        let mut progress = WorkProgress::new(scene.name, "positions");
        analysis.solve(&[0], &store, run, |p| progress.spaces(p))?;
        drop(store);
        solve_held_out_positions(&space, Some(amount.positions), run, |p| progress.held_out(p))?;
        progress.phase("fitting the tables of every method");
        let store = Store::open(&space)?;
        let options =
            PackOptions { methods: scene.methods, use_intermediate_states: true, threads: run.threads };
        let bytes = pack(&store, &options)?.bytes()?;
        rooms.work.file(&blob_name).put(&bytes)?;
        let blob = blob::load(&blob_path)?;
        let positions = positions(&store, &blob::organ(&blob_path, &blob)?, amount)?;
        progress.finish();
        let questions = with_ways(scene, folder, &analysis, positions, amount, run)?;
        let solved_s = is_new.then(|| started.elapsed().as_secs_f64());
        Ok(Self { scene, questions, space, blob, blob_path, analysis, solved_s })
    }

    /// How long the solves took that the figures of the forces need.
    pub(super) fn solved(&self) -> String {
        self.solved_s.map_or_else(
            || "Its solves are those of an earlier run.".into(),
            |s| format!("The solves of its table, positions and hands, and packing, took {s:.0} s."),
        )
    }

    /// What the reference forces are those of, with the warnings of the scene.
    pub(super) fn reference(&self) -> String {
        let mut says = self.scene.reference.to_owned();
        for warning in &self.analysis.scene.warnings {
            says += &format!(" Its scene warns: {warning}.");
        }
        says
    }

    /// The view of the blob that the loop uses.
    pub(super) fn organ(&self) -> Result<Organ<'_>, Failure> {
        blob::organ(&self.blob_path, &self.blob)
    }

    /// A live solver of the same scene, and the number of the contact at the touched place.
    pub(super) fn live(&self) -> Result<(LiveSolver, u16), Failure> {
        live(&self.analysis)
    }
}

fn live(analysis: &Analysis) -> Result<(LiveSolver, u16), Failure> {
    let path = &analysis.path;
    let solver = LiveSolver::new(&analysis.scene)
        .map_err(|error| Failure::input(format!("{}: {error}", path.display())))?;
    let node = analysis.active(None)?.1.node;
    let contact = solver.skin().contacts.iter().position(|contact| contact.node == node);
    let contact = contact
        .ok_or_else(|| Failure::work(format!("{}: the touched place is not on the skin", path.display())))?;
    Ok((solver, contact as u16))
}

/// The reachable held-out positions away from branch jumps, with their forces and residuals.
fn positions(store: &Store, organ: &Organ<'_>, amount: Amount) -> Result<Vec<Position>, Failure> {
    let mut residuals = BTreeMap::new();
    store.each_truth(0, |walk, step, truth| {
        if walk.kind == Kind::Uniform {
            residuals.insert((walk.number, step), truth.residual_n.unwrap_or(f64::NAN));
        }
    })?;
    let usable = answers(store, 0, organ, Method::Energy)?;
    let chosen = usable.iter().filter(|at| at.walk.kind == Kind::Uniform && !at.near_branch_jump);
    let position = |at: &palpate_precompute::certificate::Answer| Position {
        displacement_m: at.displacement_m.map(f64::from),
        truth_n: at.compared.truth_n,
        residual_n: residuals.get(&(at.walk.number, at.step)).copied().unwrap_or(f64::NAN),
    };
    Ok(chosen.map(position).take(amount.positions as usize).collect())
}

/// Adds hands and loops. They are read from the folder if they are there in this amount, because their reference
/// forces take long.
fn with_ways(
    scene: &OrganScene,
    folder: &Folder,
    analysis: &Analysis,
    positions: Vec<Position>,
    amount: Amount,
    run: Run<'_>,
) -> Result<Questions, Failure> {
    let frame = frame(analysis)?;
    let mut asked = Questions {
        organ: scene.name.into(),
        positions,
        loops: frame.loops(amount.loops, SEED),
        hands: frame.hands(),
    };
    for way in &mut asked.hands {
        way.truth_n.iter_mut().step_by(amount.every_ms).for_each(|truth| *truth = Some([0.0; 3]));
    }
    if let Ok(there) = Questions::read(scene.name, folder.path())
        && is_same(&there, &asked)
    {
        return Ok(there);
    }
    solve_hands(analysis, &mut asked.hands, run)?;
    asked.write(folder)?;
    Ok(asked)
}

/// Whether the stored questions are these, up to the reference forces of the hands.
fn is_same(there: &Questions, asked: &Questions) -> bool {
    let same_way = |(a, b): (&Way, &Way)| {
        // A place without a solution has no reference force.
        let is_asked = |(a, b): (&Option<Vec3>, &Option<Vec3>)| a.is_none() || b.is_some();
        let solved = a.truth_n.iter().flatten().count() * 2 > b.truth_n.iter().flatten().count();
        let is_part = a.truth_n.iter().zip(&b.truth_n).all(is_asked)
            && (solved || b.truth_n.iter().all(Option::is_none));
        a.name == b.name && a.displacement_m == b.displacement_m && is_part
    };
    let same_ways = |a: &[Way], b: &[Way]| a.len() == b.len() && a.iter().zip(b).all(same_way);
    there.positions == asked.positions
        && same_ways(&there.loops, &asked.loops)
        && same_ways(&there.hands, &asked.hands)
}

/// The frame of the touched place.
fn frame(analysis: &Analysis) -> Result<Frame, Failure> {
    let active = analysis.active(None)?.1;
    let skin = palpate_precompute::mesh::Surface::of(&analysis.scene.mesh);
    let normal = active.normal(&skin).ok_or_else(|| {
        Failure::work(format!("{}: the touched place has no normal", analysis.path.display()))
    })?;
    Ok(Frame::new(normal, analysis.sampling()?.radius_m()))
}

/// Full solutions along the hands, each continued from the one before.
fn solve_hands(analysis: &Analysis, hands: &mut [Way], run: Run<'_>) -> Result<(), Failure> {
    let (solver, contact) = live(analysis)?;
    let total: usize = hands.iter().map(|way| way.truth_n.iter().flatten().count()).sum();
    let (mut progress, mut done) = (WorkProgress::new(&analysis.scene.name, "positions"), 0);
    for way in hands {
        let mut truth = Truth::new(&solver);
        for (d, wanted) in way.displacement_m.iter().zip(&mut way.truth_n) {
            if wanted.is_none() {
                continue;
            }
            if run.stop.load(std::sync::atomic::Ordering::Relaxed) {
                return Err(super::interrupted());
            }
            // A place without a solution has no reference force.
            *wanted = truth.force_n(&touch(contact, &Vector3::from(*d))).ok();
            done += 1;
            progress.steps("hands by finite elements", done, total);
        }
    }
    progress.finish();
    Ok(())
}
