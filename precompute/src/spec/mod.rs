//! Specification of a space: tool and its place, sampling, tolerance, workspace and bounds.

mod active;
mod bounds;
mod domain;
mod grid;
mod requirements;
mod sampling;
mod tolerance;
mod workspace;

pub(crate) use active::from_axis_m;
pub use active::{ActiveNode, BESIDE, Chart, Charts, Column, ContactSurface, Tool};
pub use bounds::DisplacementBound;
#[cfg(test)]
pub(crate) use domain::squared;
pub(crate) use domain::{Domain, REST, corners, neighbours, plus};
pub(crate) use grid::MIN_RADIUS_M;
pub use grid::{GridIndex, SpaceGrid};
pub(crate) use grid::{MAX_RADIUS_M, UNIT_M, displacement_m, nearest_index};
pub use requirements::{Quantity, Requirements};
pub use sampling::{Lattice, Sampling, Scattered};
pub use tolerance::Tolerance;
pub(crate) use tolerance::percent_in_words;
pub(crate) use workspace::{Workspace, is_within};
