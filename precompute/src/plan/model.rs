//! Discretisations: cost and accuracy of another order of the shape functions or another pressure field.

use std::sync::Arc;

use crate::fem::PressurePair;
use crate::num::jet::EnergyJet;
use crate::scene::{ElementOrder, ResolvedScene, SolverOptions, elements};

use super::probe::{Probed, rest_of};

/// Meshes with more tets are not factorised with quadratic elements, which would take too long for a plan. For a
/// tool with a size, whose scene needs them, the limit is the second one.
const MAX_TETS: [usize; 2] = [3_000, 15_000];
/// The refined part of the body, in radii of the tool round its place.
const REACH: f64 = 2.0;
/// Assumed ratios of time and memory to those of linear elements for such meshes. Measured on a mesh of 1,800
/// tets: 4.8 times the unknowns, and a factorisation whose time is proportional to their square. Memory is
/// proportional to the entries of the factor.
const QUADRATIC_TIMES: [f64; 2] = [20.0, 14.0];

/// Shape functions, pressure and size of the elements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Model {
    /// Order of the shape functions.
    pub order: ElementOrder,
    /// Pressure field of incompressible regions.
    pub pair: PressurePair,
    /// Whether the mesh is refined once near the tool.
    pub refined: bool,
}

/// A model compared with that of the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ComparedModel {
    /// The model.
    pub model: Model,
    /// Seconds of a solve relative to the scene's model.
    pub times: f64,
    /// The solution at rest; `None` if it was not solved.
    pub jet: Option<EnergyJet>,
    /// Bytes of one solver relative to the scene's model.
    pub memory: f64,
}

impl Model {
    /// The model of a scene.
    pub(super) fn of(scene: &ResolvedScene) -> Self {
        Self { order: scene.order, pair: scene.solver.pressure, refined: false }
    }

    /// The name as text.
    pub(super) fn words(self, has_pressure: bool) -> String {
        let size = if self.refined { " h/2" } else { "" };
        format!("{}{size}", elements(self.order, self.pair, has_pressure))
    }

    /// The keys of a scene with these elements.
    pub(super) fn keys(self) -> &'static str {
        match (self.order, self.pair, self.refined) {
            (ElementOrder::NearTool, _, true) => "`order = \"tool\"` and `refine = \"tool\"` in [mesh]",
            (_, _, true) => "`order = 2` and `refine = \"tool\"` in [mesh]",
            (ElementOrder::NearTool, ..) => "`order = \"tool\"` in [mesh]",
            (ElementOrder::Quadratic, ..) => "`order = 2` in [mesh]",
            (_, PressurePair::Stabilised, _) => "`pressure = \"stabilised\"` in [solver]",
            _ => "`order = 1` in [mesh]",
        }
    }

    /// The other reasonable models. The force of a tool with a size converges, so that a mesh refined near it
    /// is one of them.
    pub(super) fn others(self, has_pressure: bool, has_size: bool) -> Vec<Self> {
        let of = |order, pair| Self { order, pair, refined: false };
        let quadratic = of(ElementOrder::Quadratic, PressurePair::Plain);
        let near_tool = of(ElementOrder::NearTool, PressurePair::Plain);
        let mut all = vec![of(ElementOrder::Linear, PressurePair::Plain)];
        if has_pressure {
            all.push(of(ElementOrder::Linear, PressurePair::Stabilised));
        }
        if has_size {
            all.push(near_tool);
        }
        all.push(quadratic);
        all.retain(|other| *other != self);
        if has_size {
            all.extend([near_tool, quadratic].map(|model| Self { refined: true, ..model }));
        }
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
    let solver = SolverOptions { pressure: model.pair, ..scene.solver };
    let tip = scene.tool.fingertip();
    let mut other = ResolvedScene { order: model.order, solver, ..scene.clone() };
    if model.order == ElementOrder::NearTool && other.body_force.is_some() {
        return None;
    }
    if let Some(tip) = tip.filter(|_| model.refined) {
        let place_m = scene.active[active].place_m(&scene.mesh);
        other = other.refined_near(&[place_m], REACH * tip.radius_m, 1)?;
    }
    if model.order == ElementOrder::Quadratic && other.mesh.tets.len() > MAX_TETS[usize::from(tip.is_some())]
    {
        let [times, memory] = QUADRATIC_TIMES;
        return (!model.refined).then_some(ComparedModel { model, times, jet: None, memory });
    }
    let body = Arc::new(other.body().ok()?);
    let problem = other.problem(&body, &other.active[active]);
    let (seconds, jet, size) = rest_of(&problem)?;
    Some(ComparedModel {
        model,
        times: seconds / probed.rest_s,
        jet: Some(jet),
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
pub(super) fn memory_bytes(tets: usize, order: ElementOrder, size: [usize; 3], threads: usize) -> f64 {
    const PROCESS: f64 = 12e6;
    /// Bytes per tet: geometry, and the positions of its matrix in the sparse one.
    const TET: [f64; 2] = [3e3, 12e3];
    let tet = TET[usize::from(order != ElementOrder::Linear)];
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
        let words = |order, pair, pressure, has_size| -> Vec<String> {
            let model = Model { order, pair, refined: false };
            model.others(pressure, has_size).into_iter().map(|other| other.words(pressure)).collect()
        };
        let [plain, stabilised] = [PressurePair::Plain, PressurePair::Stabilised];
        let [linear, quadratic] = [ElementOrder::Linear, ElementOrder::Quadratic];
        assert_eq!(words(linear, plain, true, false), ["P1/P1 stab.", "P2/P1"]);
        assert_eq!(words(linear, stabilised, true, false), ["P1/P1", "P2/P1"]);
        assert_eq!(words(quadratic, plain, true, false), ["P1/P1", "P1/P1 stab."]);
        assert_eq!(words(linear, plain, false, false), ["P2"]);
        assert_eq!(
            words(quadratic, plain, false, true),
            ["P1", "P2 near tool", "P2 near tool h/2", "P2 h/2"]
        );
        let of_near = words(ElementOrder::NearTool, plain, true, true);
        assert_eq!(of_near, ["P1/P1", "P1/P1 stab.", "P2/P1", "P2/P1 near tool h/2", "P2/P1 h/2"]);
    }

    #[test]
    fn memory_grows_with_threads_and_entries() {
        let size = [2_000, 60_000, 300_000];
        let [one, two] = [1, 2].map(|threads| memory_bytes(1_800, ElementOrder::Linear, size, threads));
        assert!(two > one && two < 2.0 * one);
        assert!(memory_bytes(1_800, ElementOrder::Quadratic, size.map(|n| 5 * n), 1) > one);
    }

    #[test]
    fn the_largest_spaces_may_be_worked_on_together() {
        assert_eq!(loop_bytes(&[10.0, 40.0, 20.0], 2), loop_bytes(&[40.0], 1) + loop_bytes(&[20.0], 1));
        assert_eq!(loop_bytes(&[10.0], 1), 32.0 * 200.0 * 200.0);
    }
}
