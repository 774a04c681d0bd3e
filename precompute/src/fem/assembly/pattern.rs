//! Sparsity of the tangent, computed once per problem, and the position of each element entry in it.
//!
//! Only the lower triangle of the symmetric matrix is stored, by columns. A precomputed map gives the
//! position of each element entry, so that the assembly needs no search.

use std::ops::Range;

use crate::fem::body::Body;
use crate::fem::boundary::DofMap;
use crate::fem::element::Order;

/// Sparsity of the lower triangle and the scatter map into it.
#[derive(Debug)]
pub(crate) struct Pattern {
    /// Column starts, `unknowns + 1`.
    pub(crate) column_starts: Vec<usize>,
    /// Row of every entry, sorted in each column; the diagonal comes first.
    pub(crate) rows: Vec<usize>,
    /// The elements with linear shape functions, then those with quadratic ones.
    kinds: [ElementEntries; 2],
    /// Positions of the entries that couple a multiplier to its displacement.
    pub(super) ties: Vec<usize>,
    /// Elements with a node of the handle, ascending.
    pub(super) handle_elements: Vec<u32>,
}

/// An entry of the lower triangle and its place in the values.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PlacedEntry {
    row: usize,
    column: usize,
    place: usize,
}

/// y -= A x of the symmetric matrix with these entries alone, for every column of `n` numbers.
pub(crate) fn subtract_product(entries: &[PlacedEntry], values: &[f64], x: &[f64], y: &mut [f64], n: usize) {
    for (x, y) in x.chunks(n).zip(y.chunks_mut(n)) {
        for &PlacedEntry { row, column, place } in entries {
            y[row] -= values[place] * x[column];
            if row != column {
                y[column] -= values[place] * x[row];
            }
        }
    }
}

/// Equations and entries of the elements with the same number of nodes.
#[derive(Debug)]
struct ElementEntries {
    /// Equations of each element's local unknowns: displacements node-major, then four pressures.
    dofs: Vec<u32>,
    /// Position of each element entry in the values; eliminated entries have the position one past the end.
    scatter: Vec<u32>,
    /// Pairs of local unknowns of an element.
    pairs: Vec<(usize, usize)>,
    /// Number of local unknowns of an element.
    stride: usize,
}

impl ElementEntries {
    /// Those of a range of elements, with an empty scatter map.
    fn new(body: &Body, dofs: &DofMap, range: Range<usize>, nodes: usize) -> Self {
        let stride = 3 * nodes + 4;
        let mut of_elements = Vec::with_capacity(stride * range.len());
        for index in range {
            let nodes = &body.nodes_of(index)[..nodes];
            of_elements.extend(nodes.iter().flat_map(|&node| dofs.displacement(node)));
            of_elements.extend(body.elements[index].pressures.map(|p| dofs.pressure(p)));
        }
        let pairs = local_pairs(nodes, body.has_pressure(), body.has_pressure_blocks).collect();
        Self { dofs: of_elements, scatter: Vec::new(), pairs, stride }
    }

    /// (row, column) in the lower triangle of each entry, element by element.
    fn entries(&self) -> impl Iterator<Item = (usize, usize)> {
        self.dofs.chunks(self.stride).flat_map(|local| {
            self.pairs
                .iter()
                .map(|&(i, j)| (local[i].max(local[j]) as usize, local[i].min(local[j]) as usize))
        })
    }
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
        let [linear, quadratic] = body.ranges();
        let mut kinds = [
            ElementEntries::new(body, dofs, linear, Order::Linear.nodes()),
            ElementEntries::new(body, dofs, quadratic, Order::Quadratic.nodes()),
        ];
        // Every diagonal entry exists, because the regularisation is added to pressures without a block.
        let mut columns: Vec<Vec<u32>> = (0..n).map(|i| vec![i as u32]).collect();
        let ties = || {
            dofs.multipliers.iter().map(|m| (m.equation as usize, dofs.displacement(m.node)[m.axis] as usize))
        };
        for (row, column) in kinds.iter().flat_map(ElementEntries::entries).filter(|&(row, _)| row < n) {
            columns[column].push(row as u32);
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
        for kind in &mut kinds {
            let place = |(row, column)| if row < n { place(row, column) as u32 } else { nowhere };
            kind.scatter = kind.entries().map(place).collect();
        }
        let ties = ties().map(|(row, column)| place(row, column)).collect();
        let prescribed = |dof: &u32| (n..n + 3).contains(&(*dof as usize));
        let elements = kinds.iter().flat_map(|kind| kind.dofs.chunks(kind.stride)).zip(0u32..);
        let handle_elements =
            elements.filter(|(local, _)| local.iter().any(prescribed)).map(|(_, element)| element).collect();
        Self { column_starts, rows, kinds, ties, handle_elements }
    }

