//! The certificate of a blob: errors of the packed bytes against finite-element solves that no fit uses.
//!
//! Bounds come from the independent uniform positions alone. Paths are reported as in the paper. Positions
//! near branch jumps, where the body has several solutions, are reported separately: no interpolant is
//! correct there, and a common mean would hide them.

mod displacement;
mod errors;
mod health;
mod ledger;
mod probes;
pub mod reference;

use std::collections::BTreeMap;

pub use displacement::{DisplacementCertificate, SurfaceDistances, surface_by_rbf};
pub use errors::{Compared, Errors, Within, certified_share};
pub use health::{Health, Reason, Verdict};
pub use ledger::{AdditionalSolves, Ledger, LedgerError, Line, ledger};
pub(crate) use probes::Probe;
pub use probes::nanoseconds;
pub use reference::force_n as reference_force_n;

use palpate_core::flags::SMOOTH;
use palpate_core::{Coverage, Method, Organ, Space};
use serde::{Deserialize, Serialize};

use health::Findings;

use crate::adaptive::{AdaptiveFit, LinearModelErrors, Verdict as LoopVerdict};
use crate::held_out::{Summary, is_on_training_lattice};
use crate::space::{Kind, Record, SpaceState, Store, StoreError, Walk, branch_jumps, samples, state};
use crate::spec::{GridIndex, Sampling, Scattered, Tolerance, is_within};

/// Largest number of active nodes that each have their own held-out positions. More nodes share the
/// positions, and the bounds hold for all of them together.
pub const MAX_SEPARATE_NODES: usize = 8;

/// All measurements of a blob.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Certificate {
    /// Scene, mesh, law and solver of the blob.
    pub origin: Origin,
    /// One entry for every active node in the blob.
    pub spaces: Vec<SpaceCertificate>,
}

/// Inputs of a blob.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// Name of the scene.
    pub scene: String,
    /// Hash of all content of scene and mesh that changes numbers.
    pub content_hash: String,
    /// Constitutive law.
    pub law: String,
    /// Version of the solver, with the instruction set.
    pub solver: String,
    /// f_max, N; `None` if the scene has none.
    pub max_force_n: Option<f64>,
    /// r_G, m.
    pub radius_m: f64,
    /// Grid spacing, m; for adaptive sampling the unit of the indices.
    pub spacing_m: f64,
    /// Whether the corners outside the ball were solved.
    pub complete_cells: bool,
    /// Requirements of adaptive sampling; `None` on a lattice.
    pub scattered: Option<Scattered>,
}

/// Measurements of one space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpaceCertificate {
    /// The active node.
    pub active: String,
    /// Its mesh node.
    pub node: u32,
    /// Cost of the space.
    pub cost: Cost,
    /// Number of neighbour pairs on different branches.
    pub fold_pairs: usize,
    /// Share of the ball's volume within a cell of such a pair. If a workspace or a tool that only pushes
    /// limits the reach, the share of the reachable part.
    pub folded_volume: f64,
    /// Points with two stable solutions.
    pub two_solutions: BranchDifference,
    /// Every packed method.
    pub methods: Vec<MethodCertificate>,
    /// The surface displacements, if packed.
    pub displacement: Option<DisplacementCertificate>,
    /// Spacing of the fallback lattice, m; `None` if adaptive sampling did not stagnate.
    pub switched_to_spacing_m: Option<f64>,
    /// Prediction errors of the linear model, if it is the packed model.
    pub linear: Option<LinearModelErrors>,
    /// Numerical health; `None` in blobs without this measurement.
    pub health: Option<Health>,
    /// Approximations with their change and saving, if requested.
    pub ledger: Option<Ledger>,
}

/// Grid points where attempts from different neighbours found different stable solutions. The body has two
/// branches there, and the solution depends on the path. The tables contain the solution of lower energy.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct BranchDifference {
    /// Number of points.
    pub points: usize,
    /// Largest difference of the forces at one of them, N.
    pub apart_n: f64,
}

