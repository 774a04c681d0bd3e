//! A space with a kernel of arbitrary numbers, for the tests of the core and of the host.

use super::{Draft, Random, Recipe};
use palpate_core::AlignedBytes;
use palpate_core::format::KernelHeader;
use palpate_core::kernel::{Block, LANES, NUMBERS, REACH_POINTS, SCALARS};

pub const RADIUS_M: f32 = 0.03;
pub const SPACING_M: f32 = 0.01;
pub const LENGTH_M: f64 = 0.02;
/// l S(0), N.
pub const BASE_N: [f64; 6] = [3.0, 0.4, -0.2, 4.0, 0.3, 6.0];

/// 21 configurations with arbitrary polynomials: terms of some hundreds of newtons whose sum is a few
/// newtons.
pub fn blocks() -> Vec<Block> {
    let mut random = Random(17);
    let mut blocks = vec![[[0.0; LANES]; NUMBERS]; 6];
    for n in 0..21 {
        for number in 0..NUMBERS {
            let size = if number < 3 { 1.2 } else { 0.2 };
            blocks[n / LANES][number][n % LANES] = size * f64::from(random.next());
        }
    }
    blocks
}

/// A reach that is shorter along z and asymmetric.
pub fn reach() -> Vec<u8> {
    let share = |index: usize| {
        let n = [index / 81, index / 9 % 9, index % 9].map(|n| n as f64 - 4.0);
        let size = n.iter().map(|n| n * n).sum::<f64>().sqrt().max(1.0);
        (255.0 * (0.88 - 0.4 * (n[2] / size).powi(2) - 0.1 * n[0] / size)) as u8
    };
    (0..REACH_POINTS).map(share).collect()
}

pub fn scalars() -> [f64; SCALARS] {
    let [xx, xy, xz, yy, yz, zz] = BASE_N;
    [LENGTH_M, xx, xy, xz, yy, yz, zz]
}

pub fn recipe() -> Recipe {
    Recipe { spacing_m: SPACING_M, radius_m: RADIUS_M, rbf: false, displacement: false, ..Recipe::default() }
}

pub fn add(draft: &mut Draft) {
    let header = KernelHeader {
        scalars: draft.area.push(&scalars()),
        blocks: draft.area.push(&blocks()),
        reach: draft.area.push(&reach()),
    };
    draft.spaces[0].kernel = Some(header);
}

pub fn blob() -> AlignedBytes {
    recipe().blob_with(add)
}
