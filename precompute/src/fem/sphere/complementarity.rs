//! Contact forces of linearised gaps: a linear complementarity problem with a symmetric matrix.
//!
//! s = q + D l >= 0,   l >= 0,   s . l = 0:
//!
//! the conditions of min l.D l / 2 + q.l over l >= 0. An active-set method adds the most violated gap, and leaves out
//! forces on the way to a solution where they would pull (Lawson and Hanson 1974).

use nalgebra::{DMatrix, DVector};

/// Gaps above this share of the largest |q| are closed.
const TOLERANCE: f64 = 1e-12;
/// Passes for each force.
const PASSES: usize = 8;

/// The forces l, starting from the set of `warm` forces; `None` if a part of D is singular or the passes do not
/// suffice. D is positive definite at a stable state; otherwise a gap may stay violated.
pub(crate) fn complementary(d: &DMatrix<f64>, q: &DVector<f64>, warm: &[bool]) -> Option<DVector<f64>> {
    let n = q.len();
    let closed = TOLERANCE * q.amax();
    let mut active: Vec<usize> = (0..n).filter(|&k| warm[k]).collect();
    let mut forces = DVector::zeros(n);
    let (mut tried, mut last): (Vec<usize>, Option<usize>) = (Vec::new(), None);
    for _ in 0..=PASSES * n {
        // The forces with the gaps of the set closed.
        loop {
            let part = DMatrix::from_fn(active.len(), active.len(), |i, j| d[(active[i], active[j])]);
            let right = DVector::from_fn(active.len(), |i, _| -q[active[i]]);
            let wanted = if active.is_empty() { right } else { part.lu().solve(&right)? };
            // The largest share of the way to them on which no force pulls.
            let share = |(i, &k): (usize, &usize)| {
                (wanted[i] <= 0.0).then(|| (forces[k] / (forces[k] - wanted[i]), k))
            };
            let first =
                active.iter().enumerate().filter_map(share).min_by(|a: &(f64, usize), b| a.0.total_cmp(&b.0));
            // A force of the start that pulls has no way: 0 / 0.
            let Some((share, leaves)) = first.map(|(share, k)| (if share.is_nan() { 0.0 } else { share }, k))
            else {
                active.iter().zip(wanted.iter()).for_each(|(&k, &force)| forces[k] = force);
                break;
            };
            for (&k, &force) in active.iter().zip(wanted.iter()) {
                forces[k] += share * (force - forces[k]);
            }
            forces[leaves] = 0.0;
            active.retain(|&k| k != leaves);
        }
        let gaps = q + d * &forces;
        // Where D is not positive definite, a gap that was closed may open again at once: the next one is tried.
        tried.extend(last.filter(|k| !active.contains(k)));
        let open = (0..n).filter(|k| !active.contains(k) && !tried.contains(k));
        let Some(worst) = open.min_by(|&a, &b| gaps[a].total_cmp(&gaps[b])) else { return Some(forces) };
        if gaps[worst] >= -closed {
            return Some(forces);
        }
        active.push(worst);
        last = Some(worst);
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A positive definite matrix and a vector of any sign.
    fn problem(seed: usize, n: usize) -> (DMatrix<f64>, DVector<f64>) {
        let number = |k: usize| libm::sin((97 * seed + 13 * k + 1) as f64);
        let root = DMatrix::from_fn(n, n, |i, j| number(i * n + j));
        (
            &root * root.transpose() + DMatrix::identity(n, n) * 0.05,
            DVector::from_fn(n, |i, _| number(1000 + i)),
        )
    }

    #[test]
    fn forces_push_and_gaps_are_closed_or_without_force() {
        for seed in 0..200 {
            let n = 1 + seed % 9;
            let (d, q) = problem(seed, n);
            let warm: Vec<bool> = (0..n).map(|k| (seed >> k) & 1 == 1).collect();
            let forces = complementary(&d, &q, &warm).expect("D is positive definite");
            let gaps = &q + &d * &forces;
            for (force, gap) in forces.iter().zip(gaps.iter()) {
                assert!(
                    *force >= 0.0 && *gap >= -1e-9 && (force * gap).abs() < 1e-9,
                    "{seed}: {force} {gap}"
                );
            }
        }
    }

    #[test]
    fn open_gaps_need_no_force() {
        let (d, _) = problem(1, 3);
        let forces =
            complementary(&d, &DVector::from_element(3, 1.0), &[true; 3]).expect("no part is singular");
        assert_eq!(forces, DVector::zeros(3));
    }
}
