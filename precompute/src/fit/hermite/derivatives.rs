//! Operations on the 27 derivatives of a corner in cell units; W is in newtons times cells.

use super::Derivatives;

/// The derivative with respect to these axes.
pub(super) fn part<'w>(w: &'w mut Derivatives, axes: &[usize]) -> &'w mut f64 {
    let [a, b, c] = orders(axes);
    &mut w[a][b][c]
}

pub(super) fn orders(axes: &[usize]) -> [usize; 3] {
    std::array::from_fn(|axis| axes.iter().filter(|&&a| a == axis).count())
}

/// All triples of orders along x, y and z with a sum of at most `most`.
pub(super) fn orders_up_to(most: usize) -> impl Iterator<Item = [usize; 3]> {
    let side = most + 1;
    (0..side * side * side)
        .map(move |code| [code / (side * side), code / side % side, code % side])
        .filter(move |orders| orders.iter().sum::<usize>() <= most)
}

pub(super) fn factorial(n: usize) -> f64 {
    (1..=n).product::<usize>() as f64
}

pub(super) fn orders_up_to_two() -> impl Iterator<Item = (usize, usize, usize)> {
    (0..27).map(|code| (code / 9, code / 3 % 3, code % 3))
}

/// Scales all derivatives of the force by one factor, so that no second derivative of W exceeds `limit_n`, N
/// per cell.
pub(super) fn limited_slopes(mut w: Derivatives, limit_n: f64) -> Derivatives {
    let steepest = largest(&w, |order| order == 2);
    if steepest > limit_n {
        scale(&mut w, limit_n / steepest, |order| order >= 2);
    }
    w
}

/// Limits the force and its derivatives to `limit_n` per cell, order by order.
pub(super) fn limited_ghost(mut w: Derivatives, limit_n: f64) -> Derivatives {
    for wanted in 1..=6 {
        let top = largest(&w, |order| order == wanted);
        if top > limit_n {
            scale(&mut w, limit_n / top, |order| order == wanted);
        }
    }
    w
}

/// Largest absolute derivative of the selected orders.
pub(super) fn largest(w: &Derivatives, of: impl Fn(usize) -> bool) -> f64 {
    let sizes = orders_up_to_two().filter(|&(a, b, c)| of(a + b + c)).map(|(a, b, c)| w[a][b][c].abs());
    sizes.fold(0.0, f64::max)
}

pub(super) fn scale(w: &mut Derivatives, factor: f64, of: impl Fn(usize) -> bool) {
    for (a, b, c) in orders_up_to_two().filter(|&(a, b, c)| of(a + b + c)) {
        w[a][b][c] *= factor;
    }
}
