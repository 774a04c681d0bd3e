//! The fuzz targets of the core on the inputs of the corpus, on their seeds, and on mutations of both.
//! `tests/fuzz/run` runs the fuzzer itself.

use std::path::{Path, PathBuf};

use palpate_core::JetCoupling;

use crate::common::jets::jet;
use crate::common::{Recipe, potential};
use replay::{kept, replay, write_seeds};

#[path = "../../tests/fuzz/bodies/core.rs"]
mod bodies;
#[path = "../../tests/fuzz/bodies/jets.rs"]
mod jet_bodies;
#[path = "../../tests/fuzz/replay.rs"]
mod replay;

fn corpus(target: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fuzz/corpus").join(target)
}

/// Seeds: small blobs with every kind of table, with unsolved points and folds.
fn blobs() -> Vec<Vec<u8>> {
    let small = || Recipe { radius_m: 0.01, slopes: 2, outlier: Some([0, -1, 0]), ..Recipe::default() };
    let recipes = [
        small(),
        Recipe { nodes: vec![[0.0; 3], [0.1, 0.0, 0.02]], rbf: false, ..small() },
        Recipe { solved: |ijk| ijk != [0, 1, 0], displacement: false, ..small() },
        Recipe { fold: |ijk| ijk == [0; 3], lattice_table: false, slopes: 0, ..small() },
        Recipe { hermite: false, displacement: false, ..small() },
    ];
    recipes.iter().map(|recipe| recipe.blob().to_vec()).collect()
}

#[test]
fn blobs_are_refused_or_good() {
    replay(&blobs(), 400, bodies::blob);
    replay(&kept(&corpus("blob")), 3, bodies::blob);
}

#[test]
fn ticks_are_finite_and_within_limits() {
    replay(&strokes(), 100, bodies::tick);
    replay(&kept(&corpus("tick")), 5, bodies::tick);
}

#[test]
fn jets_are_refused_or_have_finite_forces() {
    replay(&live_touches(), 2_000, jet_bodies::jets);
    replay(&kept(&corpus("jets")), 50, jet_bodies::jets);
}

/// Seeds of [`jet_bodies::jets`]: frames, a touch, a solver that is gone, and a jump of the body.
fn live_touches() -> Vec<Vec<u8>> {
    let frame = |kind: u8, contact: u16, z: f32, flags: u8| {
        let mut bytes = vec![kind];
        let mut of = jet(potential, contact, [0.0, 0.001, z], 0.006);
        let mixed_n_m = [[30.0, 2.0, 1.0]; 3];
        let partner =
            JetCoupling { control_m: [0.0, z, 0.01], slope_n: [0.0, 1.0, 0.0], mixed_n_m, own_n_m: [5.0; 6] };
        of.coupling = (flags & 32 != 0).then_some(partner);
        bytes.extend_from_slice(&of.encode()[..204]);
        bytes[1 + 14] = flags;
        bytes
    };
    let touch = |kind: u8, elapsed_us: u32, n: u32| {
        let middle = 1 << 31;
        let mut words = [0_u32; 51];
        words[..7].copy_from_slice(&[
            elapsed_us,
            0,
            middle,
            middle + (n << 22),
            middle - (n << 24),
            0x2_0100,
            0x40_3f80,
        ]);
        let mut bytes = vec![kind];
        bytes.extend_from_slice(bytemuck::cast_slice(&words));
        bytes
    };
    let release = |kind: u8| [vec![kind], vec![0; 116]].concat();
    let learnt = || (0..6).flat_map(|n| frame(0, n % 3, -2e-3 * f32::from(n), 1)).collect::<Vec<u8>>();
    let pressed = || (0..20).flat_map(|n| touch(4, 1_000, n)).collect::<Vec<u8>>();
    let full = (0_u8..12).flat_map(|n| frame(0, 0, -1e-3 * f32::from(n), 2));
    vec![
        [learnt(), pressed(), release(7), pressed()].concat(),
        [learnt(), release(7 + 16), pressed(), touch(4, 600_000, 9), touch(4, 400_000, 9)].concat(),
        [full.collect(), pressed(), frame(0, 0, 0.004, 8), pressed(), touch(12, 1_000, 3)].concat(),
        [
            learnt(),
            frame(0, 0, -0.001, 33),
            touch(36, 1_000, 1),
            frame(0, 0, -0.001, 49),
            touch(36, 1_000, 2),
            touch(4, 1_000, 2),
        ]
        .concat(),
    ]
}

/// Seeds of [`bodies::tick`]: a grasp and a walk, ticks without samples, a fault and its reset.
fn strokes() -> Vec<Vec<u8>> {
    let step = |kind: u8, buttons: u8, at: [u32; 3]| {
        let mut bytes = vec![kind, 0xe8, 3, 10, buttons];
        bytes.extend_from_slice(bytemuck::cast_slice(&at));
        bytes
    };
    let middle = 1 << 31;
    let walk = |n: u32| [middle + (n << 24), middle - (n << 23), middle];
    let touch = (0..40).flat_map(|n| step(0, u8::from(n > 1), walk(n))).collect::<Vec<u8>>();
    let silent = (0..20).flat_map(|n| step(if n > 3 { 63 << 2 } else { 0 }, u8::from(n > 1), walk(n)));
    let fault =
        [step(1, 0, [f32::NAN.to_bits(); 3]), step(61 << 2, 0, walk(1)), step(60 << 2, 0, walk(1))].concat();
    let header = |method: u8, options: u8| vec![method, options];
    vec![
        [header(6, 1), touch.clone()].concat(),
        [header(2, 4), silent.collect()].concat(),
        [header(5, 3), touch, fault, step(61 << 2, 0, walk(2))].concat(),
    ]
}

#[test]
#[ignore = "writes the seeds of tests/fuzz: run by hand after a change of the layout"]
fn write_the_first_inputs() {
    write_seeds(&corpus("blob"), &blobs());
    write_seeds(&corpus("jets"), &live_touches());
    write_seeds(&corpus("tick"), &strokes());
}
