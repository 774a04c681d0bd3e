//! Weights of many linear radial basis functions without a dense matrix: GMRES with a preconditioner of local
//! fits.
//!
//! For every centre, the k nearest centres are interpolated with a constant term: the function that is 1 at
//! the centre and 0 at the others. Its weights approximate those of the whole system, because without the
//! constant such functions decay fast (Beatson, Cherrie and Mouat, Adv. Comput. Math. 11, 1999). The weights
//! of a local fit sum to zero, so local fits cannot change the mean of a force; a rank-one term of the
//! preconditioner does. The matrix is computed row by row when it is applied, so the memory is that of the
//! Krylov vectors.
//!
//! Measured: 26 steps to 1e-11 at 1,459 centres, about 150 at 6,204; a Krylov space of 60 hardly converges.
//! For phi = r^3 with linear polynomials the residual is still 1e-1 after 60 steps, also with 20 to 60
//! distant points in every local fit. The cubic weights are therefore always computed by factorisation.

use nalgebra::{DMatrix, DVector};

use super::Centre;
use crate::num::parallel::{Pool, ThreadError};
use crate::num::vector::inner;

/// Number of centres of a local fit.
const NEAREST: usize = 48;
/// Number of steps of a cycle; the method then restarts.
const RESTART: usize = 250;
/// Maximum number of cycles of `RESTART` steps.
const CYCLES: usize = 4;
/// Target residual as a share of the right-hand side.
const TOLERANCE: f64 = 1e-10;

/// Weights of the three components, and the largest misfit, N.
pub(super) fn solve_iteratively(
    centres: &[Centre],
    threads: usize,
) -> Result<([Vec<f64>; 3], f64), ThreadError> {
    let system = System::new(centres, Pool::new(threads)?);
    let mut misfit_n = 0.0f64;
    let weights = std::array::from_fn(|axis| {
        let force: Vec<f64> = centres.iter().map(|c| c.force_n[axis]).collect();
        let weights = system.solve(&force);
        let reached = system.apply(&weights);
        for (force, reached) in force.iter().zip(reached) {
            let apart = (force - reached).abs();
            misfit_n = if apart.is_finite() { misfit_n.max(apart) } else { f64::INFINITY };
        }
        weights
    });
    Ok((weights, misfit_n))
}

struct System {
    /// Planes x, y, z.
    positions: [Vec<f64>; 3],
    /// Of every centre: its neighbours, and the weights of the local fit that is 1 at it.
    local: Vec<(Vec<u32>, Vec<f64>)>,
    /// Factor of the mean in the preconditioner.
    share: f64,
    pool: Pool,
}

impl System {
    fn new(centres: &[Centre], pool: Pool) -> Self {
        let n = centres.len();
        let positions = std::array::from_fn(|axis| centres.iter().map(|c| c.position[axis]).collect());
        let local = pool.numbers(n, |i| local_fit(centres, i));
        let mut system = Self { positions, local, share: 0.0, pool };
        // So large that the term weighs about as much as the local fits.
        let level = system.apply(&vec![1.0 / (n as f64).sqrt(); n]);
        system.share = 1.0 / (n as f64 * inner(&level, &level).sqrt());
        system
    }

