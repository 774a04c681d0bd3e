//! A kernel fit in the core's form ([`palpate_core::kernel`]): a cubic polynomial at every
//! configuration, and the range in which the fit is valid.

use palpate_core::kernel::{self, Block, KernelTable, LANES, NUMBERS, REACH_POINTS, REACH_SIDE, SCALARS};

use super::KernelFit;
use super::kernel::DATA;
use crate::num::jet::SECOND_INDICES;

/// Number of steps along a ray in the search for the range.
const STEPS: u32 = 32;
/// Number of halvings of the first step outside the range; the remaining error is below the resolution of a
/// byte.
const HALVINGS: u32 = 5;

/// d^a He_n/dr^a at r = 0, `[n][a]`: He_n is 1, r, r^2 - 1, r^3 - 3 r.
const HERMITE_AT_0: [[f64; 4]; 4] =
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 2.0, 0.0], [0.0, -3.0, 0.0, 6.0]];

/// The planes of a kernel fit.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct KernelPlanes {
    /// Kernel length l in metres, then B in newtons.
    pub scalars: [f64; SCALARS],
    /// The configurations in blocks of four.
    pub blocks: Vec<Block>,
    /// Range in each direction, as a share of the ball's radius in 1/255.
    pub reach: Vec<u8>,
}

impl KernelPlanes {
    /// The planes of a fit in a ball of `radius_m`; `is_valid_at` returns whether the fit is valid at a
    /// displacement. `None` if the core does not accept the fit: too many configurations, or one too many
    /// kernel lengths from rest.
    pub(crate) fn new(
        fit: &KernelFit,
        radius_m: f64,
        is_valid_at: impl Fn([f64; 3]) -> bool,
    ) -> Option<Self> {
        let KernelFit { length_m, quantity: _, base, centres, weights } = fit;
        if centres.len() > kernel::MAX_CENTRES {
            return None;
        }
        let base = |[i, j]: [usize; 2]| length_m * base.curvature[(i, j)];
        let [xx, xy, xz, yy, yz, zz] = SECOND_INDICES.map(base);
        let scalars = [*length_m, xx, xy, xz, yy, yz, zz];
        let mut blocks = vec![[[0.0; LANES]; NUMBERS]; centres.len().div_ceil(LANES)];
        for (n, (centre, weights)) in centres.iter().zip(weights).enumerate() {
            let numbers = centre.iter().copied().chain(polynomial(weights).map(|c| c / length_m));
            for (lanes, number) in blocks[n / LANES].iter_mut().zip(numbers) {
                lanes[n % LANES] = number;
            }
        }
        let planes = Self { scalars, blocks, reach: reach(radius_m, is_valid_at) };
        KernelTable::new(radius_m as f32, planes.view()).is_ok().then_some(planes)
    }

    /// The planes as a view for the core's check and evaluation.
    pub(crate) fn view(&self) -> kernel::KernelPlanes<'_> {
        kernel::KernelPlanes { scalars: &self.scalars, blocks: &self.blocks, reach: &self.reach }
    }
}

/// Derivatives at r = 0, in the order of [`DATA`], of the polynomial factor of a weighted sum of a Gaussian's
/// derivatives.
///
/// With d^b/dq^b exp(-|p - q|^2 / 2) = He_b(p - q) exp(..) they are P_a = sum_b w_b prod_i He_(b_i)^(a_i)(0).
fn polynomial(weights: &[f64; 20]) -> [f64; 20] {
    DATA.map(|a| {
        let term = |b: &[usize; 3]| (0..3).map(|axis| HERMITE_AT_0[b[axis]][a[axis]]).product::<f64>();
        DATA.iter().zip(weights).map(|(b, weight)| weight * term(b)).sum()
    })
}

/// For each direction of the cube, the distance up to which the fit is valid without interruption from rest,
/// rounded down to 1/255 of the radius.
fn reach(radius_m: f64, is_valid_at: impl Fn([f64; 3]) -> bool) -> Vec<u8> {
    let half = (REACH_SIDE / 2) as i32;
    let share = |index: usize| {
        let (ab, c) = (index / REACH_SIDE, index % REACH_SIDE);
        let towards = [ab / REACH_SIDE, ab % REACH_SIDE, c].map(|n| n as i32 - half);
        let is_on_surface = towards.iter().any(|n| n.abs() == half);
        if is_on_surface { along(towards, radius_m, &is_valid_at) } else { 0 }
    };
    (0..REACH_POINTS).map(share).collect()
}

