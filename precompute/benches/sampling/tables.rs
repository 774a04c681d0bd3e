//! Tables of samples, and their errors in the core's own queries.

use palpate_core::{ActiveNode, BallLattice, HermitePlanes, Method, Space, SpacePlanes};
use palpate_precompute::fit::{HermiteNodes, LatticeValues, Sample, hermite_nodes, lattice_values};
use palpate_precompute::num::norm;
use palpate_precompute::spec::{SpaceGrid, Tolerance};

/// A reachable position with the exact force there.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    /// Displacement, m.
    pub(crate) at: [f64; 3],
    /// h, N.
    pub(crate) exact: [f64; 3],
}

/// The tables of one space.
pub(crate) struct Tables {
    lattice: BallLattice,
    values: LatticeValues,
    hermite: HermiteNodes,
}

impl Tables {
    /// Every table of these samples.
    pub(crate) fn of(grid: &SpaceGrid, samples: &[Sample]) -> Self {
        let hermite = hermite_nodes(grid, samples, &[]);
        Self { hermite, ..Self::of_forces(grid, samples) }
    }

    /// The table of the forces alone.
    pub(crate) fn of_forces(grid: &SpaceGrid, samples: &[Sample]) -> Self {
        let hermite = HermiteNodes { row: Vec::new(), nodes: Vec::new() };
        Self { lattice: grid.lattice, values: lattice_values(grid, samples, &[]), hermite }
    }

    /// Share of the places with an error of the method within the tolerance; `None` if it has no table.
    pub(crate) fn share_within(
        &self,
        method: Method,
        places: &[Place],
        tolerance: &Tolerance,
    ) -> Option<f64> {
        let HermiteNodes { row, nodes } = &self.hermite;
        let planes = SpacePlanes {
            flags: &self.values.flags,
            force_n: Some(&self.values.force_n),
            hermite: (!row.is_empty()).then_some(HermitePlanes { row, nodes }),
            ..SpacePlanes::default()
        };
        let space = Space::new(ActiveNode::default(), self.lattice, planes, 0).ok()?;
        let mut within = 0;
        for &Place { at, exact } in places {
            let found = space.force(method, at.map(|x| x as f32))?.force_n;
            let error_n = norm(std::array::from_fn(|i| f64::from(found[i]) - exact[i]));
            within += usize::from(error_n <= tolerance.at(exact));
        }
        Some(within as f64 / places.len().max(1) as f64)
    }
}
