//! The quintic Hermite interpolant of the energy: the force is its exact gradient.
//!
//! W(t) = sum over corners and a, b, c of H_a(tx) H_b(ty) H_c(tz) W_abc,   h = dW/dp,   S = d2W/dp2
//!
//! The six quintics H of an axis interpolate value, slope and curvature at its two ends. On a common face two
//! cells agree on W and its first two derivatives, which depend on the four corners of the face alone: h is
//! C1, S continuous. The gradient of an energy does no work on a closed path, so the method does not generate
//! energy.
//!
//! In cells with a fold the energy is not smooth. There the cubics of [`super::hermite`] are used; in the
//! neighbouring cells both are blended. The force is conservative wherever no corner of the cell touches a
//! fold.

use super::Coverage;
use super::blend::{blend, blend_rows, blend_slopes};
use super::hermite::{Corners, Hermite, HermiteNode, HermitePlanes};
use super::interpolant::{Interpolant, Slopes};
use crate::grid::flags::{Ball, SMOOTH};
use crate::grid::{BallLattice, Location};
use crate::num::lanes::{Baseline, F32x4, Lanes, Machine, sums};
use crate::num::vec3::{self, Vec3};

impl HermitePlanes<'_> {
    /// h = dW/dp of the quintics at a location, newtons.
    pub fn energy_gradient(&self, lattice: &BallLattice, at: &Location) -> Vec3 {
        Energy(Hermite(self)).gradient(Baseline, Ball { lattice, flags: &[] }, at)
    }
}

/// The method `energy`, with the cubics that it uses near folds.
#[derive(Clone, Copy)]
pub(crate) struct Energy<'s>(pub(crate) Hermite<'s>);

impl Energy<'_> {
    /// dW/dt, newtons. Zero beyond the end of the box.
    ///
    /// Cost: 72 rows of four along c. Along x each row is weighted for value and slope side by side, then
    /// along y and z. Without the padding these are 468 products and about as many sums.
    #[inline(always)]
    fn gradient<M: Machine>(self, machine: M, ball: Ball<'_>, at: &Location) -> Vec3 {
        let Some(corners) = self.0.corners(ball, at) else { return vec3::ZERO };
        gradient(machine, &corners, at.t)
    }

    /// W and its first two derivatives; zero beyond the end of the box.
    pub(super) fn derivatives(self, ball: Ball<'_>, at: &Location) -> Derivatives {
        let none = Derivatives { value: 0.0, gradient: vec3::ZERO, hessian: [vec3::ZERO; 3] };
        self.0.corners(ball, at).map_or(none, |corners| derivatives(&corners, at.t))
    }
}

impl<'s> Interpolant for Energy<'s> {
    type Domain = Ball<'s>;

    #[inline(always)]
    fn force<M: Machine>(self, machine: M, ball: Ball<'s>, at: &Location) -> Vec3 {
        let weight = ball.smooth(SMOOTH, at);
        let cubic = if weight < 1.0 { self.0.force(machine, ball, at) } else { vec3::ZERO };
        if weight <= 0.0 {
            return cubic;
        }
        blend(weight, cubic, self.gradient(machine, ball, at))
    }

    fn slopes(self, ball: Ball<'s>, at: &Location) -> Slopes {
        let (Self(cubics), quintic) = (self, self.derivatives(ball, at));
        let cubic = || (cubics.force(Baseline, ball, at), cubics.rows(ball, at));
        let rows = blend_slopes(ball, SMOOTH, at, cubic, || (quintic.gradient, quintic.hessian));
        let is_energy = ball.smooth(SMOOTH, at) >= 1.0;
        let energy_j = is_energy.then_some(quintic.value * ball.lattice.spacing_m());
        Slopes { stiffness_n_m: ball.per_metre(rows), energy_j }
    }

    fn energy_j(self, ball: Ball<'s>, at: &Location) -> Option<f32> {
        let corners = self.0.corners(ball, at)?;
        let is_energy = ball.smooth(SMOOTH, at) >= 1.0;
        is_energy.then(|| weighted(&corners, &at.t.map(values)) * ball.lattice.spacing_m())
    }

    /// The derivative of the weight is left out, because it jumps at faces.
    fn rim_slopes(self, ball: Ball<'s>, at: &Location) -> [Vec3; 3] {
        let rows =
            blend_rows(ball.smooth(SMOOTH, at), self.0.rows(ball, at), self.derivatives(ball, at).hessian);
        ball.per_metre(rows)
    }

