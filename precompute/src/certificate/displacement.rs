//! Errors of a space's packed displacements: at their own configurations, and at positions that no fit uses.

use std::hint::black_box;
use std::time::Instant;

use palpate_core::{ConfigTag, DisplacementPlanes, DisplacementTable, Organ, Space};
use serde::{Deserialize, Serialize};

use super::blend::{Blend, Blends};
use crate::fit::{Misfit, PackedModes, Sample};
use crate::space::{Kind, Store, StoreError, SurfaceMotion};

/// Measurements of the displacements of one space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DisplacementCertificate {
    /// Number of surface nodes.
    pub nodes: usize,
    /// Number of modes.
    pub modes: usize,
    /// Number of modes with slopes; with none, the interpolation is tri-linear as in the paper.
    pub slopes: usize,
    /// Configurations stored separately from the modes.
    pub outliers: usize,
    /// Size in bytes.
    pub bytes: usize,
    /// Size as uncompressed f32, bytes.
    pub raw_bytes: usize,
    /// The scene's bound for a configuration, RMS over the surface, mm.
    pub bound_rms_mm: f64,
    /// The scene's bound at any surface node, mm.
    pub bound_max_mm: f64,
    /// Errors of all packed configurations.
    pub configurations: SurfaceDistances,
    /// Independent uniform positions within f_max, away from branch jumps.
    pub uniform: SurfaceDistances,
    /// The same positions without the slopes.
    pub uniform_trilinear: SurfaceDistances,
    /// Uniform positions near branch jumps.
    #[serde(alias = "folded")]
    pub at_branch_jumps: SurfaceDistances,
    /// Median time to evaluate one surface, us, on the machine that packed the blob.
    pub microseconds: f64,
}

/// Distances of packed surfaces from the solver's, mm.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SurfaceDistances {
    /// Number of surfaces.
    pub count: usize,
    /// RMS distance over the nodes of a surface, mean over the surfaces.
    pub rms_mean_mm: f64,
    /// Maximum over the surfaces of the RMS distance.
    pub rms_max_mm: f64,
    /// Largest node distance of a surface, mean over the surfaces.
    pub max_mean_mm: f64,
    /// Maximum over the surfaces of the node distance.
    pub max_mm: f64,
}

impl SurfaceDistances {
    fn add(&mut self, misfit: Misfit) {
        let (rms_mm, max_mm) = (1e3 * misfit.rms_m, 1e3 * misfit.max_m);
        self.count += 1;
        // Running means.
        self.rms_mean_mm += (rms_mm - self.rms_mean_mm) / self.count as f64;
        self.max_mean_mm += (max_mm - self.max_mean_mm) / self.count as f64;
        self.rms_max_mm = self.rms_max_mm.max(rms_mm);
        self.max_mm = self.max_mm.max(max_mm);
    }
}

const REPEATS: usize = 15;

/// The displacement table of a space of a blob.
pub(super) struct Packed<'p, 'b> {
    pub(super) space: &'p Space<'b>,
    pub(super) table: &'p DisplacementTable<'b>,
    /// All spaces of the blob.
    pub(super) spaces: &'p [Space<'b>],
    pub(super) blends: &'p Blends,
}

/// Measures the table of a space, made of `solved` configurations; those at table points are `samples`.
/// `nodes` are the mesh nodes of the surface. Between contact points the tables are blended.
pub(super) fn measure(
    store: &Store,
    active: usize,
    &Packed { space, table, spaces, blends }: &Packed<'_, '_>,
    nodes: &[u32],
    samples: &[Sample],
    solved: usize,
) -> Result<DisplacementCertificate, StoreError> {
    let bound = store.identity()?.displacement_bound;
    let motion = SurfaceMotion::new(store, active, nodes)?;
    let mut found = vec![[0.0f32; 3]; nodes.len()];
    let mut configurations = SurfaceDistances::default();
    for sample in samples {
        let exact = motion.at(sample.index, sample.attempt)?.displacement_m;
        let Some(slot) = space.lattice().slot(sample.index) else { continue };
        table.configuration_into(slot, &mut found);
        configurations.add(misfit(&exact, &found));
    }

    let (mut uniform, mut uniform_trilinear, mut at_branch_jumps) =
        <(SurfaceDistances, SurfaceDistances, SurfaceDistances)>::default();
    let mut visited = Vec::new();
    each_truth(store, active, (spaces, blends), &motion, |at, exact, blend, has_branch_jump| {
        visited.push(at);
        blended(blend.parts(spaces), at, |table| table, &mut found);
        if has_branch_jump {
            at_branch_jumps.add(misfit(exact, &found));
            return;
        }
        uniform.add(misfit(exact, &found));
        blended(blend.parts(spaces), at, DisplacementTable::without_slopes, &mut found);
        uniform_trilinear.add(misfit(exact, &found));
    })?;
    if visited.is_empty() {
        visited.push([0.25 * space.lattice().radius_m(); 3]);
    }
    let planes = table.planes();
    Ok(DisplacementCertificate {
        nodes: nodes.len(),
        modes: planes.scale.len(),
        slopes: planes.slopes,
        outliers: planes.outlier_row.len(),
        bytes: bytes(planes),
        raw_bytes: solved * nodes.len() * 3 * size_of::<f32>(),
        bound_rms_mm: 1e3 * bound.rms_m,
        bound_max_mm: 1e3 * bound.max_m,
        configurations,
        uniform,
        uniform_trilinear,
        at_branch_jumps,
        microseconds: microseconds(space, table, &visited, &mut found),
    })
}

