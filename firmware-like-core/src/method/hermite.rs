//! The table of energy derivatives, and the cubic Hermite interpolants of the three force components.
//!
//! A node of the table holds W_abc = d^(a+b+c) W / dx^a dy^b dz^c, a, b, c in 0..=2, at one grid point. The
//! solver gives the derivatives of order 0 to 3 exactly, the fit estimates the others. `energy` uses
//! all 27; the cubics here use those that are derivatives of h = dW/dp:
//!
//! h_i(t) = sum over corners and a, b, c in 0..=1 of H_a(tx) H_b(ty) H_c(tz) d^(a+b+c) h_i / dx^a dy^b dz^c
//!
//! The result is C1, but not a gradient. Near a fold or a failed solve W is inaccurate. There the cubics are
//! more robust than `energy`: they use no derivative of W beyond the fourth, their error in h is of order
//! spacing^4, and they do not differentiate W across a jump.

use super::Coverage;
use super::interpolant::{Interpolant, Slopes};
use crate::grid::flags::{Ball, CELL};
use crate::grid::{BallLattice, Location};
use crate::num::lanes::{Baseline, F32x4, Lanes, Machine, sums};
use crate::num::vec3::{self, Vec3};
use crate::plane::{PlaneError, PlaneProblem, check_finite, check_len, check_range};

/// W_abc at one grid point as `[a][b][c]`, in cells and newtons: W_abc spacing^(a + b + c - 1). The last of
/// every four numbers is padding, so that rows stay whole vectors.
pub type HermiteNode = [[[f32; 4]; 3]; 3];

/// Planes of the energy derivatives at the grid points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HermitePlanes<'a> {
    /// Index of its node for each slot of the box. Slots that no query reaches may share a node.
    pub row: &'a [u32],
    /// The nodes, newtons; energy and force are zero at rest. Of a sphere those of s = sqrt(2 W).
    pub nodes: &'a [HermiteNode],
}

/// The nodes of the corners of a cell as `[x][y][z]`.
pub(super) type Corners<'a> = [[[&'a HermiteNode; 2]; 2]; 2];

impl HermitePlanes<'_> {
    /// Checks that every slot of the lattice has a node, and that all values are finite.
    ///
    /// Errors: [`PlaneError`] with the name of the plane.
    pub fn check(&self, lattice: &BallLattice) -> Result<(), PlaneError> {
        let Self { row, nodes } = *self;
        check_len("hermite row", row, lattice.slots())?;
        check_range("hermite row", row, |row| (*row as usize) < nodes.len())?;
        check_finite("hermite nodes", nodes.as_flattened().as_flattened().as_flattened())
    }

    /// Checks that rest is free of energy and force.
    pub(crate) fn check_rest(&self, lattice: &BallLattice) -> Result<(), PlaneError> {
        let Self { row, nodes } = *self;
        let rest = row.get(lattice.rest_slot()).and_then(|row| nodes.get(*row as usize));
        if !rest.is_some_and(is_at_rest) {
            return Err(PlaneProblem::RestPoint.of("hermite nodes"));
        }
        Ok(())
    }

    /// h of the cubics at a location, newtons; finite if [`HermitePlanes::check`] accepts the planes.
    pub fn cubic_force(&self, lattice: &BallLattice, at: &Location) -> Vec3 {
        Hermite(self).force(Baseline, Ball { lattice, flags: &[] }, at)
    }
}

/// Whether a node has neither energy nor force.
fn is_at_rest([[[w, wz, ..], [wy, ..], _], [[wx, ..], ..], _]: &HermiteNode) -> bool {
    [w, wx, wy, wz].iter().all(|value| **value == 0.0)
}

/// The method `hermite`.
#[derive(Clone, Copy)]
pub(crate) struct Hermite<'s>(pub(crate) &'s HermitePlanes<'s>);

impl<'s> Hermite<'s> {
    /// The corners of a cell. `None` beyond the end of the box, where no query lies.
    #[inline(always)]
    pub(super) fn corners(self, ball: Ball<'_>, at: &Location) -> Option<Corners<'s>> {
        let HermitePlanes { row, nodes } = *self.0;
        let strides = ball.lattice.strides();
        let (side, sheet) = (strides.side as usize, strides.sheet as usize);
        // One bounds check for all four: the compiler derives the others from it.
        let rows = row.get(at.slot..)?.get(..sheet.wrapping_add(side).wrapping_add(2))?;
        let column = |at: usize| -> Option<[&'s HermiteNode; 2]> {
            let [low, high] = rows.get(at..at.wrapping_add(2))?.first_chunk::<2>()?;
            Some([nodes.get(*low as usize)?, nodes.get(*high as usize)?])
        };
        Some([[column(0)?, column(side)?], [column(sheet)?, column(sheet.wrapping_add(side))?]])
    }

    /// dh_i/dt_j as rows i; zero beyond the end of the box.
    pub(super) fn rows(self, ball: Ball<'_>, at: &Location) -> [Vec3; 3] {
        let Some(corners) = self.corners(ball, at) else { return [vec3::ZERO; 3] };
        let ([wx, wy, wz], [tx, ty, tz]) = (at.t.map(values), at.t);
        vec3::transposed([
            contract(Baseline, &corners, &[slopes(tx), wy, wz]),
            contract(Baseline, &corners, &[wx, slopes(ty), wz]),
            contract(Baseline, &corners, &[wx, wy, slopes(tz)]),
        ])
    }
}

impl<'s> Interpolant for Hermite<'s> {
    type Domain = Ball<'s>;

