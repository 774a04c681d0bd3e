//! The plan of every space of a store, lattice or adaptive.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::plan::{Plan, ScatteredPlan, SpacePlan};
use super::record::Record;
use super::state::SpaceState;
use super::store::{Store, StoreError};
use crate::spec::{Domain, GridIndex, Requirements, Sampling, SpaceGrid};

/// Makes the plans of the spaces of one store.
#[derive(Debug)]
pub struct Plans(Kind);

#[derive(Debug)]
enum Kind {
    Lattice { domain: Arc<Domain>, grid: SpaceGrid },
    Scattered(Vec<Requirements>),
}

impl Plans {
    /// The plans that the scene of `store` defines.
    pub fn of(store: &Store) -> Result<Self, StoreError> {
        let identity = store.identity()?;
        Ok(Self(match identity.sampling {
            Sampling::Lattice(lattice) => Kind::Lattice {
                domain: Arc::new(Domain::new(&lattice.grid, lattice.complete_cells)),
                grid: lattice.grid,
            },
            Sampling::Scattered(scattered) => {
                let (mesh, _) = store.body()?;
                let active = store.active()?;
                if identity.normals.len() != active.len() {
                    return Err(store.corrupt("the numbers of normals and of active nodes differ"));
                }
                let wanted = |((_, node), normal): ((String, u32), [f64; 3])| {
                    scattered.wanted(identity.max_force_n, mesh.nodes_m[node as usize], normal)
                };
                Kind::Scattered(active.into_iter().zip(identity.normals).map(wanted).collect())
            }
        }))
    }

    /// Points of one space without the rest point; `None` for adaptive sampling, where it is not known in
    /// advance.
    pub fn points(&self) -> Option<usize> {
        match &self.0 {
            Kind::Lattice { domain, .. } => Some(domain.count() - 1),
            Kind::Scattered(_) => None,
        }
    }

    /// Plan of an active node with nothing solved.
    ///
    /// # Panics
    ///
    /// If the store has no such active node.
    pub(crate) fn plan(&self, active: usize) -> SpacePlan {
        match &self.0 {
            Kind::Lattice { domain, grid } => SpacePlan::Lattice(Box::new(Plan::new(domain.clone(), *grid))),
            Kind::Scattered(wanted) => SpacePlan::Scattered(Box::new(ScatteredPlan::new(wanted[active]))),
        }
    }

    /// State of the space of an active node: as stored if it is finished, otherwise replayed from its
    /// attempts.
    pub fn state(&self, store: &Store, active: usize) -> Result<SpaceState, StoreError> {
        match store.finished(active)? {
            Some(state) => Ok(state),
            None => self.replayed(store, active),
        }
    }

    /// The state of a space from its attempts. A search repeats all of its fits.
    fn replayed(&self, store: &Store, active: usize) -> Result<SpaceState, StoreError> {
        REPLAYS.fetch_add(1, Ordering::Relaxed);
        let (mut plan, attempts) = (self.plan(active), store.attempts(active)?);
        let known: HashMap<(GridIndex, u32), &Record> =
            attempts.iter().map(|r| ((r.index, r.attempt), r)).collect();
        let mut open = 0;
        while let Some(task) = plan.next_task() {
            match known.get(&(task.target, task.attempt)) {
                Some(record) => plan.decide(record),
                None => open += 1,
            }
        }
        Ok(plan.state(open))
    }
}

/// State of the space of one active node ([`Plans::state`]).
pub fn state(store: &Store, active: usize) -> Result<SpaceState, StoreError> {
    match store.finished(active)? {
        Some(state) => Ok(state),
        None => Plans::of(store)?.replayed(store, active),
    }
}

static REPLAYS: AtomicU64 = AtomicU64::new(0);

/// Number of replays of this process. A finished space needs none.
pub fn replays() -> u64 {
    REPLAYS.load(Ordering::Relaxed)
}
