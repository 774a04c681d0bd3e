//! Independent f64 versions of the core's interpolants. Their difference from the core is the rounding error
//! of its f32.
//!
//! The input is the packed tables. So the difference contains the error of the evaluation and not that of the
//! fit.

use palpate_core::flags::{BRANCH_JUMP, CELL, INTERIOR, SMOOTH, SUPERCELL};
use palpate_core::kernel::{Block, KernelPlanes, KernelTable, LANES};
use palpate_core::{CORNERS, Method, Space, SpacePlanes};

use crate::fit::DATA;
use crate::num::vector::norm;

/// h at a displacement inside the ball, N; `None` if the method is not packed, and outside the cells of a root.
pub fn force_n(space: &Space<'_>, method: Method, displacement_m: [f32; 3]) -> Option<[f64; 3]> {
    let cell = Cell::of(space, displacement_m);
    match method {
        Method::Trilinear => cell.lattice(&LINEAR),
        Method::Tricubic => cell.lattice(&CUBIC),
        Method::Hybrid => {
            let share = cell.share(SUPERCELL, INTERIOR);
            Some(mix(share, cell.lattice(&LINEAR)?, cell.lattice(&CUBIC)?))
        }
        Method::RbfLinear => {
            let planes = cell.planes.rbf_linear?;
            Some(radial(&planes.centres, &planes.weights, cell.position, |r| r))
        }
        Method::RbfCubic => {
            let planes = cell.planes.rbf_cubic?;
            Some(radial(&planes.centres, &planes.weights, cell.position, |r| r * r * r))
        }
        Method::Hermite => cell.hermite(),
        Method::Energy if cell.planes.is_root => cell.root().filter(|_| cell.is_known()),
        Method::Energy => {
            let clear = space.planes().flags[cell.slot([0; 3])] & BRANCH_JUMP == 0;
            let share = if clear { cell.share(0, SMOOTH) } else { 0.0 };
            Some(mix(share, cell.hermite()?, cell.energy()?))
        }
        Method::Kernel => {
            kernel(space.kernel()?, cell.planes.kernel?, space.lattice().spacing_m(), displacement_m)
        }
    }
}

/// The sum over powers, with the library's exponential. Beyond the range of the kernel it uses the
/// continuation with the core's own stiffness.
fn kernel(
    table: &KernelTable<'_>,
    planes: KernelPlanes<'_>,
    spacing_m: f32,
    displacement_m: [f32; 3],
) -> Option<[f64; 3]> {
    let d = displacement_m.map(f64::from);
    let size = norm(d);
    let reach_m = f64::from(table.reach_m(displacement_m));
    if size <= reach_m {
        return Some(kernel_within(planes, d));
    }
    let rim = d.map(|x| x / size * reach_m);
    let (spacing_m, pulled_m) = (f64::from(spacing_m), size - reach_m);
    let rise_m = if pulled_m < spacing_m {
        pulled_m - pulled_m * pulled_m / (2.0 * spacing_m)
    } else {
        spacing_m / 2.0
    };
    let slopes = table.jet(rim.map(|x| x as f32)).stiffness_n_m;
    let at_rim = kernel_within(planes, rim);
    Some(std::array::from_fn(|i| {
        at_rim[i] + rise_m * (0..3).map(|j| slopes[i][j] * d[j] / size).sum::<f64>()
    }))
}

fn kernel_within(planes: KernelPlanes<'_>, displacement_m: [f64; 3]) -> [f64; 3] {
    let [length_m, xx, xy, xz, yy, yz, zz] = *planes.scalars.first_chunk().expect("checked planes");
    let x = displacement_m.map(|p| p / length_m);
    let base = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
    let (here, rest) = (kernel_sum(planes.blocks, x), kernel_sum(planes.blocks, [0.0; 3]));
    std::array::from_fn(|i| here[i] - rest[i] + (0..3).map(|j| base[i][j] * x[j]).sum::<f64>())
}

