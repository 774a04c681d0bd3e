//! A held node among the unknowns of a body that is numbered without a handle.
//!
//! All contact points of a body then share numbering, pattern and analysis. The equations of the node keep their
//! places: after the assembly their rows and columns are read, K_fA and K_AA, and replaced by those of a
//! diagonal, so that the solution of these equations is zero whatever the other ones are.

use crate::fem::assembly::{HandleCoupling, Pattern};

/// The entries of the rows and columns of three prescribed components.
#[derive(Debug)]
pub(super) struct HeldEntries {
    /// (place in the values, equation, axis) of the coupling with the other equations.
    free: Vec<(usize, usize, usize)>,
    /// (place in the values, axes) of the block of the node itself, lower triangle.
    own: Vec<(usize, [usize; 2])>,
}

impl HeldEntries {
    /// Those of the node with these equations.
    pub(super) fn new(pattern: &Pattern, equations: [u32; 3]) -> Self {
        let equations = equations.map(|equation| equation as usize);
        let axis_of = |equation: usize| equations.iter().position(|&own| own == equation);
        let (mut free, mut own) = (Vec::new(), Vec::new());
        for column in 0..pattern.unknowns() {
            let span = pattern.column_starts[column]..pattern.column_starts[column + 1];
            let rows = &pattern.rows[span.clone()];
            match axis_of(column) {
                Some(axis) => {
                    for (place, &row) in span.zip(rows) {
                        match axis_of(row) {
                            Some(other) => own.push((place, [other, axis])),
                            None => free.push((place, row, axis)),
                        }
                    }
                }
                None => {
                    let entries = equations.iter().enumerate();
                    free.extend(entries.filter_map(|(axis, equation)| {
                        let index = rows.binary_search(equation).ok()?;
                        Some((span.start + index, column, axis))
                    }));
                }
            }
        }
        Self { free, own }
    }

    /// Moves the entries from the assembled tangent to `coupling`; `diagonal` takes the place of the node's own.
    pub(super) fn split(&self, tangent: &mut [f64], coupling: &mut HandleCoupling, diagonal: f64) {
        let n = coupling.free.len() / 3;
        coupling.free.fill(0.0);
        for &(place, equation, axis) in &self.free {
            coupling.free[axis * n + equation] = std::mem::take(&mut tangent[place]);
        }
        for &(place, [row, column]) in &self.own {
            let value = std::mem::replace(&mut tangent[place], if row == column { diagonal } else { 0.0 });
            coupling.own[(row, column)] = value;
            coupling.own[(column, row)] = value;
        }
    }
}
