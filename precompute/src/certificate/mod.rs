//! The certificate of a blob: the packed bytes themselves against finite-element solves that no fit has seen.
//!
//! Bounds come from the independent uniform positions alone; paths are reported as the paper does. Positions at folds, where the
//! body has several branches, are reported apart: no interpolant is right there, and a mean would hide them.

mod displacement;
mod errors;
mod health;
mod ledger;
mod probes;
pub mod reference;

use std::collections::BTreeMap;

pub use displacement::{Apart, DisplacementCertificate, surface_by_rbf};
pub use errors::{Compared, Errors, NOT_FELT_N, NOT_FELT_SHARE, RELATIVE_FROM_N, Within, certified_share};
pub use health::{Health, Reason, Verdict};
pub use ledger::{Effort, Ledger, LedgerError, Line, ledger};
pub use probes::{Probe, Work, nanoseconds};
pub use reference::force_n as reference_force_n;

use palpate_core::flags::SMOOTH;
use palpate_core::{ConfigTag, Coverage, Method, Organ, Space};
use serde::{Deserialize, Serialize};

use health::Findings;
use probes::Probing;

use crate::adaptive::{AdaptiveFit, LinearSuits, Verdict as LoopVerdict};
use crate::held_out::{Summary, is_on_training_lattice};
use crate::space::{Kind, Record, SpaceState, Store, StoreError, Walk, folds, samples, state};
use crate::spec::{GridIndex, Sampling, Scattered, Tolerance, is_within};

/// More active nodes than this are certified together: bounds and maxima are of all of them, from fewer samples of each.
pub const FEW: usize = 8;

/// Everything that was measured of a blob.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Certificate {
    /// Scene, mesh, law and solver that it was made with.
    pub origin: Origin,
    /// One entry for every active node in the blob.
    pub spaces: Vec<SpaceCertificate>,
}

/// What a blob was made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// Name of the scene.
    pub scene: String,
    /// Hash over everything in scene and mesh that changes numbers.
    pub content_hash: String,
    /// Material law.
    pub law: String,
    /// Version of the solver, and instruction set.
    pub solver: String,
    /// f_max, N; none if the scene has none.
    pub max_force_n: Option<f64>,
    /// r_G, m.
    pub radius_m: f64,
    /// Grid spacing, m; of what grid indices count where positions are scattered.
    pub spacing_m: f64,
    /// Whether the corners outside the ball were solved.
    pub complete_cells: bool,
    /// What was wanted, where positions are scattered.
    pub scattered: Option<Scattered>,
}

/// What was measured of one space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpaceCertificate {
    /// The active node.
    pub active: String,
    /// Its mesh node.
    pub node: u32,
    /// What the space took.
    pub cost: Cost,
    /// Neighbours on different branches.
    pub fold_pairs: usize,
    /// Share of the ball's volume within a cell of such a pair; of the part in reach, where a workspace or pushing alone limits it.
    pub folded_volume: f64,
    /// Points where two stable solutions were found.
    pub two_solutions: TwoSolutions,
    /// Every packed method.
    pub methods: Vec<MethodCertificate>,
    /// The surface for the eye, if it was packed.
    pub displacement: Option<DisplacementCertificate>,
    /// Spacing of the lattice that took over where the predictions of the blind loop did not fall, m; none where it did not.
    pub switched_to_spacing_m: Option<f64>,
    /// That the linear body is what is packed, and how well it predicted; none where it would not do.
    pub linear: Option<LinearSuits>,
    /// What speaks against its numbers; none in blobs that were packed before it was asked.
    pub health: Option<Health>,
    /// What is left out, and what that changes and saves; where it was asked for.
    pub ledger: Option<Ledger>,
}

/// Grid points where tries from different neighbours ended at different stable solutions: the body is on two branches there, and which
/// one a hand meets depends on its way. The tables have the one of lower energy.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct TwoSolutions {
    /// How many points.
    pub points: usize,
    /// Largest difference of the forces at one of them, N.
    pub apart_n: f64,
}