    /// Zero beyond the end of the box.
    #[inline(always)]
    fn force<M: Machine>(self, machine: M, ball: Ball<'s>, at: &Location) -> Vec3 {
        let Some(corners) = self.corners(ball, at) else { return vec3::ZERO };
        let [tx, ty, tz] = at.t;
        contract(machine, &corners, &[values(tx), values(ty), values(tz)])
    }

    fn slopes(self, ball: Ball<'s>, at: &Location) -> Slopes {
        Slopes { stiffness_n_m: ball.per_metre(self.rows(ball, at)), energy_j: None }
    }

    #[inline(always)]
    fn coverage(self, ball: Ball<'s>, at: &Location) -> Coverage {
        if ball.cell_flags(at) & CELL != 0 { Coverage::Cell } else { Coverage::Extrapolated }
    }
}

/// The four cubics or their derivatives at t: `[corner][value or slope]`.
type Weights = [[f32; 2]; 2];

#[inline(always)]
fn values(t: f32) -> Weights {
    let s = 1.0 - t;
    [[(1.0 + 2.0 * t) * s * s, t * s * s], [(3.0 - 2.0 * t) * t * t, -s * t * t]]
}

fn slopes(t: f32) -> Weights {
    let s = 1.0 - t;
    [[-6.0 * t * s, s * (1.0 - 3.0 * t)], [6.0 * t * s, t * (3.0 * t - 2.0)]]
}

#[inline(always)]
fn contract<M: Machine>(machine: M, corners: &Corners<'_>, [wx, wy, wz]: &[Weights; 3]) -> Vec3 {
    let (wx, wy) = (spread(machine, wx), spread(machine, wy));
    // Corners as [x][y][z]; the two along z are contracted side by side.
    let [[n0, n1], [f0, f1]] = corners;
    let (near, far) = (contract_x(machine, n0, f0, &wx), contract_x(machine, n1, f1, &wx));
    let ([a, b, c], [d, e, f]) = (near.plain, far.plain);
    let (x, y, z) = (sum(&wy, near.of_x, far.of_x), sum(&wy, [b, c], [e, f]), sum(&wy, [a, b], [d, e]));
    let [[n0, n1], [f0, f1]] = *wz;
    let first = [F32x4::new([n0, n1, 0.0, 0.0]), F32x4::new([f0, f1, 0.0, 0.0])];
    let second = [F32x4::new([0.0, n0, n1, 0.0]), F32x4::new([0.0, f0, f1, 0.0])];
    sums(contract_z(machine, x, first), contract_z(machine, y, first), contract_z(machine, z, second))
}

/// The weights of one axis in all lanes.
#[inline(always)]
fn spread<M: Machine>(machine: M, [[n0, n1], [f0, f1]]: &Weights) -> [[M::F32x8; 2]; 2] {
    [[machine.splat(*n0), machine.splat(*n1)], [machine.splat(*f0), machine.splat(*f1)]]
}

/// Rows along c of both corners in z: for h_x those of b = 0, 1; for h_y and h_z those of b = 0, 1, 2.
struct Rows<V> {
    of_x: [V; 2],
    plain: [V; 3],
}

#[inline(always)]
fn contract_x<M: Machine>(
    machine: M,
    near: &[&HermiteNode; 2],
    far: &[&HermiteNode; 2],
    wx: &[[M::F32x8; 2]; 2],
) -> Rows<M::F32x8> {
    let ([n0, n1, n2], [f0, f1, f2]) = (rows(machine, near), rows(machine, far));
    let ([n00, n01, n02], [n10, n11, n12], [n20, n21, _]) = (n0, n1, n2);
    let ([f00, f01, f02], [f10, f11, f12], [f20, f21, _]) = (f0, f1, f2);
    // h_x has one derivative more in x than h_y and h_z.
    Rows {
        of_x: [sum(wx, [n10, n20], [f10, f20]), sum(wx, [n11, n21], [f11, f21])],
        plain: [
            sum(wx, [n00, n10], [f00, f10]),
            sum(wx, [n01, n11], [f01, f11]),
            sum(wx, [n02, n12], [f02, f12]),
        ],
    }
}

/// Two nodes side by side as `[a][b]`.
#[inline(always)]
fn rows<M: Machine>(machine: M, [low, high]: &[&HermiteNode; 2]) -> [[M::F32x8; 3]; 3] {
    let ([l0, l1, l2], [h0, h1, h2]) = (low, high);
    [row(machine, l0, h0), row(machine, l1, h1), row(machine, l2, h2)]
}

#[inline(always)]
fn row<M: Machine>(machine: M, [l0, l1, l2]: &[[f32; 4]; 3], [h0, h1, h2]: &[[f32; 4]; 3]) -> [M::F32x8; 3] {
    [machine.rows(l0, h0), machine.rows(l1, h1), machine.rows(l2, h2)]
}

#[inline(always)]
fn sum<V: Lanes>([[n0, n1], [f0, f1]]: &[[V; 2]; 2], [a, b]: [V; 2], [c, d]: [V; 2]) -> V {
    (*n0 * a + *n1 * b) + (*f0 * c + *f1 * d)
}

#[inline(always)]
fn contract_z<M: Machine>(machine: M, rows: M::F32x8, [of_low, of_high]: [F32x4; 2]) -> F32x4 {
    let [low, high] = machine.halves(rows);
    F32x4::new(low) * of_low + F32x4::new(high) * of_high
}
