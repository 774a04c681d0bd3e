//! What of a mesh makes the pressures of a mixed method doubtful.

use serde::Serialize;

use crate::mesh::{Surface, TetMesh};

use super::SLIVER_DEG;
use super::shape::smallest_dihedral_deg;

/// Places where an incompressible law's pressures (P2/P1 above all) may be poor, or not determined at all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct PressureDoubts {
    /// All tets, to see the others in proportion.
    pub tets: usize,
    /// Tets with all four vertices on the surface. The proofs that P2/P1 is stable want one vertex of each tet inside.
    pub without_interior_vertex: usize,
    /// Tets with a dihedral angle below [`SLIVER_DEG`]: the stability constant goes with the worst shape.
    pub slivers_below_5_deg: usize,
    /// Tets with all four vertices fixed: rigid, they ask their pressures for nothing.
    pub all_fixed: usize,
    /// Nodes all of whose tets are `all_fixed`: no equation holds the pressure there, and the matrix is singular.
    pub undetermined_pressures: usize,
}

/// Looks for what makes pressures doubtful, given the fixed nodes.
pub fn doubtful_for_pressure(mesh: &TetMesh, fixed: &[u32]) -> PressureDoubts {
    let mut on_surface = vec![false; mesh.nodes_m.len()];
    for node in Surface::of(mesh).nodes {
        on_surface[node as usize] = true;
    }
    let mut is_fixed = vec![false; mesh.nodes_m.len()];
    for &node in fixed {
        is_fixed[node as usize] = true;
    }
    let all = |tet: &[u32; 4], of: &[bool]| tet.iter().all(|&node| of[node as usize]);
    let mut determined = vec![false; mesh.nodes_m.len()];
    for tet in mesh.tets.iter().filter(|tet| !all(tet, &is_fixed)) {
        for &node in tet {
            determined[node as usize] = true;
        }
    }
    let sliver = |tet: &usize| smallest_dihedral_deg(&mesh.vertices_m(*tet)) < SLIVER_DEG;
    PressureDoubts {
        tets: mesh.tets.len(),
        without_interior_vertex: mesh.tets.iter().filter(|tet| all(tet, &on_surface)).count(),
        slivers_below_5_deg: (0..mesh.tets.len()).filter(sliver).count(),
        all_fixed: mesh.tets.iter().filter(|tet| all(tet, &is_fixed)).count(),
        undetermined_pressures: determined.iter().filter(|&&determined| !determined).count(),
    }
}

impl PressureDoubts {
    /// One line for the user, if there is any doubt.
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
                "{} nodes have such tets only, and no pressure at all",
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
