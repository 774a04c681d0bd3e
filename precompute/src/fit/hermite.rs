//! The table of the methods `hermite` and `energy`: 27 derivatives of W at every corner of the cells that a
//! query can use.
//!
//! In cell units, with W_abc = d^(a+b+c) W / dx^a dy^b dz^c and a, b, c in 0..=2:
//!
//! - Orders 0 to 3 are exact: W, h, S and W_ijk of the solver.
//! - W_iijj and W_iijk are differences of W_ijk with respect to the neighbours; W_iijjk and W_iijjkk are
//!   differences of those and of W_ijk. Each is the mean over all available differences: central if both
//!   neighbours are solved, one-sided at the boundary.
//! - No difference is taken across a branch jump, because W is not smooth there.
//!
//! A corner without a configuration is a ghost. It is the degree-5 polynomial that best fits W, h, S and
//! W_ijk of its neighbours. With too few neighbours it is the mean of the Taylor polynomials of the nearest
//! ones.

mod derivatives;

use std::collections::HashSet;

use faer::Mat;
use faer::linalg::solvers::SolveLstsq;
use palpate_core::HermiteNode;

use derivatives::{factorial, limited_ghost, limited_slopes, orders, orders_up_to, orders_up_to_two, part};

use super::branch_jump::BranchJump;
use super::ghosts::{GHOST_FORCE_LIMIT, cells_with_jumps, mean_of_nearest};
use super::{Derivatives, Sample};
use crate::num::vector::norm;
use crate::spec::{Domain, GridIndex, SpaceGrid, corners, neighbours, plus};

/// The table in the core's form.
#[derive(Debug, Clone, PartialEq)]
pub struct HermiteNodes {
    /// Index into `nodes` for every slot of the box.
    pub row: Vec<u32>,
    /// One node per corner of a reachable cell. The first is the rest point, which all other slots share.
    pub nodes: Vec<HermiteNode>,
}

/// The table of a sphere's root at `samples`. All other slots share a node of zeros.
pub(crate) fn root_nodes(grid: &SpaceGrid, samples: &[Sample]) -> HermiteNodes {
    let mut table = HermiteNodes { row: vec![0; grid.lattice.slots()], nodes: vec![HermiteNode::default()] };
    for sample in samples {
        if let Some(slot) = grid.lattice.slot(sample.index) {
            table.row[slot] = table.nodes.len() as u32;
            table.nodes.push(packed(&exact(sample, grid.spacing_m).w));
        }
    }
    table
}

/// The table of `samples`, sorted by index, including the rest point.
pub fn hermite_nodes(grid: &SpaceGrid, samples: &[Sample], branch_jumps: &[BranchJump]) -> HermiteNodes {
    let slots = grid.lattice.slots();
    let mut solved = vec![None; slots];
    for sample in samples {
        if let Some(slot) = grid.lattice.slot(sample.index) {
            solved[slot] = Some(exact(sample, grid.spacing_m));
        }
    }
    let mut cuts: Vec<(GridIndex, GridIndex)> =
        branch_jumps.iter().flat_map(|jump| [(jump.from, jump.to), (jump.to, jump.from)]).collect();
    cuts.sort_unstable();
    let mut field = Field { grid, solved, cuts };
    if samples.iter().any(|sample| sample.derivatives.is_none()) {
        field.differentiate();
    }
    let mut table = HermiteNodes { row: vec![0; slots], nodes: Vec::new() };
    let at_jumps: HashSet<GridIndex> =
        branch_jumps.iter().flat_map(cells_with_jumps).flat_map(corners).collect();
    let largest_n = samples.iter().map(|s| norm(s.jet.force_n)).fold(0.0, f64::max);
    for index in Domain::new(grid, true).points() {
        let Some(slot) = grid.lattice.slot(index) else { continue };
        let node = match field.solved[slot] {
            Some(known) if at_jumps.contains(&index) => {
                limited_slopes(known.w, MAX_SLOPE_RATIO * field.steepest(index))
            }
            Some(known) => known.w,
            None => {
                let free = field.fitted(index).unwrap_or_else(|| field.ghost(index));
                limited_ghost(free, GHOST_FORCE_LIMIT * largest_n)
            }
        };
        table.row[slot] = table.nodes.len() as u32;
        table.nodes.push(packed(&node));
    }
    table
}