impl TwoSolutions {
    /// Of all tries of a space.
    pub fn of(attempts: &[Record]) -> Self {
        let stable = |r: &&Record| r.tag.is_solved() && r.unstable_modes.unwrap_or(0) == 0;
        let mut points: BTreeMap<GridIndex, Vec<[f64; 3]>> = BTreeMap::new();
        for record in attempts.iter().filter(stable) {
            points.entry(record.index).or_default().push(record.force_n);
        }
        let mut found = Self::default();
        for forces in points.values() {
            let apart =
                |a: &[f64; 3], b: &[f64; 3]| Compared { truth_n: *a, found_n: *b, covered: true }.error_n();
            let pairs = forces.iter().enumerate().flat_map(|(n, a)| forces[..n].iter().map(move |b| (a, b)));
            let apart_n = pairs.map(|(a, b)| apart(a, b)).fold(0.0, f64::max);
            if apart_n > NOT_FELT_N {
                found.points += 1;
                found.apart_n = found.apart_n.max(apart_n);
            }
        }
        found
    }
}

/// What a space and its truth took.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Cost {
    /// Solved configurations.
    pub configurations: usize,
    /// Tries, failed ones and those from other neighbours among them.
    pub tries: usize,
    /// Points that could not be solved.
    pub failed: usize,
    /// Seconds of solving, all threads together.
    pub seconds: f64,
    /// Largest residual of a configuration, N.
    pub residual_n: f64,
    /// Held-out positions solved.
    pub held_out: u32,
    /// Seconds of solving them.
    pub held_out_seconds: f64,
}

/// What was measured of one method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MethodCertificate {
    /// The method.
    pub method: String,
    /// Independent uniform positions within f_max, away from folds.
    pub uniform: Errors,
    /// The same by distance from rest: up to a half, three quarters, and all of r_G.
    pub by_radius: [Errors; 3],
    /// Uniform positions at folds.
    pub folded: Errors,
    /// Share of positions whose error a hand does not feel, with 95 % confidence, from the uniform ones away from folds.
    pub not_felt_certified: f64,
    /// The same positions against the tolerance that the scene names itself; none where it names none but what a hand feels.
    pub tolerated: Option<Within>,
    /// Regular paths within the grid and f_max, points of the grid left out, away from folds.
    pub regular: Errors,
    /// Random paths, alike.
    pub random: Errors,
    /// Positions of paths at folds.
    pub paths_folded: Errors,
    /// Work, seams, rounding and time.
    pub probe: Probe,
}

/// A truth that a method is compared with.
struct Truth {
    walk: Walk,
    step: u32,
    displacement_m: [f32; 3],
    force_n: [f64; 3],
    folded: bool,
}

/// A held-out position with what a method answers there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    /// The path, or the single position, that it belongs to.
    pub walk: Walk,
    /// Which step of it, from 1.
    pub step: u32,
    /// Where, m.
    pub displacement_m: [f32; 3],
    /// Truth and answer.
    pub compared: Compared,
    /// It lies at a fold.
    pub folded: bool,
}