    /// A w.
    fn apply(&self, weights: &[f64]) -> Vec<f64> {
        let [x, y, z] = &self.positions;
        self.pool.numbers(weights.len(), |i| {
            const LANES: usize = 8;
            let at = [x[i], y[i], z[i]];
            let mut sums = [0.0; LANES];
            let chunks = x.chunks(LANES).zip(y.chunks(LANES)).zip(z.chunks(LANES)).zip(weights.chunks(LANES));
            for (((x, y), z), w) in chunks {
                for ((((sum, x), y), z), w) in sums.iter_mut().zip(x).zip(y).zip(z).zip(w) {
                    let d = [at[0] - x, at[1] - y, at[2] - z];
                    *sum += w * (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
                }
            }
            sums.iter().sum()
        })
    }

    /// The preconditioner: local fits and the rank-one term of the mean.
    fn precondition(&self, values: &[f64]) -> Vec<f64> {
        let mut weights = vec![0.0; values.len()];
        for ((neighbours, local), value) in self.local.iter().zip(values) {
            for (&j, l) in neighbours.iter().zip(local) {
                weights[j as usize] += l * value;
            }
        }
        let level = self.share * values.iter().sum::<f64>();
        weights.iter_mut().for_each(|w| *w += level);
        weights
    }

    /// Restarted GMRES, preconditioned from the right: A M y = f, w = M y.
    fn solve(&self, force: &[f64]) -> Vec<f64> {
        let n = force.len();
        let goal = TOLERANCE * inner(force, force).sqrt();
        let mut weights = vec![0.0; n];
        for _ in 0..CYCLES {
            let mut residual = force.to_vec();
            add_scaled(&mut residual, &self.apply(&weights), -1.0);
            let start = inner(&residual, &residual).sqrt();
            if start <= goal {
                break;
            }
            residual.iter_mut().for_each(|r| *r /= start);
            let mut basis = vec![residual];
            // Hessenberg matrix by columns, reduced by Givens rotations.
            let (mut columns, mut rotations) = (Vec::<Vec<f64>>::new(), Vec::<(f64, f64)>::new());
            let mut right = vec![start];
            for step in 0..RESTART {
                let mut next = self.apply(&self.precondition(&basis[step]));
                let mut column = Vec::with_capacity(step + 2);
                // Orthogonalised twice, because rounding errors remain after one pass.
                for pass in 0..2 {
                    for (k, vector) in basis.iter().enumerate() {
                        let along = inner(&next, vector);
                        add_scaled(&mut next, vector, -along);
                        if pass == 0 { column.push(along) } else { column[k] += along }
                    }
                }
                let length = inner(&next, &next).sqrt();
                for (k, &(c, s)) in rotations.iter().enumerate() {
                    (column[k], column[k + 1]) =
                        (c * column[k] + s * column[k + 1], c * column[k + 1] - s * column[k]);
                }
                let size = libm::hypot(column[step], length);
                let (c, s) = (column[step] / size, length / size);
                column[step] = size;
                rotations.push((c, s));
                columns.push(column);
                right.push(-s * right[step]);
                right[step] *= c;
                if right[step + 1].abs() <= goal || length == 0.0 || !size.is_finite() {
                    break;
                }
                next.iter_mut().for_each(|v| *v /= length);
                basis.push(next);
            }
            // Back substitution, then the step.
            let m = columns.len();
            let mut y = right[..m].to_vec();
            for i in (0..m).rev() {
                y[i] /= columns[i][i];
                for k in 0..i {
                    y[k] -= columns[i][k] * y[i];
                }
            }
            let mut combined = vec![0.0; n];
            for (vector, y) in basis.iter().zip(&y) {
                add_scaled(&mut combined, vector, *y);
            }
            add_scaled(&mut weights, &self.precondition(&combined), 1.0);
        }
        weights
    }
}

/// The nearest centres of centre `i`, and the weights of the function that is 1 at it and 0 at the others.
fn local_fit(centres: &[Centre], i: usize) -> (Vec<u32>, Vec<f64>) {
    let squared = |j: usize, k: usize| -> f64 {
        centres[j].position.iter().zip(centres[k].position).map(|(a, b)| (a - b) * (a - b)).sum()
    };
    let mut order: Vec<(f64, u32)> = (0..centres.len()).map(|j| (squared(i, j), j as u32)).collect();
    let count = NEAREST.min(order.len());
    let by_distance = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    if count < order.len() {
        order.select_nth_unstable_by(count - 1, by_distance);
        order.truncate(count);
    }
    order.sort_unstable_by(by_distance);
    let near: Vec<u32> = order.into_iter().map(|(_, j)| j).collect();
    let size = count + 1;
    let matrix = DMatrix::from_fn(size, size, |a, b| match (a < count, b < count) {
        (true, true) => squared(near[a] as usize, near[b] as usize).sqrt(),
        (false, false) => 0.0,
        _ => 1.0,
    });
    let at = near.iter().position(|&j| j as usize == i).unwrap_or(0);
    let unit = DVector::from_fn(size, |a, _| f64::from(u8::from(a == at)));
    let weights =
        matrix.lu().solve(&unit).map_or_else(|| vec![0.0; count], |w| w.as_slice()[..count].to_vec());
    (near, weights)
}

fn add_scaled(to: &mut [f64], from: &[f64], share: f64) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += share * from;
    }
}