/// Limit of the slopes at a branch jump, as a multiple of the largest change of the force to a neighbour,
/// because a slope can belong to a branch that ends within the cell. The limit is that of monotone cubic
/// interpolation (Fritsch and Carlson, SIAM J. Numer. Anal. 17, 1980: 3).
const MAX_SLOPE_RATIO: f64 = 3.0;

/// A solved node: its table entries, and the pure third derivatives, which the table does not contain.
#[derive(Debug, Clone, Copy)]
struct Known {
    w: Derivatives,
    pure: [f64; 3],
}

fn exact(sample: &Sample, spacing_m: f64) -> Known {
    let mut w = Derivatives::default();
    w[0][0][0] = sample.jet.energy_j / spacing_m;
    for (i, h) in sample.jet.force_n.iter().enumerate() {
        *part(&mut w, &[i]) = *h;
        for j in i..3 {
            *part(&mut w, &[i, j]) = sample.jet.stiffness_n_m[(i, j)] * spacing_m;
        }
    }
    let mut pure = [0.0; 3];
    for (triple, third) in crate::num::jet::THIRD_INDICES.iter().zip(sample.jet.third_n_m2) {
        let value = third * spacing_m * spacing_m;
        let [i, j, k] = *triple;
        if i == k {
            pure[i] = value;
        } else {
            *part(&mut w, &[i, j, k]) = value;
        }
    }
    if let Some(all) = sample.derivatives {
        w = all;
        for (a, b, c) in orders_up_to_two() {
            w[a][b][c] *= spacing_m.powi((a + b + c) as i32 - 1);
        }
    }
    Known { w, pure }
}

/// Solved nodes by slot.
struct Field<'g> {
    grid: &'g SpaceGrid,
    solved: Vec<Option<Known>>,
    /// Pairs of neighbours with a branch jump between them, in both directions, sorted.
    cuts: Vec<(GridIndex, GridIndex)>,
}

