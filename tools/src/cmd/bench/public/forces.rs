//! The sections that are judged from forces: at positions, along hands, round loops.

use std::time::Instant;

use palpate_precompute::num::norm;

use super::answers::Forces;
use super::figures::{Judged, Section, Table};
use super::judge;
use super::organs::Ready;
use super::ours::{LIVE, live_along, of_methods};
use super::questions::{Questions, Way};
use super::run::{Context, finished};
use crate::failure::Failure;
use crate::progress::WorkProgress;

/// Names of the sections.
pub(super) const FORCE: &str = "force";
pub(super) const HANDS: &str = "hands";
pub(super) const ENERGY: &str = "energy";

/// Judges the forces of one system at one kind of question.
pub(super) type Judge = fn(&Questions, &Forces) -> Vec<Judged>;

/// The judge of a section; `None` if it is not judged from forces.
pub(super) fn judge_of(section: &str) -> Option<Judge> {
    match section {
        FORCE => Some(judge::positions),
        HANDS => Some(judge::hands),
        ENERGY => Some(judge::energy),
        _ => None,
    }
}

/// The answers of all own systems to the questions of an organ.
#[derive(Debug)]
pub(super) struct Ours {
    /// Name of a system, and its forces.
    pub(super) systems: Vec<(String, Forces)>,
}

/// Measures a section on all organs. `keep` stores the answers of an organ.
pub(super) fn section(
    key: &str,
    organs: &[Ready],
    context: &Context<'_>,
    mut keep: impl FnMut(&Ready, &Ours) -> Result<(), Failure>,
) -> Result<Section, Failure> {
    let start = Instant::now();
    let judge = judge_of(key).ok_or_else(|| Failure::work(format!("{key} is not judged from forces")))?;
    let mut tables = Vec::new();
    for ready in organs {
        context.go_on()?;
        let mut ours = Ours { systems: of_methods(ready)? };
        let mut live = Forces::none(&ready.questions);
        match key {
            HANDS => live.hands = along(ready, &ready.questions.hands, context)?,
            ENERGY => live.loops = along(ready, &ready.questions.loops, context)?,
            _ => {}
        }
        ours.systems.push((LIVE.into(), live));
        keep(ready, &ours)?;
        let judged =
            ours.systems.iter().map(|(name, forces)| (name.clone(), judge(&ready.questions, forces)));
        tables.push(Table::judged(
            &format!("{key}.{}", ready.scene.name),
            &format!("Organ \u{201c}{}\u{201d}", ready.scene.name),
            &format!("Here {}. {} {}", ready.scene.about, details(key, ready), ready.reference()),
            judged.collect(),
        ));
    }
    let (title, explains) = words(key);
    let section = finished(context, key, title, explains, &[], start.elapsed().as_secs_f64(), tables);
    let file = file_of(key);
    let files = vec![format!("OUT/questions/*/{file}"), format!("OUT/answers/*/*/{file}")];
    Ok(Section { files, ..section })
}

fn along(ready: &Ready, ways: &[Way], context: &Context<'_>) -> Result<Vec<Vec<Option<[f64; 3]>>>, Failure> {
    let mut progress = WorkProgress::new(ready.scene.name, "ways");
    let forces = live_along(ready, ways, |done| {
        progress.steps("live in simulated time", done, ways.len());
        context.go_on()
    });
    progress.finish();
    forces
}

/// File of the questions.
fn file_of(key: &str) -> &'static str {
    match key {
        FORCE => super::questions::POSITIONS,
        ENERGY => super::questions::LOOPS,
        _ => super::questions::HANDS,
    }
}

/// The size of the set.
fn details(key: &str, ready: &Ready) -> String {
    let questions = &ready.questions;
    match key {
        FORCE => {
            let residual = questions.positions.iter().map(|at| at.residual_n).fold(0.0, f64::max);
            let force_n = questions.positions.iter().map(|at| norm(at.truth_n)).fold(0.0, f64::max);
            format!(
                "{} positions with forces up to {force_n:.1} N; the largest residual of a reference solution is {residual:.0e} N. {}",
                questions.positions.len(),
                ready.solved()
            )
        }
        ENERGY => format!("{} loops of a second each.", questions.loops.len()),
        _ => {
            let solved: usize = questions.hands.iter().map(|way| way.truth_n.iter().flatten().count()).sum();
            format!("{} hands, {solved} reference solutions.", questions.hands.len())
        }
    }
}

fn words(key: &str) -> (&'static str, &'static [&'static str]) {
    match key {
        FORCE => (
            "Force against finite elements",
            &[
                "The force of each interpolation method at random positions away from branch jumps, against a full finite-element \
                 solution of the same body that no table uses. GetFEM, FElupe and DOLFINx find the same forces of held nodes \
                 (docs/measurements.md, section 21). An error is \u{201c}not felt\u{201d} if it is at most 3.5 % of the force, half of the just noticeable \
                 difference, or 20 mN, about the smallest force that a finger notices.",
                "Columns are ways to interpolate the solved configurations. \u{201c}trilinear\u{201d}, \u{201c}tricubic\u{201d} and \
                 \u{201c}hybrid\u{201d}, cubic where the grid has all neighbours and linear elsewhere, are those of the paper. \
                 \u{201c}rbf-linear\u{201d} and \u{201c}rbf-cubic\u{201d} have radial functions of nearby points. \u{201c}hermite\u{201d} also uses the \
                 stiffness. \u{201c}energy\u{201d}, the default, interpolates the energy, whose gradient is the force. \
                 \u{201c}kernel\u{201d} does so between positions chosen one by one. \u{201c}live\u{201d}, from the next section on, \
                 needs no table.",
            ],
        ),
        HANDS => (
            "Force under a moving hand",
            &[
                "A press, a poke and a slide with the tremor of a hand, one sample a millisecond. The methods answer each sample \
                 from their table. \u{201c}live\u{201d} solves beside the loop, in simulated time: each solve takes as long as on this \
                 processor, so its errors depend on the machine.",
            ],
        ),
        _ => (
            "Energy round closed loops",
            &[
                "A hand that moves the tool round a circle in an elastic body gets back the energy that it put in. A net energy is \
                 an error of the force field: turning one way the hand loses it, turning the other way the hand gets it. Zero is right.",
            ],
        ),
    }
}
