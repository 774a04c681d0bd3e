//! Specification of a space: sampling, tolerance, workspace and bounds. It is independent of the body.

mod bounds;
mod domain;
mod grid;
mod sampling;
mod tolerance;
mod wanted;
mod workspace;

pub use bounds::DisplacementBound;
pub(crate) use domain::REST;
pub(crate) use domain::corners;
#[cfg(test)]
pub(crate) use domain::squared;
pub use domain::{Domain, neighbours, plus};
pub use grid::{GridIndex, RADII_M, SpaceGrid, UNIT_M, displacement_m, nearest_index};
pub use sampling::{Lattice, Sampling, Scattered};
pub use tolerance::Tolerance;
pub use wanted::Wanted;
pub use workspace::{Workspace, is_within};