impl BranchDifference {
    /// Result over all attempts of a space.
    pub(crate) fn of(attempts: &[Record]) -> Self {
        let mut points: BTreeMap<GridIndex, Vec<[f64; 3]>> = BTreeMap::new();
        for (index, at) in attempts.iter().filter_map(|r| Some((r.index, r.equilibrium()?))) {
            if at.unstable_modes.unwrap_or(0) == 0 {
                points.entry(index).or_default().push(at.force_n);
            }
        }
        let mut found = Self::default();
        for forces in points.values() {
            let apart =
                |a: &[f64; 3], b: &[f64; 3]| Compared { truth_n: *a, found_n: *b, covered: true }.error_n();
            let pairs = forces.iter().enumerate().flat_map(|(n, a)| forces[..n].iter().map(move |b| (a, b)));
            let apart_n = pairs.map(|(a, b)| apart(a, b)).fold(0.0, f64::max);
            if apart_n > Tolerance::IMPERCEPTIBLE.absolute_n {
                found.points += 1;
                found.apart_n = found.apart_n.max(apart_n);
            }
        }
        found
    }
}

/// Cost of a space and of its held-out positions.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Cost {
    /// Solved configurations.
    pub configurations: usize,
    /// Number of attempts, including failed and repeated ones.
    pub tries: usize,
    /// Points that could not be solved.
    pub failed: usize,
    /// Sum of the solve times over all threads, s.
    pub seconds: f64,
    /// Largest residual of a configuration, N.
    pub residual_n: f64,
    /// Solved held-out positions.
    pub held_out: u32,
    /// Sum of their solve times, s.
    pub held_out_seconds: f64,
}

/// Measurements of one method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MethodCertificate {
    /// Name of the method.
    pub method: String,
    /// Independent uniform positions within f_max, away from branch jumps.
    pub uniform: Errors,
    /// The same by distance from rest: up to 1/2, up to 3/4, and up to 1 of r_G.
    pub by_radius: [Errors; 3],
    /// Uniform positions near branch jumps.
    pub folded: Errors,
    /// Share of positions with an imperceptible error, with 95 % confidence, from the uniform positions away
    /// from branch jumps.
    pub not_felt_certified: f64,
    /// The same positions against the scene's own tolerance; `None` if the scene uses the perceptual one.
    pub tolerated: Option<Within>,
    /// Positions of regular paths within the grid and f_max, without grid points, away from branch jumps.
    pub regular: Errors,
    /// The same for random paths.
    pub random: Errors,
    /// Positions of paths near branch jumps.
    pub paths_folded: Errors,
    /// Work, face jumps, rounding and time.
    pub probe: Probe,
}

/// A reference solution for the comparison with a method.
struct Truth {
    walk: Walk,
    step: u32,
    displacement_m: [f32; 3],
    force_n: [f64; 3],
    folded: bool,
}

/// A held-out position with the force of a method.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    /// Its path, or the single position.
    pub walk: Walk,
    /// Its step on the path, from 1.
    pub step: u32,
    /// Displacement, m.
    pub displacement_m: [f32; 3],
    /// Reference and computed force.
    pub compared: Compared,
    /// Whether it is near a branch jump.
    pub folded: bool,
}

/// Forces of a method of `space`, packed from active node number `active` of `store`, at every held-out
/// position that can be compared: reachable, inside the ball, and not used by a fit. Ordered by kind, walk
/// and step; empty if the method is not packed.
pub fn answers(
    store: &Store,
    active: usize,
    space: &Space<'_>,
    method: Method,
) -> Result<Vec<Answer>, StoreError> {
    let truths = truths(store, active, space, &store.identity()?.sampling)?;
    Ok(answered(space, method, &truths))
}

fn answered(space: &Space<'_>, method: Method, truths: &[Truth]) -> Vec<Answer> {
    let answer = |truth: &Truth| {
        let Truth { walk, step, displacement_m, force_n, folded } = *truth;
        let found = space.force(method, displacement_m)?;
        let compared = Compared {
            truth_n: force_n,
            found_n: found.force_n.map(f64::from),
            covered: found.coverage != Coverage::Extrapolated,
        };
        Some(Answer { walk, step, displacement_m, compared, folded })
    };
    truths.iter().filter_map(answer).collect()
}

