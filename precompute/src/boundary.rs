//! Boundary conditions by elimination: which nodal values are unknown, and in what order.
//!
//! Fixed nodes (the paper's script F) and the active node (script A) are eliminated rather than tied by Lagrange
//! multipliers. The reaction is then the internal force at the active node, which equals the multiplier to
//! rounding; multipliers kept in the matrix cost hundreds of delayed pivots instead. Deviation from the paper,
//! in the algebra only.

use crate::element::Tet4;
use crate::solve::ordering::nested_dissection;

/// Marks a value that is prescribed to zero or does not exist.
pub const ABSENT: u32 = u32::MAX;

/// Numbers the unknowns of one body held at `fixed` nodes and at one active node.
///
/// Free nodes are ordered by nested dissection of the mesh graph; each gives its displacement components and,
/// for an incompressible law, its pressure one after the other, so that the factorisation sees dense 3 x 3 or
/// 4 x 4 blocks. The three prescribed components of the active node get the indices `unknowns() + axis`.
#[derive(Debug)]
pub struct DofMap {
    displacement: Vec<[u32; 3]>,
    pressure: Vec<u32>,
    unknowns: usize,
}

impl DofMap {
    /// Unknowns of `elements` over `node_count` nodes. With `pressures`, every node of an element that has a free
    /// vertex carries a multiplier; a node all of whose elements are held on every vertex would leave a zero row
    /// and gets none.
    pub fn new(
        elements: &[Tet4],
        node_count: usize,
        fixed: &[bool],
        active_node: u32,
        pressures: bool,
    ) -> Self {
        let held = |node: u32| fixed[node as usize] || node == active_node;
        let mut has_displacement = vec![false; node_count];
        let mut has_pressure = vec![false; node_count];
        for element in elements {
            let moves = element.nodes.iter().any(|&n| !held(n));
            for &node in &element.nodes {
                has_displacement[node as usize] |= !held(node);
                has_pressure[node as usize] |= pressures && moves;
            }
        }
        let order =
            nested_dissection(elements, node_count, |node| has_displacement[node] || has_pressure[node]);
        let mut displacement = vec![[ABSENT; 3]; node_count];
        let mut pressure = vec![ABSENT; node_count];
        let mut next = 0u32;
        for &node in &order {
            if has_displacement[node] {
                displacement[node] = [next, next + 1, next + 2];
                next += 3;
            }
            if has_pressure[node] {
                pressure[node] = next;
                next += 1;
            }
        }
        displacement[active_node as usize] = [next, next + 1, next + 2];
        Self { displacement, pressure, unknowns: next as usize }
    }

    /// Number of equations.
    pub fn unknowns(&self) -> usize {
        self.unknowns
    }

    /// Equation of each displacement component of `node`; `>= unknowns()` for the active node, [`ABSENT`] if fixed.
    #[inline]
    pub fn displacement(&self, node: u32) -> [u32; 3] {
        self.displacement[node as usize]
    }

    /// Equation of the pressure multiplier of `node`, or [`ABSENT`].
    #[inline]
    pub fn pressure(&self, node: u32) -> u32 {
        self.pressure[node as usize]
    }

    /// The 16 local unknowns of an element: 4 x 3 displacements, node-major, then 4 pressures.
    pub fn element(&self, element: &Tet4) -> [u32; 16] {
        let mut dofs = [ABSENT; 16];
        for (a, &node) in element.nodes.iter().enumerate() {
            dofs[3 * a..3 * a + 3].copy_from_slice(&self.displacement(node));
            dofs[12 + a] = self.pressure(node);
        }
        dofs
    }

    /// Pairs (equation, position in the state vector) of every unknown; see [`crate::body::Body`] for the state.
    pub fn state_positions(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let nodes = self.displacement.len();
        let displacements = self.displacement.iter().enumerate().flat_map(|(node, dofs)| {
            dofs.iter().enumerate().map(move |(axis, &dof)| (dof as usize, 3 * node + axis))
        });
        let pressures =
            self.pressure.iter().enumerate().map(move |(node, &dof)| (dof as usize, 3 * nodes + node));
        displacements.chain(pressures).filter(|&(dof, _)| dof < self.unknowns)
    }
}
