//! A capsule against the skin: its derivatives by centre and axis, and a sphere as its limit.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};
use palpate_precompute::fem::{CoatedSphere, Configuration, Constraints, Layer, Pose, Problem, Solver};

use super::live_sphere::{scene, way};

const RADIUS_M: f64 = 0.008;

/// A solver of the small organ under a capsule, the start of its way beside the body, and its place in the skin.
struct Press {
    solver: Solver,
    beside: Vector3<f64>,
    pressed: Vector3<f64>,
}

impl Press {
    fn new() -> Self {
        let scene = scene();
        let body = scene.body().expect("it can be solved");
        // A thick layer, because the fourth derivatives jump where a point comes into it.
        let layer = Layer { thickness_m: 4e-3, pressure_pa: 1e5 };
        let capsule = CoatedSphere::new(&body, RADIUS_M, layer, [0.0; 3]);
        let free = Problem::with(body.into(), None, Constraints::Elimination);
        let way = way(&scene);
        Self { solver: Solver::new(Arc::new(free.at(capsule))), beside: way[0], pressed: way[280] }
    }

    /// The state with this centre and half axis, from beside the body in steps of a millimetre; of a sphere without one.
    fn solve(&mut self, centre: Vector3<f64>, half: impl Into<Option<Vector3<f64>>>) -> Configuration {
        self.solver.set_half_axis(half.into().map(Into::into));
        let mut state = self.solver.problem().body.rest_state.clone();
        let mut found = None;
        for n in (0..=40).rev() {
            let at = centre + f64::from(n) / 40.0 * (self.beside - self.pressed);
            let next = self.solver.solve_at(&Pose::translation(at.into()), &state).expect("it converges");
            state.clone_from(&next.seed.state);
            found = Some(next);
        }
        found.expect("there are steps")
    }
}

/// By central differences with the half axis fixed, and with the centre fixed.
#[test]
fn the_derivatives_of_a_capsule_are_differences() {
    let mut press = Press::new();
    let (centre, half) = (press.pressed, Vector3::new(0.004, 0.009, 0.003));
    let found = press.solve(centre, half);
    let (jet, coupling) = (*found.jet(), found.seed.coupling.expect("of the axis"));
    let force = Vector3::from(jet.force_n);
    assert!(force.norm() > 0.5, "{force}");
    let step_m = 1e-5;
    let mut stiffness = Matrix3::zeros();
    for axis in 0..3 {
        let by: Vector3<f64> = step_m * Vector3::ith(axis, 1.0);
        let [before, after] = [-by, by].map(|by| *press.solve(centre + by, half).jet());
        let slope = (after.energy_j - before.energy_j) / (2.0 * step_m);
        assert!((slope - force[axis]).abs() < 1e-6 * force.norm(), "{slope} {force}");
        let column = (Vector3::from(after.force_n) - Vector3::from(before.force_n)) / (2.0 * step_m);
        stiffness.set_column(axis, &column);
        // W_ijk along one axis.
        let third = (after.stiffness_n_m[(axis, axis)] - before.stiffness_n_m[(axis, axis)]) / (2.0 * step_m);
        let known = jet.third_n_m2[[0, 6, 9][axis]];
        assert!(
            (third - known).abs() < 1e-3 * jet.third_n_m2.iter().map(|x| x.abs()).fold(0.0, f64::max),
            "{third} {known}"
        );

        let of_axis = [-by, by].map(|by| press.solve(centre, half + by));
        let [before, after] = of_axis.each_ref().map(|found| *found.jet());
        let [low, high] =
            of_axis.map(|found| Vector3::from(found.seed.coupling.expect("of the axis").force_n));
        let bent = (high - low) / (2.0 * step_m);
        let error = (bent - coupling.own_n_m.column(axis)).norm();
        assert!(error < 1e-3 * coupling.own_n_m.norm(), "{axis}: {bent} {}", coupling.own_n_m);
        let slope = (after.energy_j - before.energy_j) / (2.0 * step_m);
        assert!(
            (slope - coupling.force_n[axis]).abs() < 1e-5 * force.norm(),
            "{slope} {:?}",
            coupling.force_n
        );
        let column = (Vector3::from(after.force_n) - Vector3::from(before.force_n)) / (2.0 * step_m);
        let error = (column - coupling.mixed_n_m.column(axis)).norm();
        assert!(error < 1e-4 * coupling.mixed_n_m.norm(), "{axis}: {column} {}", coupling.mixed_n_m);
    }
    assert!(
        (stiffness - jet.stiffness_n_m).norm() < 1e-4 * stiffness.norm(),
        "{stiffness} {}",
        jet.stiffness_n_m
    );
    // A turn t changes the axis by t x a, and the energy by t . (a x dW/da).
    let torque = half.cross(&Vector3::from(coupling.force_n));
    let error = (Vector3::from(found.torque_n_m) - torque).norm();
    assert!(error < 1e-8 * torque.norm() && torque.norm() > 1e-4, "{error} of {torque}");
}

/// A capsule without length is a sphere, and one is longer than a sphere of its radius: it pushes harder.
#[test]
fn a_short_capsule_is_a_sphere() {
    let mut press = Press::new();
    let centre = press.pressed;
    let tiny = press.solve(centre, Vector3::new(0.0, 1e-9, 0.0));
    let long = press.solve(centre, Vector3::new(0.0, 0.01, 0.0));
    let sphere = press.solve(centre, None);
    let (one, other) = (Vector3::from(tiny.jet().force_n), Vector3::from(sphere.jet().force_n));
    assert!((one - other).norm() < 1e-5 * other.norm(), "{one} {other}");
    assert!(Vector3::from(long.jet().force_n).norm() > 1.1 * other.norm());
}
