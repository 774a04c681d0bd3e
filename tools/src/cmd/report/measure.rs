//! Measurements of one case, from the space to the rows of the report's main tables.

use std::collections::BTreeMap;
use std::path::Path;

use palpate_core::Method;
use palpate_precompute::certificate::{Answer, Certificate, Errors, answers, nanoseconds};
use palpate_precompute::space::{Kind, Store, Walk};
use serde::Serialize;

use super::plan::{Case, Family, Plan};
use super::solve::solved;
use super::tables::{Fitted, LeftOut, fitted};
use crate::failure::Failure;
use crate::steps::Steps;

/// Cost of a space (the paper's Fig. 7).
#[derive(Debug, Clone, Serialize)]
pub(super) struct SpaceRow {
    pub scene: String,
    pub law: String,
    pub active: String,
    pub radius_m: f64,
    pub max_force_n: Option<f64>,
    pub complete_cells: bool,
    /// Number of points within the ball.
    pub grid: u32,
    pub configurations: usize,
    pub tries: usize,
    pub failed: usize,
    /// Seconds of the solves, with all threads.
    pub solve_seconds: f64,
    /// Newton and quasi-Newton steps, and the factorisations among them: a machine-independent cost.
    pub iterations: u64,
    pub factorisations: u64,
    pub largest_residual_n: f64,
    pub branch_jump_pairs: usize,
    pub branch_jump_volume: f64,
    pub held_out_positions: u32,
    pub held_out_seconds: f64,
    pub space_bytes: u64,
}

/// Errors and cost of a method on a grid.
#[derive(Debug, Clone, Serialize)]
pub(super) struct MethodRow {
    pub scene: String,
    pub law: String,
    pub grid: u32,
    pub method: &'static str,
    /// Median of a query, measured at the end of this run.
    pub nanoseconds: f64,
    pub configurations: usize,
    pub solve_seconds: f64,
    pub table_bytes: usize,
    pub blob_bytes: usize,
    /// Uniform positions away from branch jumps, and the error vector there; NaN if there are none.
    pub positions: usize,
    pub covered_share: f64,
    pub mean_n: f64,
    pub p50_n: f64,
    pub p95_n: f64,
    pub p99_n: f64,
    pub max_n: f64,
    /// Mean over positions in cells with complete data of the method.
    pub covered_mean_n: f64,
    pub below_jnd_share: f64,
    pub below_jnd_certified: f64,
    /// Uniform positions at branch jumps, which are excluded from the means.
    pub branch_jump_positions: usize,
    pub branch_jump_mean_n: f64,
    pub branch_jump_max_n: f64,
    pub work_mean_share: f64,
    pub work_max_share: f64,
    /// Around circles that touch branch jumps; NaN if there are none.
    pub work_at_branch_jumps_mean_share: f64,
    pub work_at_branch_jumps_max_share: f64,
    pub seam_n: f64,
    pub rounding_n: f64,
}

/// Errors along one path without the steps at branch jumps (the paper's Eqs. 13 and 14, and Fig. 9).
#[derive(Debug, Clone, Serialize)]
pub(super) struct PathRow {
    pub scene: String,
    pub grid: u32,
    pub method: &'static str,
    pub kind: &'static str,
    pub number: u32,
    pub positions: usize,
    pub branch_jump_positions: usize,
    pub mean_n: f64,
    pub mean_relative: f64,
    pub max_n: f64,
    pub max_relative: f64,
}

/// Means over all paths (the paper's Fig. 8).
#[derive(Debug, Clone, Serialize)]
pub(super) struct MeanRow {
    pub scene: String,
    pub grid: u32,
    pub method: &'static str,
    pub paths: usize,
    pub mean_n: f64,
    pub mean_relative: f64,
    pub max_n: f64,
    pub max_relative: f64,
}

/// A certificate and its case.
#[derive(Debug, Clone, Serialize)]
pub(super) struct CertificateRow {
    pub case: String,
    pub method: &'static str,
    pub certificate: Certificate,
}

/// All measurements of one case.
#[derive(Debug)]
pub(super) struct Measured {
    /// Row of the space.
    pub space: SpaceRow,
    /// One row per method.
    pub methods: Vec<MethodRow>,
    /// One row per path and method.
    pub paths: Vec<PathRow>,
    /// One row per method.
    pub means: Vec<MeanRow>,
    /// Certificates of the blobs.
    pub certificates: Vec<CertificateRow>,
    /// Methods without tables.
    pub left_out: Vec<LeftOut>,
    /// The blobs, in the order of `methods`.
    pub fitted: Vec<Fitted>,
    /// Positions of the held-out solutions.
    pub visited: Vec<[f32; 3]>,
    /// Forces along one regular path.
    pub along: Along,
}

