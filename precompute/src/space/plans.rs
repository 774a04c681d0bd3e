//! The plan of every space of a store, lattice or scattered.

use std::collections::HashMap;
use std::sync::Arc;

use super::plan::{Plan, ScatteredPlan, SpacePlan};

use super::record::Record;
use super::store::{Store, StoreError};
use crate::mesh::Surface;
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

/// The plan of an active node as far as its store goes; `None` where it is a lattice.
pub fn planned(store: &Store, active: usize) -> Result<Option<ScatteredPlan>, StoreError> {
    Ok(match Plans::of(store)?.replayed(active, &store.attempts(active)?).0 {
        SpacePlan::Scattered(plan) => Some(*plan),
        SpacePlan::Lattice(_) => None,
    })
}
