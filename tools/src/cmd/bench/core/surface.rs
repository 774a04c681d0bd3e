//! Time of the surface displacements, for the largest surface that a scene may request. The viewer has 33 ms
//! per frame.

use std::hint::black_box;
use std::time::Instant;

use palpate_core::flags::SMOOTH;
use palpate_core::{DisplacementPlanes, DisplacementTable};
use palpate_precompute::spec::SpaceGrid;
use serde::Serialize;

use crate::failure::Failure;

const VERTICES: usize = 2_000;
const MODES: usize = 64;

/// Time of one surface.
#[derive(Debug, Clone, Copy, Serialize)]
pub(super) struct SurfaceTime {
    pub vertices: usize,
    pub modes: usize,
    pub median_us: f64,
    pub min_us: f64,
}

/// Times `rounds` surfaces at different displacements. Every mode has slopes. The values are arbitrary.
pub(super) fn measure(rounds: usize) -> Result<SurfaceTime, Failure> {
    let lattice = SpaceGrid::new(0.01, 0.05).map_err(Failure::work)?.lattice;
    let numbers = |count: usize| -> Vec<i16> { (0..count).map(|n| (n * 31_417 % 65_521) as i16).collect() };
    let (modes, coefficients) = (numbers(MODES * VERTICES * 3), numbers(MODES * 4 * lattice.slots()));
    let planes = DisplacementPlanes {
        slopes: MODES,
        row: &(0..lattice.slots() as u32).collect::<Vec<_>>(),
        modes: &modes,
        scale: &[1e-12; MODES],
        coefficients: &coefficients,
        outlier_row: &[],
        outlier_scale: &[],
        outliers: &[],
    };
    let table = DisplacementTable::new(&lattice, planes, VERTICES)
        .map_err(|error| Failure::work(format!("the synthetic surface is refused: {error:?}")))?;
    let flags = vec![SMOOTH; lattice.slots()];
    let mut out = vec![[0.0; 3]; VERTICES];
    let mut times: Vec<f64> = (0..rounds)
        .map(|n| {
            let at = [0.01 * (n as f32).sin(), 0.02 * (n as f32).cos(), 0.005];
            let start = Instant::now();
            table.displacement_into(&lattice, &flags, black_box(at), &mut out);
            black_box(&out);
            start.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    times.sort_unstable_by(f64::total_cmp);
    let (median_us, min_us) = (times[times.len() / 2], times[0]);
    Ok(SurfaceTime { vertices: VERTICES, modes: MODES, median_us, min_us })
}