/// Gradient of sum_n E_n sum_a P_a r^a / a!.
fn kernel_sum(blocks: &[Block], x: [f64; 3]) -> [f64; 3] {
    const FACTORIALS: [f64; 4] = [1.0, 1.0, 2.0, 6.0];
    let mut sum = [0.0; 3];
    for (block, lane) in blocks.iter().flat_map(|block| (0..LANES).map(move |lane| (block, lane))) {
        let r: [f64; 3] = std::array::from_fn(|axis| x[axis] - block[axis][lane]);
        let e = libm::exp(-0.5 * r.iter().map(|r| r * r).sum::<f64>());
        for (orders, number) in DATA.iter().zip(&block[3..]) {
            // r^n e and its derivative along one axis.
            let power = |axis: usize| r[axis].powi(orders[axis] as i32) / FACTORIALS[orders[axis]];
            let slope = |axis: usize| {
                let falling = match orders[axis] {
                    0 => 0.0,
                    n => r[axis].powi(n as i32 - 1) / FACTORIALS[n - 1],
                };
                falling - r[axis] * power(axis)
            };
            for (along, sum) in sum.iter_mut().enumerate() {
                let factors: f64 = (0..3).map(|i| if i == along { slope(i) } else { power(i) }).product();
                *sum += e * number[lane] * factors;
            }
        }
    }
    sum
}

/// a + share (b - a).
fn mix(share: f64, a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] + share * (b[i] - a[i]))
}

/// Points of a 1-D stencil, relative to the cell's low corner, and their weights.
struct Stencil {
    points: &'static [i32],
    weight: fn(usize, f64) -> f64,
}

const LINEAR: Stencil = Stencil { points: &[0, 1], weight: |n, t| if n == 0 { 1.0 - t } else { t } };
/// Catmull-Rom, in powers of t.
const CUBIC: Stencil = Stencil {
    points: &[-1, 0, 1, 2],
    weight: |n, t| {
        let [a, b, c, d] =
            [[0.0, -0.5, 1.0, -0.5], [1.0, 0.0, -2.5, 1.5], [0.0, 0.5, 2.0, -1.5], [0.0, 0.0, -0.5, 0.5]][n];
        a + t * (b + t * (c + t * d))
    },
};

/// Quintics in powers of t: value, slope and curvature at 0, then at 1.
const QUINTIC: [[f64; 6]; 6] = [
    [1.0, 0.0, 0.0, -10.0, 15.0, -6.0],
    [0.0, 1.0, 0.0, -6.0, 8.0, -3.0],
    [0.0, 0.0, 0.5, -1.5, 1.5, -0.5],
    [0.0, 0.0, 0.0, 10.0, -15.0, 6.0],
    [0.0, 0.0, 0.0, -4.0, 7.0, -3.0],
    [0.0, 0.0, 0.0, 0.5, -1.0, 0.5],
];
/// Cubics: value and slope at 0, then at 1.
const HERMITE: [[f64; 4]; 4] =
    [[1.0, 0.0, -3.0, 2.0], [0.0, 1.0, -2.0, 1.0], [0.0, 0.0, 3.0, -2.0], [0.0, 0.0, -1.0, 1.0]];

fn polynomial(powers: &[f64], t: f64) -> f64 {
    powers.iter().rev().fold(0.0, |sum, c| sum * t + c)
}

fn slope(powers: &[f64], t: f64) -> f64 {
    powers.iter().enumerate().skip(1).rev().fold(0.0, |sum, (n, c)| sum * t + n as f64 * c)
}

/// The cell of a query and the position in it.
struct Cell<'s, 'a> {
    space: &'s Space<'a>,
    planes: SpacePlanes<'a>,
    low: [i32; 3],
    t: [f64; 3],
    position: [f64; 3],
}

impl<'s, 'a> Cell<'s, 'a> {
    fn of(space: &'s Space<'a>, displacement_m: [f32; 3]) -> Self {
        let (spacing_m, reach) = (f64::from(space.lattice().spacing_m()), space.lattice().reach());
        let position = displacement_m.map(|x| f64::from(x) / spacing_m);
        let low = position.map(|x| (x.floor() as i32).clamp(-reach, reach - 1));
        let t = std::array::from_fn(|axis| position[axis] - f64::from(low[axis]));
        Self { space, planes: space.planes(), low, t, position }
    }

    fn slot(&self, offset: [i32; 3]) -> usize {
        let point = std::array::from_fn(|axis| self.low[axis] + offset[axis]);
        self.space.lattice().slot(point).expect("a point round a cell is in the box")
    }