    #[inline(always)]
    fn coverage(self, ball: Ball<'s>, at: &Location) -> Coverage {
        self.0.coverage(ball, at)
    }
}

/// W, dW/dt and the rows of d2W/dt2, in cells and newtons.
pub(super) struct Derivatives {
    pub(super) value: f32,
    pub(super) gradient: Vec3,
    pub(super) hessian: [Vec3; 3],
}

/// The six quintics or one of their derivatives at t: `[corner][a]`.
type Weights = [[f32; 3]; 2];

/// H_a(t) for both corners.
#[inline(always)]
fn values(t: f32) -> Weights {
    // The quintics of corner 1; those of corner 0 are their mirror images. The factored form is exact at t =
    // 0 and 1.
    let half = |t: f32, s: f32| {
        let cube = t * t * t;
        [cube * (10.0 - t * (15.0 - 6.0 * t)), -cube * s * (4.0 - 3.0 * t), 0.5 * cube * s * s]
    };
    let s = 1.0 - t;
    let [v, d, c] = half(s, t);
    [[v, -d, c], half(t, s)]
}

/// dH_a/dt.
#[inline(always)]
fn slopes(t: f32) -> Weights {
    let half = |t: f32, s: f32| {
        let square = t * t;
        [30.0 * square * s * s, square * (t * (28.0 - 15.0 * t) - 12.0), 0.5 * square * s * (3.0 - 5.0 * t)]
    };
    let s = 1.0 - t;
    let [v, d, c] = half(s, t);
    [[-v, d, -c], half(t, s)]
}

/// d2H_a/dt2.
fn curvatures(t: f32) -> Weights {
    let half = |t: f32, s: f32| {
        [60.0 * t * s * (1.0 - 2.0 * t), -12.0 * t * s * (2.0 - 5.0 * t), t * (3.0 - t * (12.0 - 10.0 * t))]
    };
    let s = 1.0 - t;
    let [v, d, c] = half(s, t);
    [[v, -d, c], half(t, s)]
}

/// H or dH/dt: of three axes in three lanes, or of one axis in all lanes.
///
/// The value function of corner 0 is 1 minus that of corner 1 and is left out. Thus the difference of two
/// energies is formed before it is weighted, and a large W causes no cancellation.
struct Basis<V> {
    value: V,
    /// By corner.
    slope: [V; 2],
    curvature: [V; 2],
}

/// H and dH/dt, one lane per axis.
#[inline(always)]
fn bases([tx, ty, tz]: Vec3) -> [Basis<F32x4>; 2] {
    let number = F32x4::splat;
    let t = F32x4::new([tx, ty, tz, tz]);
    let s = number(1.0) - t;
    let (t2, s2) = (t * t, s * s);
    let (t3, s3, both) = (t2 * t, s2 * s, t2 * s2);
    let slope = |t3: F32x4, t: F32x4, s: F32x4| t3 * s * (number(4.0) - number(3.0) * t);
    let slope_rise = |t2: F32x4, t: F32x4| t2 * (t * (number(28.0) - number(15.0) * t) - number(12.0));
    let curvature_rise = |ts: F32x4, t: F32x4| ts * (number(1.5) - number(2.5) * t);
    let half = number(0.5) * both;
    let zero = number(0.0);
    [
        Basis {
            value: t3 * (number(10.0) - t * (number(15.0) - number(6.0) * t)),
            slope: [slope(s3, s, t), zero - slope(t3, t, s)],
            curvature: [half * s, half * t],
        },
        Basis {
            value: number(30.0) * both,
            slope: [slope_rise(s2, s), slope_rise(t2, t)],
            curvature: [zero - curvature_rise(s2 * t, s), curvature_rise(t2 * s, t)],
        },
    ]
}

impl Basis<F32x4> {
    /// The basis of one axis in all lanes.
    #[inline(always)]
    fn spread<const AXIS: usize>(&self) -> Self {
        let ([s0, s1], [c0, c1]) = (self.slope, self.curvature);
        Self {
            value: self.value.spread::<AXIS>(),
            slope: [s0.spread::<AXIS>(), s1.spread::<AXIS>()],
            curvature: [c0.spread::<AXIS>(), c1.spread::<AXIS>()],
        }
    }

