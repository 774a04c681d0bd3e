//! Statistics of the outcomes of held-out walks.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::num::vector::norm;
use crate::space::{Kind, Store, StoreError};

/// Counts over the walks of one kind.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Number of walks.
    pub walks: u32,
    /// Number of complete walks.
    pub whole: u32,
    /// Number of walks that ended at f_max.
    pub at_force_limit: u32,
    /// Number of walks that ended with a failed step, by reason.
    pub failed: BTreeMap<String, u32>,
    /// Solved positions.
    pub positions: u32,
    /// Solved positions with inverted elements.
    pub inverted: u32,
    /// Solved positions with an unstable state.
    pub unstable: u32,
    /// Steps that switched the branch.
    pub switched: u32,
    /// Largest |h| below f_max, N.
    pub largest_n: f64,
    /// Newton iterations.
    pub iterations: u64,
    /// Number of factorisations.
    pub factorisations: u64,
    /// Sum of the wall times of all solves, s.
    pub seconds: f64,
}

impl Summary {
    /// Counts the walks of each kind at one active node.
    pub fn of(store: &Store, active: usize) -> Result<BTreeMap<Kind, Self>, StoreError> {
        let mut all: BTreeMap<Kind, Self> = BTreeMap::new();
        store.each_truth(active, |walk, step, truth| {
            let sum = all.entry(walk.kind).or_default();
            sum.walks += u32::from(step == 1);
            sum.iterations += u64::from(truth.iterations);
            sum.factorisations += u64::from(truth.factorisations);
            sum.seconds += truth.seconds;
            match &truth.result {
                Ok(at) => {
                    if at.terminating {
                        sum.at_force_limit += 1;
                    } else {
                        sum.largest_n = sum.largest_n.max(norm(at.force_n));
                    }
                    sum.positions += 1;
                    sum.inverted += u32::from(at.inverted > 0);
                    sum.unstable += u32::from(at.unstable_modes.is_some_and(|n| n > 0));
                    sum.switched += u32::from(at.switched);
                }
                Err(reason) => *sum.failed.entry(reason.clone()).or_default() += 1,
            }
        })?;
        for sum in all.values_mut() {
            // A walk ends at its first terminating or failed step.
            sum.whole = sum.walks - sum.at_force_limit - sum.failures();
        }
        Ok(all)
    }

    /// Number of walks that ended with a failed step.
    pub fn failures(&self) -> u32 {
        self.failed.values().sum()
    }

    /// Adds the counts of other walks.
    pub fn add(&mut self, other: &Self) {
        self.walks += other.walks;
        self.whole += other.whole;
        self.at_force_limit += other.at_force_limit;
        for (reason, count) in &other.failed {
            *self.failed.entry(reason.clone()).or_default() += count;
        }
        self.positions += other.positions;
        self.inverted += other.inverted;
        self.unstable += other.unstable;
        self.switched += other.switched;
        self.largest_n = self.largest_n.max(other.largest_n);
        self.iterations += other.iterations;
        self.factorisations += other.factorisations;
        self.seconds += other.seconds;
    }
}
