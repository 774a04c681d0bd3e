//! The ledger of the first body: the omissions of its blob, made or possible, with their effects and savings.

use palpate_core::{Method, Organ};
use palpate_precompute::certificate::{Ledger, Line};
use palpate_precompute::pipeline::ledger;
use palpate_precompute::space::{Store, solver_version};
use serde::{Deserialize, Serialize};

use super::measure::Measured;
use super::plan::{Case, Plan};
use super::steps::{Steps, kept};
use crate::failure::Failure;

/// Number of positions solved with each altered body; the finer bodies take seconds each.
const POSITIONS: usize = 8;
const SMALL_POSITIONS: usize = 2;

/// Number of steps of [`measured`].
pub(super) const STEPS: usize = 1;

/// One omission.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct LedgerRow {
    pub scene: String,
    pub grid: u32,
    pub method: String,
    /// What is omitted, or could be.
    pub what: String,
    /// Whether it is omitted.
    pub made: bool,
    /// Mean force difference of the omission, N; `None` if it is unknown.
    pub force_mean_n: Option<f64>,
    pub force_max_n: Option<f64>,
    /// Whether only a bound of the largest difference is known.
    pub is_bound: bool,
    /// Share of the positions with a difference below the just-noticeable difference.
    pub below_jnd_share: Option<f64>,
    /// Difference of the surface, mm.
    pub surface_rms_mm: Option<f64>,
    pub unit: String,
    pub cost_with: f64,
    pub cost_without: f64,
}

impl LedgerRow {
    fn of(scene: &str, grid: u32, method: Method, line: Line) -> Self {
        let Line { what, made, force, surface, unit, cost: [cost_with, cost_without], .. } = line;
        let counted = force.filter(|errors| errors.count > 0);
        let mean = counted.map(|errors| errors.mean_n);
        Self {
            scene: scene.into(),
            grid,
            method: method.name().into(),
            what,
            made,
            force_mean_n: mean,
            force_max_n: force.map(|errors| errors.max_n),
            is_bound: force.is_some() && mean.is_none(),
            below_jnd_share: counted.map(|errors| errors.below_jnd as f64 / errors.count as f64),
            surface_rms_mm: surface.map(|apart| apart.rms_mean_mm),
            unit,
            cost_with,
            cost_without,
        }
    }

    /// Whether this is the linear body.
    pub(super) fn is_linear_body(&self) -> bool {
        self.what.starts_with("nonlinearity")
    }

    /// Ratio of the cost without the omission to that with it.
    pub(super) fn times(&self) -> f64 {
        self.cost_without / self.cost_with
    }

    /// The force difference to show, N: its mean, or its bound.
    pub(super) fn shown_n(&self) -> Option<f64> {
        self.force_mean_n.or(self.force_max_n)
    }
}

/// The ledger of a case for `energy`, or otherwise for its last method.
pub(super) fn measured(
    plan: &Plan,
    case: &Case,
    of: &Measured,
    steps: &mut Steps,
) -> Result<Vec<LedgerRow>, Failure> {
    steps.next(&format!("{}: the ledger of approximations", case.name))?;
    let Some(fitted) = of.fitted.last() else { return Ok(Vec::new()) };
    let positions = if plan.small { SMALL_POSITIONS } else { POSITIONS };
    let store = Store::open(&plan.work.path().join(format!("{}.space", case.name)))?;
    let (hash, method) = (store.identity()?.content_hash, fitted.method);
    let held_out = fitted.space().cost.held_out;
    let key = format!("{hash} {} {positions} {held_out} {}", method.name(), solver_version());
    let file = plan.work.file(&format!("{}-ledger.json", case.name));
    kept(&file, key, || {
        let organ: Organ<'_> = Organ::read(fitted.file.bytes()).map_err(Failure::work)?;
        let found = ledger(&case.bench, &store, 0, (&organ, fitted.space()), positions, plan.run(steps))?;
        steps.go_on()?;
        let Ledger { lines, .. } = found.unwrap_or_default();
        let row = |line| LedgerRow::of(&of.space.scene, case.points, method, line);
        Ok(lines.into_iter().map(row).collect())
    })
}
