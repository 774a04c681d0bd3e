//! Measures the tables of a blob at the held-out positions of its space.

use std::collections::BTreeMap;

use palpate_core::{Method, Organ, Space};

use super::blend::{Blend, Blends};
use super::branch_jump::has_branch_jump;
use super::probes::{divisor, probe, share_of_part};
use super::{
    Answer, BranchDifference, Certificate, Compared, Cost, Discretisation, Errors, Health, MethodCertificate,
    Origin, SpaceCertificate, Within, certified_share, displacement, pooled,
};
use crate::adaptive::Verdict;
use crate::held_out::{Summary, is_on_training_lattice};
use crate::num::vector::{distance, norm};
use crate::space::{Kind, Record, SpaceState, Store, StoreError, Walk, branch_jumps, samples, state};
use crate::spec::{GridIndex, Sampling, Tolerance, is_within};

/// A reference solution for the comparison with a method.
pub(crate) struct Truth {
    pub(crate) walk: Walk,
    step: u32,
    pub(crate) displacement_m: [f32; 3],
    pub(crate) force_n: [f64; 3],
    /// Whether it is near a branch jump.
    pub(crate) near_branch_jump: bool,
    /// The spaces that answer there.
    pub(crate) blend: Blend,
}

/// Forces of a method of the blob `organ`, packed from `store`, at every held-out position of active node
/// number `active` that can be compared: reachable, inside the ball, and not used by a fit. Ordered by kind,
/// walk and step; empty if the method is not packed.
pub fn answers(
    store: &Store,
    active: usize,
    organ: &Organ<'_>,
    method: Method,
) -> Result<Vec<Answer>, StoreError> {
    let truths = truths(store, active, organ, &Blends::of(store, organ)?)?;
    Ok(answered(&organ.spaces, method, &truths))
}