/// Force along a regular path, by finite elements and by each method.
#[derive(Debug, Default)]
pub(super) struct Along {
    /// Direction, not of unit length.
    pub number: u32,
    /// |d|, m.
    pub distance_m: Vec<f64>,
    /// |h| by finite elements, N.
    pub truth_n: Vec<f64>,
    /// Methods with |h| and |error| at each distance, N.
    pub methods: Vec<(Method, Vec<[f64; 2]>)>,
}

/// Measures a case: solves missing configurations, fits, and computes the figures.
pub(super) fn measured(
    plan: &Plan,
    family: &Family,
    case: &Case,
    sibling: Option<&Path>,
    again: bool,
    steps: &mut Steps,
) -> Result<Measured, Failure> {
    let path = solved(plan, case, &plan.draw(family.radius_m()), sibling, steps)?;
    steps.next(&format!("{}: tables and certificates", case.name))?;
    let store = Store::open(&path)?;
    let (fitted, left_out) = fitted(plan, &store, (&case.name, again), |_| steps.go_on())?;
    let origin = |fitted: &Fitted| fitted.certificate.origin.clone();
    let Some((origin, first)) = fitted.first().map(|f| (origin(f), f.space().clone())) else {
        return Err(Failure::input(format!(
            "{}: none of the methods can be fitted on {} points; take a coarser grid or another method",
            case.name, case.points
        )));
    };
    let cost = first.cost;
    let attempts = store.attempts(0)?;
    let scene = family.name.clone();
    let mut measured = Measured {
        space: SpaceRow {
            scene: scene.clone(),
            law: origin.law.clone(),
            active: first.active.clone(),
            radius_m: origin.radius_m,
            max_force_n: origin.max_force_n,
            complete_cells: origin.complete_cells,
            grid: case.points,
            configurations: cost.configurations,
            tries: cost.tries,
            failed: cost.failed,
            solve_seconds: cost.seconds,
            iterations: attempts.iter().map(|r| u64::from(r.iterations)).sum(),
            factorisations: attempts.iter().map(|r| u64::from(r.factorisations)).sum(),
            largest_residual_n: cost.residual_n,
            branch_jump_pairs: first.branch_jump_pairs,
            branch_jump_volume: first.branch_jump_volume,
            held_out_positions: cost.held_out,
            held_out_seconds: cost.held_out_seconds,
            space_bytes: std::fs::metadata(&path).map_or(0, |m| m.len()),
        },
        methods: Vec::new(),
        paths: Vec::new(),
        means: Vec::new(),
        certificates: Vec::new(),
        left_out,
        fitted: Vec::new(),
        visited: Vec::new(),
        along: Along::default(),
    };
    for fitted in fitted {
        let found = answers(&store, 0, &fitted.organ()?, fitted.method)?;
        measured.take(&scene, case.points, fitted, &found);
    }
    Ok(measured)
}

impl Measured {
    fn take(&mut self, scene: &str, grid: u32, fitted: Fitted, found: &[Answer]) {
        let method = fitted.method.name();
        let (figures, cost) = (fitted.figures(), fitted.space().cost);
        let uniform = |answer: &&Answer| answer.walk.kind == Kind::Uniform && !answer.near_branch_jump;
        let covered = Errors::of(found.iter().filter(uniform).map(|a| &a.compared).filter(|c| c.covered));
        let e = figures.uniform;
        let share = |n: usize| n as f64 / e.count.max(1) as f64;
        self.methods.push(MethodRow {
            scene: scene.into(),
            law: self.space.law.clone(),
            grid,
            method,
            nanoseconds: figures.probe.nanoseconds,
            configurations: cost.configurations,
            solve_seconds: cost.seconds,
            table_bytes: fitted.table_bytes,
            blob_bytes: fitted.blob_bytes,
            positions: e.count,
            covered_share: some(e.count, share(e.covered)),
            mean_n: some(e.count, e.mean_n),
            p50_n: some(e.count, e.p50_n),
            p95_n: some(e.count, e.p95_n),
            p99_n: some(e.count, e.p99_n),
            max_n: some(e.count, e.max_n),
            covered_mean_n: some(covered.count, covered.mean_n),
            below_jnd_share: some(e.count, share(e.below_jnd)),
            below_jnd_certified: figures.below_jnd_certified,
            branch_jump_positions: figures.at_branch_jumps.count,
            branch_jump_mean_n: some(figures.at_branch_jumps.count, figures.at_branch_jumps.mean_n),
            branch_jump_max_n: some(figures.at_branch_jumps.count, figures.at_branch_jumps.max_n),
            work_mean_share: figures.probe.work.mean,
            work_max_share: figures.probe.work.max,
            work_at_branch_jumps_mean_share: some(
                figures.probe.work_at_branch_jumps.circles,
                figures.probe.work_at_branch_jumps.mean,
            ),
            work_at_branch_jumps_max_share: some(
                figures.probe.work_at_branch_jumps.circles,
                figures.probe.work_at_branch_jumps.max,
            ),
            seam_n: figures.probe.seam_n,
            rounding_n: figures.probe.rounding_n,
        });
        let paths = path_rows(scene, grid, method, found);
        self.means.push(mean_row(scene, grid, method, &paths));
        self.paths.extend(paths);
        let case = format!("{scene}-{grid}");
        self.certificates.push(CertificateRow { case, method, certificate: fitted.certificate.clone() });
        self.visited = found.iter().map(|answer| answer.displacement_m).collect();
        self.along.add(fitted.method, found);
        self.fitted.push(fitted);
    }

