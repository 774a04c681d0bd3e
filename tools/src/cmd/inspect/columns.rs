//! Values in the columns of CSV tables.

/// A number of a table.
pub(super) fn number(x: f64) -> String {
    format!("{x:?}")
}

/// A value of a table; empty if there is none.
pub(super) fn field(value: Option<impl ToString>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

/// Numbers of a table; empty if there are none.
pub(super) fn numbers<const N: usize>(values: Option<[f64; N]>) -> [String; N] {
    values.map_or([const { String::new() }; N], |values| values.map(number))
}
