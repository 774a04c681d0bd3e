//! The layer against the fixed part.
//!
//! What is fixed does not give way. There a layer whose pressure grows with the third power of the overlap becomes stiffer
//! than any device can render: for the force of a hand it would have to be scaled down, and the softer wall be pressed deeper
//! still. Under a live hand the layer is therefore a spring there, which begins as elsewhere. With the overlap D = R_o - r and
//! t = D / d, on a plane
//!
//! F(D) = a t^4 / (1 + b t^3),   a = 2 pi R_o k d / 4,   b = a / (K d),
//!
//! which becomes linear with the stiffness K, and is nowhere stiffer than 4 K / 3. A plane at the distance h from the centre
//! is pressed with 2 pi h P, where P is the energy per area at the overlap R_o - h. Hence
//!
//! phi(r) = F(R_o - r) / (2 pi r),
//!
//! which also keeps the skin away from the centre.

use std::f64::consts::TAU;

/// Stiffness K of a plane wall, N/m: stiffer than soft tissue, and for most devices no reason to scale the force.
const WALL_N_M: f64 = 1_500.0;

/// phi and its first three derivatives by r, per area, at the distance r within a layer with the thickness d, m, and the
/// pressure k, Pa, that begins at the radius `outer_m`.
pub(super) fn potential((d, k): (f64, f64), outer_m: f64, r: f64) -> [f64; 4] {
    let a = 0.25 * TAU * outer_m * k * d;
    let b = a / (WALL_N_M * d);
    let t = (outer_m - r) / d;
    let (t2, t3) = (t * t, t * t * t);
    let below = 1.0 + b * t3;
    let squared = below * below;
    // F by t, and by r.
    let f = [
        t2 * t2 / below,
        t3 * (4.0 + b * t3) / squared,
        6.0 * t2 * (2.0 - b * t3) / (squared * below),
        (t * (24.0 - 30.0 * b * t3) * below - 9.0 * b * t2 * t2 * (12.0 - 6.0 * b * t3))
            / (squared * squared),
    ];
    let [g, g1, g2, g3] = [a * f[0], -a * f[1] / d, a * f[2] / (d * d), -a * f[3] / (d * d * d)];
    let by = 1.0 / (TAU * r);
    [
        by * g,
        by * (g1 - g / r),
        by * (g2 - 2.0 * g1 / r + 2.0 * g / (r * r)),
        by * (g3 - 3.0 * g2 / r + 6.0 * g1 / (r * r) - 6.0 * g / (r * r * r)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// That of a sphere of 10 mm.
    const LAYER: (f64, f64) = (2e-3, 1e5);
    const OUTER_M: f64 = 0.01 + 2.0 / 3.0 * 2e-3;

    #[test]
    fn the_derivatives_are_differences() {
        for overlap_m in [1e-4, 1e-3, 2e-3, 5e-3, 8e-3] {
            let (r, step_m) = (OUTER_M - overlap_m, 1e-7);
            let [before, at, after] = [-step_m, 0.0, step_m].map(|by| potential(LAYER, OUTER_M, r + by));
            for order in 0..3 {
                let slope = (after[order] - before[order]) / (2.0 * step_m);
                let wanted = at[order + 1];
                assert!(
                    (slope - wanted).abs() < 1e-5 * wanted.abs().max(at[2].abs() * 1e-3),
                    "{overlap_m} {order}"
                );
            }
        }
    }

    /// The sum over rings of a plane.
    #[test]
    fn a_plane_is_a_spring() {
        let force_n = |overlap_m: f64| {
            let (h, rings) = (OUTER_M - overlap_m, 20_000);
            let width_m = (OUTER_M - h) / f64::from(rings);
            let ring = |n: u32| {
                let r = h + (f64::from(n) + 0.5) * width_m;
                -potential(LAYER, OUTER_M, r)[1] * h / r * TAU * r * width_m
            };
            (0..rings).map(ring).sum::<f64>()
        };
        let steps: Vec<f64> = (0..80).map(|n| force_n(1e-4 * f64::from(n))).collect();
        let slopes: Vec<f64> = steps.windows(2).map(|pair| (pair[1] - pair[0]) / 1e-4).collect();
        let stiffest_n_m = slopes.iter().copied().fold(0.0, f64::max);
        assert!(stiffest_n_m > WALL_N_M && stiffest_n_m < 1.34 * WALL_N_M, "{stiffest_n_m}");
        assert!(slopes[60..].iter().all(|slope| (slope / WALL_N_M - 1.0).abs() < 0.1), "{slopes:?}");
        // A light touch is that of the layer on anything else that does not move.
        let light_n = 0.25 * TAU * OUTER_M * LAYER.1 * LAYER.0 * 0.1f64.powi(4);
        assert!((force_n(0.1 * LAYER.0) / light_n - 1.0).abs() < 0.01);
    }
}
