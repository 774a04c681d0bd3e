//! The measured results.

use super::bodies::BodyRow;
use super::curves::CurveRow;
use super::hard::HardRow;
use super::ledger::LedgerRow;
use super::machine::Machine;
use super::measure::Measured;
use super::parts::{PartsRow, SurfaceRow};
use super::plan::Plan;
use crate::cmd::bench::forms::FormRow;

/// All data of the page.
#[derive(Debug)]
pub(super) struct Report {
    pub(super) plan: Plan,
    /// By family, and in each family by grid.
    pub(super) cases: Vec<Vec<Measured>>,
    pub(super) bodies: Vec<BodyRow>,
    pub(super) curves: Vec<CurveRow>,
    pub(super) hard: Vec<HardRow>,
    pub(super) parts: (Vec<PartsRow>, Vec<SurfaceRow>),
    pub(super) ledger: Vec<LedgerRow>,
    pub(super) forms: Vec<FormRow>,
    pub(super) machine: Machine,
}
