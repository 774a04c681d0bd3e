//! A held-out path or position: the job and the outcome of a worker.

use palpate_core::ConfigTag;
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use super::record::{Equilibrium, StoredSeed, unless_nan};
use crate::fem::solve::{Configuration, Seed, SolveFailure, Solver};
use crate::mesh::SkinPoint;
use crate::num::vector::norm;
use crate::spec::GridIndex;

/// Kind of held-out reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
pub enum Kind {
    /// One of the 26 straight paths towards the neighbours of a lattice point.
    Regular,
    /// A path of small steps with a slowly turning direction.
    Random,
    /// A position drawn uniformly from the ball, solved from the nearest solved corner of its cell. Between
    /// contact points the place on the skin is drawn too.
    Uniform,
}

impl Kind {
    /// All kinds, in their order.
    pub(crate) const ALL: [Self; 3] = [Self::Regular, Self::Random, Self::Uniform];

    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Regular => "regular",
            Self::Random => "random",
            Self::Uniform => "uniform",
        }
    }

    /// The kind of this name.
    pub(crate) fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// Identity of a walk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Walk {
    /// Active node.
    pub active: u32,
    /// Kind of the walk.
    pub kind: Kind,
    /// Number within the kind.
    pub number: u32,
}

/// Solve these positions in order, each from the one before.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct WalkJob {
    /// Identity of the walk.
    pub walk: Walk,
    /// Where the tool touches; `None` at the active node itself.
    pub place: Option<SkinPoint>,
    /// Start: a point of the space and its state; `None` for rest.
    pub start: Option<(GridIndex, StoredSeed)>,
    /// Displacements of the active node, or of the tool at `place`, m.
    pub positions_m: Vec<[f64; 3]>,
    /// Whether the displacements of all nodes are stored.
    pub keep_displacements: bool,
}

/// Outcome of a walk up to its end or its first failure.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct WalkOutcome {
    /// Identity of the walk.
    pub walk: Walk,
    /// One entry per step; the last one may be terminating or failed.
    pub truths: Vec<Truth>,
}

/// Reference values at one position.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Displacement of the active node, m.
    pub displacement_m: [f64; 3],
    /// The solution, or the reason of the failure.
    pub result: Result<Equilibrium, String>,
    /// Residual, N; `None` for a failed solve whose residual is not a number.
    pub residual_n: Option<f64>,
    /// Newton iterations.
    pub iterations: u32,
    /// Number of factorisations.
    pub factorisations: u32,
    /// Wall time, s.
    pub seconds: f64,
    /// Displacements of all nodes (f32 x, y, z, little-endian), m; empty if not stored.
    pub displacements: Vec<u8>,
}

impl Truth {
    fn solved(at: [f64; 3], c: &Configuration, max_force_n: f64, seconds: f64) -> Self {
        let reachable = norm(c.jet().force_n) < max_force_n;
        Self {
            displacement_m: at,
            result: Ok(Equilibrium::of(c, !reachable)),
            residual_n: Some(c.residual_n),
            iterations: c.iterations,
            factorisations: c.factorisations,
            seconds,
            displacements: Vec::new(),
        }
    }

    fn failed(at: [f64; 3], failure: &SolveFailure, seconds: f64) -> Self {
        Self {
            displacement_m: at,
            result: Err(failure.reason.to_string()),
            residual_n: unless_nan(failure.residual_n),
            iterations: failure.iterations,
            factorisations: 0,
            seconds,
            displacements: Vec::new(),
        }
    }

    /// Expandable: |h| < f_max. Terminating: |h| >= f_max. Otherwise failed.
    pub fn tag(&self) -> ConfigTag {
        self.equilibrium().map_or(ConfigTag::Failed, Equilibrium::tag)
    }

    /// The solution; `None` for a failed step.
    pub fn equilibrium(&self) -> Option<&Equilibrium> {
        self.result.as_ref().ok()
    }
}

impl WalkJob {
    /// Walks from `start` (rest if `None`) until the positions end, a step fails, or |h| reaches
    /// `max_force_n`. `None` if `stop` is set meanwhile, because a partial walk would look like a complete
    /// one.
    pub(crate) fn solve(
        &self,
        solver: &mut Solver,
        start: Option<Seed>,
        max_force_n: f64,
        stop: &AtomicBool,
    ) -> Option<WalkOutcome> {
        let mut truths = Vec::with_capacity(self.positions_m.len());
        let mut clock = Instant::now();
        let mut here = match start {
            // The same displacement at the place itself; the state of a neighbour is near its solution.
            Some(seed) if self.place.is_some() => {
                solver.solve_at(&seed.pose, &seed.state).or_else(|_| solver.rest()).map(|c| c.seed)
            }
            Some(seed) => Ok(seed),
            None => solver.rest().map(|c| c.seed),
        };
        for &at in &self.positions_m {
            if stop.load(Ordering::Relaxed) {
                return None;
            }
            let solved = here.and_then(|seed| solver.advance(&seed, at));
            let seconds = std::mem::replace(&mut clock, Instant::now()).elapsed().as_secs_f64();
            match solved {
                Ok(c) => {
                    let mut truth = Truth::solved(at, &c, max_force_n, seconds);
                    if self.keep_displacements {
                        let nodes = solver.problem().body.displacement_len();
                        let values = c.seed.state[..nodes].iter();
                        truth.displacements = values.flat_map(|&x| (x as f32).to_le_bytes()).collect();
                    }
                    let is_last = truth.tag() == ConfigTag::Terminating;
                    truths.push(truth);
                    if is_last {
                        break;
                    }
                    here = Ok(c.seed);
                }
                Err(failure) => {
                    truths.push(Truth::failed(at, &failure, seconds));
                    break;
                }
            }
        }
        Some(WalkOutcome { walk: self.walk, truths })
    }
}