/// Measures every packed method of `organ`, which was packed from `store`.
pub fn certify(store: &Store, organ: &Organ<'_>) -> Result<Certificate, StoreError> {
    let identity = store.identity()?;
    let sampling = &identity.sampling;
    let mut spaces = Vec::new();
    for (active, (name, node)) in store.active()?.into_iter().enumerate() {
        let Some(space) = organ.spaces.iter().find(|space| *space.active.name == *name) else { continue };
        let records = store.records(active)?;
        let truths = truths(store, active, space, sampling)?;
        // Adaptive sampling has neither table points nor neighbours.
        let (samples, mut folded) = sampling.lattice().map_or_else(Default::default, |lattice| {
            (samples(&lattice.grid, &records), branch_jumps(&lattice.grid, &records))
        });
        let state = sampling.scattered().map(|_| state(store, active)).transpose()?;
        let fallback = state.as_ref().and_then(SpaceState::fallback);
        let fit = state.and_then(|state| state.fit);
        if let Some(lattice) = &fallback {
            folded = branch_jumps(&lattice.grid, &lattice.records(&records));
        }
        let methods = Method::ALL.into_iter().filter(|&method| space.has(method));
        let displacement = space.displacement().as_ref().map(|table| {
            let nodes = organ.surface.node;
            let solved = records.iter().filter(|r| r.tag().is_solved()).count();
            displacement::measure(store, active, space, table, nodes, &samples, solved)
        });
        let cost = cost(store, active)?;
        let tolerance = sampling.scattered().map(|scattered| scattered.tolerance);
        let tolerance = tolerance.filter(|tolerance| *tolerance != Tolerance::IMPERCEPTIBLE);
        let methods: Vec<MethodCertificate> =
            methods.map(|method| measure(space, method, &truths, tolerance)).collect();
        let two_solutions = BranchDifference::of(&store.attempts(active)?);
        // Positions that the workspace excludes, or that a tool that only pushes cannot reach, are not
        // judged.
        let kept_in = fit.as_ref().filter(|fit| fit.wanted.is_kept_in()).map(AdaptiveFit::reachable_set);
        let in_reach = |at: [f32; 3]| kept_in.as_ref().is_none_or(|reach| reach.has(at.map(f64::from)));
        let folded_volume = probes::share_of_part(space, in_reach, |at| has_branch_jump(space, at));
        let fold_pairs = folded.len();
        let findings = Findings {
            cost: &cost,
            fold_pairs,
            folded_volume,
            two_solutions,
            methods: &methods,
            fit: fit.as_ref(),
        };
        spaces.push(SpaceCertificate {
            health: Some(Health::of(&records, &findings)),
            cost,
            fold_pairs,
            two_solutions,
            folded_volume,
            methods,
            displacement: displacement.transpose()?,
            ledger: None,
            linear: fit.filter(|fit| fit.verdict == Some(LoopVerdict::Linear)).map(|fit| fit.linear),
            switched_to_spacing_m: fallback.map(|lattice| lattice.grid.spacing_m),
            active: name,
            node,
        });
    }
    Ok(Certificate {
        origin: Origin {
            scene: identity.scene_name,
            content_hash: identity.content_hash,
            law: identity.law,
            solver: store.meta("solver")?,
            max_force_n: Some(identity.max_force_n).filter(|f| f.is_finite()),
            radius_m: sampling.radius_m(),
            spacing_m: sampling.unit_m(),
            complete_cells: sampling.lattice().is_some_and(|lattice| lattice.complete_cells),
            scattered: sampling.scattered().copied(),
        },
        spaces,
    })
}

/// Number of uniform positions away from branch jumps for each space of `organ`, which bounds are computed
/// from. Each with the number of its active node in the store.
pub fn clear_positions(store: &Store, organ: &Organ<'_>) -> Result<Vec<(usize, usize)>, StoreError> {
    let sampling = store.identity()?.sampling;
    let mut counts = Vec::new();
    for (active, (name, _)) in store.active()?.into_iter().enumerate() {
        let Some(space) = organ.spaces.iter().find(|space| *space.active.name == *name) else { continue };
        let truths = truths(store, active, space, &sampling)?;
        let clear = truths.iter().filter(|truth| truth.walk.kind == Kind::Uniform && !truth.folded).count();
        counts.push((active, clear));
    }
    Ok(counts)
}

