//! Interpolation of the surface displacement from scattered configurations.

use faer::linalg::solvers::Llt;
use faer::prelude::Solve;
use faer::{Mat, Side};

use super::displacement::{DisplacementFault, fit_displacement};
use super::kernel::{DATA, NUGGET, entry, polynomials};
use super::{DisplacementFit, Sample, SurfaceMotionSample};
use crate::spec::{DisplacementBound, GridIndex, SpaceGrid};

/// Gaussian-kernel interpolation of the surface displacement from the displacement and slopes of all
/// configurations.
///
/// The method is that of [`super::KernelFit`] for the energy, with data of order 0 and 1, after subtraction
/// of the linear part at rest. An interpolated surface is a linear combination of the given ones with the
/// same weights for all nodes. The matrix is therefore factorised once, and no modes are needed.
#[derive(Debug)]
pub(crate) struct ScatteredMotion {
    length_m: f64,
    /// Displacements of the active node in units of the kernel length.
    centres: Vec<[f64; 3]>,
    factor: Llt<f64>,
    /// One row of surface components per datum, scaled by the kernel length, m.
    data: Vec<Vec<f64>>,
    /// Slopes at rest.
    base: [Vec<f32>; 3],
}

/// Number of data per configuration: the displacement and its three slopes, the first of [`DATA`].
const ORDERS: usize = 4;

impl ScatteredMotion {
    /// Interpolation of configurations, each with its displacement of the active node, m; the first is rest.
    /// `None` if the matrix is not positive definite.
    pub(crate) fn new(length_m: f64, configurations: &[([f64; 3], SurfaceMotionSample)]) -> Option<Self> {
        let base = configurations.first()?.1.slopes.clone();
        let centres: Vec<[f64; 3]> = configurations.iter().map(|(p, _)| p.map(|x| x / length_m)).collect();
        let n = ORDERS * centres.len();
        let mut matrix = Mat::<f64>::zeros(n, n);
        for (m, &x) in centres.iter().enumerate() {
            for (k, &y) in centres.iter().enumerate() {
                let (tables, e) = polynomials(x, y);
                for a in 0..ORDERS {
                    for b in 0..ORDERS {
                        // The diagonal of these orders is 1 without scaling.
                        matrix[(ORDERS * m + a, ORDERS * k + b)] = e * entry(DATA[a], DATA[b], &tables);
                    }
                }
            }
            for a in 0..ORDERS {
                matrix[(ORDERS * m + a, ORDERS * m + a)] += NUGGET[2];
            }
        }
        let mut data = Vec::with_capacity(n);
        for (p, moved) in configurations {
            let linear = |k: usize| -> f64 { (0..3).map(|i| p[i] * f64::from(base[i][k])).sum() };
            let displacement = moved.displacement_m.iter().enumerate();
            data.push(displacement.map(|(k, &u)| f64::from(u) - linear(k)).collect());
            for (slopes, base) in moved.slopes.iter().zip(&base) {
                let beside = slopes.iter().zip(base).map(|(s, b)| length_m * (f64::from(*s) - f64::from(*b)));
                data.push(beside.collect());
            }
        }
        Some(Self { length_m, centres, factor: matrix.llt(Side::Lower).ok()?, data, base })
    }

    /// The table of this motion at the points of `samples`. The bound is that of the scene; the interpolation
    /// between the configurations takes its share of it.
    pub(crate) fn table<E>(
        &self,
        grid: &SpaceGrid,
        samples: &[Sample],
        bound: DisplacementBound,
    ) -> Result<DisplacementFit, DisplacementFault<E>> {
        let solved: Vec<GridIndex> = samples.iter().map(|sample| sample.index).collect();
        // Each surface is read twice and costly to evaluate. The list is small, so it is kept in memory.
        let all: Vec<SurfaceMotionSample> =
            solved.iter().map(|&index| self.at(grid.displacement_m(index))).collect();
        fit_displacement(grid, &solved, &[], bound.at_points_of_a_fit(), |at| Ok(all[at].clone()))
    }