    /// Times every method at the positions of the held-out solutions: the median of `rounds` interleaved
    /// rounds, so that a disturbance affects all methods.
    pub(super) fn time(&mut self, rounds: usize) -> Result<(), Failure> {
        let mut all = vec![Vec::new(); self.fitted.len()];
        for _ in 0..rounds {
            for (times, fitted) in all.iter_mut().zip(&self.fitted) {
                times.push(nanoseconds(&fitted.organ()?.spaces[0], fitted.method, &self.visited));
            }
        }
        for (row, mut times) in self.methods.iter_mut().zip(all) {
            times.sort_by(f64::total_cmp);
            row.nanoseconds = times[rounds / 2];
        }
        Ok(())
    }
}

/// A value over `count` positions; NaN if there are none.
fn some(count: usize, value: f64) -> f64 {
    if count > 0 { value } else { f64::NAN }
}

fn path_rows(scene: &str, grid: u32, method: &'static str, found: &[Answer]) -> Vec<PathRow> {
    let mut walks: BTreeMap<Walk, Vec<&Answer>> = BTreeMap::new();
    for answer in found.iter().filter(|answer| answer.walk.kind != Kind::Uniform) {
        walks.entry(answer.walk).or_default().push(answer);
    }
    let row = |(walk, steps): (Walk, Vec<&Answer>)| {
        let clear: Vec<_> =
            steps.iter().filter(|answer| !answer.near_branch_jump).map(|answer| &answer.compared).collect();
        let e = Errors::of(clear.iter().copied());
        PathRow {
            scene: scene.into(),
            grid,
            method,
            kind: walk.kind.name(),
            number: walk.number,
            positions: clear.len(),
            branch_jump_positions: steps.len() - clear.len(),
            mean_n: some(e.count, e.component_mean_n),
            mean_relative: some(e.count, e.relative_mean),
            max_n: some(e.count, e.component_max_n),
            max_relative: some(e.count, e.relative_max),
        }
    };
    walks.into_iter().map(row).collect()
}

/// The mean of the paths' means, as in the paper. Paths entirely at branch jumps are excluded.
fn mean_row(scene: &str, grid: u32, method: &'static str, paths: &[PathRow]) -> MeanRow {
    let counted: Vec<&PathRow> = paths.iter().filter(|path| path.positions > 0).collect();
    let mean =
        |of: fn(&PathRow) -> f64| counted.iter().map(|path| of(path)).sum::<f64>() / counted.len() as f64;
    let max = |of: fn(&PathRow) -> f64| counted.iter().map(|path| of(path)).fold(f64::NAN, f64::max);
    MeanRow {
        scene: scene.into(),
        grid,
        method,
        paths: counted.len(),
        mean_n: mean(|path| path.mean_n),
        mean_relative: mean(|path| path.mean_relative),
        max_n: max(|path| path.max_n),
        max_relative: max(|path| path.max_relative),
    }
}

fn norm(v: impl IntoIterator<Item = f64>) -> f64 {
    v.into_iter().map(|x| x * x).sum::<f64>().sqrt()
}

impl Along {
    /// Adds a method's forces along the longest regular path; of several, the one with the largest force.
    fn add(&mut self, method: Method, found: &[Answer]) {
        let regular = || found.iter().filter(|answer| answer.walk.kind == Kind::Regular);
        let mut ends: BTreeMap<u32, (u32, f64)> = BTreeMap::new();
        for answer in regular() {
            let end = (answer.step, norm(answer.compared.truth_n));
            let last = ends.entry(answer.walk.number).or_insert(end);
            *last = if end.0 > last.0 { end } else { *last };
        }
        let longest = ends.iter().max_by(|(_, a), (_, b)| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let Some(number) = longest.map(|(number, _)| *number) else { return };
        let steps: Vec<&Answer> = regular().filter(|answer| answer.walk.number == number).collect();
        self.number = number;
        self.distance_m = steps.iter().map(|a| norm(a.displacement_m.map(f64::from))).collect();
        self.truth_n = steps.iter().map(|a| norm(a.compared.truth_n)).collect();
        let answered = steps.iter().map(|a| [norm(a.compared.found_n), a.compared.error_n()]).collect();
        self.methods.push((method, answered));
    }
}