/// Errors at independent positions away from branch jumps, without those of interpolation: the distance of
/// the surfaces from their projection onto the modes (truncation), and the additional distance by rounding of
/// the coefficients.
pub(crate) fn modes_and_digits(
    store: &Store,
    active: usize,
    (organ, table): (&Organ<'_>, &DisplacementTable<'_>),
    blends: &Blends,
) -> Result<[SurfaceDistances; 2], StoreError> {
    let motion = SurfaceMotion::new(store, active, organ.surface.node)?;
    let modes = PackedModes::of_planes(table.planes());
    let mut apart = [SurfaceDistances::default(); 2];
    each_truth(store, active, (&organ.spaces, blends), &motion, |_, exact, blend, has_branch_jump| {
        // Between contact points the modes of one space say nothing.
        if blend.is_alone() && !has_branch_jump {
            let causes = modes.left_and_rounded(exact);
            apart.iter_mut().zip(&causes).for_each(|(apart, cause)| apart.add(Misfit::of(cause)));
        }
    })?;
    Ok(apart)
}

/// Independent uniform positions within f_max with stored displacements: the displacements, and whether the
/// position is near a branch jump.
fn each_truth(
    store: &Store,
    active: usize,
    (spaces, blends): (&[Space<'_>], &Blends),
    motion: &SurfaceMotion<'_>,
    mut see: impl FnMut([f32; 3], &[f32], &Blend, bool),
) -> Result<(), StoreError> {
    store.each_truth(active, |walk, _, truth| {
        let at = truth.displacement_m.map(|x| x as f32);
        let usable = walk.kind == Kind::Uniform && truth.tag() == ConfigTag::Expandable;
        let Some(blend) = blends.at(walk).filter(|blend| usable && blend.is_inside(spaces, at)) else {
            return;
        };
        if let Some(exact) = motion.of_truth(&truth.displacements) {
            let switched = truth.equilibrium().is_some_and(|at| at.switched);
            see(at, &exact, &blend, switched || blend.has_branch_jump(spaces, at));
        }
    })
}

/// The sum of the displacements of the spaces; a space without a table does not move the surface.
fn blended<'s, 'b: 's>(
    parts: impl Iterator<Item = (&'s Space<'b>, f32)>,
    at: [f32; 3],
    form: impl Fn(DisplacementTable<'b>) -> DisplacementTable<'b>,
    sum: &mut [[f32; 3]],
) {
    let mut one = vec![[0.0; 3]; sum.len()];
    sum.fill([0.0; 3]);
    for (space, weight) in parts {
        let Some(table) = space.displacement().copied() else { continue };
        form(table).displacement_into(space.lattice(), space.planes().flags, at, &mut one);
        for (sum, one) in sum.as_flattened_mut().iter_mut().zip(one.as_flattened()) {
            *sum += weight * one;
        }
    }
}

/// Size of all planes.
fn bytes(planes: &DisplacementPlanes<'_>) -> usize {
    let of_modes = size_of_val(planes.modes) + size_of_val(planes.scale);
    let of_rows = size_of_val(planes.row) + size_of_val(planes.coefficients);
    let of_outliers = size_of_val(planes.outlier_row) + size_of_val(planes.outlier_scale);
    of_modes + of_rows + of_outliers + size_of_val(planes.outliers)
}

fn misfit(exact: &[f32], found: &[[f32; 3]]) -> Misfit {
    let apart: Vec<f64> =
        exact.iter().zip(found.as_flattened()).map(|(a, b)| f64::from(*a) - f64::from(*b)).collect();
    Misfit::of(&apart)
}

fn microseconds(
    space: &Space<'_>,
    table: &DisplacementTable<'_>,
    visited: &[[f32; 3]],
    found: &mut [[f32; 3]],
) -> f64 {
    let mut times: Vec<f64> = (0..REPEATS)
        .map(|n| {
            let at = visited[n * visited.len() / REPEATS];
            let start = Instant::now();
            table.displacement_into(space.lattice(), space.planes().flags, black_box(at), found);
            black_box(&mut *found);
            start.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[REPEATS / 2]
}
