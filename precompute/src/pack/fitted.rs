//! The expensive part of packing: the fits of each space, before the layout.
//!
//! The spaces are independent. Threads share them, each with its own connection to the store. The result does
//! not depend on the number of threads.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use palpate_core::Method;

use super::PackError;
use crate::adaptive::{Resampled, Verdict, resample};
use crate::fit::{
    BranchJump, Derivatives, DisplacementFault, DisplacementFit, HermiteNodes, KernelPlanes, Sample,
    ScatteredMotion, SurfaceMotionSample, fit_displacement, hermite_nodes, hermite_nodes_known,
};
use crate::num::parallel::Pool;
use crate::space::{Record, Store, SurfaceMotion, branch_jumps, samples, state};
use crate::spec::{DisplacementBound, GridIndex, Lattice, Sampling, SpaceGrid, displacement_m};

/// A space that is packed.
pub(super) struct SelectedSpace {
    /// Number of its active node in the store.
    pub(super) active: usize,
    pub(super) name: String,
    /// Its mesh node.
    pub(super) node: u32,
    pub(super) records: Vec<Record>,
}

/// The fits of a space.
pub(super) struct Fitted {
    pub(super) known: TableInput,
    pub(super) hermite: Option<HermiteNodes>,
    pub(super) kernel: Option<KernelPlanes>,
    pub(super) displacement: Option<DisplacementFit>,
}

/// Input of the tables of a space: configurations on a lattice, solved there or evaluated from a fit.
pub(super) struct TableInput {
    pub(super) grid: SpaceGrid,
    pub(super) samples: Vec<Sample>,
    pub(super) branch_jumps: Vec<BranchJump>,
    /// The fit of adaptive sampling, if any.
    said: Option<FitResult>,
    /// Lattice step in index units of the store.
    step: i32,
}

impl TableInput {
    /// The solved points of a lattice, whose records have indices in lattice steps.
    fn solved(grid: &SpaceGrid, records: &[Record], step: i32) -> Self {
        Self {
            grid: *grid,
            samples: samples(grid, records),
            branch_jumps: branch_jumps(grid, records),
            said: None,
            step,
        }
    }
}

/// Results of a fit besides the samples.
struct FitResult {
    /// All derivatives that the energy's table needs.
    derivatives: BTreeMap<GridIndex, Derivatives>,
    /// Kernel length of the fit, m.
    length_m: f64,
    /// The linear model is packed instead of the fit.
    is_linear: bool,
    /// The kernel itself, if it is requested and within the limits of the core.
    kernel: Option<KernelPlanes>,
}

/// Inputs that all spaces share.
pub(super) struct Fitter<'p> {
    pub(super) sampling: Sampling,
    /// Mesh nodes of the surface.
    pub(super) nodes: &'p [u32],
    pub(super) methods: &'p [Method],
    /// The bound of the displacements, if the scene requests them.
    pub(super) visual: Option<DisplacementBound>,
}

