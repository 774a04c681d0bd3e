//! The expensive part of packing: the fits of each space, before the layout.
//!
//! The spaces are independent. Threads share them; each space has its own connection to the store. The result
//! does not depend on the number of threads.

use palpate_core::Method;

use super::PackError;
use crate::adaptive::{AdaptiveFit, Resampled, Verdict, resample};
use crate::fit::{
    BranchJump, DisplacementFault, DisplacementFit, HermiteNodes, KernelPlanes, Misfit, Sample,
    ScatteredMotion, SurfaceMotionSample, fit_displacement, hermite_nodes, root_nodes,
};
use crate::num::parallel::in_parallel;
use crate::space::{Record, Store, SurfaceMotion, branch_jumps, samples, state};
use crate::spec::{DisplacementBound, GridIndex, Lattice, Quantity, Sampling, SpaceGrid, displacement_m};

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
    /// The fit of adaptive sampling, if the samples are evaluated from it.
    fit: Option<AdaptiveFit>,
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
            fit: None,
            step,
        }
    }
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
        // A connection serves one thread, so every space opens its own. It sees only committed rows.
        store.commit()?;
        let path = store.path();
        let one = |selected: &SelectedSpace| self.one(&Store::open(path)?, selected);
        in_parallel(selected, threads, one)?.into_iter().collect()
    }

    fn one(&self, store: &Store, selected: &SelectedSpace) -> Result<Fitted, PackError> {
        let known = self.known(store, selected)?;
        let TableInput { grid, samples, branch_jumps, fit, .. } = &known;
        let is_root = fit.as_ref().is_some_and(|fit| fit.wanted.quantity == Quantity::Root);
        let is_wanted = |method| self.methods.contains(&method);
        let hermite = (is_wanted(Method::Hermite) || is_wanted(Method::Energy)).then(|| {
            if is_root { root_nodes(grid, samples) } else { hermite_nodes(grid, samples, branch_jumps) }
        });
        let radius_m = f64::from(grid.radius_m as f32);
        let kernel = fit.as_ref().filter(|_| is_wanted(Method::Kernel));
        let kernel = kernel.and_then(|fit| KernelPlanes::new(&fit.fit, radius_m, |at| fit.is_valid_at(at)));
        let displacement = self
            .visual
            .filter(|_| !is_root)
            .map(|bound| self.displacement(store, selected, &known, bound))
            .transpose()?;
        Ok(Fitted { known, hermite, kernel, displacement })
    }

    fn known(&self, store: &Store, selected: &SelectedSpace) -> Result<TableInput, PackError> {
        if let Sampling::Lattice(Lattice { grid, .. }) = &self.sampling {
            return Ok(TableInput::solved(grid, &selected.records, 1));
        }
        let state = state(store, selected.active)?;
        if let Some(lattice) = state.fallback() {
            let records = lattice.records(&selected.records);
            return Ok(TableInput::solved(&lattice.grid, &records, lattice.spacing));
        }
        let fit = state.fit.ok_or(PackError::Empty)?;
        let resampled =
            resample(&fit).map_err(|error| PackError::Lattice { active: selected.name.clone(), error })?;
        let Resampled { grid, samples, .. } = resampled;
        Ok(TableInput { grid, samples, branch_jumps: Vec::new(), fit: Some(fit), step: 1 })
    }

    fn displacement(
        &self,
        store: &Store,
        selected: &SelectedSpace,
        known: &TableInput,
        bound: DisplacementBound,
    ) -> Result<DisplacementFit, PackError> {
        let TableInput { grid, samples, branch_jumps, fit, step } = known;
        let motion = SurfaceMotion::new(store, selected.active, self.nodes)?;
        let fitted = match fit {
            Some(fit) => {
                let scattered = scattered_motion(selected, fit, &motion, bound.at_points_of_a_fit())?;
                scattered.table(grid, samples, bound)
            }
            None => {
                let solved: Vec<GridIndex> = samples.iter().map(|sample| sample.index).collect();
                fit_displacement(grid, &solved, branch_jumps, bound, |at| {
                    motion.at(samples[at].index.map(|n| n * step), samples[at].attempt)
                })
            }
        };
        let active = || selected.name.clone();
        fitted.map_err(|fault| match fault {
            DisplacementFault::Read(error) => PackError::Store(error),
            DisplacementFault::Modes => PackError::Modes(active()),
            DisplacementFault::Bound { index, misfit: Misfit { rms_m, max_m } } => {
                PackError::Displacement { active: active(), index, rms_m, max_m }
            }
        })
    }
}

/// Surface motion between adaptively sampled configurations. It is linear if the force is linear and the
/// linear motion meets the bound at all configurations; otherwise it is interpolated.
fn scattered_motion(
    selected: &SelectedSpace,
    fit: &AdaptiveFit,
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
    let of = |some| ScatteredMotion::new(fit.fit.length_m, some).ok_or(PackError::Empty);
    if fit.verdict == Some(Verdict::Linear) && !configurations.is_empty() {
        let linear = of(&configurations[..1])?;
        let holds = |(p, moved): &([f64; 3], SurfaceMotionSample)| bound.allows(&linear.at(*p), moved);
        if configurations.iter().all(holds) {
            return Ok(linear);
        }
    }
    of(&configurations)
}
