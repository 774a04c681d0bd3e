//! Values in the columns of CSV tables.

/// Numbers of a table; empty cells if there are none.
pub(super) fn cells<const N: usize>(values: Option<[f64; N]>) -> Vec<Option<f64>> {
    values.map_or(vec![None; N], |values| values.map(Some).into())
}
