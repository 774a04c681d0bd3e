//! Force as a function of displacement by finite elements, for laws, fixed sets and active nodes (the paper's
//! Fig. 6).

use palpate_precompute::fem::Solver;
use palpate_precompute::held_out::regular_directions;
use palpate_precompute::mesh::Surface;
use palpate_precompute::num::norm;
use palpate_precompute::pipeline::Analysis;
use palpate_precompute::scene::ActiveNode;
use palpate_precompute::space::solver_version;
use serde::{Deserialize, Serialize};

use super::plan::{Family, Plan};
use crate::cmd::paper::compare::by_law;
use crate::failure::Failure;
use crate::steps::{Steps, kept};

/// The paper's laws.
const LAWS: [&str; 3] = ["st-venant-kirchhoff", "modified-st-venant-kirchhoff", "mooney-rivlin"];
/// The fixed sets of the bundled organs.
const HELD: [&str; 2] = ["F1", "F2"];
/// Maximum number of active nodes per scene.
const MAX_NODES: usize = 2;
/// Number of points of a curve.
const STEPS: u32 = 25;

/// A point of a curve.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct CurveRow {
    pub scene: String,
    pub law: String,
    pub held: String,
    pub active: String,
    pub distance_m: f64,
    pub force_n: f64,
}

/// Solves the curves of a body, fixed as in its scene, or at F1 and at F2 if its mesh has both.
pub(super) fn measured(plan: &Plan, family: &Family, steps: &mut Steps) -> Result<Vec<CurveRow>, Failure> {
    steps.next(&format!("{}: force against displacement by law", family.name))?;
    let mut benches = Vec::new();
    for group in HELD {
        benches.extend(family.held_by(Some(group))?.map(|bench| (group, bench)));
    }
    if benches.len() < HELD.len() {
        benches = family.held_by(None)?.into_iter().map(|bench| ("as in the scene", bench)).collect();
    }
    let mut rows = Vec::new();
    for (held, bench) in &benches {
        for law in LAWS {
            // Laws that are no counterpart of the scene's law are omitted.
            let Ok(bench) = by_law(bench, law) else { continue };
            for node in bench.scene.active.iter().take(MAX_NODES) {
                rows.extend(curve(plan, family, &bench, node, (held, law), steps)?);
            }
        }
    }
    Ok(rows)
}

/// Along the regular direction that is nearest to the outward normal, up to r_G or the first failure of the
/// solver.
fn curve(
    plan: &Plan,
    family: &Family,
    bench: &Analysis,
    node: &ActiveNode,
    (held, law): (&str, &str),
    steps: &Steps,
) -> Result<Vec<CurveRow>, Failure> {
    let outward = Surface::of(&bench.scene.mesh).normal(node.node).unwrap_or([0.0, 0.0, 1.0]);
    let along = |d: &[f64; 3]| -> f64 { d.iter().zip(outward).map(|(a, b)| a * b).sum() };
    let direction = regular_directions().max_by(|a, b| along(a).total_cmp(&along(b))).unwrap_or(outward);
    let radius_m = family.radius_m();
    let hash = bench.scene.model_hash().to_hex();
    let key = format!("{hash} {} {:?} {radius_m:?} {STEPS} {}", node.node, node.patch, solver_version());
    let file = plan.work.file(&format!("curve-{}-{}.json", &hash[..16], node.node));
    let points = kept(&file, key, || {
        let mut solver = Solver::new(bench.problem(node));
        let mut points = vec![[0.0; 2]];
        let Ok(rest) = solver.rest() else { return Ok(points) };
        let mut seed = rest.seed;
        for step in 1..=STEPS {
            steps.go_on()?;
            let distance_m = radius_m * f64::from(step) / f64::from(STEPS);
            let Ok(c) = solver.advance(&seed, direction.map(|x| x * distance_m)) else { break };
            points.push([distance_m, norm(c.jet().force_n)]);
            seed = c.seed;
        }
        Ok(points)
    })?;
    let row = |[distance_m, force_n]: [f64; 2]| CurveRow {
        scene: family.name.clone(),
        law: law.into(),
        held: held.into(),
        active: node.name.clone(),
        distance_m,
        force_n,
    };
    Ok(points.into_iter().map(row).collect())
}