impl Field<'_> {
    /// The neighbour of `index`, or `None` if it is unsolved or on a different branch.
    fn joined(&self, index: GridIndex, axis: usize, step: i32) -> Option<&Known> {
        let mut other = index;
        other[axis] += step;
        let known = self.solved[self.grid.lattice.slot(other)?].as_ref()?;
        self.cuts.binary_search(&(index, other)).is_err().then_some(known)
    }

    /// Largest change of |h| to a solved neighbour on any branch, N.
    fn steepest(&self, index: GridIndex) -> f64 {
        let force = |at: GridIndex| -> Option<[f64; 3]> {
            let w = &self.solved[self.grid.lattice.slot(at)?].as_ref()?.w;
            Some([w[1][0][0], w[0][1][0], w[0][0][1]])
        };
        let Some(here) = force(index) else { return 0.0 };
        neighbours()
            .filter_map(|step| force(plus(index, step)))
            .map(|there| norm(std::array::from_fn(|i| there[i] - here[i])))
            .fold(0.0, f64::max)
    }

    /// First difference of a derivative along an axis.
    fn first(&self, index: GridIndex, of: &[usize], axis: usize) -> Option<f64> {
        let [a, b, c] = orders(of);
        let value = |known: &Known| known.w[a][b][c];
        let here = value(self.solved[self.grid.lattice.slot(index)?].as_ref()?);
        match [-1, 1].map(|step| self.joined(index, axis, step).map(value)) {
            [Some(low), Some(high)] => Some(0.5 * (high - low)),
            [None, Some(high)] => Some(high - here),
            [Some(low), None] => Some(here - low),
            [None, None] => None,
        }
    }

    /// Second difference of a derivative along an axis.
    fn second(&self, index: GridIndex, of: &[usize], axis: usize) -> Option<f64> {
        let [a, b, c] = orders(of);
        let value = |known: &Known| known.w[a][b][c];
        let here = value(self.solved[self.grid.lattice.slot(index)?].as_ref()?);
        let [low, high] = [-1, 1].map(|step| self.joined(index, axis, step).map(value));
        Some(high? - 2.0 * here + low?)
    }

    /// Computes the derivatives of order four and more. Each order uses the previous one.
    fn differentiate(&mut self) {
        const PAIRS: [[usize; 3]; 3] = [[0, 1, 2], [0, 2, 1], [1, 2, 0]];
        self.fill(|field, at, w| {
            for [i, j, k] in PAIRS {
                *part(w, &[i, i, j, j]) =
                    mean([field.first(at, &[i, i, j], j), field.first(at, &[i, j, j], i)]);
                // Twice with respect to k, once to i and once to j.
                *part(w, &[i, j, k, k]) = mean([
                    field.first(at, &[j, k, k], i),
                    field.first(at, &[i, k, k], j),
                    field.first(at, &[i, j, k], k),
                ]);
            }
        });
        self.fill(|field, at, w| {
            for [i, j, k] in PAIRS {
                *part(w, &[i, i, j, j, k]) = mean([
                    field.first(at, &[i, i, j, j], k),
                    field.second(at, &[i, i, k], j),
                    field.second(at, &[j, j, k], i),
                ]);
            }
        });
        self.fill(|field, at, w| {
            *part(w, &[0, 0, 1, 1, 2, 2]) = mean(PAIRS.map(|[i, j, k]| field.second(at, &[i, i, j, j], k)));
        });
    }

    /// Lets `add` change the derivatives of every solved node; `add` reads the field before the changes.
    fn fill(&mut self, add: impl Fn(&Self, GridIndex, &mut Derivatives)) {
        let added: Vec<Option<Known>> = (0..self.solved.len())
            .map(|slot| {
                let mut known = self.solved[slot]?;
                add(self, self.grid.lattice.ijk(slot), &mut known.w);
                Some(known)
            })
            .collect();
        self.solved = added;
    }

    /// The degree-5 polynomial that best fits all exact derivatives of the nodes around `index`; `None` if
    /// there are too few.
    ///
    /// The unknowns are the 56 derivatives at `index`. Each row is one of the 20 derivatives of a node as a
    /// Taylor sum, weighted by the factorial of its order and the square of the distance.
    fn fitted(&self, index: GridIndex) -> Option<Derivatives> {
        let chosen = self.around(index)?;
        let unknowns: Vec<[usize; 3]> = orders_up_to(5).collect();
        let derivatives: Vec<[usize; 3]> = orders_up_to(3).collect();
        let (n, rows) = (unknowns.len(), chosen.len() * derivatives.len());
        let (mut matrix, mut right) = (Mat::<f64>::zeros(rows + n, n), Mat::<f64>::zeros(rows + n, 1));
        for (node, slot) in chosen.into_iter().enumerate() {
            let (known, step) = (self.solved[slot].as_ref()?, self.offset(index, slot).map(f64::from));
            for (number, &wanted) in derivatives.iter().enumerate() {
                let row = node * derivatives.len() + number;
                let weight = 1.0 / (squared(step) * factorial(wanted.iter().sum()));
                for (column, unknown) in unknowns.iter().enumerate() {
                    let along = |axis: usize| {
                        let left = unknown[axis].checked_sub(wanted[axis]);
                        left.map_or(0.0, |left| step[axis].powi(left as i32) / factorial(left))
                    };
                    matrix[(row, column)] = weight * along(0) * along(1) * along(2);
                }
                right[(row, 0)] = weight * known.derivative(wanted);
            }
        }
        // The ridge keeps undetermined directions near zero.
        let ridge = RIDGE * matrix.norm_l2() / (n as f64).sqrt();
        for i in 0..n {
            matrix[(rows + i, i)] = ridge;
        }
        let solved = matrix.col_piv_qr().solve_lstsq(&right);
        let mut w = Derivatives::default();
        for (&[a, b, c], value) in unknowns.iter().zip(solved.col(0).iter()) {
            if !value.is_finite() {
                return None;
            }
            if a <= 2 && b <= 2 && c <= 2 {
                w[a][b][c] = *value;
            }
        }
        Some(w)
    }

    /// The slots of the nodes for the fit at `index`, all on one branch, the nearest first; `None` if there
    /// are too few.
    fn around(&self, index: GridIndex) -> Option<Vec<usize>> {
        let squared = |slot: usize| -> i32 { self.offset(index, slot).iter().map(|n| n * n).sum() };
        let mut order: Vec<(i32, usize)> = (0..self.solved.len())
            .filter(|&slot| self.solved[slot].is_some() && squared(slot) <= MAX_DISTANCE)
            .map(|slot| (squared(slot), slot))
            .collect();
        order.sort_unstable();
        let mut chosen: Vec<usize> = Vec::new();
        for (_, slot) in order {
            let here = self.grid.lattice.ijk(slot);
            let joined =
                |other: &usize| self.cuts.binary_search(&(here, self.grid.lattice.ijk(*other))).is_err();
            if chosen.len() < MAX_NODES && chosen.iter().all(joined) {
                chosen.push(slot);
            }
        }
        let is_near = chosen.first().is_some_and(|&slot| squared(slot) <= NEAR_DISTANCE);
        (chosen.len() >= MIN_NODES && is_near).then_some(chosen)
    }

    /// Position of a slot relative to `index`, in cells.
    fn offset(&self, index: GridIndex, slot: usize) -> GridIndex {
        let at = self.grid.lattice.ijk(slot);
        std::array::from_fn(|axis| at[axis] - index[axis])
    }

    /// Mean of the Taylor polynomials of the nearest solved nodes.
    fn ghost(&self, index: GridIndex) -> Derivatives {
        let known = self.solved.iter().enumerate();
        let known = known.filter_map(|(slot, node)| Some((self.grid.lattice.ijk(slot), node.as_ref()?)));
        let mut mean = Derivatives::default();
        mean_of_nearest(known, index, mean.as_flattened_mut().as_flattened_mut(), |node, step, sum| {
            let continued = taylor(node, step, squared(step) > f64::from(NEAR_DISTANCE));
            for (sum, value) in sum.iter_mut().zip(continued.as_flattened().as_flattened()) {
                *sum += value;
            }
        });
        mean
    }
}

