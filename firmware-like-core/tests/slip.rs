//! The energy of a slip: no closed path over the surface gives energy to the hand.

use crate::common::ball::{RADIUS_M, uneven};
use crate::common::{Recipe, sphere};
use palpate_core::vec3::{self, Vec3};
use palpate_core::{AlignedBytes, Config, Controller, Method, Organ, Phase, Sample, State, TouchSurface};

/// The ball with energies, between whose nodes the stiffness varies by a third.
fn ball() -> AlignedBytes {
    let body = sphere(RADIUS_M, 2);
    let recipe = Recipe {
        nodes: body.0.clone(),
        normal: vec3::normalize_or_zero,
        stiffer: uneven,
        body: Some(body),
        radius_m: 0.02,
        rbf: false,
        hermite: true,
        displacement: false,
        force: |d| d.map(|x| 400.0 * f64::from(x)),
        ghost: |d| d.map(|x| 400.0 * f64::from(x)),
        ..Recipe::default()
    };
    recipe.blob()
}

/// Work on the body of a press, a slide at a depth along a part of a circle, and a lift there, J. The way back is
/// free, so the path is closed.
fn stroke(blob: &AlignedBytes, friction: f32, method: Method, (tilt, from, length): (f32, u32, u32)) -> f64 {
    let organ = <Organ<'_>>::read(blob).expect("good");
    let mut memory = vec![0; TouchSurface::words(&organ)];
    let mut config = Config::new(method);
    config.contact.friction = friction;
    config.contact.capture_radius_m = 1.0;
    config.limits.max_stiffness_n_m = f32::INFINITY;
    let surface = TouchSurface::new(&organ, &mut memory);
    let controller = Controller::new(&organ, config).expect("packed").on_surface(surface);
    let mut state = State::new();
    state.arm();
    let steps = 3_000;
    let at = |index: u32, height_m: f32| -> Vec3 {
        let angle = core::f32::consts::TAU * index as f32 / steps as f32;
        let (sine, cosine) = (libm::sinf(angle), libm::cosf(angle));
        let (st, ct) = (libm::sinf(tilt), libm::cosf(tilt));
        vec3::scale([cosine, sine * ct, sine * st], RADIUS_M + height_m)
    };
    let down = (0..=60).map(|i| at(from, 1e-3 - 1e-4 * i as f32));
    let along = (0..=length).map(|i| at(from + i, -5e-3));
    let up = (0..=100).map(|i| at(from + length, -5e-3 + 1e-4 * i as f32));
    let (mut work_j, mut before): (f64, Option<(Vec3, Vec3)>) = (0.0, None);
    for (t, position_m) in (0..).zip(down.chain(along).chain(up)) {
        let sample = Sample { t_us: 1_000 * t, position_m, ..Sample::default() };
        let command = controller.tick(&mut state, sample.t_us, Some(&sample));
        assert_eq!(command.phase, Phase::Active, "{command:?}");
        if let Some((from_m, from_n)) = before {
            let mean_n = vec3::scale(vec3::add(from_n, command.reaction_n), 0.5);
            work_j += f64::from(vec3::dot(mean_n, vec3::sub(position_m, from_m)));
        }
        before = Some((position_m, command.reaction_n));
    }
    assert_eq!(before.expect("ticks").1, vec3::ZERO, "the tool has left");
    work_j
}

#[test]
fn no_closed_path_over_the_surface_gives_energy_to_the_hand() {
    let blob = ball();
    let mut least_j = [f64::INFINITY; 2];
    for friction in [0.0, 0.02] {
        for tilt in [0.0, 0.4, 1.1, 2.3] {
            for from in (0..3_000).step_by(150) {
                // The cubics have the same forces at the nodes and no energy: the slip follows the force alone.
                for (least_j, method) in least_j.iter_mut().zip([Method::Energy, Method::Hermite]) {
                    let work_j = stroke(&blob, friction, method, (tilt, from, 220));
                    *least_j = least_j.min(work_j);
                }
            }
        }
    }
    let [with_j, without_j] = least_j;
    println!(
        "least work into the body: {:.4} mJ, along the force alone {:.4} mJ",
        1e3 * with_j,
        1e3 * without_j
    );
    assert!(with_j > -2e-6, "the hand receives {with_j} J");
    assert!(without_j < -1e-4, "the paths are too easy: {without_j}");
}
