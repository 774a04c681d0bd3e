//! Discretisation error of the force: the same displacements with the same tool on other elements, pressure
//! fields and meshes, compared with the finest of them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

use palpate_precompute::fem::{Problem, Solver};
use palpate_precompute::num::{norm, on_each_thread};
use palpate_precompute::pipeline::Analysis;
use palpate_precompute::space::solver_version;
use serde::{Deserialize, Serialize};

use super::plan::{Family, Plan};
use super::steps::{Steps, kept};
use crate::failure::Failure;

/// Radius of the patch that the tool holds, m, limited to a share of the body's diagonal. With a single node
/// the force decreases without limit as the mesh is refined, so only a tool of finite size has a force that
/// converges. 25 mm contains 8 nodes of the bundled small mesh.
const PATCH_M: f64 = 0.025;
const PATCH_SHARE: f64 = 0.15;
/// Displacements along each axis, as shares of r_G, each solved from the one before.
const SHARES: [f64; 2] = [0.1, 0.3];

/// One body.
#[derive(Debug, Clone, Serialize)]
pub(super) struct BodyRow {
    pub scene: String,
    pub law: String,
    /// Element and pressure field.
    pub element: String,
    pub mesh: String,
    pub tets: usize,
    pub equations: usize,
    /// "node" or "patch".
    pub tool: &'static str,
    pub patch_radius_m: Option<f64>,
    /// Displacements solved here and by the finest body, of those requested.
    pub compared: usize,
    pub asked: usize,
    /// Relative to the finest body: mean and largest |h - h_finest| / |h_finest|.
    pub mean_relative: f64,
    pub max_relative: f64,
    pub mean_n: f64,
    /// Mean time of a configuration.
    pub seconds: f64,
    pub finest: bool,
}

/// Results of one body.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Solved {
    equations: usize,
    /// Force at each solved displacement, and its seconds.
    forces: BTreeMap<usize, ([f64; 3], f64)>,
}

/// One discretisation.
struct Model<'f> {
    family: &'f Family,
    order: u8,
    stabilised: bool,
}

impl Model<'_> {
    fn element(&self, bench: &Analysis) -> String {
        match (bench.body.has_pressure(), self.order, self.stabilised) {
            (false, 1, _) => "tet4".into(),
            (false, ..) => "tet10".into(),
            (true, 1, false) => "tet4, P1/P1".into(),
            (true, 1, true) => "tet4, P1/P1 stabilised".into(),
            (true, ..) => "tet10, P2/P1".into(),
        }
    }
}

/// The discretisations of each family from coarse to fine, with the finer mesh after the coarser one.
fn ways(plan: &Plan) -> Result<Vec<(&Family, Vec<Model<'_>>)>, Failure> {
    let mut all = Vec::new();
    for family in &plan.families {
        let pressure = family.bench.body.has_pressure();
        let on = |family| {
            let plain = |order| Model { family, order, stabilised: false };
            let stabilised = pressure.then_some(Model { family, order: 1, stabilised: true });
            [Some(plain(1)), stabilised, Some(plain(2))].into_iter().flatten()
        };
        let mut ways: Vec<Model<'_>> = on(family).collect();
        let law = family.bench.body.law_names();
        let finer = plan.finer.iter().find(|finer| finer.bench.body.law_names() == law);
        ways.extend(finer.into_iter().flat_map(on));
        all.push((family, ways));
    }
    Ok(all)
}

/// Number of steps of [`measured`].
pub(super) fn steps(plan: &Plan) -> usize {
    plan.families.len()
}

