//! LDL^T in single precision, of a matrix scaled to a unit diagonal. It is no solution but a preconditioner: half the
//! memory and half the time of one in double precision, for the same number of steps.
//!
//! With D = diag(|K_ii|)^(-1/2) the factor is that of D (K - delta V / mu) D. The vectors are scaled to a largest
//! component of one, so that their size does not matter.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::ldlt::factor::LdltRegularization;
use faer::sparse::linalg::cholesky::LdltRef;
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};

use super::symbolic::{SymbolicFactor, negative_pivots};
use super::{Matrix, RIGHT_SIDES};

/// A factor to apply from any number of threads, each with its [`SingleScratch`].
#[derive(Debug)]
pub(in crate::fem::solve) struct SingleFactor {
    values: Vec<f32>,
    /// D, by equation.
    scale: Vec<f64>,
}

/// Scratch memory of one thread.
pub(in crate::fem::solve) struct SingleScratch {
    memory: MemBuffer,
    columns: Vec<f32>,
}

impl std::fmt::Debug for SingleScratch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SingleScratch").field("columns", &self.columns.len()).finish()
    }
}

impl SingleScratch {
    /// For factors of this analysis.
    pub(in crate::fem::solve) fn new(symbolic: &SymbolicFactor, unknowns: usize) -> Self {
        let analysis = &symbolic.symbolic;
        let memory = analysis
            .factorize_numeric_ldlt_scratch::<f32>(Par::Seq, Default::default())
            .or(analysis.solve_in_place_scratch::<f32>(RIGHT_SIDES, Par::Seq));
        Self { memory: MemBuffer::new(memory), columns: vec![0.0; RIGHT_SIDES * unknowns] }
    }
}

impl SingleFactor {
    /// Memory for a factor of this analysis.
    pub(in crate::fem::solve) fn new(symbolic: &SymbolicFactor, unknowns: usize) -> Self {
        Self { values: vec![0.0; symbolic.factor_entries()], scale: vec![1.0; unknowns] }
    }

    /// Factorises a matrix; whether that is possible.
    pub(in crate::fem::solve) fn make(
        &mut self,
        matrix: Matrix<'_>,
        delta: f64,
        scratch: &mut SingleScratch,
    ) -> bool {
        let Matrix { symbolic, pattern, values, .. } = matrix;
        let n = pattern.unknowns();
        let mut regularised = values[..pattern.entries()].to_vec();
        for &(place, size) in &symbolic.pressure_diagonal {
            regularised[place] -= delta * size;
        }
        for (scale, &start) in self.scale.iter_mut().zip(&pattern.column_starts) {
            let diagonal = regularised[start].abs();
            *scale = if diagonal > 0.0 { 1.0 / diagonal.sqrt() } else { 1.0 };
        }
        let mut scaled = Vec::with_capacity(regularised.len());
        for column in 0..n {
            let span = pattern.column_starts[column]..pattern.column_starts[column + 1];
            let entries = pattern.rows[span.clone()].iter().zip(&regularised[span]);
            scaled.extend(entries.map(|(&row, value)| (value * self.scale[column] * self.scale[row]) as f32));
        }
        drop(regularised);
        let structure =
            SymbolicSparseColMatRef::new_checked(n, n, &pattern.column_starts, None, &pattern.rows);
        let matrix = SparseColMatRef::new(structure, &scaled);
        let shift = LdltRegularization::default();
        let stack = MemStack::new(&mut scratch.memory);
        let made = symbolic.symbolic.factorize_numeric_ldlt(
            &mut self.values,
            matrix,
            Side::Lower,
            shift,
            Par::Seq,
            stack,
            Default::default(),
        );
        made.is_ok()
    }

    /// The entries by the analysis, and D by equation.
    pub(super) fn into_parts(self) -> (Vec<f32>, Vec<f64>) {
        (self.values, self.scale)
    }

    /// Replaces the columns r by M^-1 r.
    pub(in crate::fem::solve) fn solve(
        &self,
        symbolic: &SymbolicFactor,
        columns: &mut [f64],
        scratch: &mut SingleScratch,
    ) {
        let n = self.scale.len();
        let count = columns.len() / n;
        let mut sizes = [0.0f64; RIGHT_SIDES];
        for ((column, single), size) in columns.chunks(n).zip(scratch.columns.chunks_mut(n)).zip(&mut sizes) {
            let scaled = column.iter().zip(&self.scale).map(|(value, scale)| value * scale);
            *size = scaled.clone().fold(0.0f64, |most, value| most.max(value.abs()));
            let unit = if *size > 0.0 { 1.0 / *size } else { 0.0 };
            single.iter_mut().zip(scaled).for_each(|(single, value)| *single = (value * unit) as f32);
        }
        let right = MatMut::from_column_major_slice_mut(&mut scratch.columns[..count * n], n, count);
        let factor = LdltRef::new(&symbolic.symbolic, &self.values);
        factor.solve_in_place_with_conj(Conj::No, right, Par::Seq, MemStack::new(&mut scratch.memory));
        for ((column, single), size) in columns.chunks_mut(n).zip(scratch.columns.chunks(n)).zip(sizes) {
            for ((value, &single), scale) in column.iter_mut().zip(single).zip(&self.scale) {
                *value = f64::from(single) * scale * size;
            }
        }
    }

    /// Number of negative pivots minus those of a stable state.
    pub(in crate::fem::solve) fn unstable_modes(&self, symbolic: &SymbolicFactor) -> Option<u32> {
        Some(negative_pivots(symbolic, &self.values)?.abs_diff(symbolic.negative_when_stable) as u32)
    }
}
