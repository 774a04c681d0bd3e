//! The plan of every space of a store, lattice or scattered.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::plan::{Plan, ScatteredPlan, SpacePlan};
use super::record::Record;
use super::state::SpaceState;
use super::store::{Store, StoreError};
use crate::spec::{Domain, GridIndex, Sampling, SpaceGrid, Wanted};

/// Makes the plans of the spaces of one store.
#[derive(Debug)]
pub struct Plans(Kind);

#[derive(Debug)]
enum Kind {
    Lattice { domain: Arc<Domain>, grid: SpaceGrid },
    Scattered(Vec<Wanted>),
}

impl Plans {
    /// What the scene of `store` asks for.
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
                    return Err(store.corrupt("it has not one normal for each active node"));
                }
                let wanted = |((_, node), normal): ((String, u32), [f64; 3])| {
                    scattered.wanted(identity.max_force_n, mesh.nodes_m[node as usize], normal)
                };
                Kind::Scattered(active.into_iter().zip(identity.normals).map(wanted).collect())
            }
        }))
    }

    /// Points of one space, the rest point not counted; not known beforehand where they are scattered.
    pub fn points(&self) -> Option<usize> {
        match &self.0 {
            Kind::Lattice { domain, .. } => Some(domain.len() - 1),
            Kind::Scattered(_) => None,
        }
    }

    /// Plan of an active node with nothing solved.
    ///
    /// # Panics
    /// If the store has no such active node.
    pub fn plan(&self, active: usize) -> SpacePlan {
        match &self.0 {
            Kind::Lattice { domain, grid } => SpacePlan::Lattice(Box::new(Plan::new(domain.clone(), *grid))),
            Kind::Scattered(wanted) => SpacePlan::Scattered(Box::new(ScatteredPlan::new(wanted[active]))),
        }
    }

    /// How far the space of an active node is: as stored, or replayed from its attempts if it is not finished.
    pub fn state(&self, store: &Store, active: usize) -> Result<SpaceState, StoreError> {
        match store.finished(active)? {
            Some(state) => Ok(state),
            None => self.replayed(store, active),
        }
    }

    /// The state of a space from its attempts. A search makes all of its fits again on the way.
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

/// How far the space of one active node is ([`Plans::state`]).
pub fn state(store: &Store, active: usize) -> Result<SpaceState, StoreError> {
    match store.finished(active)? {
        Some(state) => Ok(state),
        None => Plans::of(store)?.replayed(store, active),
    }
}

static REPLAYS: AtomicU64 = AtomicU64::new(0);

/// How often this process replayed a space from its attempts: none of a finished one.
pub fn replays() -> u64 {
    REPLAYS.load(Ordering::Relaxed)
}