    /// Weights along z in lanes 0 to 2: first those of the near row, with `constant` in place of the weight
    /// of the value, then those of the far row less those of the near row.
    #[inline(always)]
    fn along_z(&self, constant: F32x4) -> [F32x4; 2] {
        let ([s0, s1], [c0, c1]) = (self.slope, self.curvature);
        let lanes = |value: F32x4, slope: F32x4, curvature: F32x4| {
            let (_, even) = value.interleave(curvature);
            let (_, odd) = slope.interleave(F32x4::splat(0.0));
            even.interleave(odd).0
        };
        [lanes(constant, s0 + s1, c0 + c1), lanes(self.value, s1, c1)]
    }
}

impl<V: Lanes> Basis<V> {
    /// The sum without W_0 of the near corner; `rise` is W_0 of the far corner less W_0 of the near one.
    #[inline(always)]
    fn sum(&self, rise: V, [_, n1, n2]: &[V; 3], [_, f1, f2]: &[V; 3]) -> V {
        let ([s0, s1], [c0, c1]) = (self.slope, self.curvature);
        (self.value * rise + (s0 * *n1 + s1 * *f1)) + (c0 * *n2 + c1 * *f2)
    }
}

/// One axis of two bases, one row each.
#[inline(always)]
fn both<const AXIS: usize, M: Machine>(
    machine: M,
    low: &Basis<F32x4>,
    high: &Basis<F32x4>,
) -> Basis<M::F32x8> {
    let ([ls0, ls1], [lc0, lc1]) = (low.slope, low.curvature);
    let ([hs0, hs1], [hc0, hc1]) = (high.slope, high.curvature);
    Basis {
        value: join::<AXIS, M>(machine, low.value, high.value),
        slope: [join::<AXIS, M>(machine, ls0, hs0), join::<AXIS, M>(machine, ls1, hs1)],
        curvature: [join::<AXIS, M>(machine, lc0, hc0), join::<AXIS, M>(machine, lc1, hc1)],
    }
}

#[inline(always)]
fn join<const LANE: usize, M: Machine>(machine: M, low: F32x4, high: F32x4) -> M::F32x8 {
    machine.join([low.get::<LANE>(); 4], [high.get::<LANE>(); 4])
}

/// The corners contracted along x and y: rows along c of the near and the far corner in z, each with H' in x, with H'
/// in y, and with H in both; and the weights along z of H and H'.
struct Contracted {
    near: [F32x4; 3],
    far: [F32x4; 3],
    value: [F32x4; 2],
    rise: [F32x4; 2],
}

#[inline(always)]
fn gradient<M: Machine>(machine: M, corners: &Corners<'_>, t: Vec3) -> Vec3 {
    let Contracted { near: [near_x, near_y, near], far: [far_x, far_y, far], value, rise } =
        contracted(machine, corners, t);
    sums(contract_z(near_x, far_x, value), contract_z(near_y, far_y, value), contract_z(near, far, rise))
}

/// The interpolated quantity and its gradient, in cells and newtons.
#[inline(always)]
pub(super) fn value_and_gradient<M: Machine>(machine: M, corners: &Corners<'_>, t: Vec3) -> (f32, Vec3) {
    let Contracted { near: [near_x, near_y, near], far: [far_x, far_y, far], value, rise } =
        contracted(machine, corners, t);
    let gradient =
        sums(contract_z(near_x, far_x, value), contract_z(near_y, far_y, value), contract_z(near, far, rise));
    let sum = contract_z(near, far, value);
    let sum = sum + sum.upper();
    (sum.get::<0>() + sum.get::<1>(), gradient)
}

#[inline(always)]
fn contracted<M: Machine>(machine: M, corners: &Corners<'_>, t: Vec3) -> Contracted {
    let [values, rises] = bases(t);
    let in_x = both::<0, M>(machine, &values, &rises);
    let in_y = both::<1, M>(machine, &values, &values);
    let rise_y = rises.spread::<1>();
    // Corners as [x][y][z].
    let [[[n00, n01], [n10, n11]], [[f00, f01], [f10, f11]]] = *corners;
    let (near, far) = (contract_x(machine, n00, f00, &in_x), contract_x(machine, n10, f10, &in_x));
    let nearer = contract_y(machine, &near, &far, &in_y, &rise_y);
    let (near, far) = (contract_x(machine, n01, f01, &in_x), contract_x(machine, n11, f11, &in_x));
    let farther = contract_y(machine, &near, &far, &in_y, &rise_y);
    let value = values.along_z(F32x4::splat(1.0));
    let rise = rises.along_z(F32x4::splat(0.0));
    Contracted { near: nearer, far: farther, value, rise }
}

