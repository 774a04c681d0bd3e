//! Jets of a capsule: its half axis is the second control, and turns the force and the moment.

use palpate_core::vec3::Vec3;
use palpate_core::{Field, Jet, JetCoupling, JetFlags, JetMemory, NodeWeight, Touch, vec3};

use crate::common::jets::flat;

const SLOPE_N: Vec3 = [1.0, -2.0, 0.5];
const MIXED_N_M: [Vec3; 3] = [[30.0, 0.0, 5.0], [0.0, 20.0, 0.0], [7.0, 0.0, 10.0]];
/// Q = d2W/da2: xx, xy, xz, yy, yz, zz.
const OWN_N_M: [f32; 6] = [100.0, 10.0, 0.0, 200.0, -20.0, 300.0];

/// A jet whose axis was this one.
fn turned(half_m: Vec3, flags: JetFlags) -> Jet {
    let coupling =
        JetCoupling { control_m: half_m, slope_n: SLOPE_N, mixed_n_m: MIXED_N_M, own_n_m: OWN_N_M };
    Jet { flags, energy_j: 0.2, coupling: Some(coupling), ..flat(0, [0.0; 3], [0.0, 0.0, 3.0]) }
}

struct Tool {
    memory: JetMemory<1, 8>,
    now_us: u64,
}

impl Tool {
    /// Force and dW/da after the fades.
    fn at(&mut self, displacement_m: Vec3, half_m: Vec3) -> (Vec3, Vec3) {
        for _ in 0..300 {
            self.tick(displacement_m, half_m);
        }
        self.tick(displacement_m, half_m)
    }

    fn tick(&mut self, displacement_m: Vec3, half_m: Vec3) -> (Vec3, Vec3) {
        self.now_us += 1_000;
        let weights = [NodeWeight { space: 0, weight: 1.0 }, NodeWeight::default(), NodeWeight::default()];
        let half_axis_m = Some(half_m);
        let touch =
            Touch { now_us: self.now_us, weights, displacement_m, hip_m: displacement_m, half_axis_m };
        let force_n = self.memory.force(&touch).expect("there is a jet").force_n;
        (force_n, self.memory.turning_n())
    }

    fn with(jets: impl IntoIterator<Item = Jet>) -> Self {
        let mut memory = JetMemory::new();
        assert!(jets.into_iter().all(|jet| memory.insert(&jet)));
        Self { memory, now_us: 0 }
    }
}

/// W = 0.2 + 3 z + (slope + x M) . y + y Q y / 2, or its root: force and dW/da are the derivatives by differences.
#[test]
fn force_and_slope_are_the_derivatives_of_one_energy() {
    let value = |[x, y, z]: [f64; 3], [a, b, c]: [f64; 3]| -> f64 {
        let slope = [1.0 + 30.0 * x + 7.0 * z, -2.0 + 20.0 * y, 0.5 + 5.0 * x + 10.0 * z];
        let own = 50.0 * a * a + 10.0 * a * b + 100.0 * b * b - 20.0 * b * c + 150.0 * c * c;
        0.2 + 3.0 * z + slope[0] * a + slope[1] * b + slope[2] * c + own
    };
    let (d, by) = ([0.003, -0.002, 0.004], [0.002, 0.001, -0.003]);
    let control: [f64; 3] = [0.01, 0.0, 0.005];
    for root in [false, true] {
        let mut tool =
            Tool::with([turned(control.map(|x| x as f32), JetFlags { root, ..JetFlags::default() })]);
        let half_m: [f64; 3] = std::array::from_fn(|k| control[k] + by[k]);
        let (force_n, slope_n) = tool.at(d.map(|x: f64| x as f32), half_m.map(|x| x as f32));
        let energy = |d, by| if root { 0.5 * f64::powi(value(d, by), 2) } else { value(d, by) };
        for axis in 0..3 {
            let moved = |of: [f64; 3], step: f64| {
                let mut moved = of;
                moved[axis] += step;
                moved
            };
            let step = 1e-6;
            let wanted_n = (energy(moved(d, step), by) - energy(moved(d, -step), by)) / (2.0 * step);
            let turning_n = (energy(d, moved(by, step)) - energy(d, moved(by, -step))) / (2.0 * step);
            assert!(
                (f64::from(force_n[axis]) - wanted_n).abs() < 1e-4,
                "{root} {axis}: {force_n:?} {wanted_n}"
            );
            assert!(
                (f64::from(slope_n[axis]) - turning_n).abs() < 1e-4,
                "{root} {axis}: {slope_n:?} {turning_n}"
            );
        }
    }
}

/// A touch begins without a moment, and another jet takes over without a step of it.
#[test]
fn a_moment_has_no_steps() {
    let flags = JetFlags { root: true, ..JetFlags::default() };
    let mut tool = Tool::with([turned([0.01, 0.0, 0.0], flags)]);
    let half_m = [0.01, 0.001, 0.0];
    assert_eq!(tool.tick(vec3::ZERO, half_m).1, vec3::ZERO);
    let (_, mut before_n) = tool.at(vec3::ZERO, half_m);
    assert!(vec3::norm(before_n) > 0.3, "{before_n:?}");
    assert!(tool.memory.insert(&Jet { energy_j: 0.3, ..turned([0.01, 0.0, 0.0], flags) }));
    let mut largest_n = 0.0_f32;
    for _ in 0..100 {
        let (_, now_n) = tool.tick(vec3::ZERO, half_m);
        largest_n = largest_n.max(vec3::distance(now_n, before_n));
        before_n = now_n;
    }
    // The change of 0.23 N fades in with 10 ms.
    assert!((0.01..0.04).contains(&largest_n), "{largest_n}");
    tool.memory.released(tool.now_us);
    assert_eq!(tool.memory.turning_n(), vec3::ZERO);
}
