//! Discretisations: cost and accuracy of another order of the shape functions or another pressure field.

use std::sync::Arc;

use crate::fem::PressurePair;
use crate::scene::{ResolvedScene, SolverOptions, elements};

use super::probe::{Probed, rest_of};

/// Meshes with more tets are not factorised with quadratic elements, which would take too long for a plan.
const MAX_TETS: usize = 3000;
/// Assumed ratios of time and memory to those of linear elements for such meshes. Measured on a mesh of 1,800
/// tets: 4.8 times the unknowns, and a factorisation whose time is proportional to their square. Memory is
/// proportional to the entries of the factor.
const QUADRATIC_TIMES: [f64; 2] = [20.0, 14.0];

/// Shape functions and pressure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Model {
    /// 1 or 2.
    pub order: u8,
    /// Pressure field of incompressible regions.
    pub pair: PressurePair,
}

/// A model compared with that of the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ComparedModel {
    /// The model.
    pub model: Model,
    /// Seconds of a solve relative to the scene's model.
    pub times: f64,
    /// Trace of the condensed stiffness at rest divided by 3, N/m; `None` if it was not solved.
    pub stiffness_n_m: Option<f64>,
    /// Bytes of one solver relative to the scene's model.
    pub memory: f64,
}

impl Model {
    /// The model of a scene.
    pub(super) fn of(scene: &ResolvedScene) -> Self {
        Self { order: scene.order, pair: scene.solver.pressure }
    }

    /// The name as text.
    pub(super) fn words(self, has_pressure: bool) -> &'static str {
        elements(self.order, self.pair, has_pressure)
    }

    /// The other reasonable models.
    pub(super) fn others(self, has_pressure: bool) -> Vec<Self> {
        let (plain, stabilised) = (PressurePair::Plain, PressurePair::Stabilised);
        let mut all = vec![Self { order: 1, pair: plain }, Self { order: 2, pair: plain }];
        if has_pressure {
            all.insert(1, Self { order: 1, pair: stabilised });
        }
        all.retain(|other| *other != self && !(other.order == 2 && self.order == 2));
        all
    }
}

/// Data of another model of the scene, from its solve at rest with the same active node; `None` if the scene
/// cannot have it.
pub(super) fn beside(
    scene: &ResolvedScene,
    active: usize,
    model: Model,
    probed: &Probed,
) -> Option<ComparedModel> {
    if model.order == 2 && scene.mesh.tets.len() > MAX_TETS {
        let [times, memory] = QUADRATIC_TIMES;
        return Some(ComparedModel { model, times, stiffness_n_m: None, memory });
    }
    let solver = SolverOptions { pressure: model.pair, ..scene.solver };
    let other = ResolvedScene { order: model.order, solver, ..scene.clone() };
    let body = Arc::new(other.body().ok()?);
    let problem = Arc::new(other.problem(&body, &scene.active[active]));
    let (seconds, trace, size) = rest_of(&problem)?;
    Some(ComparedModel {
        model,
        times: seconds / probed.rest_s,
        stiffness_n_m: Some(trace / 3.0),
        memory: solver_bytes(size) / solver_bytes(probed.size),
    })
}

/// Bytes of one thread's solver, from unknowns, entries of the matrix and of its factor: values, the factor
/// and its workspace, a dozen vectors and several sets of three right-hand sides.
pub(super) fn solver_bytes([unknowns, matrix, factor]: [usize; 3]) -> f64 {
    8.0 * (2.0 * matrix as f64 + 1.5 * factor as f64 + 40.0 * unknowns as f64)
}

/// Bytes of the whole process: the program, the body with its scatter map and analysis, and a solver per
/// thread.
pub(super) fn memory_bytes(tets: usize, order: u8, size: [usize; 3], threads: usize) -> f64 {
    const PROCESS: f64 = 12e6;
    /// Bytes per tet: geometry, and the positions of its matrix in the sparse one.
    const TET: [f64; 2] = [3e3, 12e3];
    let tet = TET[usize::from(order.clamp(1, 2)) - 1];
    // Every active node in progress has its own analysis: matrix and factor as indices.
    let analysis = 8.0 * (2.0 * size[1] as f64 + 0.5 * size[2] as f64);
    PROCESS + tets as f64 * tet + threads as f64 * (solver_bytes(size) + analysis)
}

/// Bytes of the fits of adaptive sampling in the spaces that are solved at the same time, in the worst case
/// those with the most configurations: four factors of 20 rows per configuration each.
pub(super) fn loop_bytes(configurations: &[f64], threads: usize) -> f64 {
    let mut counts = configurations.to_vec();
    counts.sort_by(|a, b| b.total_cmp(a));
    counts.iter().take(threads).map(|count| 4.0 * 8.0 * (20.0 * count).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_other_models_of_a_scene() {
        let words = |model: Model, pressure| -> Vec<&str> {
            model.others(pressure).into_iter().map(|other| other.words(pressure)).collect()
        };
        let [plain, stabilised] = [PressurePair::Plain, PressurePair::Stabilised];
        assert_eq!(words(Model { order: 1, pair: plain }, true), ["P1/P1 stab.", "P2/P1"]);
        assert_eq!(words(Model { order: 1, pair: stabilised }, true), ["P1/P1", "P2/P1"]);
        assert_eq!(words(Model { order: 2, pair: plain }, true), ["P1/P1", "P1/P1 stab."]);
        assert_eq!(words(Model { order: 1, pair: plain }, false), ["P2"]);
    }

    #[test]
    fn memory_grows_with_threads_and_entries() {
        let size = [2_000, 60_000, 300_000];
        let [one, two] = [1, 2].map(|threads| memory_bytes(1_800, 1, size, threads));
        assert!(two > one && two < 2.0 * one);
        assert!(memory_bytes(1_800, 2, size.map(|n| 5 * n), 1) > one);
    }

    #[test]
    fn the_largest_spaces_may_be_worked_on_together() {
        assert_eq!(loop_bytes(&[10.0, 40.0, 20.0], 2), loop_bytes(&[40.0], 1) + loop_bytes(&[20.0], 1));
        assert_eq!(loop_bytes(&[10.0], 1), 32.0 * 200.0 * 200.0);
    }
}
