//! Surface displacements from the states in the store.

use super::store::{Store, StoreError};
use crate::fit::SurfaceMotionSample;
use crate::spec::GridIndex;

/// Surface nodes of the body with one active node, and their rest positions.
#[derive(Debug)]
pub(crate) struct SurfaceMotion<'s> {
    store: &'s Store,
    active: usize,
    nodes: &'s [u32],
    rest: Vec<[f32; 3]>,
}

impl<'s> SurfaceMotion<'s> {
    /// The motion of `nodes` for this active node.
    pub(crate) fn new(store: &'s Store, active: usize, nodes: &'s [u32]) -> Result<Self, StoreError> {
        let rest = store.displacements(active, [0; 3], 0)?;
        if nodes.iter().any(|&n| n as usize >= rest.len()) {
            return Err(store.corrupt("a surface node is not in its mesh"));
        }
        Ok(Self { store, active, nodes, rest })
    }

    /// Displacement from rest and its derivatives at a configuration.
    pub(crate) fn at(&self, index: GridIndex, attempt: u32) -> Result<SurfaceMotionSample, StoreError> {
        let [displacement, slopes @ ..] = self.store.displacements_and_slopes(self.active, index, attempt)?;
        let of_surface = |all: &Vec<[f32; 3]>| self.nodes.iter().flat_map(|&n| all[n as usize]).collect();
        Ok(SurfaceMotionSample {
            displacement_m: self.since_rest(&displacement),
            slopes: slopes.each_ref().map(of_surface),
        })
    }

    /// Displacements from rest of a held-out position from its bytes; `None` if they were not stored.
    pub(crate) fn of_truth(&self, bytes: &[u8]) -> Option<Vec<f32>> {
        let numbers: Vec<f32> = bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        let all = numbers.as_chunks::<3>().0;
        (all.len() >= self.rest.len()).then(|| self.since_rest(all))
    }

    fn since_rest(&self, all: &[[f32; 3]]) -> Vec<f32> {
        let of_node = |&n: &u32| -> [f32; 3] {
            std::array::from_fn(|axis| all[n as usize][axis] - self.rest[n as usize][axis])
        };
        self.nodes.iter().flat_map(of_node).collect()
    }
}
