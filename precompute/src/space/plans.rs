//! The plan of every space of a store, lattice or adaptive.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::plan::{Plan, ScatteredPlan, SpacePlan};
use super::record::Record;
use super::state::SpaceState;
use super::store::{Store, StoreError};
use crate::adaptive::{MAX_FORCE_FACTOR, MOST_DATA, Shared, on_one_branch};
use crate::fit::{LEAST_ROOT_J, Sample};
use crate::num::jet::EnergyJet;
use crate::num::parallel::in_parallel;
use crate::num::vector::{difference, distance, dot, norm};
use crate::spec::{Chart, Domain, GridIndex, Lattice, Requirements, Sampling, SpaceGrid, displacement_m};

/// Makes the plans of the spaces of one store.
#[derive(Debug)]
pub(crate) enum Plans {
    Lattice {
        domain: Arc<Domain>,
        grid: SpaceGrid,
    },
    /// By active node, with the displacements to solve first.
    Scattered(Vec<(Requirements, Vec<[f64; 3]>)>),
    /// By chart of a sphere's field, with the charts.
    Charts(Vec<Requirements>, Vec<Chart>),
}

/// A configuration of another chart is used this far above the column, and a length of the kernel beyond its sides, m.
const MARGIN_M: f64 = 2e-3;
/// Two configurations in one fit are at least so far apart, m.
const APART_M: f64 = 3e-4;
/// Most configurations of a complete chart with those of others.
const MOST_AT_END: usize = 400;

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
        if let Some(charts) = identity.charts {
            let charts = charts.charts;
            let wanted = charts.iter().map(|chart| scattered.wanted_of(identity.max_force_n, chart));
            return Ok(Self::Charts(wanted.collect(), charts));
        }
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
            Self::Scattered(_) | Self::Charts(..) => None,
        }
    }

    /// The zero of the displacement of one chart from that of another, m.
    pub(crate) fn origin_m(&self, active: usize, chart: Option<u32>) -> [f64; 3] {
        match (self, chart) {
            (Self::Charts(_, charts), Some(chart)) => {
                difference(charts[chart as usize].centre_m, charts[active].centre_m)
            }
            _ => [0.0; 3],
        }
    }

    /// Whether the spaces are charts of a sphere's field.
    pub(crate) fn are_charts(&self) -> bool {
        matches!(self, Self::Charts(..))
    }

    /// The active nodes whose configurations the plan of this one uses; they must be finished before it begins.
    pub(crate) fn before(&self, active: usize) -> impl Iterator<Item = usize> {
        (0..active).filter(move |other| self.overlap(active, *other))
    }

    /// Plan of an active node with nothing solved.
    ///
    /// # Panics
    ///
    /// If the store has no such active node.
    pub(crate) fn plan(&self, store: &Store, active: usize) -> Result<Box<dyn SpacePlan>, StoreError> {
        Ok(match self {
            Self::Charts(wanted, _) => {
                let shared = self.shared(store, active, self.before(active), (&[], MOST_DATA))?;
                Box::new(ScatteredPlan::new(wanted[active], Vec::new()).knowing(shared))
            }
            Self::Lattice { domain, grid } => Box::new(Plan::new(domain.clone(), *grid)),
            Self::Scattered(all) => {
                let (wanted, visited_m) = &all[active];
                Box::new(ScatteredPlan::new(*wanted, visited_m.clone()))
            }
        })
    }

    /// The configurations of `others` that lie in a chart, as displacements from its origin, those near it first. They are
    /// apart from `own` ones; whether they are on the same branch is [`on_one_branch`]'s question.
    fn shared(
        &self,
        store: &Store,
        active: usize,
        others: impl Iterator<Item = usize>,
        (own, most): (&[EnergyJet], usize),
    ) -> Result<Vec<Shared>, StoreError> {
        let Self::Charts(wanted, charts) = self else { return Ok(Vec::new()) };
        let (wanted, Chart { centre_m, normal, column }) = (&wanted[active], charts[active]);
        let mut found: Vec<Shared> = Vec::new();
        for other in others {
            let from_m = difference(charts[other].centre_m, centre_m);
            let solved = store.records(other)?;
            let solved = solved.iter().filter(|record| record.equilibrium().is_some_and(|at| !at.switched));
            for record in solved {
                let at_m = displacement_m(record.index);
                let Some(jet) = record.jet_for_fit(at_m, wanted.quantity) else { continue };
                let jet = EnergyJet { control_m: std::array::from_fn(|k| at_m[k] + from_m[k]), ..jet };
                let is_near = column.contains(normal, jet.control_m, column.length_m)
                    && dot(jet.control_m, normal) <= column.top_m + MARGIN_M
                    && norm(jet.control_m) <= wanted.radius_m;
                let is_datum =
                    jet.energy_j > LEAST_ROOT_J && norm(jet.force_n) <= MAX_FORCE_FACTOR * wanted.max_force_n;
                if is_near && is_datum {
                    found.push(Shared { chart: other as u32, index: record.index, jet });
                }
            }
        }
        found.sort_by(|a, b| norm(a.jet.control_m).total_cmp(&norm(b.jet.control_m)));
        let mut kept: Vec<Shared> = Vec::new();
        for shared in found {
            let at_m = shared.jet.control_m;
            let others = own.iter().chain(kept.iter().map(|kept| &kept.jet)).map(|jet| jet.control_m);
            let least_m = others.map(|other| distance(other, at_m)).fold(norm(at_m), f64::min);
            if least_m >= APART_M && own.len() + kept.len() < most {
                kept.push(shared);
            }
        }
        Ok(kept)
    }

    /// The state of a finished chart with the configurations of all charts round it, in place of only those that were
    /// finished before it.
    fn completed(&self, store: &Store, active: usize, state: SpaceState) -> Result<SpaceState, StoreError> {
        let Self::Charts(_, charts) = self else { return Ok(state) };
        let Some(fit) = &state.fit else { return Ok(state) };
        let own: Vec<EnergyJet> = fit.own().copied().collect();
        // Its own that the search has left out may agree with those round them.
        let others = (0..charts.len()).filter(|other| *other == active || self.overlap(active, *other));
        let shared = self.shared(store, active, others, (&own, MOST_AT_END))?;
        let jets: Vec<EnergyJet> =
            own.iter().copied().chain(shared.iter().map(|shared| shared.jet)).collect();
        let agrees = on_one_branch(&jets, &fit.wanted.tolerance);
        let own: Vec<EnergyJet> =
            own.iter().zip(&agrees).filter(|(_, agrees)| **agrees).map(|(jet, _)| *jet).collect();
        let first = jets.len() - shared.len();
        let shared = shared.into_iter().zip(&agrees[first..]).filter(|(_, agrees)| **agrees);
        let shared = shared.map(|(shared, _)| shared).collect();
        Ok(SpaceState { fit: Some(fit.with_shared(&own, shared)), ..state })
    }

    fn overlap(&self, active: usize, other: usize) -> bool {
        let Self::Charts(_, charts) = self else { return false };
        let (a, b) = (&charts[active], &charts[other]);
        distance(a.centre_m, b.centre_m) < a.column.core_m + b.column.core_m + a.column.length_m
            && dot(a.normal, b.normal) > 0.0
    }
}