fn along(towards: [i32; 3], radius_m: f64, is_valid_at: &impl Fn([f64; 3]) -> bool) -> u8 {
    let length = towards.iter().map(|n| f64::from(n * n)).sum::<f64>().sqrt();
    let at = |share: f64| towards.map(|n| f64::from(n) / length * share * radius_m);
    let step = 1.0 / f64::from(STEPS);
    let whole = (1..=STEPS).take_while(|n| is_valid_at(at(f64::from(*n) * step))).count() as u32;
    let (mut low, mut high) = (f64::from(whole) * step, f64::from(whole + 1) * step);
    if whole < STEPS {
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if is_valid_at(at(middle)) { low = middle } else { high = middle }
        }
    }
    // The fit is always valid at rest, and 0 would mean no range.
    ((255.0 * low.min(1.0)) as u8).max(1)
}

#[cfg(test)]
mod tests {
    use palpate_core::lanes::Baseline;

    use super::super::KernelSystem;
    use super::super::synthetic::{jet, spread};
    use super::*;

    const RADIUS_M: f64 = 0.05;

    fn fit(configurations: u32, length_m: f64) -> KernelFit {
        let mut system = KernelSystem::of_energy(length_m, jet([0.0; 3]).stiffness_n_m);
        system.add(&[jet([0.0; 3])]).expect("the first");
        for n in 1..configurations {
            system.add(&[jet(spread(n, RADIUS_M))]).expect("apart");
        }
        system.fit
    }