fn cost(store: &Store, active: usize) -> Result<Cost, StoreError> {
    let attempts = store.attempts(active)?;
    let records = store.records(active)?;
    let solved = || records.iter().filter(|r| r.tag().is_solved());
    let mut cost = Cost {
        configurations: solved().count(),
        tries: attempts.len(),
        failed: records.len() - solved().count(),
        seconds: attempts.iter().map(|r| r.seconds).sum(),
        residual_n: solved().filter_map(|r| r.residual_n).fold(0.0, f64::max),
        ..Cost::default()
    };
    for summary in Summary::of(store, active)?.values() {
        cost.held_out += summary.positions;
        cost.held_out_seconds += summary.seconds;
    }
    Ok(cost)
}

/// Held-out positions that can be compared: reachable, inside the ball, and not used by a fit.
fn truths(
    store: &Store,
    active: usize,
    space: &Space<'_>,
    sampling: &Sampling,
) -> Result<Vec<Truth>, StoreError> {
    let seen = |at| match sampling {
        Sampling::Lattice(lattice) => is_on_training_lattice(&lattice.grid, lattice.increments, at),
        Sampling::Scattered(_) => false,
    };
    // Paths can leave the workspace.
    let workspace = match sampling.scattered().filter(|scattered| scattered.workspace_m.is_some()) {
        Some(scattered) => scattered.workspace_of(store.body()?.0.nodes_m[space.active.node as usize]),
        None => None,
    };
    let mut truths = Vec::new();
    store.each_truth(active, |walk, step, truth| {
        let at = truth.displacement_m;
        let displacement_m = at.map(|x| x as f32);
        let reachable = truth.equilibrium().filter(|found| !found.terminating);
        let usable = space.lattice().locate(displacement_m).inside
            && workspace.is_none_or(|workspace| is_within(&workspace, &at))
            && !seen(at);
        if let Some(found) = reachable.filter(|_| usable) {
            let folded = found.switched || has_branch_jump(space, displacement_m);
            truths.push(Truth { walk: *walk, step, displacement_m, force_n: found.force_n, folded });
        }
    })?;
    Ok(truths)
}

/// Whether the cell of the position, or an adjacent one, contains a branch jump.
fn has_branch_jump(space: &Space<'_>, displacement_m: [f32; 3]) -> bool {
    let at = space.lattice().locate(displacement_m);
    let corners = space.lattice().corners(at.slot);
    corners.iter().any(|slot| space.planes().flags.get(*slot).is_none_or(|bits| bits & SMOOTH == 0))
}

fn measure(
    space: &Space<'_>,
    method: Method,
    truths: &[Truth],
    tolerance: Option<Tolerance>,
) -> MethodCertificate {
    let answers = answered(space, method, truths);
    let errors = |chosen: &dyn Fn(&Answer) -> bool| {
        Errors::of(answers.iter().filter(|answer| chosen(answer)).map(|answer| &answer.compared))
    };
    let radius_m = f64::from(space.lattice().radius_m());
    let share =
        |at: &Answer| at.displacement_m.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt() / radius_m;
    let clear = |at: &Answer, kind| at.walk.kind == kind && !at.folded;
    let ring =
        |from: f64, to: f64| errors(&|at| clear(at, Kind::Uniform) && share(at) > from && share(at) <= to);
    let uniform = errors(&|at| clear(at, Kind::Uniform));
    let visited: Vec<[f32; 3]> = truths.iter().map(|truth| truth.displacement_m).collect();
    MethodCertificate {
        method: method.name().into(),
        by_radius: [ring(-1.0, 0.5), ring(0.5, 0.75), ring(0.75, 2.0)],
        folded: errors(&|at| at.folded && at.walk.kind == Kind::Uniform),
        not_felt_certified: certified_share(uniform.count, uniform.count - uniform.not_felt),
        tolerated: tolerance.map(|tolerance| {
            let clear = answers.iter().filter(|at| clear(at, Kind::Uniform));
            Within::of(tolerance, clear.map(|answer| &answer.compared))
        }),
        uniform,
        regular: errors(&|at| clear(at, Kind::Regular)),
        random: errors(&|at| clear(at, Kind::Random)),
        paths_folded: errors(&|at| at.folded && at.walk.kind != Kind::Uniform),
        probe: probes::probe(space, method, &visited),
    }
}