    /// The pattern of some of the equations, ascending, and the places of its entries in the values.
    pub(crate) fn restricted(&self, keep: &[usize]) -> (Self, Vec<usize>) {
        let mut index = vec![usize::MAX; self.unknowns()];
        for (new, &old) in keep.iter().enumerate() {
            index[old] = new;
        }
        let (mut column_starts, mut rows, mut places) = (vec![0], Vec::new(), Vec::new());
        for &column in keep {
            for place in self.column_starts[column]..self.column_starts[column + 1] {
                let row = index[self.rows[place]];
                if row != usize::MAX {
                    rows.push(row);
                    places.push(place);
                }
            }
            column_starts.push(rows.len());
        }
        let none = || ElementEntries { dofs: Vec::new(), scatter: Vec::new(), pairs: Vec::new(), stride: 1 };
        let pattern = Self {
            column_starts,
            rows,
            kinds: [none(), none()],
            ties: Vec::new(),
            handle_elements: Vec::new(),
        };
        (pattern, places)
    }

    /// The entries that have some of the equations, ascending, as their row or column.
    pub(crate) fn entries_of(&self, equations: &[usize]) -> Vec<PlacedEntry> {
        let mut is_wanted = vec![false; self.unknowns()];
        equations.iter().for_each(|&equation| is_wanted[equation] = true);
        let column = |column: usize| {
            (self.column_starts[column]..self.column_starts[column + 1]).map(move |place| PlacedEntry {
                row: self.rows[place],
                column,
                place,
            })
        };
        let all = (0..self.unknowns()).flat_map(column);
        all.filter(|entry| is_wanted[entry.row] || is_wanted[entry.column]).collect()
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
        let [linear, quadratic] = &self.kinds;
        let beyond = element.checked_sub(linear.dofs.len() / linear.stride);
        let (kind, index) = beyond.map_or((linear, element), |index| (quadratic, index));
        &kind.dofs[kind.stride * index..kind.stride * (index + 1)]
    }

    /// Positions of each element's entries, element by element: of the linear, and of the quadratic ones.
    pub(super) fn scatter(&self) -> [std::slice::ChunksExact<'_, u32>; 2] {
        self.kinds.each_ref().map(|kind| kind.scatter.chunks_exact(kind.pairs.len()))
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

    /// y = A x for every column of x. Three at a time read the matrix once.
    pub(crate) fn multiply_columns(&self, values: &[f64], x: &[f64], y: &mut [f64]) {
        let n = self.unknowns();
        for (x, y) in x.chunks(3 * n).zip(y.chunks_mut(3 * n)) {
            if x.len() < 3 * n {
                x.chunks(n).zip(y.chunks_mut(n)).for_each(|(x, y)| self.multiply(values, x, y));
                continue;
            }
            let ([x0, x1, x2], [y0, y1, y2]) = (thirds(x), thirds_mut(y));
            y0.fill(0.0);
            y1.fill(0.0);
            y2.fill(0.0);
            for column in 0..n {
                let (start, end) = (self.column_starts[column], self.column_starts[column + 1]);
                let of_column = [x0[column], x1[column], x2[column]];
                let mut sums = of_column.map(|x| values[start] * x);
                for (&row, &value) in self.rows[start + 1..end].iter().zip(&values[start + 1..end]) {
                    y0[row] += value * of_column[0];
                    y1[row] += value * of_column[1];
                    y2[row] += value * of_column[2];
                    sums[0] += value * x0[row];
                    sums[1] += value * x1[row];
                    sums[2] += value * x2[row];
                }
                y0[column] += sums[0];
                y1[column] += sums[1];
                y2[column] += sums[2];
            }
        }
    }
}

fn thirds(x: &[f64]) -> [&[f64]; 3] {
    let (first, rest) = x.split_at(x.len() / 3);
    let (second, third) = rest.split_at(first.len());
    [first, second, third]
}

fn thirds_mut(x: &mut [f64]) -> [&mut [f64]; 3] {
    let (first, rest) = x.split_at_mut(x.len() / 3);
    let (second, third) = rest.split_at_mut(first.len());
    [first, second, third]
}