/// Fits every chart of a sphere's field to the configurations of all charts round it, once all are finished. Nothing
/// happens for another tool, or if it is done already.
pub fn complete_charts(store: &Store, threads: usize) -> Result<(), StoreError> {
    let Plans::Charts(_, charts) = Plans::of(store)? else { return Ok(()) };
    if store.are_charts_complete()? {
        return Ok(());
    }
    let all: Vec<usize> = (0..charts.len()).collect();
    // A connection serves one thread, and sees only committed rows.
    store.commit()?;
    let path = store.path();
    let one = |&active: &usize| -> Result<Option<SpaceState>, StoreError> {
        let store = Store::open(path)?;
        let Some(state) = store.finished(active)? else { return Ok(None) };
        Plans::of(&store)?.completed(&store, active, state).map(Some)
    };
    let one_by_one = |_| all.iter().map(one).collect();
    let completed: Vec<Result<Option<SpaceState>, StoreError>> =
        in_parallel(&all, threads, one).unwrap_or_else(one_by_one);
    let completed = completed.into_iter().collect::<Result<Option<Vec<SpaceState>>, StoreError>>()?;
    completed.map_or(Ok(()), |states| store.complete_charts(&states))
}

/// State of the space of one active node: as stored if it is finished, otherwise replayed from its attempts.
pub fn state(store: &Store, active: usize) -> Result<SpaceState, StoreError> {
    if let Some(state) = store.finished(active)? {
        return Ok(state);
    }
    // A search repeats all of its fits.
    REPLAYS.fetch_add(1, Ordering::Relaxed);
    let (mut plan, attempts) = (Plans::of(store)?.plan(store, active)?, store.attempts(active)?);
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
