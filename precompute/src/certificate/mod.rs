//! The certificate of a blob: errors of the packed bytes against finite-element solves that no fit uses.
//!
//! Bounds come from the independent uniform positions alone. Paths are reported as in the paper. Positions
//! near branch jumps, where the body has several solutions, are reported separately: no interpolant is
//! correct there, and a common mean would hide them.

mod blend;
mod branch_jump;
mod discretisation;
mod displacement;
mod errors;
mod health;
mod measure;
mod pooled;
mod probes;
mod reference;

pub(crate) use blend::Blends;
pub use discretisation::{Discretisation, FinerForce};
pub(crate) use displacement::modes_and_digits;
pub use displacement::{DisplacementCertificate, SurfaceDistances};
pub use errors::{Compared, Errors, Within, certified_share};
pub use health::{Health, Reason, Verdict};
pub(crate) use measure::{Truth, answered, clear_positions, truths};
pub use measure::{answers, certify};
pub(crate) use probes::share_of_part;
pub use probes::{Probe, nanoseconds};
pub use reference::force_n as reference_force_n;

use serde::{Deserialize, Serialize};

use crate::adaptive::LinearModelErrors;
use crate::space::Walk;
use crate::spec::Scattered;

/// Largest number of active nodes that each have their own held-out positions. More nodes share the
/// positions, and the bounds hold for all of them together.
pub const MAX_SEPARATE_NODES: usize = 8;

/// All measurements of a blob. An alias is the name of a field in earlier blobs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Certificate {
    /// Scene, mesh, law and solver of the blob.
    pub origin: Origin,
    /// One entry for every active node in the blob.
    pub spaces: Vec<SpaceCertificate>,
    /// The error of the discretisation; `None` for a point tool, and if it was not measured.
    #[serde(default)]
    pub discretisation: Option<Discretisation>,
}

/// Inputs of a blob.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// Name of the scene.
    pub scene: String,
    /// Hash of all content of scene and mesh that changes numbers.
    pub content_hash: String,
    /// Constitutive law.
    pub law: String,
    /// Version of the solver, with the instruction set.
    pub solver: String,
    /// f_max, N; `None` if the scene has none.
    pub max_force_n: Option<f64>,
    /// r_G, m.
    pub radius_m: f64,
    /// Grid spacing, m; for adaptive sampling the unit of the indices.
    pub spacing_m: f64,
    /// Whether the corners outside the ball were solved.
    pub complete_cells: bool,
    /// Requirements of adaptive sampling; `None` on a lattice.
    pub scattered: Option<Scattered>,
}

/// Measurements of one space.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct SpaceCertificate {
    /// The active node.
    pub active: String,
    /// Its mesh node.
    pub node: u32,
    /// Cost of the space.
    pub cost: Cost,
    /// Number of neighbour pairs on different branches.
    #[serde(alias = "fold_pairs")]
    pub branch_jump_pairs: usize,
    /// Share of the ball's volume within a cell of such a pair. If a workspace or a tool that only pushes
    /// limits the reach, the share of the reachable part.
    #[serde(alias = "folded_volume")]
    pub branch_jump_volume: f64,
    /// Points with two solutions that are not known to be unstable.
    pub two_solutions: BranchDifference,
    /// Every packed method.
    pub methods: Vec<MethodCertificate>,
    /// The surface displacements, if packed.
    pub displacement: Option<DisplacementCertificate>,
    /// Spacing of the fallback lattice, m; `None` if adaptive sampling did not stagnate.
    pub switched_to_spacing_m: Option<f64>,
    /// Prediction errors of the linear model, if it is the packed model.
    pub linear: Option<LinearModelErrors>,
    /// Numerical health; `None` in blobs without this measurement.
    pub health: Option<Health>,
    /// Approximations with their change and saving, if requested.
    pub ledger: Option<Ledger>,
}

/// Grid points where attempts from different neighbours found different solutions, none known to be unstable. The body has two
/// branches there, and the solution depends on the path. The tables contain the solution of lower energy.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct BranchDifference {
    /// Number of points.
    pub points: usize,
    /// Largest difference of the forces at one of them, N.
    pub apart_n: f64,
}

/// Cost of a space and of its held-out positions.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Cost {
    /// Solved configurations.
    pub configurations: usize,
    /// Number of attempts, including failed and repeated ones.
    pub tries: usize,
    /// Points that could not be solved.
    pub failed: usize,
    /// Sum of the solve times over all threads, s.
    pub seconds: f64,
    /// Largest residual of a configuration, N.
    pub residual_n: f64,
    /// Solved held-out positions.
    pub held_out: u32,
    /// Sum of their solve times, s.
    pub held_out_seconds: f64,
}

/// Measurements of one method.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct MethodCertificate {
    /// Name of the method.
    pub method: String,
    /// Independent uniform positions within f_max, away from branch jumps.
    pub uniform: Errors,
    /// The same by distance from rest: up to 1/2, up to 3/4, and up to 1 of r_G.
    pub by_radius: [Errors; 3],
    /// Uniform positions near branch jumps.
    #[serde(alias = "folded")]
    pub at_branch_jumps: Errors,
    /// Share of positions with an imperceptible error, with 95 % confidence, from the uniform positions away
    /// from branch jumps.
    #[serde(alias = "not_felt_certified")]
    pub below_jnd_certified: f64,
    /// The same positions against the scene's own tolerance; `None` if the scene uses the perceptual one.
    pub tolerated: Option<Within>,
    /// Positions of regular paths within the grid and f_max, without grid points, away from branch jumps.
    pub regular: Errors,
    /// The same for random paths.
    pub random: Errors,
    /// Positions of paths near branch jumps.
    #[serde(alias = "paths_folded")]
    pub paths_at_branch_jumps: Errors,
    /// Work, face jumps, rounding and time.
    pub probe: Probe,
}

/// A held-out position with the force of a method.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    /// Its path, or the single position.
    pub walk: Walk,
    /// Its step on the path, from 1.
    pub step: u32,
    /// Displacement, m.
    pub displacement_m: [f32; 3],
    /// Reference and computed force.
    pub compared: Compared,
    /// Whether it is near a branch jump.
    pub near_branch_jump: bool,
}

/// The ledger of a space: approximations of its blob, with the measured change and saving of each.
///
/// A line is an approximation that is made, or one that is possible but not made (the linear body, elements
/// of lower order).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Ledger {
    /// Number of positions solved with each altered body.
    pub positions: usize,
    /// Wall time of these solves, s.
    pub seconds: f64,
    /// The lines.
    pub lines: Vec<Line>,
}

/// One approximation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// What the approximation omits.
    pub what: String,
    /// Whether it is made.
    pub made: bool,
    /// Difference of the force with and without it; `None` if it cannot be measured.
    pub force: Option<Errors>,
    /// Mean difference divided by the mean |h|.
    pub relative: Option<f64>,
    /// Difference of the surface displacements.
    pub surface: Option<SurfaceDistances>,
    /// Unit of the two costs.
    pub unit: String,
    /// Cost with the approximation, and without it.
    pub cost: [f64; 2],
}
