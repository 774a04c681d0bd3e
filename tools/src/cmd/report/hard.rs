//! Hard cases of the interpolation: tables with missing points, and a body with several branches at large
//! displacements.

use palpate_precompute::certificate::{Answer, Errors, answers};
use palpate_precompute::held_out::{Draw, Summary};
use palpate_precompute::space::{Kind, Store, branch_jumps};
use palpate_precompute::spec::GridIndex;
use serde::Serialize;

use super::measure::some;
use super::plan::{Case, Family, Plan, points_of};
use super::solve::solved;
use super::steps::Steps;
use super::tables::{Choice, fitted};
use super::words::law;
use crate::failure::Failure;

/// Results of a method in a hard case.
#[derive(Debug, Clone, Serialize)]
pub(super) struct HardRow {
    pub scene: String,
    /// Description of the case.
    pub case: String,
    pub radius_m: f64,
    pub max_force_n: Option<f64>,
    pub grid: u32,
    /// Number of points in the fit.
    pub configurations: usize,
    pub missing_share: f64,
    pub branch_jump_pairs: usize,
    pub branch_jump_volume: f64,
    /// Largest force difference between neighbours, beyond that of the stiffness.
    pub largest_jump_n: f64,
    /// Number of points whose attempts found two stable solutions, and the largest difference of these.
    pub two_solutions: usize,
    pub apart_n: f64,
    /// Number of held-out positions where the body left its branch on the path.
    pub branch_changes: u32,
    pub held_out: u32,
    pub method: &'static str,
    /// Radius of the measured positions away from branch jumps, and the errors there.
    pub within_m: f64,
    pub positions: usize,
    pub covered_share: f64,
    pub mean_n: f64,
    pub p99_n: f64,
    pub max_n: f64,
    pub below_jnd_share: f64,
    /// Positions at branch jumps, and the errors there.
    pub branch_jump_positions: usize,
    pub branch_jump_mean_n: f64,
    pub branch_jump_max_n: f64,
    /// Largest force jump at cell faces.
    pub seam_n: f64,
}

/// Shares of the points that are removed.
const MISSING: [f64; 4] = [0.0, 0.02, 0.1, 0.5];

/// Cells along the radius of the coarsest grid, and the ratio of its radius to that of the queried ball.
const COARSE_CELLS: u32 = 3;
const COARSE_FACTOR: f64 = 1.2;
/// Ratio of the displacements to those of the scene, large enough for several branches.
const FAR_FACTOR: f64 = 2.0;

/// Number of steps of [`measured`].
pub(super) fn steps(plan: &Plan) -> usize {
    1 + 3 + 3 * plan.families.len()
}

/// Measures the hard cases: the first body on one grid, and every body with large displacements.
pub(super) fn measured(
    plan: &Plan,
    grid: (u32, u32),
    again: bool,
    steps: &mut Steps,
) -> Result<Vec<HardRow>, Failure> {
    let mut rows = Vec::new();
    let first = &plan.families[0];
    let near = first.on_grid(grid)?;
    let store = Store::open(&plan.work.path().join(format!("{}.space", near.name)))?;
    steps.next(&format!("{}: tables with holes", near.name))?;
    let whole = |name: String, what: String, grid: u32| Hard {
        what,
        grid,
        within_m: f64::INFINITY,
        hole: Hole { name, share: 0.0 },
        again,
    };
    for share in MISSING {
        let (name, what) = match share {
            0.0 => (near.name.clone(), "as it is".into()),
            share => (
                format!("{}-without-{:.0}", near.name, 100.0 * share),
                format!("{:.0} % of the points missing", 100.0 * share),
            ),
        };
        let hard = Hard { hole: Hole { name: name.clone(), share }, ..whole(name, what, grid.0) };
        rows.extend(hard.rows(plan, first, &store, steps)?);
    }
    drop(store);

    let radius_m = first.radius_m();
    let coarse = first.wider("coarse", COARSE_FACTOR, (points_of(COARSE_CELLS), COARSE_CELLS), false)?;
    let what = format!(
        "cells of {:.0} mm, asked to {:.0} mm",
        1e3 * COARSE_FACTOR * radius_m / f64::from(COARSE_CELLS),
        1e3 * radius_m
    );
    // About a third of the positions are outside the queried ball.
    let full = plan.draw(COARSE_FACTOR * radius_m);
    let draw = Draw { regular_m: None, random: 0, uniform: 2 * full.uniform, ..full };
    let store = open(plan, &coarse, &draw, steps)?;
    let hard = Hard { within_m: radius_m, ..whole(coarse.name, what, coarse.points) };
    rows.extend(hard.rows(plan, first, &store, steps)?);
    drop(store);

    for (n, family) in plan.families.iter().enumerate() {
        // The first law without a force limit, so that branches meet. A law that collapses there keeps its
        // own limit.
        let limited = n > 0;
        let far = family.wider("far", FAR_FACTOR, grid, limited)?;
        let radius_m = FAR_FACTOR * family.radius_m();
        let full = plan.draw(radius_m);
        // A failing solve costs as much as a hundred others there.
        let draw = Draw { regular_m: None, random: full.random / 2, uniform: full.uniform / 2, ..full };
        let store = open(plan, &far, &draw, steps)?;
        let law = law(&family.bench.body.law_names());
        let within = if limited { "within f_max" } else { "no force limit" };
        let what = format!("{law}, twice as far, r_G = {:.0} mm, {within}", 1e3 * radius_m);
        rows.extend(whole(far.name, what, far.points).rows(plan, family, &store, steps)?);
    }
    Ok(rows)
}