/// What a method of `space`, packed from active node number `active` of `store`, answers at every held-out position that may be
/// compared: reachable, inside the ball, and not among those that a fit saw. In the order of kind, walk and step; nothing if the
/// method is not packed.
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
    let probing = Probing::of(organ.spaces.len());
    let mut spaces = Vec::new();
    for (active, (name, node)) in store.active()?.into_iter().enumerate() {
        let Some(space) = organ.spaces.iter().find(|space| *space.active().name == *name) else { continue };
        let records = store.records(active)?;
        let truths = truths(store, active, space, sampling)?;
        // Of scattered positions there are neither points of the table nor neighbours.
        let (samples, mut folded) = sampling.lattice().map_or_else(Default::default, |lattice| {
            (samples(&lattice.grid, &records), folds(&lattice.grid, &records))
        });
        let state = sampling.scattered().map(|_| state(store, active)).transpose()?;
        let fallback = state.as_ref().and_then(SpaceState::fallback);
        let fit = state.and_then(|state| state.fit);
        if let Some(lattice) = &fallback {
            folded = folds(&lattice.grid, &lattice.records(&records));
        }
        let methods = Method::ALL.into_iter().filter(|&method| space.has(method));
        let displacement = space.displacement().as_ref().map(|table| {
            let nodes = organ.surface.node;
            let solved = records.iter().filter(|r| r.tag.is_solved()).count();
            displacement::measure(store, active, space, table, nodes, &samples, solved)
        });
        let cost = cost(store, active)?;
        let tolerance = sampling.scattered().map(|scattered| scattered.tolerance);
        let tolerance = tolerance.filter(|tolerance| *tolerance != Tolerance::CANNOT_BE_FELT);
        let methods: Vec<MethodCertificate> =
            methods.map(|method| measure(space, method, &truths, tolerance, probing)).collect();
        let two_solutions = TwoSolutions::of(&store.attempts(active)?);
        // What a workspace or pushing alone keeps the tool from is nothing to be judged.
        let kept_in = fit.as_ref().filter(|fit| fit.wanted.is_kept_in()).map(AdaptiveFit::within_reach);
        let in_reach = |at: [f32; 3]| kept_in.as_ref().is_none_or(|reach| reach.has(at.map(f64::from)));
        let folded_volume = probes::share_of_part(space, in_reach, |at| is_folded(space, at));
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

/// How many uniform positions away from folds the store holds for each space of `organ`: those that bounds come from. Each with the number of its
/// active node in the store.
pub fn clear_positions(store: &Store, organ: &Organ<'_>) -> Result<Vec<(usize, usize)>, StoreError> {
    let sampling = store.identity()?.sampling;
    let mut counts = Vec::new();
    for (active, (name, _)) in store.active()?.into_iter().enumerate() {
        let Some(space) = organ.spaces.iter().find(|space| *space.active().name == *name) else { continue };
        let truths = truths(store, active, space, &sampling)?;
        let clear = truths.iter().filter(|truth| truth.walk.kind == Kind::Uniform && !truth.folded).count();
        counts.push((active, clear));
    }
    Ok(counts)
}

fn cost(store: &Store, active: usize) -> Result<Cost, StoreError> {
    let attempts = store.attempts(active)?;
    let records = store.records(active)?;
    let solved = || records.iter().filter(|r| r.tag.is_solved());
    let mut cost = Cost {
        configurations: solved().count(),
        tries: attempts.len(),
        failed: records.len() - solved().count(),
        seconds: attempts.iter().map(|r| r.seconds).sum(),
        residual_n: solved().map(|r| r.residual_n).fold(0.0, f64::max),
        ..Cost::default()
    };
    for summary in Summary::of(store, active)?.values() {
        cost.held_out += summary.positions;
        cost.held_out_seconds += summary.seconds;
    }
    Ok(cost)
}

/// Held-out positions that may be compared: reachable, inside the ball, and not among those that a fit saw.
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
    // Paths lead out of it.
    let workspace = match sampling.scattered().filter(|scattered| scattered.workspace_m.is_some()) {
        Some(scattered) => scattered.workspace_of(store.body()?.0.nodes_m[space.active().node as usize]),
        None => None,
    };
    let mut truths = Vec::new();
    store.each_truth(active, |walk, step, truth| {
        let at = truth.displacement_m;
        let displacement_m = at.map(|x| x as f32);
        let usable = truth.tag == ConfigTag::Expandable
            && space.lattice().locate(displacement_m).inside
            && workspace.is_none_or(|workspace| is_within(&workspace, &at))
            && !seen(at);
        if usable {
            let folded = truth.switched || is_folded(space, displacement_m);
            truths.push(Truth { walk: *walk, step, displacement_m, force_n: truth.force_n, folded });
        }
    })?;
    Ok(truths)
}

/// Whether a cell with a fold in it is that of the position or touches it.
fn is_folded(space: &Space<'_>, displacement_m: [f32; 3]) -> bool {
    let at = space.lattice().locate(displacement_m);
    let corners = space.lattice().corners(at.slot);
    corners.iter().any(|slot| space.flags().get(*slot).is_none_or(|bits| bits & SMOOTH == 0))
}

fn measure(
    space: &Space<'_>,
    method: Method,
    truths: &[Truth],
    tolerance: Option<Tolerance>,
    probing: Probing,
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
        probe: probes::probe(space, method, &visited, probing),
    }
}