/// Solves the displacements with every discretisation and compares them with the last.
pub(super) fn measured(plan: &Plan, steps: &mut Steps) -> Result<Vec<BodyRow>, Failure> {
    let mut rows = Vec::new();
    for (family, ways) in ways(plan)? {
        steps.next(&format!("{}: elements, pressure fields and meshes", family.name))?;
        let patch_m = PATCH_M.min(PATCH_SHARE * family.bench.scene.mesh.diagonal_m());
        for patch_m in [None, Some(patch_m)] {
            let mut solved = Vec::new();
            // A patch of one node is the same as the node.
            if patch_m.is_some() && family.discretised(1, false, patch_m)?.scene.active[0].patch.len() < 3 {
                continue;
            }
            for way in &ways {
                let bench = way.family.discretised(way.order, way.stabilised, patch_m)?;
                solved.push((
                    way,
                    solve(plan, &bench, family.radius_m(), steps)?,
                    way.element(&bench),
                    bench,
                ));
            }
            let finest = solved.last().map(|(_, solved, ..)| solved.forces.clone()).unwrap_or_default();
            for (n, (way, one, element, bench)) in solved.iter().enumerate() {
                let mut row = compare(one, &finest);
                row.scene.clone_from(&family.name);
                row.law = bench.body.law_names();
                row.element.clone_from(element);
                row.mesh.clone_from(&way.family.name);
                row.tets = bench.scene.mesh.tets.len();
                (row.tool, row.patch_radius_m) = (if patch_m.is_some() { "patch" } else { "node" }, patch_m);
                row.finest = n + 1 == solved.len();
                rows.push(row);
            }
        }
    }
    Ok(rows)
}

fn compare(one: &Solved, finest: &BTreeMap<usize, ([f64; 3], f64)>) -> BodyRow {
    let pairs = one.forces.iter().filter_map(|(at, (force, _))| Some((force, &finest.get(at)?.0)));
    let apart: Vec<[f64; 2]> = pairs
        .map(|(a, b)| {
            let error = norm(std::array::from_fn(|i| a[i] - b[i]));
            [error, error / norm(*b).max(f64::MIN_POSITIVE)]
        })
        .collect();
    let mean = |of: usize| apart.iter().map(|e| e[of]).sum::<f64>() / apart.len().max(1) as f64;
    let seconds: f64 = one.forces.values().map(|(_, seconds)| seconds).sum();
    BodyRow {
        scene: String::new(),
        law: String::new(),
        element: String::new(),
        mesh: String::new(),
        tets: 0,
        equations: one.equations,
        tool: "",
        patch_radius_m: None,
        compared: apart.len(),
        asked: 6 * SHARES.len(),
        mean_relative: mean(1),
        max_relative: apart.iter().map(|e| e[1]).fold(0.0, f64::max),
        mean_n: mean(0),
        seconds: seconds / one.forces.len().max(1) as f64,
        finest: false,
    }
}

/// The six directions along the axes, each in steps from rest. The results are stored in a file.
fn solve(plan: &Plan, bench: &Analysis, radius_m: f64, steps: &Steps) -> Result<Solved, Failure> {
    let hash = bench.scene.model_hash().to_hex();
    let node = &bench.scene.active[0];
    let key = format!("{hash} {} {:?} {radius_m:?} {SHARES:?} {}", node.node, node.patch, solver_version());
    let file = plan.work.file(&format!("forces-{}-{}.json", &hash[..16], node.patch.len()));
    kept(&file, key, || {
        let problem = bench.problem(node);
        let forces = on_threads(&problem, radius_m, plan.threads, &steps.stop)?;
        steps.go_on()?;
        Ok(Solved { equations: problem.unknowns(), forces })
    })
}

fn on_threads(
    problem: &Arc<Problem>,
    radius_m: f64,
    threads: usize,
    stop: &AtomicBool,
) -> Result<BTreeMap<usize, ([f64; 3], f64)>, Failure> {
    let next = AtomicUsize::new(0);
    let work = || {
        let mut solver = Solver::new(problem.clone());
        let mut found = Vec::new();
        while !stop.load(Ordering::Relaxed) {
            let direction = next.fetch_add(1, Ordering::Relaxed);
            if direction >= 6 {
                break;
            }
            let Ok(rest) = solver.rest() else { break };
            let mut seed = rest.seed;
            for (n, share) in SHARES.into_iter().enumerate() {
                let mut target = [0.0; 3];
                target[direction / 2] =
                    share * radius_m * if direction.is_multiple_of(2) { 1.0 } else { -1.0 };
                let start = Instant::now();
                // A direction ends at the first failure of the solver.
                let Ok(c) = solver.advance(&seed, target) else { break };
                found.push((direction * SHARES.len() + n, (c.jet().force_n, start.elapsed().as_secs_f64())));
                seed = c.seed;
            }
        }
        found
    };
    let solved = on_each_thread(threads, work).map_err(Failure::work)?;
    Ok(solved.into_iter().flatten().collect())
}
