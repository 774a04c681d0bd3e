//! The plan of every space of a store, lattice or adaptive.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::plan::{Plan, ScatteredPlan, SpacePlan};
use super::record::Record;
use super::state::SpaceState;
use super::store::{Store, StoreError};
use crate::fit::Sample;
use crate::num::jet::EnergyJet;
use crate::num::vector::norm;
use crate::spec::{Domain, GridIndex, Lattice, Requirements, Sampling, SpaceGrid};

/// Makes the plans of the spaces of one store.
#[derive(Debug)]
pub(crate) enum Plans {
    Lattice {
        domain: Arc<Domain>,
        grid: SpaceGrid,
    },
    /// By active node, with the displacements to solve first.
    Scattered(Vec<(Requirements, Vec<[f64; 3]>)>),
}

impl Plans {
    /// The plans that the scene of `store` defines.
    pub(crate) fn of(store: &Store) -> Result<Self, StoreError> {
        let identity = store.identity()?;
        let scattered = match identity.sampling {
            Sampling::Lattice(lattice) => {
                let domain = Arc::new(Domain::new(&lattice.grid, lattice.complete_cells));
                return Ok(Self::Lattice { domain, grid: lattice.grid });
            }
            Sampling::Scattered(scattered) => scattered,
        };
        let ((mesh, _), active) = (store.body()?, store.active()?);
        if identity.normals.len() != active.len() {
            return Err(store.corrupt("the numbers of normals and of active nodes differ"));
        }
        let wanted = |(at, ((_, node), normal)): (usize, ((String, u32), &[f64; 3]))| {
            let place_m = identity.at_active(at, node, |node| mesh.nodes_m[node as usize]);
            let visited_m = identity.visited_m.get(at).cloned().unwrap_or_default();
            (scattered.wanted(identity.max_force_n, place_m, *normal), visited_m)
        };
        Ok(Self::Scattered(active.into_iter().zip(&identity.normals).enumerate().map(wanted).collect()))
    }

    /// Points of one space without the rest point; `None` for adaptive sampling, where it is not known in
    /// advance.
    pub(crate) fn points(&self) -> Option<usize> {
        match self {
            Self::Lattice { domain, .. } => Some(domain.count() - 1),
            Self::Scattered(_) => None,
        }
    }

    /// Plan of an active node with nothing solved.
    ///
    /// # Panics
    ///
    /// If the store has no such active node.
    pub(crate) fn plan(&self, active: usize) -> Box<dyn SpacePlan> {
        match self {
            Self::Lattice { domain, grid } => Box::new(Plan::new(domain.clone(), *grid)),
            Self::Scattered(all) => {
                let (wanted, visited_m) = &all[active];
                Box::new(ScatteredPlan::new(*wanted, visited_m.clone()))
            }
        }
    }
}

/// State of the space of one active node: as stored if it is finished, otherwise replayed from its attempts.
pub fn state(store: &Store, active: usize) -> Result<SpaceState, StoreError> {
    if let Some(state) = store.finished(active)? {
        return Ok(state);
    }
    // A search repeats all of its fits.
    REPLAYS.fetch_add(1, Ordering::Relaxed);
    let (mut plan, attempts) = (Plans::of(store)?.plan(active), store.attempts(active)?);
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

static REPLAYS: AtomicU64 = AtomicU64::new(0);

/// Number of replays of this process. A finished space needs none.
pub fn replays() -> u64 {
    REPLAYS.load(Ordering::Relaxed)
}

/// The configurations of a lattice on a model, sorted by index. No other point is solved from one beyond the
/// force limit of `wanted` or, if `is_limited`, beyond the tool's reach.
pub fn expand_model(
    lattice: &Lattice,
    wanted: &Requirements,
    is_limited: bool,
    jet: impl Fn(GridIndex) -> EnergyJet,
) -> Vec<Sample> {
    let domain = Domain::new(&lattice.grid, lattice.complete_cells);
    let mut plan = Plan::new(Arc::new(domain), lattice.grid);
    let mut samples = BTreeMap::new();
    while let Some(task) = plan.next_task() {
        let (index, jet) = (task.target, jet(task.target));
        let terminating = index != [0; 3] && norm(jet.force_n) >= wanted.max_force_n;
        let is_last = is_limited && !wanted.lattice_goes_on_from(jet.control_m, jet.force_n);
        plan.decide(&Record::of_jet(&task, &jet, terminating || is_last));
        samples.insert(
            index,
            Sample { index, attempt: 0, jet, derivatives: None, terminating, inverted: false },
        );
    }
    samples.into_values().collect()
}