pub(crate) fn answered(spaces: &[Space<'_>], method: Method, truths: &[Truth]) -> Vec<Answer> {
    let answer = |truth: &Truth| {
        let Truth { walk, step, displacement_m, force_n, near_branch_jump, blend } = *truth;
        let (found_n, covered) = blend.force(spaces, method, displacement_m)?;
        let compared = Compared { truth_n: force_n, found_n: found_n.map(f64::from), covered };
        Some(Answer { walk, step, displacement_m, compared, near_branch_jump })
    };
    truths.iter().filter_map(answer).collect()
}

/// Measures every packed method of `organ`, which was packed from `store`.
pub fn certify(store: &Store, organ: &Organ<'_>) -> Result<Certificate, StoreError> {
    let identity = store.identity()?;
    let sampling = &identity.sampling;
    let blends = Blends::of(store, organ)?;
    let discretisation = Discretisation::stored(store)?;
    let has_size = identity.contacts.is_some() || identity.charts.is_some();
    let mesh = Discretisation::doubt(discretisation.as_ref(), has_size);
    let mut spaces = Vec::new();
    for (active, name, node, space) in packed(store, organ)? {
        let records = store.records(active)?;
        let truths = truths(store, active, organ, &blends)?;
        // Adaptive sampling has neither table points nor neighbours.
        let (samples, mut jumps) = sampling.lattice().map_or_else(Default::default, |lattice| {
            (samples(&lattice.grid, &records), branch_jumps(&lattice.grid, &records))
        });
        let state = sampling.scattered().map(|_| state(store, active)).transpose()?;
        let fallback = state.as_ref().and_then(SpaceState::fallback);
        let fit = state.and_then(|state| state.fit);
        if let Some(lattice) = &fallback {
            jumps = branch_jumps(&lattice.grid, &lattice.records(&records));
        }
        let methods = Method::ALL.into_iter().filter(|&method| space.has(method));
        let displacement = space.displacement().as_ref().map(|table| {
            let nodes = organ.surface.node;
            let solved = records.iter().filter(|r| r.tag().is_solved()).count();
            let of = displacement::Packed { space, table, spaces: &organ.spaces, blends: &blends };
            displacement::measure(store, active, &of, nodes, &samples, solved)
        });
        let cost = cost(store, active)?;
        let tolerance = sampling.scattered().map(|scattered| scattered.tolerance);
        let tolerance = tolerance.filter(|tolerance| *tolerance != Tolerance::IMPERCEPTIBLE);
        let methods: Vec<MethodCertificate> =
            methods.map(|method| measure(space, &organ.spaces, method, &truths, tolerance)).collect();
        let two_solutions = BranchDifference::of(&store.attempts(active)?);
        // Positions that the workspace excludes, or that a tool that only pushes cannot reach, are not
        // judged.
        let kept_in = fit.as_ref().filter(|fit| fit.wanted.is_kept_in());
        let in_reach = |at: [f32; 3]| kept_in.is_none_or(|fit| fit.is_reachable(at.map(f64::from)));
        let branch_jump_volume = share_of_part(space, in_reach, |at| has_branch_jump(space, at));
        let linear = fit.as_ref().filter(|fit| fit.verdict == Some(Verdict::Linear)).map(|fit| fit.linear);
        let mut certificate = SpaceCertificate {
            active: name,
            node,
            cost,
            branch_jump_pairs: jumps.len(),
            branch_jump_volume,
            two_solutions,
            methods,
            displacement: displacement.transpose()?,
            switched_to_spacing_m: fallback.map(|lattice| lattice.grid.spacing_m),
            linear,
            health: None,
            ledger: None,
        };
        certificate.health = Some(Health::of(&records, &certificate, fit.as_ref(), mesh.as_ref()));
        spaces.push(certificate);
    }
    pooled::judge(&mut spaces);
    Ok(Certificate {
        discretisation,
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

/// The spaces of `organ`, each with number, name and mesh node of its active node in the store.
fn packed<'o, 'b>(
    store: &Store,
    organ: &'o Organ<'b>,
) -> Result<impl Iterator<Item = (usize, String, u32, &'o Space<'b>)>, StoreError> {
    let actives = store.active()?.into_iter().enumerate();
    Ok(actives.filter_map(|(active, (name, node))| {
        let space = organ.spaces.iter().find(|space| *space.active.name == *name)?;
        Some((active, name, node, space))
    }))
}

/// Number of uniform positions away from branch jumps for each space of `organ`, which bounds are computed
/// from. Each with the number of its active node in the store.
pub(crate) fn clear_positions(store: &Store, organ: &Organ<'_>) -> Result<Vec<(usize, usize)>, StoreError> {
    let blends = Blends::of(store, organ)?;
    let mut counts = Vec::new();
    for (active, ..) in packed(store, organ)? {
        let truths = truths(store, active, organ, &blends)?;
        let clear =
            truths.iter().filter(|truth| truth.walk.kind == Kind::Uniform && !truth.near_branch_jump).count();
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
pub(crate) fn truths(
    store: &Store,
    active: usize,
    organ: &Organ<'_>,
    blends: &Blends,
) -> Result<Vec<Truth>, StoreError> {
    let identity = store.identity()?;
    let sampling = &identity.sampling;
    let seen = |at| match sampling {
        Sampling::Lattice(lattice) => is_on_training_lattice(&lattice.grid, lattice.increments, at),
        Sampling::Scattered(_) => false,
    };
    // Paths can leave the workspace.
    let workspace = match sampling.scattered().filter(|scattered| scattered.workspace_m.is_some()) {
        Some(scattered) => {
            let (mesh, node) = (store.body()?.0, store.active()?[active].1);
            scattered.workspace_of(identity.at_active(active, node, |n| mesh.nodes_m[n as usize]))
        }
        None => None,
    };
    let mut truths = Vec::new();
    store.each_truth(active, |walk, step, truth| {
        let Some(blend) = blends.at(walk) else { return };
        let at = truth.displacement_m;
        let displacement_m = at.map(|x| x as f32);
        let reachable = truth.equilibrium().filter(|found| !found.terminating);
        let usable = blend.is_inside(&organ.spaces, displacement_m)
            && workspace.is_none_or(|workspace| is_within(&workspace, &at))
            && !seen(at);
        if let Some(found) = reachable.filter(|_| usable) {
            let near_branch_jump = found.switched || blend.has_branch_jump(&organ.spaces, displacement_m);
            truths.push(Truth {
                walk: *walk,
                step,
                displacement_m,
                force_n: found.force_n,
                near_branch_jump,
                blend,
            });
        }
    })?;
    Ok(truths)
}

fn measure(
    space: &Space<'_>,
    spaces: &[Space<'_>],
    method: Method,
    truths: &[Truth],
    tolerance: Option<Tolerance>,
) -> MethodCertificate {
    let answers = answered(spaces, method, truths);
    let errors = |chosen: &dyn Fn(&Answer) -> bool| {
        Errors::of(answers.iter().filter(|answer| chosen(answer)).map(|answer| &answer.compared))
    };
    let radius_m = f64::from(space.lattice().radius_m());
    let share = |at: &Answer| norm(at.displacement_m.map(f64::from)) / radius_m;
    let clear = |at: &Answer, kind| at.walk.kind == kind && !at.near_branch_jump;
    let ring =
        |from: f64, to: f64| errors(&|at| clear(at, Kind::Uniform) && share(at) > from && share(at) <= to);
    let uniform = errors(&|at| clear(at, Kind::Uniform));
    let visited: Vec<[f32; 3]> = truths.iter().map(|truth| truth.displacement_m).collect();
    MethodCertificate {
        method: method.name().into(),
        by_radius: [ring(-1.0, 0.5), ring(0.5, 0.75), ring(0.75, 2.0)],
        at_branch_jumps: errors(&|at| at.near_branch_jump && at.walk.kind == Kind::Uniform),
        below_jnd_certified: certified_share(uniform.count, uniform.count - uniform.below_jnd),
        tolerated: tolerance.map(|tolerance| {
            let clear = answers.iter().filter(|at| clear(at, Kind::Uniform));
            Within::of(tolerance, clear.map(|answer| &answer.compared))
        }),
        uniform,
        regular: errors(&|at| clear(at, Kind::Regular)),
        random: errors(&|at| clear(at, Kind::Random)),
        paths_at_branch_jumps: errors(&|at| at.near_branch_jump && at.walk.kind != Kind::Uniform),
        probe: probe(space, method, &visited, divisor(spaces.len())),
    }
}

impl BranchDifference {
    /// Result over all attempts of a space.
    fn of(attempts: &[Record]) -> Self {
        let mut points: BTreeMap<GridIndex, Vec<[f64; 3]>> = BTreeMap::new();
        for (index, at) in attempts.iter().filter_map(|r| Some((r.index, r.equilibrium()?))) {
            // A solution of unknown stability can be the other one that the body takes.
            if at.unstable_modes.is_none_or(|modes| modes == 0) {
                points.entry(index).or_default().push(at.force_n);
            }
        }
        let mut found = Self::default();
        for forces in points.values() {
            let pairs = forces.iter().enumerate().flat_map(|(n, a)| forces[..n].iter().map(move |b| (a, b)));
            let apart_n = pairs.map(|(a, b)| distance(*a, *b)).fold(0.0, f64::max);
            if apart_n > Tolerance::IMPERCEPTIBLE.absolute_n {
                found.points += 1;
                found.apart_n = found.apart_n.max(apart_n);
            }
        }
        found
    }
}
