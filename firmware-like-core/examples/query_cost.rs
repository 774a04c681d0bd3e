//! Nanoseconds per force query, by method, on a 514-point table.
//!
//! cargo run --release -p palpate-core --features std --example query_cost
//!
//! Without `--features std` the square root is libm's: the cost a microcontroller build pays, with the same bits.

use std::hint::black_box;
use std::time::Instant;

use palpate_core::flags;
use palpate_core::grid::BallLattice;
use palpate_core::hermite::{HermiteTable, Node};
use palpate_core::method::Method;
use palpate_core::rbf::{LANES, RbfTable};
use palpate_core::table::{LatticeTable, Space};
use palpate_core::vec3::Vec3;

const QUERIES: usize = 4096;
const REPEATS: usize = 200;

fn main() {
    for cells in [5.0_f32, 7.0, 10.0, 15.0] {
        measure(cells);
    }
}

fn measure(cells: f32) {
    let radius_m = 0.05;
    let lattice = BallLattice::new(radius_m / cells, radius_m).expect("a valid grid");
    let mut bits = vec![0_u8; lattice.slots()];
    let force: Vec<Vec<f32>> = (0..3)
        .map(|axis| (0..lattice.slots()).map(|slot| (slot * (axis + 1)) as f32 * 1e-4).collect())
        .collect();
    let mut centres = vec![Vec::new(); 3];
    for ijk in lattice.points().chain([[0; 3]]) {
        bits[lattice.slot(ijk).expect("a lattice point has a slot")] = flags::SOLVED;
        for (plane, n) in centres.iter_mut().zip(ijk) {
            plane.push(f64::from(n));
        }
    }
    flags::derive(&lattice, &mut bits);
    let padded = centres[0].len().next_multiple_of(LANES);
    centres.iter_mut().for_each(|plane| plane.resize(padded, 0.0));
    let weights: Vec<Vec<f64>> =
        (0..3).map(|axis| (0..padded).map(|i| ((i * 7 + axis) % 13) as f64 - 6.0).collect()).collect();
    let narrow = |planes: &[Vec<f64>]| -> Vec<Vec<f32>> {
        planes.iter().map(|plane| plane.iter().map(|&value| value as f32).collect()).collect()
    };
    let (centres_f32, weights_f32) = (narrow(&centres), narrow(&weights));
    let row: Vec<u32> = (0..lattice.slots() as u32).collect();
    let nodes: Vec<Node> = (0..lattice.slots()).map(|slot| [[slot as f32 * 1e-4; 12]; 3]).collect();
    let space = Space {
        name: heapless::String::new(),
        node: 0,
        rest_position_m: [0.0; 3],
        outward_normal: [0.0, 0.0, 1.0],
        lattice,
        flags: &bits,
        lattice_table: Some(LatticeTable::new(&lattice, three(&force)).expect("planes fit")),
        rbf_linear: Some(RbfTable::new(three(&centres_f32), three(&weights_f32)).expect("planes fit")),
        rbf_cubic: Some(RbfTable::new(three(&centres), three(&weights)).expect("planes fit")),
        hermite: Some(HermiteTable::new(lattice.slots(), &row, &nodes).expect("planes fit")),
        displacement: None,
    };
    let queries = queries(radius_m);
    println!("{} points", lattice.count());
    for method in Method::ALL {
        let repeats =
            if matches!(method, Method::RbfLinear | Method::RbfCubic) { REPEATS / 20 } else { REPEATS };
        let mut best_ns = f64::INFINITY;
        for _ in 0..repeats {
            let start = Instant::now();
            for &query in &queries {
                black_box(black_box(&space).force(method, query));
            }
            best_ns = best_ns.min(start.elapsed().as_nanos() as f64 / QUERIES as f64);
        }
        println!("  {:<12} {best_ns:9.1} ns a query", method.name());
    }
}

fn three<T>(planes: &[Vec<T>]) -> [&[T]; 3] {
    [&planes[0], &planes[1], &planes[2]]
}

/// Uniform in the ball of half the radius and more, fixed seed.
fn queries(radius_m: f32) -> Vec<Vec3> {
    let mut seed = 7_u32;
    let mut next = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 8) as f32 / (1 << 24) as f32 * 2.0 - 1.0
    };
    std::iter::repeat_with(|| [next(), next(), next()])
        .filter(|point| point.iter().map(|x| x * x).sum::<f32>() <= 1.0)
        .map(|point| point.map(|x| x * radius_m))
        .take(QUERIES)
        .collect()
}