/// Squared length of a step, in cells.
fn squared(step: [f64; 3]) -> f64 {
    step.iter().map(|x| x * x).sum()
}

/// Largest squared distance, in cells, at which a node is extrapolated with all its derivatives. Beyond it
/// only W, h and S are used.
const NEAR_DISTANCE: i32 = 3;

/// Largest squared distance, in cells, of the nodes in a fit, and the maximum number of these nodes.
const MAX_DISTANCE: i32 = 6;
const MAX_NODES: usize = 20;
const MIN_NODES: usize = 6;
/// Ridge as a share of the root mean square norm of a column.
const RIDGE: f64 = 3e-7;

impl Known {
    /// The exact derivative of these orders, whose sum is at most three.
    fn derivative(&self, [a, b, c]: [usize; 3]) -> f64 {
        match [a, b, c].iter().position(|&order| order == 3) {
            Some(axis) => self.pure[axis],
            None => self.w[a][b][c],
        }
    }
}

/// The derivatives of a node's Taylor polynomial at a distance of `step` cells.
fn taylor(node: &Known, step: [f64; 3], only_quadratic: bool) -> Derivatives {
    // step^n / n!
    let power = step.map(|s| [1.0, s, 0.5 * s * s, s * s * s / 6.0]);
    let mut moved = Derivatives::default();
    for (a, b, c) in orders_up_to_two() {
        let mut sum = 0.0;
        for (i, j, k) in orders_up_to_two() {
            if i >= a && j >= b && k >= c && !(only_quadratic && i + j + k > 2) {
                sum += node.w[i][j][k] * power[0][i - a] * power[1][j - b] * power[2][k - c];
            }
        }
        for (axis, pure) in node.pure.iter().enumerate() {
            let order = [a, b, c];
            let others = (0..3).filter(|&other| other != axis).all(|other| order[other] == 0);
            if others && !only_quadratic {
                sum += pure * power[axis][3 - order[axis]];
            }
        }
        moved[a][b][c] = sum;
    }
    moved
}

/// Mean of the available values; zero without any.
fn mean<const N: usize>(routes: [Option<f64>; N]) -> f64 {
    let there = routes.iter().flatten();
    there.clone().sum::<f64>() / there.count().max(1) as f64
}

fn packed(w: &Derivatives) -> HermiteNode {
    let mut node = HermiteNode::default();
    for (a, b, c) in orders_up_to_two() {
        node[a][b][c] = w[a][b][c] as f32;
    }
    node
}

#[cfg(test)]
mod tests;