    fn table(planes: &KernelPlanes) -> KernelTable<'_> {
        KernelTable::new(RADIUS_M as f32, planes.view()).expect("checked")
    }

    fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    }

    /// Compares the core's value, gradient and Hessian with those of the fit. The fit has a small force at
    /// rest; the core subtracts it.
    #[test]
    fn the_core_gives_back_the_fit() {
        for (configurations, length_m) in [(4, 0.03), (21, 0.03), (36, 0.04), (37, 0.02)] {
            let fit = fit(configurations, length_m);
            let planes = KernelPlanes::new(&fit, RADIUS_M, |_| true).expect("it fits");
            let (table, rest) = (table(&planes), fit.jet([0.0; 3]));
            assert_eq!(planes.blocks.len(), configurations.div_ceil(4) as usize);
            for n in 0..500 {
                let at = spread(n, RADIUS_M).map(|x| x as f32);
                let exact = fit.jet(at.map(f64::from));
                let found = table.jet(at);
                let linear: f64 = rest.force_n.iter().zip(at).map(|(g, x)| g * f64::from(x)).sum();
                let energy_j = exact.energy_j - rest.energy_j - linear;
                assert!((found.energy_j - energy_j).abs() < 1e-9, "{} {energy_j}", found.energy_j);
                let force_n = std::array::from_fn(|i| exact.force_n[i] - rest.force_n[i]);
                assert!(apart(found.force_n, force_n) < 1e-7, "{:?} {force_n:?}", found.force_n);
                for (i, j) in (0..9).map(|code| (code / 3, code % 3)) {
                    let (a, b) = (found.stiffness_n_m[i][j], exact.stiffness_n_m[(i, j)]);
                    assert!((a - b).abs() < 1e-5, "{a} {b}");
                }
                // The sum of the tick; its error is the rounding to f32.
                let tick = table.force(Baseline, at).map(f64::from);
                assert!(apart(tick, force_n) < 2e-6, "{tick:?} {force_n:?}");
            }
            assert_eq!(table.force(Baseline, [0.0; 3]), [0.0; 3]);
        }
    }

    /// The comparison above must detect an error of 0.1 mN in one coefficient.
    #[test]
    fn a_planted_fault_is_seen() {
        let fit = fit(21, 0.03);
        let mut planes = KernelPlanes::new(&fit, RADIUS_M, |_| true).expect("it fits");
        let worst = |planes: &KernelPlanes| {
            let (table, rest) = (table(planes), fit.force_n([0.0; 3]));
            let error = |n: u32| {
                let at = spread(n, RADIUS_M).map(|x| x as f32);
                let exact = fit.force_n(at.map(f64::from));
                apart(table.jet(at).force_n, std::array::from_fn(|i| exact[i] - rest[i]))
            };
            (0..300).map(error).fold(0.0, f64::max)
        };
        assert!(worst(&planes) < 1e-7);
        for number in 3..NUMBERS {
            let kept = planes.blocks[2][number][1];
            planes.blocks[2][number][1] += 1e-4;
            assert!(worst(&planes) > 1e-7, "the test ignores number {number}");
            planes.blocks[2][number][1] = kept;
        }
    }

    /// Required precision of the numbers: f64, in the blob and in the tick.
    #[test]
    fn singles_cost_more_than_the_fit_errs() {
        let fit = fit(36, 0.04);
        let planes = KernelPlanes::new(&fit, RADIUS_M, |_| true).expect("it fits");
        let mut rounded = planes.clone();
        for x in rounded.blocks.iter_mut().flatten().flatten() {
            *x = f64::from(*x as f32);
        }
        let (exact, stored) = (table(&planes), table(&rounded));
        let (mut of_storage, mut of_sum, mut of_tick) = (0.0_f64, 0.0_f64, 0.0_f64);
        for n in 0..2000 {
            let at = spread(n, RADIUS_M).map(|x| x as f32);
            let truth = exact.jet(at).force_n;
            of_storage = of_storage.max(apart(stored.jet(at).force_n, truth));
            of_sum = of_sum.max(apart(in_singles(&planes, at), truth));
            of_tick = of_tick.max(apart(exact.force(Baseline, at).map(f64::from), truth));
        }
        let largest = planes.blocks.iter().flatten().flatten().fold(0.0_f64, |most, x| most.max(x.abs()));
        println!(
            "largest number {largest:.3e} N; f32 numbers {:.4} mN, f32 sum {:.4} mN, as it is {:.4} mN",
            1e3 * of_storage,
            1e3 * of_sum,
            1e3 * of_tick
        );
        assert!(of_tick < 2e-6);
        assert!(of_sum > 100.0 * of_tick && of_storage > 10.0 * of_tick);
    }

    /// The core's sum with f32 instead of f64.
    fn in_singles(planes: &KernelPlanes, displacement_m: [f32; 3]) -> [f64; 3] {
        let x = displacement_m.map(|p| p / planes.scalars[0] as f32);
        let sum = |x: [f32; 3]| -> [f32; 3] {
            let mut sum = [0.0_f32; 3];
            for (block, lane) in planes.blocks.iter().flat_map(|b| (0..LANES).map(move |lane| (b, lane))) {
                let r: [f32; 3] = std::array::from_fn(|axis| x[axis] - block[axis][lane] as f32);
                let e = (-0.5 * r.iter().map(|r| r * r).sum::<f32>()).exp();
                let factorial = [1.0_f32, 1.0, 2.0, 6.0];
                let (mut value, mut slope) = (0.0_f32, [0.0_f32; 3]);
                for (orders, number) in DATA.iter().zip(&block[3..]) {
                    let number = number[lane] as f32;
                    let power = |i: usize, n: usize| r[i].powi(n as i32) / factorial[n];
                    value += number * (0..3).map(|i| power(i, orders[i])).product::<f32>();
                    for (along, slope) in slope.iter_mut().enumerate() {
                        let mut lower = *orders;
                        if lower[along] > 0 {
                            lower[along] -= 1;
                            *slope += number * (0..3).map(|i| power(i, lower[i])).product::<f32>();
                        }
                    }
                }
                for i in 0..3 {
                    sum[i] += e * (slope[i] - r[i] * value);
                }
            }
            sum
        };
        let [_, xx, xy, xz, yy, yz, zz] = planes.scalars.map(|b| b as f32);
        let base = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
        let (here, rest) = (sum(x), sum([0.0; 3]));
        std::array::from_fn(|i| f64::from((0..3).map(|j| base[i][j] * x[j]).sum::<f32>() + here[i] - rest[i]))
    }

    /// The range ends where the fit becomes invalid along a ray from rest.
    #[test]
    fn a_reach_ends_where_the_fit_does() {
        let fit = fit(8, 0.03);
        // An ellipsoid, and behind it a separate region that no ray reaches without leaving the first one.
        let is_valid_at = |at: [f64; 3]| {
            let inside = (at[0] / 0.04).powi(2) + (at[1] / 0.02).powi(2) + (at[2] / 0.03).powi(2) < 1.0;
            inside || at[1].abs() > 0.035
        };
        let planes = KernelPlanes::new(&fit, RADIUS_M, is_valid_at).expect("it fits");
        let table = table(&planes);
        for n in 0..2000 {
            let [x, y, z] = spread(n, 1.0);
            let length = (x * x + y * y + z * z).sqrt();
            let exact =
                ((x / 0.04).powi(2) + (y / 0.02).powi(2) + (z / 0.03).powi(2)).sqrt().recip() * length;
            let found = f64::from(table.reach_m([x, y, z].map(|x| x as f32)));
            assert!((found - exact).abs() < 0.06 * exact, "{found} {exact}");
        }
    }
}
