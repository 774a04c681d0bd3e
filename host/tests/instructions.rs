//! Every method gives the same bits with every instruction set of this processor.

use crate::core_blobs::{self, Random, Recipe};
use palpate_core::{ForceSample, Method, Organ, Vec3};
use palpate_host::{Instructions, Interpolator};

/// Nodes, faces, the rim, points beyond it, and values that are not finite, in all combinations.
fn odd_queries(spacing_m: f32, radius_m: f32) -> impl Iterator<Item = Vec3> {
    let values = [
        0.0,
        -0.0,
        spacing_m,
        -2.0 * spacing_m,
        0.5 * spacing_m,
        radius_m,
        -radius_m,
        f32::MIN_POSITIVE,
        -1e-45,
        1e30,
        f32::NAN,
        f32::NEG_INFINITY,
    ];
    values.into_iter().flat_map(move |x| values.into_iter().flat_map(move |y| values.map(|z| [x, y, z])))
}

fn bits(sample: ForceSample) -> ([u32; 3], palpate_core::Coverage) {
    (sample.force_n.map(f32::to_bits), sample.coverage)
}

#[test]
fn instructions_do_not_change_the_result() {
    // With holes and a branch jump, so that both methods of every blend and the transition are evaluated.
    let recipe = Recipe {
        radius_m: 0.04,
        solved: |ijk| ijk != [2, 1, 0] && ijk != [-1, -3, 1],
        fold: |[i, j, k]| i == 1 && j == 0 && k.abs() < 2,
        ..Recipe::default()
    };
    let blob = recipe.blob();
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let space = &organ.spaces[0];
    let mut random = Random(21);
    let queries: Vec<Vec3> =
        (0..20_000).map(|_| random.point(0.045)).chain(odd_queries(0.01, 0.04)).collect();
    let kernel = core_blobs::kernel::blob();
    let with_kernel: Organ<'_> = Organ::read(&kernel).expect("a valid blob");
    let (mut compared, lattice) = (0, Method::OF_LATTICE.map(|method| (method, space)));
    for (method, space) in lattice.into_iter().chain([(Method::Kernel, &with_kernel.spaces[0])]) {
        let others: Vec<Interpolator> = Instructions::ALL
            .into_iter()
            .filter_map(|instructions| Interpolator::with_instructions(instructions, method))
            .collect();
        assert!(!others.is_empty(), "the baseline is always there");
        for query in &queries {
            let want = space.force(method, *query).map(bits).expect("packed");
            for other in &others {
                let found = other.force(space, query).map(bits);
                assert_eq!(found, Some(want), "{method:?} at {query:?} on {}", other.instructions());
                compared += 1;
            }
        }
    }
    let available: Vec<&str> =
        Instructions::ALL.into_iter().filter(|i| i.are_available()).map(Instructions::name).collect();
    println!("{compared} answers compared on {}", available.join(", "));
}

#[test]
fn the_best_available_instructions_are_chosen() {
    let chosen = Interpolator::new(Method::Energy);
    assert_eq!((chosen.instructions(), chosen.method()), (Instructions::best(), Method::Energy));
    assert!(Instructions::Baseline.are_available() && chosen.instructions().are_available());
}
