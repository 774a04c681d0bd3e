//! Hard cases of the interpolation: tables with holes, and a body pulled so far that it has several branches.

use palpate_precompute::configuration_space::fold::folds;
use palpate_precompute::configuration_space::{GridIndex, SpaceGrid, Store};
use palpate_precompute::held_out::{Draw, Summary};
use serde::Serialize;

use super::measure::some;
use super::plan::{Family, Plan};
use super::solve::solved;
use super::steps::Steps;
use super::tables::{Choice, fitted};
use crate::failure::Failure;

/// A method in a hard case.
#[derive(Debug, Clone, Serialize)]
pub(super) struct HardRow {
    pub scene: String,
    /// What is hard.
    pub case: String,
    pub radius_m: f64,
    pub max_force_n: Option<f64>,
    pub grid: u32,
    /// Points in the fit.
    pub configurations: usize,
    pub missing_share: f64,
    pub fold_pairs: usize,
    pub folded_volume: f64,
    /// Between neighbours, beyond what the stiffness accounts for.
    pub largest_jump_n: f64,
    /// Held-out positions where the body left its branch on the way.
    pub branch_changes: u32,
    pub held_out: u32,
    pub method: &'static str,
    /// Away from folds.
    pub positions: usize,
    pub covered_share: f64,
    pub mean_n: f64,
    pub p99_n: f64,
    pub max_n: f64,
    /// At folds.
    pub folded_positions: usize,
    pub folded_mean_n: f64,
    pub folded_max_n: f64,
    /// At the seams of cells.
    pub seam_n: f64,
}

/// Shares of the points that are taken away.
const MISSING: [f64; 4] = [0.0, 0.02, 0.1, 0.5];

/// Number of steps of [`measured`].
pub(super) fn steps() -> usize {
    4
}

/// Measures the hard cases of a body on one grid.
pub(super) fn measured(
    plan: &Plan,
    family: &Family,
    grid: (u32, u32),
    again: bool,
    steps: &mut Steps,
) -> Result<Vec<HardRow>, Failure> {
    let mut rows = Vec::new();
    let near = family.on_grid(grid)?;
    let store = Store::open(&plan.work.join(format!("{}.space", near.name)))?;
    steps.next(&format!("{}: tables with holes", near.name))?;
    for share in MISSING {
        let name = match share {
            0.0 => near.name.clone(),
            share => format!("{}-without-{:.0}", near.name, 100.0 * share),
        };
        let what = match share {
            0.0 => "as it is".into(),
            share => format!("{:.0} % of the points missing", 100.0 * share),
        };
        rows.extend(case(plan, family, &store, &what, &Hole { name, share, again, grid: grid.0 }, steps)?);
    }
    drop(store);
    let far = family.pulled_far(grid)?;
    let radius_m = 2.0 * family.radius_m();
    let full = plan.draw(radius_m);
    // Every failing solve costs a hundred others there.
    let draw = Draw { regular_m: None, random: full.random / 2, uniform: full.uniform / 2, ..full };
    let path = solved(plan, &far, &draw, None, steps)?;
    steps.next(&format!("{}: tables and certificates", far.name))?;
    let store = Store::open(&path)?;
    let what = format!("twice as far, r_G = {:.0} mm, no force limit", 1e3 * radius_m);
    let hole = Hole { name: far.name, share: 0.0, again, grid: grid.0 };
    rows.extend(case(plan, family, &store, &what, &hole, steps)?);
    Ok(rows)
}

/// A space without some of its points.
struct Hole {
    name: String,
    share: f64,
    again: bool,
    grid: u32,
}

impl Hole {
    /// Whether a point stays: a fixed pseudo-random choice (SplitMix64 of its index).
    fn keeps(&self, index: GridIndex) -> bool {
        let mut x = index.iter().fold(0u64, |x, n| x << 16 ^ (i64::from(*n) & 0xffff) as u64);
        for multiplier in [0xbf58_476d_1ce4_e5b9_u64, 0x94d0_49bb_1331_11eb] {
            x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
            x = (x ^ (x >> 30)).wrapping_mul(multiplier);
        }
        index == [0; 3] || ((x >> 11) as f64 / (1_u64 << 53) as f64) >= self.share
    }
}

fn case(
    plan: &Plan,
    family: &Family,
    store: &Store,
    what: &str,
    hole: &Hole,
    steps: &Steps,
) -> Result<Vec<HardRow>, Failure> {
    let identity = store.identity()?;
    let grid = SpaceGrid::new(identity.spacing_m, identity.radius_m).map_err(Failure::work)?;
    let records = store.records(0)?;
    let solved = records.iter().filter(|r| r.tag.is_solved());
    let (all, there) =
        solved.fold((0, 0), |(all, there), r| (all + 1, there + usize::from(hole.keeps(r.index))));
    let jump = folds(&grid, &records).iter().map(|fold| fold.rho_h_n).fold(0.0, f64::max);
    let summary = Summary::of(store, 0)?;
    let choice = Choice { name: &hole.name, keep: &|index| hole.keeps(index), again: hole.again };
    let (all_fitted, _) = fitted(plan, store, &choice, |_| steps.go_on())?;
    let rows = all_fitted.iter().map(|fitted| {
        let (figures, space) = (fitted.figures(), fitted.space());
        let (clear, folded) = (figures.uniform, figures.folded);
        HardRow {
            scene: family.name.clone(),
            case: what.into(),
            radius_m: identity.radius_m,
            max_force_n: Some(identity.max_force_n).filter(|f| f.is_finite()),
            grid: hole.grid,
            configurations: there,
            missing_share: 1.0 - there as f64 / all.max(1) as f64,
            fold_pairs: space.fold_pairs,
            folded_volume: space.folded_volume,
            largest_jump_n: jump,
            branch_changes: summary.values().map(|sum| sum.switched).sum(),
            held_out: summary.values().map(|sum| sum.positions).sum(),
            method: fitted.method.name(),
            positions: clear.count,
            covered_share: clear.covered as f64 / clear.count as f64,
            mean_n: some(clear.count, clear.mean_n),
            p99_n: some(clear.count, clear.p99_n),
            max_n: some(clear.count, clear.max_n),
            folded_positions: folded.count,
            folded_mean_n: some(folded.count, folded.mean_n),
            folded_max_n: some(folded.count, folded.max_n),
            seam_n: figures.probe.seam_n,
        }
    });
    Ok(rows.collect())
}
