//! The plan of every space of a store, lattice or scattered.

use std::collections::HashMap;
use std::sync::Arc;

use super::domain::Domain;
use super::plan::{Plan, TagCounts, Task};
use super::{GridIndex, Record, Sampling, SpaceGrid, Store, StoreError};
use crate::mesh::Surface;
use crate::scattered::{PASSES, ScatteredPlan, Wanted};

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
                let surface = Surface::of(&mesh);
                let wanted = |(name, node): (String, u32)| {
                    let normal = surface.normal(node);
                    let normal =
                        normal.ok_or_else(|| store.corrupt(format!("{name} is not on the surface")))?;
                    Ok(scattered.wanted(identity.max_force_n, mesh.nodes_m[node as usize], normal))
                };
                Kind::Scattered(store.active()?.into_iter().map(wanted).collect::<Result<_, StoreError>>()?)
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

    /// The plan of an active node with these tries done, and how many are open: the points that are certain to be next.
    pub fn replayed(&self, active: usize, attempts: &[Record]) -> (SpacePlan, usize) {
        let mut plan = self.plan(active);
        let known: HashMap<(GridIndex, u32), &Record> =
            attempts.iter().map(|r| ((r.index, r.attempt), r)).collect();
        let mut open = 0;
        while let Some(task) = plan.next_task() {
            match known.get(&(task.target, task.attempt)) {
                Some(record) => plan.decide(record),
                None => open += 1,
            }
        }
        (plan, open)
    }
}

/// Tries that a space still needs, as far as can be said. Zero when it is complete.
pub fn still_to_solve(store: &Store, active: usize) -> Result<usize, StoreError> {
    Ok(Plans::of(store)?.replayed(active, &store.attempts(active)?).1)
}

/// The plan of one space.
#[derive(Debug)]
pub enum SpacePlan {
    /// Of a lattice.
    Lattice(Box<Plan>),
    /// Of scattered positions.
    Scattered(Box<ScatteredPlan>),
}

impl SpacePlan {
    /// The next task that is certain; `None` while what is out must come back first, or when all is done.
    pub fn next_task(&mut self) -> Option<Task> {
        match self {
            Self::Lattice(plan) => plan.next_task(),
            Self::Scattered(plan) => plan.next_task(),
        }
    }

    /// Takes the outcome of a task that was handed out.
    pub fn decide(&mut self, record: &Record) {
        match self {
            Self::Lattice(plan) => plan.decide(record),
            Self::Scattered(plan) => plan.decide(record),
        }
    }

    /// Points by tag, the rest point not counted.
    pub fn counts(&self) -> TagCounts {
        match self {
            Self::Lattice(plan) => plan.counts(),
            Self::Scattered(plan) => plan.counts(),
        }
    }

    /// Highest level, round or batch so far.
    pub fn round(&self) -> u32 {
        match self {
            Self::Lattice(plan) => plan.round(),
            Self::Scattered(plan) => plan.round(),
        }
    }

    /// Whether failed points or those at folds are being solved once more.
    pub fn is_solving_again(&self) -> bool {
        match self {
            Self::Lattice(plan) => plan.is_solving_again(),
            Self::Scattered(plan) => plan.is_solving_again(),
        }
    }

    /// Whether nothing is left to do.
    pub fn is_done(&self) -> bool {
        match self {
            Self::Lattice(plan) => plan.is_done(),
            Self::Scattered(plan) => plan.is_done(),
        }
    }

    /// Predictions that passed, of those that must, where the space is scattered.
    pub fn passes(&self) -> Option<usize> {
        match self {
            Self::Lattice(_) => None,
            Self::Scattered(plan) => Some(plan.search().map_or(0, |search| search.passes().min(PASSES))),
        }
    }
}
