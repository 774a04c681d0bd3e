//! The attempts of a solved space.

use std::collections::HashMap;
use std::path::Path;

use palpate_precompute::space::{Record, Store, state};
use palpate_precompute::spec::{Lattice, SpaceGrid};

use super::Failure;
use super::simulated::Try;

/// A complete space in memory.
#[derive(Debug)]
pub(crate) struct SolvedSpace {
    /// Its grid.
    pub(crate) grid: SpaceGrid,
    /// Whether cells were completed.
    pub(crate) complete_cells: bool,
    /// Active nodes with solved points.
    pub(crate) actives: Vec<usize>,
    /// All attempts.
    pub(crate) records: HashMap<Try, Record>,
}

impl SolvedSpace {
    /// Reads a complete store. States between grid points are omitted.
    pub(crate) fn load(path: &Path) -> Result<Self, Failure> {
        let store = Store::open(path)?;
        let identity = store.identity()?;
        let Lattice { grid, complete_cells, .. } =
            *identity.sampling.lattice().ok_or_else(|| format!("{}: not a lattice", path.display()))?;
        let (mut actives, mut records) = (Vec::new(), HashMap::new());
        for active in 0..store.active()?.len() {
            let attempts = store.attempts(active)?;
            if attempts.is_empty() {
                continue;
            }
            if state(&store, active)?.open > 0 {
                let path = path.display();
                return Err(
                    format!("{path}: the space is not finished; run `palpate precompute` first").into()
                );
            }
            actives.push(active);
            for record in attempts {
                records.insert((active as u32, record.index, record.attempt), record);
            }
        }
        Ok(Self { grid, complete_cells, actives, records })
    }

    /// Seconds of every solve, sorted.
    pub(crate) fn seconds(&self) -> Vec<f64> {
        let mut seconds: Vec<f64> = self.records.values().map(|r| r.seconds).collect();
        seconds.sort_by(f64::total_cmp);
        seconds
    }
}
