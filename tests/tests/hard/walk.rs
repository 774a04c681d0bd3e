//! Straight loading paths in equal steps, each continued from the previous one.

use std::sync::Arc;

use nalgebra::Vector3;
use palpate_precompute::fem::{
    Body, Configuration, Constraints, Handle, Model, Problem, SolveFailure, Solver,
};
use palpate_precompute::mesh::TetMesh;
use palpate_precompute::scene::{ResolvedScene, Scene};

use super::table::Cost;

/// Result of a straight path.
#[derive(Debug)]
pub(crate) struct Walk {
    /// Displacement of the last solved configuration along the path, m.
    pub(crate) reached_m: f64,
    /// The last solved configuration.
    pub(crate) last: Configuration,
    /// Why the path ended early.
    pub(crate) failure: Option<SolveFailure>,
    /// Where an element was first inverted, m.
    pub(crate) inverted_at_m: Option<f64>,
    /// Work of the tool along the path, J, by the corrected trapezoidal rule with the stiffness at both ends,
    /// of fourth order.
    pub(crate) work_j: f64,
    /// Total cost.
    pub(crate) cost: Cost,
}

impl Walk {
    /// The outcome of the path as a table cell.
    pub(crate) fn verdict(&self) -> String {
        self.failure.map_or_else(
            || "complete path".into(),
            |f| format!("ends at {:.0} mm: {}", 1e3 * self.reached_m, f.reason),
        )
    }

    /// Force, distortion and stability at the end of the path, as a table cell.
    pub(crate) fn result(&self) -> String {
        state(&self.last)
    }
}

/// Force, distortion and stability of a configuration as a table cell.
pub(crate) fn state(c: &Configuration) -> String {
    let modes = c.unstable_modes.map_or("?".into(), |n| n.to_string());
    let force = norm(c.jet().force_n);
    format!("{force:.4} N, min J {:.3}, {} inverted, {modes} unstable", c.min_jacobian, c.inverted)
}

/// Euclidean norm.
pub(crate) fn norm(v: [f64; 3]) -> f64 {
    Vector3::from(v).norm()
}

/// |a - b| / |b|.
pub(crate) fn relative_error(a: [f64; 3], b: [f64; 3]) -> f64 {
    (Vector3::from(a) - Vector3::from(b)).norm() / norm(b)
}

/// Body of a valid mesh.
pub(crate) fn body(mesh: &TetMesh, model: &Model) -> Arc<Body> {
    Arc::new(Body::new(mesh, model).expect("every element has volume"))
}

/// Problem of a prescribed node set, by elimination.
pub(crate) fn problem(body: &Arc<Body>, handle: Handle) -> Arc<Problem> {
    Arc::new(Problem::with(body.clone(), Some(handle.into()), Constraints::Elimination))
}

/// The bundled organ.
pub(crate) fn organ() -> ResolvedScene {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/liver-small.toml");
    Scene::load(path.as_ref()).and_then(|scene| scene.resolve()).expect("the bundled scene is valid")
}

/// Solves up to `steps` steps of `step_m` along `direction`.
pub(crate) fn walk(
    solver: &mut Solver,
    direction: [f64; 3],
    step_m: f64,
    steps: u32,
) -> Result<Walk, SolveFailure> {
    let rest = solver.rest()?;
    let along = Vector3::from(direction).normalize();
    let equations = solver.problem().unknowns();
    let mut walk = Walk {
        reached_m: 0.0,
        last: rest,
        failure: None,
        inverted_at_m: None,
        work_j: 0.0,
        cost: Cost { equations, ..Cost::default() },
    };
    for step in 1..=steps {
        let at_m = f64::from(step) * step_m;
        match solver.advance(&walk.last.seed, (along * at_m).into()) {
            Ok(next) => walk.take(next, at_m, &along),
            Err(failure) => {
                walk.cost.iterations += failure.iterations;
                walk.failure = Some(failure);
                break;
            }
        }
    }
    Ok(walk)
}

impl Walk {
    fn take(&mut self, next: Configuration, at_m: f64, along: &Vector3<f64>) {
        self.cost.iterations += next.iterations;
        self.cost.factorisations += next.factorisations;
        self.cost.increments += next.increments;
        let step_m = at_m - self.reached_m;
        let force = |c: &Configuration| Vector3::from(c.jet().force_n).dot(along);
        let slope = |c: &Configuration| along.dot(&(c.jet().stiffness_n_m * along));
        self.work_j += 0.5 * step_m * (force(&self.last) + force(&next))
            + step_m * step_m / 12.0 * (slope(&self.last) - slope(&next));
        if next.inverted > 0 {
            self.inverted_at_m.get_or_insert(at_m);
        }
        self.reached_m = at_m;
        self.last = next;
    }
}