/// Solves a space and its held-out solutions.
fn open(plan: &Plan, case: &Case, draw: &Draw, steps: &mut Steps) -> Result<Store, Failure> {
    let path = solved(plan, case, draw, None, steps)?;
    steps.next(&format!("{}: tables and certificates", case.name))?;
    Ok(Store::open(&path)?)
}

/// A space with some points removed.
struct Hole {
    name: String,
    share: f64,
}

impl Hole {
    /// Whether a point is kept: a fixed pseudo-random choice (SplitMix64 of its index).
    fn keeps(&self, index: GridIndex) -> bool {
        let mut x = index.iter().fold(0u64, |x, n| x << 16 ^ (i64::from(*n) & 0xffff) as u64);
        for multiplier in [0xbf58_476d_1ce4_e5b9_u64, 0x94d0_49bb_1331_11eb] {
            x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
            x = (x ^ (x >> 30)).wrapping_mul(multiplier);
        }
        index == [0; 3] || ((x >> 11) as f64 / (1_u64 << 53) as f64) >= self.share
    }
}

/// One case: the points of the fit, and the queried positions.
struct Hard {
    what: String,
    grid: u32,
    within_m: f64,
    hole: Hole,
    again: bool,
}

impl Hard {
    fn rows(
        &self,
        plan: &Plan,
        family: &Family,
        store: &Store,
        steps: &Steps,
    ) -> Result<Vec<HardRow>, Failure> {
        let Self { what, grid, within_m, hole, again } = self;
        let identity = store.identity()?;
        let radius_m = identity.sampling.radius_m();
        let records = store.records(0)?;
        let solved = records.iter().filter(|r| r.tag().is_solved());
        let (all, there) =
            solved.fold((0, 0), |(all, there), r| (all + 1, there + usize::from(hole.keeps(r.index))));
        let lattice = identity.sampling.lattice();
        let branch_jumps = lattice.map_or_else(Vec::new, |lattice| branch_jumps(&lattice.grid, &records));
        let jump = branch_jumps.iter().map(|fold| fold.rho_h_n).fold(0.0, f64::max);
        let summary = Summary::of(store, 0)?;
        let choice = Choice { name: &hole.name, keep: &|index| hole.keeps(index), again: *again };
        let (all_fitted, _) = fitted(plan, store, &choice, |_| steps.go_on())?;
        let rows = all_fitted.iter().map(|fitted| {
            let (figures, space) = (fitted.figures(), fitted.space());
            let asked = fitted.with_space(|space| answers(store, 0, space, fitted.method))??;
            let errors = |near_branch_jump: bool| {
                let is_asked = |at: &&Answer| {
                    let squared: f64 = at.displacement_m.iter().map(|&x| f64::from(x).powi(2)).sum();
                    at.walk.kind == Kind::Uniform
                        && at.near_branch_jump == near_branch_jump
                        && squared <= within_m * within_m
                };
                Errors::of(asked.iter().filter(is_asked).map(|at| &at.compared))
            };
            let (clear, at_branch_jumps) = (errors(false), errors(true));
            Ok(HardRow {
                scene: family.name.clone(),
                case: what.clone(),
                radius_m,
                max_force_n: Some(identity.max_force_n).filter(|f| f.is_finite()),
                grid: *grid,
                configurations: there,
                missing_share: 1.0 - there as f64 / all.max(1) as f64,
                branch_jump_pairs: space.branch_jump_pairs,
                branch_jump_volume: space.branch_jump_volume,
                largest_jump_n: jump,
                two_solutions: space.two_solutions.points,
                apart_n: space.two_solutions.apart_n,
                branch_changes: summary.values().map(|sum| sum.switched).sum(),
                held_out: summary.values().map(|sum| sum.positions).sum(),
                method: fitted.method.name(),
                within_m: within_m.min(radius_m),
                positions: clear.count,
                covered_share: clear.covered as f64 / clear.count as f64,
                mean_n: some(clear.count, clear.mean_n),
                p99_n: some(clear.count, clear.p99_n),
                max_n: some(clear.count, clear.max_n),
                below_jnd_share: clear.below_jnd as f64 / clear.count as f64,
                branch_jump_positions: at_branch_jumps.count,
                branch_jump_mean_n: some(at_branch_jumps.count, at_branch_jumps.mean_n),
                branch_jump_max_n: some(at_branch_jumps.count, at_branch_jumps.max_n),
                seam_n: figures.probe.seam_n,
            })
        });
        rows.collect()
    }
}
