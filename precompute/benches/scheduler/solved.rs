//! The attempts of a solved space.

use std::collections::HashMap;
use std::path::Path;

use palpate_precompute::mesh::TetMesh;
use palpate_precompute::space::{Record, Store, StoreIdentity, state};

use super::Failure;
use super::simulated::{Durations, Try, nanoseconds};

/// A complete space in memory.
#[derive(Debug)]
pub(crate) struct SolvedSpace {
    /// What it was solved for.
    pub(crate) identity: StoreIdentity,
    /// Its body.
    pub(crate) mesh: TetMesh,
    /// Fixed nodes of the body.
    pub(crate) fixed: Vec<u32>,
    /// Names and nodes of all active nodes.
    pub(crate) active: Vec<(String, u32)>,
    /// Numbers of the active nodes with solved points.
    pub(crate) actives: Vec<usize>,
    /// All attempts.
    pub(crate) records: HashMap<Try, Record>,
}

impl SolvedSpace {
    /// Reads a store whose begun spaces are complete. States between grid points are omitted.
    pub(crate) fn load(path: &Path) -> Result<Self, Failure> {
        let store = Store::open(path)?;
        let (mut actives, mut records) = (Vec::new(), HashMap::new());
        let active = store.active()?;
        for number in 0..active.len() {
            let attempts = store.attempts(number)?;
            if attempts.is_empty() {
                continue;
            }
            if state(&store, number)?.open > 0 {
                let path = path.display();
                return Err(
                    format!("{path}: the space is not finished; run `palpate precompute` first").into()
                );
            }
            actives.push(number);
            for record in attempts {
                records.insert((number as u32, record.index, record.attempt), record);
            }
        }
        let (mesh, fixed) = store.body()?;
        Ok(Self { identity: store.identity()?, mesh, fixed, active, actives, records })
    }

    /// Durations of the solves.
    pub(crate) fn durations(&self) -> Durations {
        Durations::of(self.records.values())
    }
}

/// Durations of the solves of a space that need not be finished.
pub(crate) fn durations_in(path: &Path) -> Result<Durations, Failure> {
    let store = Store::open(path)?;
    let mut records = Vec::new();
    for number in 0..store.active()?.len() {
        records.extend(store.attempts(number)?);
    }
    Ok(Durations::of(records.iter()))
}

impl Durations {
    fn of<'a>(records: impl Iterator<Item = &'a Record>) -> Self {
        let (mut at_rest, mut others) = (Vec::new(), Vec::new());
        for record in records {
            let all = if record.parent.is_none() { &mut at_rest } else { &mut others };
            all.push(nanoseconds(record.seconds));
        }
        // The order of a hash map differs from run to run.
        at_rest.sort_unstable();
        others.sort_unstable();
        Self { at_rest, others }
    }
}
