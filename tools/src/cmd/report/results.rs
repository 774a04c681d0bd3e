//! The measured results.

use super::curves::CurveRow;
use super::measure::Measured;
use super::plan::Plan;
use crate::machine::Machine;

/// All data of the page.
#[derive(Debug)]
pub(super) struct Report {
    pub(super) plan: Plan,
    /// By family, and in each family by grid.
    pub(super) cases: Vec<Vec<Measured>>,
    pub(super) curves: Vec<CurveRow>,
    pub(super) machine: Machine,
}
