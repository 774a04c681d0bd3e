//! The identity of a store without a scene.

use palpate_precompute::mesh::TetMesh;
use palpate_precompute::space::StoreIdentity;
use palpate_precompute::spec::{DisplacementBound, Lattice, Sampling, SpaceGrid};

/// That of a lattice with complete cells on an arbitrary body.
pub(crate) fn identity(grid: SpaceGrid, mesh: &TetMesh) -> StoreIdentity {
    StoreIdentity {
        scene_name: "bench".into(),
        scene: String::new(),
        content_hash: String::new(),
        mesh_hash: mesh.content_hash(),
        law: String::new(),
        max_force_n: f64::INFINITY,
        sampling: Sampling::Lattice(Lattice { grid, complete_cells: true, increments: None }),
        normals: Vec::new(),
        visited_m: Vec::new(),
        contacts: None,
        charts: None,
        visual: false,
        displacement_bound: DisplacementBound::default(),
    }
}