/// Rows along c for b = 0, 1, 2, contracted along x with H and H' side by side.
#[inline(always)]
fn contract_x<M: Machine>(
    machine: M,
    near: &HermiteNode,
    far: &HermiteNode,
    of: &Basis<M::F32x8>,
) -> [M::F32x8; 3] {
    let [[n00, n01, n02], [n10, n11, n12], [n20, n21, n22]] = near;
    let [[f00, f01, f02], [f10, f11, f12], [f20, f21, f22]] = far;
    [
        contract_column(machine, [n00, n10, n20], [f00, f10, f20], of),
        contract_column(machine, [n01, n11, n21], [f01, f11, f21], of),
        contract_column(machine, [n02, n12, n22], [f02, f12, f22], of),
    ]
}

/// The rows of a = 0, 1, 2 at both ends of an edge along x, contracted.
#[inline(always)]
fn contract_column<M: Machine>(
    machine: M,
    [n0, n1, n2]: [&[f32; 4]; 3],
    [f0, f1, f2]: [&[f32; 4]; 3],
    of: &Basis<M::F32x8>,
) -> M::F32x8 {
    let near = [machine.rows(n0, n0), machine.rows(n1, n1), machine.rows(n2, n2)];
    let far = [machine.rows(f0, f0), machine.rows(f1, f1), machine.rows(f2, f2)];
    machine.rows(n0, &[0.0; 4]) + of.sum(machine.rows(f0, f0) - machine.rows(n0, n0), &near, &far)
}

/// A row along c, contracted with H' in x and H in y, with H in x and H' in y, and with H in both.
#[inline(always)]
fn contract_y<M: Machine>(
    machine: M,
    near: &[M::F32x8; 3],
    far: &[M::F32x8; 3],
    value: &Basis<M::F32x8>,
    rise: &Basis<F32x4>,
) -> [F32x4; 3] {
    let ([n0, n1, n2], [f0, f1, f2]) = (*near, *far);
    let step = f0 - n0;
    let [plain, along_x] = machine.halves(n0 + value.sum(step, near, far));
    let near = [low(machine, n0), low(machine, n1), low(machine, n2)];
    let far = [low(machine, f0), low(machine, f1), low(machine, f2)];
    [F32x4::new(along_x), rise.sum(low(machine, step), &near, &far), F32x4::new(plain)]
}

#[inline(always)]
fn low<M: Machine>(machine: M, rows: M::F32x8) -> F32x4 {
    let [low, _] = machine.halves(rows);
    F32x4::new(low)
}

#[inline(always)]
fn contract_z(low: F32x4, high: F32x4, [of_low, of_rise]: [F32x4; 2]) -> F32x4 {
    low * of_low + (high - low) * of_rise
}

/// The sum over the corners with these weights along each axis.
fn weighted(corners: &Corners<'_>, [wx, wy, wz]: &[Weights; 3]) -> f32 {
    let mut total = 0.0;
    for (plane, wx) in corners.iter().zip(wx) {
        for (column, wy) in plane.iter().zip(wy) {
            for (node, wz) in column.iter().zip(wz) {
                for (row, wx) in node.iter().zip(wx) {
                    for (run, wy) in row.iter().zip(wy) {
                        let [a, b, c, _] = run;
                        let [wa, wb, wc] = wz;
                        total += wx * wy * (a * wa + b * wb + c * wc);
                    }
                }
            }
        }
    }
    total
}

/// All derivatives, one corner after the other: for stiffness and energy, which the tick does not need inside
/// the ball.
fn derivatives(corners: &Corners<'_>, t: Vec3) -> Derivatives {
    let weights = t.map(|t| [values(t), slopes(t), curvatures(t)]);
    let [x, y, z] = &weights;
    let sum = |order: [usize; 3]| -> f32 {
        match [x.get(order[0]), y.get(order[1]), z.get(order[2])] {
            [Some(wx), Some(wy), Some(wz)] => weighted(corners, &[*wx, *wy, *wz]),
            _ => 0.0,
        }
    };
    let (xy, xz, yz) = (sum([1, 1, 0]), sum([1, 0, 1]), sum([0, 1, 1]));
    Derivatives {
        value: sum([0, 0, 0]),
        gradient: [sum([1, 0, 0]), sum([0, 1, 0]), sum([0, 0, 1])],
        hessian: [[sum([2, 0, 0]), xy, xz], [xy, sum([0, 2, 0]), yz], [xz, yz, sum([0, 0, 2])]],
    }
}
