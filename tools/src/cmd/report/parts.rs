//! Effect of states between grid points on radial basis functions, and comparison of interpolations of the
//! displayed surface.

use palpate_core::{Method, Organ};
use palpate_host::BlobFile;
use palpate_precompute::certificate::{Certificate, SurfaceDistances, surface_by_rbf};
use palpate_precompute::fit::Kernel;
use palpate_precompute::held_out::Draw;
use palpate_precompute::pack::{PackOptions, pack};
use palpate_precompute::pipeline::certified;
use palpate_precompute::space::Store;
use serde::Serialize;

use super::measure::some;
use super::plan::{Family, Plan};
use super::solve::solved;
use super::steps::Steps;
use crate::failure::Failure;

/// A force by radial basis functions, with or without states between grid points.
#[derive(Debug, Clone, Serialize)]
pub(super) struct PartsRow {
    pub scene: String,
    pub grid: u32,
    pub method: &'static str,
    pub intermediate: bool,
    pub centres: usize,
    pub positions: usize,
    pub mean_n: f64,
    pub p99_n: f64,
    pub max_n: f64,
    pub nanoseconds: f64,
}

/// The surface with one interpolation.
#[derive(Debug, Clone, Serialize)]
pub(super) struct SurfaceRow {
    pub scene: String,
    pub grid: u32,
    pub nodes: usize,
    pub how: &'static str,
    /// Bytes that a reader would have to keep.
    pub bytes: usize,
    pub positions: usize,
    pub rms_mean_mm: f64,
    pub rms_max_mm: f64,
    pub max_mean_mm: f64,
    pub max_mm: f64,
    pub microseconds: f64,
}

/// Number of increments of a transition, as in the paper.
const PARTS: u32 = 5;
const SMALL_PARTS: u32 = 2;

/// Number of steps of [`measured`].
pub(super) const STEPS: usize = 3;

/// Measures one body on one grid.
pub(super) fn measured(
    plan: &Plan,
    family: &Family,
    grid: (u32, u32),
    steps: &mut Steps,
) -> Result<(Vec<PartsRow>, Vec<SurfaceRow>), Failure> {
    let parts = if plan.small { SMALL_PARTS } else { PARTS };
    let case = family.in_parts(parts, grid)?;
    let draw = Draw { regular_m: None, random: 0, ..plan.draw(family.radius_m()) };
    let path = solved(plan, &case, &draw, None, steps)?;
    steps.next(&format!("{}: states between grid points, and the surface", case.name))?;
    let store = Store::open(&path)?;
    let points = store.records(0)?.iter().filter(|r| r.tag().is_solved()).count();
    let mut forces = Vec::new();
    for intermediate in [false, true] {
        let methods = &[Method::RbfLinear, Method::RbfCubic];
        let options = PackOptions { methods, use_intermediate_states: intermediate, threads: plan.threads };
        let (packed, certificate) = certified(&store, &options)?;
        let file = BlobFile::of(&packed.bytes()?);
        let organ: Organ<'_> = Organ::read(file.bytes()).map_err(Failure::work)?;
        // Tables are padded to whole registers with centres of zero weight.
        let centres = organ.spaces[0].planes().rbf_cubic.map_or(0, |planes| planes.centres[0].len());
        for (method, figures) in methods.iter().zip(&certificate.spaces[0].methods) {
            let clear = figures.uniform;
            forces.push(PartsRow {
                scene: family.name.clone(),
                grid: grid.0,
                method: method.name(),
                intermediate,
                centres: if intermediate { centres } else { points },
                positions: clear.count,
                mean_n: some(clear.count, clear.mean_n),
                p99_n: some(clear.count, clear.p99_n),
                max_n: some(clear.count, clear.max_n),
                nanoseconds: figures.probe.nanoseconds,
            });
        }
        steps.go_on()?;
    }
    Ok((forces, surfaces(family, grid.0, plan, &store)?))
}

fn surfaces(family: &Family, grid: u32, plan: &Plan, store: &Store) -> Result<Vec<SurfaceRow>, Failure> {
    let options =
        PackOptions { methods: &[Method::Energy], use_intermediate_states: false, threads: plan.threads };
    let file = BlobFile::of(&pack(store, &options)?.bytes()?);
    let organ: Organ<'_> = Organ::read(file.bytes()).map_err(Failure::work)?;
    let certificate: Certificate = palpate_precompute::certificate::certify(store, &organ)?;
    let Some(packed) = certificate.spaces.first().and_then(|space| space.displacement.clone()) else {
        return Err(Failure::work("a space for display without displacements"));
    };
    let row = |how: &'static str, bytes: usize, apart: SurfaceDistances, microseconds: f64| SurfaceRow {
        scene: family.name.clone(),
        grid,
        nodes: packed.nodes,
        how,
        bytes,
        positions: apart.count,
        rms_mean_mm: apart.rms_mean_mm,
        rms_max_mm: apart.rms_max_mm,
        max_mean_mm: apart.max_mean_mm,
        max_mm: apart.max_mm,
        microseconds,
    };
    let mut rows =
        vec![row("packed modes, tri-linear", packed.bytes, packed.uniform_trilinear, packed.microseconds)];
    // If the grid is fine enough for the bound, no mode has slopes.
    if packed.slopes > 0 {
        rows.push(row("packed modes, with slopes", packed.bytes, packed.uniform, packed.microseconds));
    }
    for (kernel, how) in [(Kernel::Linear, "radial r, f64"), (Kernel::Cubic, "radial r\u{b3}, f64")] {
        let fitted = surface_by_rbf(store, 0, &organ, &organ.spaces[0], kernel)?;
        let (apart, microseconds) = fitted.map_err(Failure::work)?;
        rows.push(row(how, 2 * packed.raw_bytes, apart, microseconds));
    }
    Ok(rows)
}
