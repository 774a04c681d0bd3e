//! Sparsity of the tangent, computed once per problem, and the position of each element entry in it.
//!
//! Only the lower triangle of the symmetric matrix is stored, by columns. A precomputed map gives the
//! position of each element entry, so that the assembly needs no search.

use crate::fem::body::Body;
use crate::fem::boundary::DofMap;

/// Sparsity of the lower triangle and the scatter map into it.
#[derive(Debug)]
pub(crate) struct Pattern {
    /// Column starts, `unknowns + 1`.
    pub(crate) column_starts: Vec<usize>,
    /// Row of every entry, sorted in each column; the diagonal comes first.
    pub(crate) rows: Vec<usize>,
    /// Equations of each element's local unknowns: displacements node-major, then four pressures.
    element_dofs: Vec<u32>,
    /// Position of each element entry in the values; eliminated entries have the position one past the end.
    scatter: Vec<u32>,
    /// Numbers of local unknowns and of entries of an element.
    strides: [usize; 2],
    /// Positions of the entries that couple a multiplier to its displacement.
    pub(super) ties: Vec<usize>,
    /// Elements with a node of the handle.
    pub(super) handle_elements: Vec<u32>,
}

/// Pairs (row, column) of local unknowns in the order of the scatter map. First the displacement blocks of
/// nodes (a, b) with b <= a, row-major; of the diagonal blocks only the lower triangle. Then the coupling of
/// each pressure, then the lower triangle of the pressure block.
fn local_pairs(nodes: usize, pressures: bool, blocks: bool) -> impl Iterator<Item = (usize, usize)> {
    let displacements = 3 * nodes;
    let blocks_of_nodes = (0..nodes).flat_map(|a| (0..=a).map(move |b| (a, b))).flat_map(|(a, b)| {
        (0..3).flat_map(move |i| (0..if a == b { i + 1 } else { 3 }).map(move |j| (3 * a + i, 3 * b + j)))
    });
    let coupling = (0..if pressures { 4 } else { 0 })
        .flat_map(move |v| (0..displacements).map(move |j| (displacements + v, j)));
    let pressure = (0..if blocks { 4 } else { 0 })
        .flat_map(move |u| (0..=u).map(move |v| (displacements + u, displacements + v)));
    blocks_of_nodes.chain(coupling).chain(pressure)
}

impl Pattern {
    /// Pattern of `body` with the unknowns of `dofs`.
    pub(crate) fn new(body: &Body, dofs: &DofMap) -> Self {
        let n = dofs.unknowns;
        let nodes = body.order.nodes();
        let pairs: Vec<(usize, usize)> =
            local_pairs(nodes, body.has_pressure(), body.has_pressure_blocks).collect();
        let stride = 3 * nodes + 4;
        let mut element_dofs = Vec::with_capacity(stride * body.elements.len());
        for (index, element) in body.elements.iter().enumerate() {
            element_dofs.extend(body.nodes_of(index).iter().flat_map(|&node| dofs.displacement(node)));
            element_dofs.extend(element.pressures.map(|p| dofs.pressure(p)));
        }
        // Every diagonal entry exists, because the regularisation is added to pressures without a block.
        let mut columns: Vec<Vec<u32>> = (0..n).map(|i| vec![i as u32]).collect();
        let ties = || {
            dofs.multipliers.iter().map(|m| (m.equation as usize, dofs.displacement(m.node)[m.axis] as usize))
        };
        for local in element_dofs.chunks(stride) {
            for &(i, j) in &pairs {
                let (row, column) = (local[i].max(local[j]), local[i].min(local[j]));
                if (row as usize) < n {
                    columns[column as usize].push(row);
                }
            }
        }
        for (multiplier, displacement) in ties() {
            columns[displacement].push(multiplier as u32);
        }
        let mut column_starts = Vec::with_capacity(n + 1);
        let mut rows = Vec::new();
        column_starts.push(0);
        for column in &mut columns {
            column.sort_unstable();
            column.dedup();
            rows.extend(column.iter().map(|&r| r as usize));
            column_starts.push(rows.len());
        }
        let place = |row: usize, column: usize| {
            let (start, end) = (column_starts[column], column_starts[column + 1]);
            start + rows[start..end].binary_search(&row).expect("every pair was entered above")
        };
        let nowhere = rows.len() as u32;
        let mut scatter = Vec::with_capacity(pairs.len() * body.elements.len());
        for local in element_dofs.chunks(stride) {
            scatter.extend(pairs.iter().map(|&(i, j)| {
                let (row, column) = (local[i].max(local[j]) as usize, local[i].min(local[j]) as usize);
                if row < n { place(row, column) as u32 } else { nowhere }
            }));
        }
        let ties = ties().map(|(row, column)| place(row, column)).collect();
        let prescribed = |dof: &u32| (n..n + 3).contains(&(*dof as usize));
        let handle_elements = element_dofs
            .chunks(stride)
            .zip(0u32..)
            .filter(|(local, _)| local.iter().any(prescribed))
            .map(|(_, element)| element)
            .collect();
        Self {
            column_starts,
            rows,
            element_dofs,
            scatter,
            strides: [stride, pairs.len()],
            ties,
            handle_elements,
        }
    }

    /// Place in the values of the entry of two equations that share an element; one past the end if one of them
    /// does not exist.
    pub(crate) fn place_or_nowhere(&self, one: u32, other: u32) -> usize {
        let (row, column) = (one.max(other) as usize, one.min(other) as usize);
        if row >= self.unknowns() {
            return self.entries();
        }
        let (start, end) = (self.column_starts[column], self.column_starts[column + 1]);
        start + self.rows[start..end].binary_search(&row).expect("the equations share an element")
    }

    /// Number of equations.
    pub(crate) fn unknowns(&self) -> usize {
        self.column_starts.len() - 1
    }

    /// Number of stored entries.
    pub(crate) fn entries(&self) -> usize {
        self.rows.len()
    }

    /// Equations of an element's local unknowns.
    pub(super) fn dofs_of(&self, element: usize) -> &[u32] {
        let stride = self.strides[0];
        &self.element_dofs[stride * element..stride * (element + 1)]
    }

    /// Positions of each element's entries, element by element.
    pub(super) fn scatter(&self) -> std::slice::ChunksExact<'_, u32> {
        self.scatter.chunks_exact(self.strides[1])
    }

    /// The same entries as columns of the upper triangle: (column starts, sorted rows).
    pub(crate) fn upper_triangle(&self) -> (Vec<usize>, Vec<usize>) {
        let n = self.unknowns();
        let mut columns = vec![Vec::new(); n];
        for column in 0..n {
            for &row in &self.rows[self.column_starts[column]..self.column_starts[column + 1]] {
                columns[row].push(column);
            }
        }
        let starts = std::iter::once(0)
            .chain(columns.iter().scan(0, |total, column| {
                *total += column.len();
                Some(*total)
            }))
            .collect();
        (starts, columns.concat())
    }

    /// y = A x for the symmetric matrix whose lower triangle has the `values`.
    pub(crate) fn multiply(&self, values: &[f64], x: &[f64], y: &mut [f64]) {
        y.fill(0.0);
        for column in 0..self.unknowns() {
            let (start, end) = (self.column_starts[column], self.column_starts[column + 1]);
            let x_column = x[column];
            let mut sum = values[start] * x_column;
            for (&row, &value) in self.rows[start + 1..end].iter().zip(&values[start + 1..end]) {
                y[row] += value * x_column;
                sum += value * x[row];
            }
            y[column] += sum;
        }
    }
}