impl Fitter<'_> {
    /// The fits of all spaces, in the same order.
    pub(super) fn all(
        &self,
        store: &Store,
        selected: &[SelectedSpace],
        threads: usize,
    ) -> Result<Vec<Fitted>, PackError> {
        let threads = threads.clamp(1, selected.len().max(1));
        if threads == 1 {
            return selected.iter().map(|selected| self.one(store, selected)).collect();
        }
        let pool = Pool::new(threads).map_err(PackError::Threads)?;
        let next = AtomicUsize::new(0);
        let done: Vec<Mutex<Option<Result<Fitted, PackError>>>> =
            selected.iter().map(|_| Mutex::new(None)).collect();
        // The other connections see only committed rows.
        store.commit()?;
        let path = store.path();
        let work = || -> Result<(), PackError> {
            let own = Store::open(path)?;
            while let Some((selected, done)) = {
                let at = next.fetch_add(1, Ordering::Relaxed);
                selected.get(at).zip(done.get(at))
            } {
                let fitted = self.one(&own, selected);
                *done.lock().expect("no thread panics while it holds the lock") = Some(fitted);
            }
            Ok(())
        };
        pool.each(work).into_iter().collect::<Result<(), PackError>>()?;
        let taken =
            |done: Mutex<Option<_>>| done.into_inner().expect("no thread panics while it holds the lock");
        done.into_iter().map(|done| taken(done).expect("every space was fitted")).collect()
    }

    fn one(&self, store: &Store, selected: &SelectedSpace) -> Result<Fitted, PackError> {
        let mut known = self.known(store, selected)?;
        let kernel = known.said.as_mut().and_then(|said| said.kernel.take());
        let has_hermite = [Method::Hermite, Method::Energy].iter().any(|m| self.methods.contains(m));
        let hermite = has_hermite.then(|| match &known.said {
            Some(said) => hermite_nodes_known(&known.grid, &known.samples, &said.derivatives),
            None => hermite_nodes(&known.grid, &known.samples, &known.branch_jumps),
        });
        let displacement =
            self.visual.map(|bound| self.displacement(store, selected, &known, bound)).transpose()?;
        Ok(Fitted { known, hermite, kernel, displacement })
    }

    fn known(&self, store: &Store, selected: &SelectedSpace) -> Result<TableInput, PackError> {
        match &self.sampling {
            Sampling::Lattice(Lattice { grid, .. }) => Ok(TableInput::solved(grid, &selected.records, 1)),
            Sampling::Scattered(_) => {
                let state = state(store, selected.active)?;
                if let Some(lattice) = state.fallback() {
                    let records = lattice.records(&selected.records);
                    return Ok(TableInput::solved(&lattice.grid, &records, lattice.spacing));
                }
                let fit = state.fit.ok_or(PackError::Empty)?;
                let resampled = resample(&fit)
                    .map_err(|error| PackError::Lattice { active: selected.name.clone(), error })?;
                let Resampled { grid, samples, derivatives, .. } = resampled;
                let is_linear = fit.verdict == Some(Verdict::Linear);
                let wanted = self.methods.contains(&Method::Kernel);
                let kernel = wanted.then(|| {
                    KernelPlanes::new(&fit.fit, f64::from(grid.radius_m as f32), |at| fit.is_valid_at(at))
                });
                let kernel = kernel.flatten();
                let length_m = fit.fit.length_m();
                let said = FitResult { derivatives, length_m, is_linear, kernel };
                Ok(TableInput { grid, samples, branch_jumps: Vec::new(), said: Some(said), step: 1 })
            }
        }
    }

    fn displacement(
        &self,
        store: &Store,
        selected: &SelectedSpace,
        known: &TableInput,
        bound: DisplacementBound,
    ) -> Result<DisplacementFit, PackError> {
        let TableInput { grid, samples, branch_jumps, said, step } = known;
        let motion = SurfaceMotion::new(store, selected.active, self.nodes)?;
        let solved: Vec<GridIndex> = samples.iter().map(|sample| sample.index).collect();
        let fitted = match said {
            Some(said) => {
                let bound = bound.at_points_of_a_fit();
                // Each displacement is read twice and costly to evaluate. The list is small, so it is kept in
                // memory.
                let scattered = scattered_motion(selected, said, &motion, bound)?;
                let all: Vec<SurfaceMotionSample> =
                    solved.iter().map(|&index| scattered.at(grid.displacement_m(index))).collect();
                fit_displacement(grid, &solved, branch_jumps, bound, |at| Ok(all[at].clone()))
            }
            None => fit_displacement(grid, &solved, branch_jumps, bound, |at| {
                motion.at(samples[at].index.map(|n| n * step), samples[at].attempt)
            }),
        };
        let active = || selected.name.clone();
        fitted.map_err(|fault| match fault {
            DisplacementFault::Read(error) => PackError::Store(error),
            DisplacementFault::Modes => PackError::Displacement { active: active(), beyond: None },
            DisplacementFault::Bound { index, misfit } => {
                PackError::Displacement { active: active(), beyond: Some((index, misfit)) }
            }
        })
    }
}

/// Surface motion between adaptively sampled configurations. It is linear if the force is linear and the
/// linear motion meets the bound at all configurations; otherwise it is interpolated.
fn scattered_motion(
    selected: &SelectedSpace,
    said: &FitResult,
    motion: &SurfaceMotion<'_>,
    bound: DisplacementBound,
) -> Result<ScatteredMotion, PackError> {
    let mut configurations = Vec::new();
    let on_branch = |r: &&Record| r.equilibrium().is_some_and(|at| !at.switched);
    for record in selected.records.iter().filter(on_branch) {
        let moved = motion.at(record.index, record.attempt)?;
        configurations.push((displacement_m(record.index), moved));
    }
    // Rest comes first.
    let size = |p: &[f64; 3]| p.iter().map(|x| x * x).sum::<f64>();
    configurations.sort_by(|a, b| size(&a.0).total_cmp(&size(&b.0)));
    let of = |some| ScatteredMotion::new(said.length_m, some).ok_or(PackError::Empty);
    if said.is_linear && !configurations.is_empty() {
        let linear = of(&configurations[..1])?;
        let holds = |(p, moved): &([f64; 3], SurfaceMotionSample)| bound.allows(&linear.at(*p), moved);
        if configurations.iter().all(holds) {
            return Ok(linear);
        }
    }
    of(&configurations)
}