    fn lattice(&self, stencil: &Stencil) -> Option<[f64; 3]> {
        let force_n = self.planes.force_n?;
        let mut sum = [0.0; 3];
        let points = || stencil.points.iter().enumerate();
        for (a, &i) in points() {
            for (b, &j) in points() {
                for (c, &k) in points() {
                    let orders = [a, b, c];
                    let weight: f64 =
                        (0..3).map(|axis| (stencil.weight)(orders[axis], self.t[axis])).product();
                    let slot = self.slot([i, j, k]);
                    for (sum, component) in sum.iter_mut().zip(force_n[slot]) {
                        *sum += weight * f64::from(component);
                    }
                }
            }
        }
        Some(sum)
    }

    /// Smoothstep of the tri-linear interpolation of `flag`, if all corners of the cell have `needed`.
    fn share(&self, needed: u8, flag: u8) -> f64 {
        if self.space.planes().flags[self.slot([0; 3])] & needed != needed {
            return 0.0;
        }
        let w: f64 = CORNERS
            .into_iter()
            .filter(|&corner| self.space.planes().flags[self.slot(corner)] & flag != 0)
            .map(|corner| -> f64 {
                corner.iter().zip(self.t).map(|(&n, t)| if n == 0 { 1.0 - t } else { t }).product()
            })
            .sum();
        w * w * (3.0 - 2.0 * w)
    }

    /// W_abc at a corner, as a function of the orders [a, b, c].
    fn derivatives(&self, corner: [i32; 3]) -> Option<impl Fn([usize; 3]) -> f64 + 'a> {
        let planes = self.planes.hermite?;
        let node = &planes.nodes[planes.row[self.slot(corner)] as usize];
        Some(|[a, b, c]: [usize; 3]| f64::from(node[a][b][c]))
    }

    fn energy(&self) -> Option<[f64; 3]> {
        self.quintic().map(|(_, slope)| slope)
    }

    /// h = max(0, s) ds/dp.
    /// Whether all corners of the cell were solved.
    fn is_known(&self) -> bool {
        self.space.planes().flags[self.slot([0; 3])] & CELL != 0
    }

    fn root(&self) -> Option<[f64; 3]> {
        let (value, slope) = self.quintic()?;
        let root = f64::from(self.space.lattice().spacing_m()) * value.max(0.0);
        Some(slope.map(|slope| root * slope))
    }

    /// The interpolated quantity, in cells, and its gradient.
    fn quintic(&self) -> Option<(f64, [f64; 3])> {
        let (mut total, mut sum) = (0.0, [0.0; 3]);
        for corner in CORNERS {
            let derivative = self.derivatives(corner)?;
            for orders in (0..27).map(|code: usize| [code / 9, code / 3 % 3, code % 3]) {
                let value = derivative(orders);
                let of = |axis: usize| &QUINTIC[3 * corner[axis] as usize + orders[axis]];
                total += value * (0..3).map(|axis| polynomial(of(axis), self.t[axis])).product::<f64>();
                for (along, sum) in sum.iter_mut().enumerate() {
                    let factor = |axis: usize| {
                        let f = if axis == along { slope } else { polynomial };
                        f(of(axis), self.t[axis])
                    };
                    *sum += value * factor(0) * factor(1) * factor(2);
                }
            }
        }
        Some((total, sum))
    }

    fn hermite(&self) -> Option<[f64; 3]> {
        let mut sum = [0.0; 3];
        for corner in CORNERS {
            let derivative = self.derivatives(corner)?;
            for orders in CORNERS.map(|corner| corner.map(|n| n as usize)) {
                let factor = |axis: usize| {
                    polynomial(&HERMITE[2 * corner[axis] as usize + orders[axis]], self.t[axis])
                };
                let weight = factor(0) * factor(1) * factor(2);
                for (along, sum) in sum.iter_mut().enumerate() {
                    let mut of_energy = orders;
                    of_energy[along] += 1;
                    *sum += weight * derivative(of_energy);
                }
            }
        }
        Some(sum)
    }
}

fn radial<T: Copy + Into<f64>>(
    centres: &[&[T]; 3],
    weights: &[&[T]; 3],
    position: [f64; 3],
    phi: impl Fn(f64) -> f64,
) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for i in 0..centres[0].len() {
        let squared: f64 = (0..3).map(|axis| (position[axis] - centres[axis][i].into()).powi(2)).sum();
        let value = phi(squared.sqrt());
        for (sum, plane) in sum.iter_mut().zip(weights) {
            *sum += value * plane[i].into();
        }
    }
    sum
}
