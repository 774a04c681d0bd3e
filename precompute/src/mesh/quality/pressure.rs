//! Properties of a mesh that reduce the accuracy of the pressures of a mixed method.

use serde::Serialize;

use crate::mesh::{Surface, TetMesh};

use super::SLIVER_DEG;
use super::shape::smallest_dihedral_deg;

/// Number of places where an incompressible law's pressures (above all P2/P1) can be inaccurate or
/// undetermined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct PressureDoubts {
    /// Number of all tets, for comparison.
    pub tets: usize,
    /// Tets with all four vertices on the surface. The stability proofs of P2/P1 assume one interior vertex
    /// per tet.
    pub without_interior_vertex: usize,
    /// Tets with a dihedral angle below [`SLIVER_DEG`]: the worst shape determines the stability constant.
    pub slivers_below_5_deg: usize,
    /// Tets with all four vertices fixed. They are rigid and contribute no equation to their pressures.
    pub all_fixed: usize,
    /// Nodes whose tets are all fixed: no equation determines their pressure, and the matrix is singular.
    pub undetermined_pressures: usize,
}

/// Counts these places for the given fixed nodes.
pub fn doubtful_for_pressure(mesh: &TetMesh, fixed: &[u32]) -> PressureDoubts {
    let skin = Surface::of(mesh);
    let mut is_fixed = vec![false; mesh.nodes_m.len()];
    for &node in fixed {
        is_fixed[node as usize] = true;
    }
    let on_surface = |tet: &&[u32; 4]| tet.iter().all(|&node| skin.contains(node));
    let all_fixed = |tet: &&[u32; 4]| tet.iter().all(|&node| is_fixed[node as usize]);
    let mut determined = vec![false; mesh.nodes_m.len()];
    for tet in mesh.tets.iter().filter(|tet| !all_fixed(tet)) {
        for &node in tet {
            determined[node as usize] = true;
        }
    }
    let sliver = |tet: &usize| smallest_dihedral_deg(&mesh.vertices_m(*tet)) < SLIVER_DEG;
    PressureDoubts {
        tets: mesh.tets.len(),
        without_interior_vertex: mesh.tets.iter().filter(on_surface).count(),
        slivers_below_5_deg: (0..mesh.tets.len()).filter(sliver).count(),
        all_fixed: mesh.tets.iter().filter(all_fixed).count(),
        undetermined_pressures: determined.iter().filter(|&&determined| !determined).count(),
    }
}

impl PressureDoubts {
    /// The warning in one line, or `None` without such places.
    pub fn warning(&self) -> Option<String> {
        let parts = [
            (self.without_interior_vertex, "have no vertex inside the body"),
            (self.slivers_below_5_deg, "have a dihedral angle below 5 degrees"),
            (self.all_fixed, "have all vertices fixed"),
        ];
        let mut said: Vec<String> =
            parts.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")).collect();
        if self.undetermined_pressures > 0 {
            said.push(format!(
                "the pressure of {} nodes with only such tets is undetermined",
                self.undetermined_pressures
            ));
        }
        (!said.is_empty()).then(|| {
            format!(
                "pressures may be poor: of {} tets {}; refine or mesh again there, or fix fewer nodes",
                self.tets,
                said.join(", ")
            )
        })
    }
}
