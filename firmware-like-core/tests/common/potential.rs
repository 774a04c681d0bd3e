//! The analytic organ: a nonlinear potential with all its derivatives.

use palpate_core::vec3::Vec3;

/// W = a |d|^2 / 2 + b z^3 / 3 + c |d|^4 / 4 + e x y z,   h = grad W,   h(0) = 0
///
/// Stiffer in compression than in tension, with coupling of the axes. z is along the outward normal: pressing
/// has z < 0 and h_z < 0.
pub const A: f64 = 150.0;
const B: f64 = -900.0;
const C: f64 = 4.0e4;
const E: f64 = 2.0e3;

/// A factor and the powers of x, y and z.
pub type Monomial = (f64, [usize; 3]);

/// The monomials of W.
const MONOMIALS: [Monomial; 11] = [
    (A / 2.0, [2, 0, 0]),
    (A / 2.0, [0, 2, 0]),
    (A / 2.0, [0, 0, 2]),
    (B / 3.0, [0, 0, 3]),
    (C / 4.0, [4, 0, 0]),
    (C / 4.0, [0, 4, 0]),
    (C / 4.0, [0, 0, 4]),
    (C / 2.0, [2, 2, 0]),
    (C / 2.0, [2, 0, 2]),
    (C / 2.0, [0, 2, 2]),
    (E, [1, 1, 1]),
];

/// The derivative of W of these orders along x, y and z.
pub fn potential(d: Vec3, orders: [usize; 3]) -> f64 {
    polynomial(&MONOMIALS, d, orders)
}

/// The derivative of a sum of monomials of these orders along x, y and z.
pub fn polynomial(monomials: &[Monomial], d: Vec3, orders: [usize; 3]) -> f64 {
    let falling = |n: usize, k: usize| (0..k).map(|i| n as f64 - i as f64).product::<f64>();
    let of = |&(factor, powers): &Monomial| -> f64 {
        let along = |i: usize| {
            let left = powers[i].checked_sub(orders[i]);
            left.map_or(0.0, |left| falling(powers[i], orders[i]) * f64::from(d[i]).powi(left as i32))
        };
        factor * along(0) * along(1) * along(2)
    };
    monomials.iter().map(of).sum()
}

/// The gradient of W.
pub fn force(d: Vec3) -> [f64; 3] {
    let [x, y, z] = d.map(f64::from);
    let radial = A + C * (x * x + y * y + z * z);
    [radial * x + E * y * z, radial * y + E * x * z, radial * z + B * z * z + E * x * y]
}