    /// Displacement and slopes of the surface at a displacement of the active node, m.
    pub(crate) fn at(&self, displacement_m: [f64; 3]) -> SurfaceMotionSample {
        let x = displacement_m.map(|p| p / self.length_m);
        let mut right = Mat::<f64>::zeros(self.data.len(), ORDERS);
        for (m, &centre) in self.centres.iter().enumerate() {
            let (tables, e) = polynomials(x, centre);
            for a in 0..ORDERS {
                for b in 0..ORDERS {
                    right[(ORDERS * m + b, a)] = e * entry(DATA[a], DATA[b], &tables);
                }
            }
        }
        let weights = self.factor.solve(&right);
        let sum = |order: usize| -> Vec<f64> {
            let mut sum = vec![0.0; self.base[0].len()];
            for (row, data) in self.data.iter().enumerate() {
                let weight = weights[(row, order)];
                for (sum, x) in sum.iter_mut().zip(data) {
                    *sum += weight * x;
                }
            }
            sum
        };
        let displacement = sum(0).into_iter().enumerate().map(|(k, u)| {
            (u + (0..3).map(|i| displacement_m[i] * f64::from(self.base[i][k])).sum::<f64>()) as f32
        });
        SurfaceMotionSample {
            displacement_m: displacement.collect(),
            slopes: std::array::from_fn(|axis| {
                let slopes = sum(axis + 1).into_iter().zip(&self.base[axis]);
                slopes.map(|(s, &base)| (s / self.length_m) as f32 + base).collect()
            }),
        }
    }
}

/// The displacement table of adaptively sampled configurations, each with its displacement of the active
/// node, m, rest first: their surface is interpolated with the kernel length l, m, at the points of
/// `samples`. `None` if two configurations coincide or a surface exceeds `bound`.
pub(crate) fn displacement_of_fit(
    length_m: f64,
    configurations: &[([f64; 3], SurfaceMotionSample)],
    (grid, samples): (&SpaceGrid, &[Sample]),
    bound: DisplacementBound,
) -> Option<DisplacementFit> {
    let motion = ScatteredMotion::new(length_m, configurations)?;
    motion.table::<std::convert::Infallible>(grid, samples, bound).ok()
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::spread;
    use super::*;

    /// Two nodes: the active node, and a node that rotates with it.
    fn moved(p: [f64; 3]) -> SurfaceMotionSample {
        let (s, c) = (15.0 * p[0]).sin_cos();
        let all = [p[0], p[1], p[2], 0.02 * s + 0.3 * p[1], 0.02 * (1.0 - c), 5.0 * p[1] * p[2]];
        let by_x = [1.0, 0.0, 0.0, 0.3 * c, 0.3 * s, 0.0];
        let by_y = [0.0, 1.0, 0.0, 0.3, 0.0, 5.0 * p[2]];
        let by_z = [0.0, 0.0, 1.0, 0.0, 0.0, 5.0 * p[1]];
        let narrow = |row: [f64; 6]| row.map(|x| x as f32).to_vec();
        SurfaceMotionSample {
            displacement_m: narrow(all),
            slopes: [narrow(by_x), narrow(by_y), narrow(by_z)],
        }
    }

    fn apart(a: &[f32], b: &[f32]) -> f32 {
        a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn a_surface_is_met_and_followed_between() {
        // Largest errors of displacement (m) and slopes for this number of configurations.
        let worst = |configurations: u32| {
            let places = std::iter::once([0.0; 3]).chain((1..configurations).map(|n| spread(n, 0.05)));
            let given: Vec<([f64; 3], SurfaceMotionSample)> = places.map(|p| (p, moved(p))).collect();
            let motion = ScatteredMotion::new(0.04, &given).expect("apart");
            for (p, given) in &given {
                assert!(apart(&motion.at(*p).displacement_m, &given.displacement_m) < 2e-5, "{p:?}");
            }
            let mut worst = [0.0f32; 2];
            for n in 500..600 {
                let p = spread(n, 0.045);
                let (found, truth) = (motion.at(p), moved(p));
                worst[0] = worst[0].max(apart(&found.displacement_m, &truth.displacement_m));
                for (found, truth) in found.slopes.iter().zip(&truth.slopes) {
                    worst[1] = worst[1].max(apart(found, truth));
                }
                // The active node follows the tool.
                assert!(apart(&found.displacement_m[..3], &p.map(|x| x as f32)) < 1e-6);
            }
            worst
        };
        let (few, many) = (worst(10), worst(80));
        println!("{few:?} {many:?}");
        assert!(many[0] < 0.1 * few[0] && many[1] < 0.2 * few[1], "{few:?} {many:?}");
        assert!(many[0] < 1e-4, "{many:?}");
    }
}
