//! Solved configurations as the fits take them.

use palpate_core::ConfigTag;

use super::record::Record;
use crate::fit::{self, Fold, Sample};
use crate::spec::SpaceGrid;

/// The solved points among `records`, sorted by grid index.
pub fn samples(grid: &SpaceGrid, records: &[Record]) -> Vec<Sample> {
    let mut samples: Vec<Sample> = records
        .iter()
        .filter(|r| r.tag.is_solved() && grid.lattice.slot(r.index).is_some())
        .map(|r| Sample {
            index: r.index,
            attempt: r.attempt,
            // Rest has no force by its definition; what the solver left of a body force's residual is rounding.
            energy_j: if r.index == [0; 3] { 0.0 } else { r.energy_j },
            force_n: if r.index == [0; 3] { [0.0; 3] } else { r.force_n },
            third_n_m2: r.third_n_m2,
            stiffness_n_m: std::array::from_fn(|i| std::array::from_fn(|j| r.stiffness_n_m[(i, j)])),
            terminating: r.tag == ConfigTag::Terminating,
            inverted: r.inverted > 0,
        })
        .collect();
    samples.sort_unstable_by_key(|s| s.index);
    samples
}

/// The folds among the solutions of a space that tables must not smooth over.
pub fn folds(grid: &SpaceGrid, records: &[Record]) -> Vec<Fold> {
    let solved = records.iter().filter(|r| r.tag.is_solved());
    fit::folds(&solved.map(|r| (r.index, r.jet(grid.displacement_m(r.index)))).collect::<Vec<_>>())
}
