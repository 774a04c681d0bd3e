//! The methods of Peterlik 2010: on the lattice of forces, and by radial basis functions.
//!
//! The lattice has one force per slot, z fastest, newtons: solved configurations, and extrapolated values
//! where there is none.

mod hybrid;
pub(crate) mod rbf;
mod tricubic;
mod trilinear;

pub(crate) use hybrid::Hybrid;
pub(crate) use tricubic::Tricubic;
pub(crate) use trilinear::Trilinear;

use crate::num::vec3::Vec3;

/// N consecutive forces along z.
#[inline(always)]
fn run<const N: usize>(force: &[Vec3], at: usize) -> Option<&[Vec3; N]> {
    force.get(at..at.saturating_add(N))?.first_chunk()
}
