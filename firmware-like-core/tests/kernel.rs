//! The method `kernel`: a plain reference sum, derivatives, closed paths, the force outside the reach,
//! damaged planes.

use crate::common::kernel::{BASE_N, LENGTH_M, RADIUS_M, SPACING_M, add, blob, blocks, recipe};
use crate::common::{Draft, Random, distance, sign};
use palpate_core::format::{KernelHeader, PlaneRef};
use palpate_core::kernel::{Block, LANES, NUMBERS, REACH_POINTS, REACH_SIDE, SCALARS};
use palpate_core::vec3::{self, Vec3};
use palpate_core::{
    AlignedBytes, BlobError, Config, Controller, Coverage, Method, Organ, Phase, PlaneError, PlaneProblem,
    Sample, Space, State,
};

fn spoiled(spoil: impl FnOnce(&mut Draft, KernelHeader)) -> Result<(), BlobError> {
    let blob = recipe().blob_with(|draft| {
        add(draft);
        let header = draft.spaces[0].kernel.expect("just added");
        spoil(draft, header);
    });
    Organ::<2>::read(&blob).map(|_| ())
}

fn read(blob: &AlignedBytes) -> Organ<'_, 2> {
    Organ::read(blob).expect("the blob is good")
}

/// W by monomials and the exponential of the standard library, J.
fn plain(displacement_m: [f64; 3]) -> f64 {
    let sum = |x: [f64; 3]| -> f64 {
        let factorial = [1.0, 1.0, 2.0, 6.0];
        let mut orders = vec![[0; 3]];
        for degree in 1..=3_usize {
            for a in (0..=degree).rev() {
                orders.extend((0..=degree - a).rev().map(|b| [a, b, degree - a - b]));
            }
        }
        let term = |block: &Block, lane: usize| {
            let r: [f64; 3] = core::array::from_fn(|i| x[i] - block[i][lane]);
            let e = (-0.5 * r.iter().map(|r| r * r).sum::<f64>()).exp();
            let monomial = |o: &[usize; 3]| -> f64 {
                (0..3).map(|i| r[i].powi(o[i] as i32) / factorial[o[i]]).product()
            };
            e * orders.iter().zip(&block[3..]).map(|(o, number)| number[lane] * monomial(o)).sum::<f64>()
        };
        blocks().iter().flat_map(|block| (0..LANES).map(move |lane| term(block, lane))).sum()
    };
    let x = displacement_m.map(|p| p / LENGTH_M);
    let step = 1e-5;
    let at =
        |axis: usize, sign: f64| sum(core::array::from_fn(|i| if i == axis { sign * step } else { 0.0 }));
    let linear: f64 = (0..3).map(|axis| x[axis] * (at(axis, 1.0) - at(axis, -1.0)) / (2.0 * step)).sum();
    let [xx, xy, xz, yy, yz, zz] = BASE_N;
    let [a, b, c] = x;
    let quadratic = 0.5 * (xx * a * a + yy * b * b + zz * c * c) + xy * a * b + xz * a * c + yz * b * c;
    LENGTH_M * (quadratic + sum(x) - sum([0.0; 3]) - linear)
}

fn within(space: &Space<'_>, random: &mut Random) -> Vec3 {
    loop {
        let d = random.point(RADIUS_M);
        let reach = space.kernel().expect("packed").reach_m(d);
        if vec3::norm(d) < 0.98 * reach {
            return d;
        }
    }
}

#[test]
fn value_gradient_and_hessian_are_those_of_the_plain_sum() {
    let blob = blob();
    let organ = read(&blob);
    let space = &organ.spaces[0];
    let mut random = Random(1);
    for _ in 0..500 {
        let d = within(space, &mut random);
        let found = space.estimate(Method::Kernel, d).expect("packed");
        let p = d.map(f64::from);
        let w = plain(p);
        assert!((f64::from(found.energy_j.expect("within reach")) - w).abs() < 1e-7 + 1e-6 * w.abs());
        let h = 1e-5;
        let moved = |axis: usize, step: f64| {
            let mut at = p;
            at[axis] += step;
            at
        };
        for i in 0..3 {
            let slope = (plain(moved(i, h)) - plain(moved(i, -h))) / (2.0 * h);
            assert!((f64::from(found.force_n[i]) - slope).abs() < 2e-5, "{slope} {found:?}");
            for j in 0..3 {
                let column = |step: f64| {
                    let at = moved(j, step).map(|x| x as f32);
                    let exact = f64::from(at[j]);
                    (exact, space.kernel().expect("packed").jet(at).force_n[i])
                };
                let ((low, below), (high, above)) = (column(-1e-4), column(1e-4));
                let slope = (above - below) / (high - low);
                let found = f64::from(found.stiffness_n_m[i][j]);
                assert!((found - slope).abs() < 0.05 + 1e-3 * slope.abs(), "{i}{j}: {found} {slope}");
            }
        }
    }
    let rest = space.force(Method::Kernel, [0.0; 3]).expect("packed");
    assert_eq!((rest.force_n, rest.coverage), ([0.0; 3], Coverage::Scattered));
}

/// On a closed path the kernel returns the energy it took; the tri-cubic of the same blob does not.
#[test]
fn no_work_is_done_round_a_loop() {
    let blob = blob();
    let organ = read(&blob);
    let space = &organ.spaces[0];
    let work = |method| -> (f64, f64) {
        let (mut net, mut exchanged) = (0.0, 0.0);
        const STEPS: usize = 4000;
        let place = |n: usize| -> [f64; 3] {
            let (s, c) = (std::f64::consts::TAU * n as f64 / STEPS as f64).sin_cos();
            [0.004 + 0.01 * c, 0.002 + 0.01 * s, -0.003 + 0.004 * s * c]
        };
        for n in 0..STEPS {
            let (a, b) = (place(n), place(n + 1));
            let middle: [f32; 3] = std::array::from_fn(|i| (0.5 * (a[i] + b[i])) as f32);
            let answer = space.force(method, middle).expect("packed");
            assert!(method != Method::Kernel || answer.coverage == Coverage::Scattered);
            let step: f64 = (0..3).map(|i| f64::from(answer.force_n[i]) * (b[i] - a[i])).sum();
            net += step;
            exchanged += step.abs();
        }
        (net.abs(), exchanged)
    };
    let ((kernel, of), (tricubic, of_tricubic)) = (work(Method::Kernel), work(Method::Tricubic));
    assert!(kernel < 1e-6 * of, "{kernel} of {of} J");
    assert!(
        tricubic / of_tricubic > 10.0 * kernel / of,
        "the path must show a difference: {tricubic} of {of_tricubic} J"
    );
}

/// Value and slope are continuous at the end of the reach. Further out the force is constant along a ray, and
/// continuous across rays.
#[test]
fn outside_the_reach_the_force_becomes_constant() {
    let blob = blob();
    let organ = read(&blob);
    let space = &organ.spaces[0];
    let table = space.kernel().expect("packed");
    let mut random = Random(4);
    for _ in 0..1000 {
        let direction = vec3::normalize_or_zero(random.point(1.0));
        let rim = table.reach_m(direction);
        assert!((0.4 * RADIUS_M..RADIUS_M).contains(&rim));
        let force = |r: f32| space.force(Method::Kernel, vec3::scale(direction, r)).expect("packed");
        let (inside, outside) = (force(0.99999 * rim), force(1.00001 * rim));
        assert_eq!(
            (inside.coverage, outside.coverage),
            (Coverage::Scattered, Coverage::Extrapolated),
            "{direction:?}"
        );
        assert!(distance(inside.force_n, outside.force_n) < 2e-3, "{direction:?}");
        let step = 2e-5;
        let [low, high] = [-step, step].map(|d| {
            let [near, far] = [force(rim + 0.05 * d).force_n, force(rim + d).force_n];
            vec3::scale(vec3::sub(far, near), 1.0 / (0.95 * d))
        });
        assert!(distance(low, high) < 12.0, "{direction:?}: {low:?} {high:?}");
        let last = force(rim + 1.001 * SPACING_M).force_n;
        for far in [0.05, 1.0, 1e20, 3e38] {
            assert!(distance(force(far).force_n, last) < 2e-4, "{direction:?} at {far}");
        }
        // Across rays, over the edges and faces of the cube of the reach.
        for out in [1.1, 2.0, 100.0] {
            let axis = (out as usize) % 3;
            let mut on_edge = direction;
            on_edge[(axis + 1) % 3] = on_edge[axis];
            let [low, high] = [-1e-7, 1e-7].map(|step| {
                let mut at = on_edge;
                at[axis] += step;
                space.force(Method::Kernel, vec3::scale(at, out * RADIUS_M)).expect("packed").force_n
            });
            assert!(distance(low, high) < 2e-3, "{on_edge:?}: {low:?} {high:?}");
        }
    }
    for odd in [[f32::NAN, 0.0, 0.0], [f32::INFINITY, 0.0, 1.0], [f32::NEG_INFINITY; 3]] {
        let answer = space.force(Method::Kernel, odd).expect("packed");
        assert_eq!((answer.force_n, answer.coverage), ([0.0; 3], Coverage::Extrapolated));
        assert!(space.estimate(Method::Kernel, odd).expect("packed").energy_j.is_none());
    }
    let tiny = space.force(Method::Kernel, [1e-45, -1e-42, 0.0]).expect("packed").force_n;
    assert!(vec3::norm(tiny) < 1e-6);
}

/// The derivatives on both sides of the faces of the lattice agree.
#[test]
fn the_force_is_smooth_inside_the_reach() {
    let blob = blob();
    let organ = read(&blob);
    let space = &organ.spaces[0];
    let mut random = Random(6);
    for n in 0..2000 {
        let mut d = within(space, &mut random);
        d[n % 3] = (d[n % 3] / SPACING_M).round() * SPACING_M;
        let Some(here) = space.estimate(Method::Kernel, d).filter(|found| found.energy_j.is_some()) else {
            continue;
        };
        for step in [-1e-7, 1e-7] {
            let mut at = d;
            at[n % 3] += step;
            let there = space.estimate(Method::Kernel, at).expect("packed");
            assert!(distance(here.force_n, there.force_n) < 2e-4);
            for (a, b) in here.stiffness_n_m.iter().zip(there.stiffness_n_m) {
                assert!(distance(*a, b) < 0.1, "{a:?} {b:?}");
            }
        }
        let s = here.stiffness_n_m;
        assert_eq!([s[0][1], s[0][2], s[1][2]], [s[1][0], s[2][0], s[2][1]]);
    }
}

#[test]
fn a_space_with_a_kernel_has_the_method_and_one_without_has_not() {
    let plain = recipe().blob();
    assert!(!read(&plain).spaces[0].has(Method::Kernel));
    assert_eq!(read(&plain).spaces[0].force(Method::Kernel, [0.0; 3]), None);
    let blob = blob();
    assert!(
        Method::ALL
            .into_iter()
            .filter(|m| !m.name().starts_with("rbf"))
            .all(|m| read(&blob).spaces[0].has(m))
    );
    assert_eq!(spoiled(|draft, _| draft.spaces[0].kernel = None), Ok(()));
}

#[test]
fn invalid_planes_are_refused_by_name() {
    let of = |plane, problem| Err(BlobError::Plane { space: Some(0), error: PlaneError { plane, problem } });
    let scalar = |place: usize, value: f64| {
        spoiled(|draft, header| {
            draft.area.plane(header.scalars, 8)[8 * place..][..8].copy_from_slice(&value.to_le_bytes());
        })
    };
    // l is not positive, or so small that the exponents leave their range.
    for value in [0.0, -0.02, f64::NAN, 1e-9, f64::from(RADIUS_M) / 16.1, 1e9] {
        assert_eq!(scalar(0, value), of("kernel scalars", PlaneProblem::Value { index: 0 }), "{value}");
    }
    assert_eq!(scalar(0, f64::from(RADIUS_M) / 15.9), Ok(()));
    for place in 1..SCALARS {
        for value in [f64::NAN, f64::INFINITY, 1e16] {
            assert_eq!(scalar(place, value), of("kernel scalars", PlaneProblem::Value { index: place }));
        }
    }
    for place in 0..NUMBERS {
        for value in [f64::NAN, f64::NEG_INFINITY, -1e16] {
            let found = spoiled(|draft, header| {
                let at = (2 * NUMBERS * LANES + place * LANES + 3) * 8;
                draft.area.plane(header.blocks, 8 * NUMBERS * LANES)[at..][..8]
                    .copy_from_slice(&value.to_le_bytes());
            });
            assert_eq!(found, of("kernel blocks", PlaneProblem::Value { index: 2 }), "number {place}");
        }
    }
    assert_eq!(
        spoiled(|draft, header| draft.area.plane(header.reach, 1)[REACH_SIDE] = 0),
        of("kernel reach", PlaneProblem::OutOfRange { index: REACH_SIDE })
    );
    let inner = (REACH_SIDE + 1) * REACH_SIDE + 1;
    assert_eq!(spoiled(|draft, header| draft.area.plane(header.reach, 1)[inner] = 0), Ok(()));
    let shorter = |of: fn(&mut KernelHeader) -> &mut PlaneRef, by: i64| {
        spoiled(|draft, mut header| {
            let plane = of(&mut header);
            plane.len = (i64::from(plane.len) + by) as u32;
            draft.spaces[0].kernel = Some(header);
        })
    };
    let length = |plane, have, need| of(plane, PlaneProblem::Length { have, need });
    assert_eq!(shorter(|h| &mut h.scalars, -1), length("kernel scalars", 6, 7));
    assert_eq!(shorter(|h| &mut h.reach, -1), length("kernel reach", 728, 729));
    assert_eq!(shorter(|h| &mut h.blocks, -6), length("kernel blocks", 0, 1));
    let too_many = BlobError::Capacity { what: "kernel centres", space: Some(0), need: 4 * 65, limit: 256 };
    assert_eq!(shorter(|h| &mut h.blocks, 65 - 6), Err(too_many));
    for (what, of) in [
        ("kernel scalars", (|h| &mut h.scalars) as fn(&mut KernelHeader) -> &mut PlaneRef),
        ("kernel blocks", |h| &mut h.blocks),
        ("kernel reach", |h| &mut h.reach),
    ] {
        for offset in [1 << 30, 8] {
            let found = spoiled(|draft, mut header| {
                of(&mut header).offset = offset;
                draft.spaces[0].kernel = Some(header);
            });
            assert!(
                matches!(found, Err(BlobError::Plane { error, space: Some(0) }) if error.plane == what),
                "{found:?}"
            );
        }
    }
}

/// Any byte of the kernel is damaged, with a correct checksum: the blob is refused, or finite everywhere. The
/// checksum itself detects truncations and single bits.
#[test]
fn damage_behind_a_correct_checksum_is_refused_or_harmless() {
    let blob = blob();
    let bytes = blob.len();
    let planes = SCALARS * 8 + 6 * NUMBERS * LANES * 8 + REACH_POINTS + 200;
    let mut random = Random(8);
    let (mut refused, mut kept) = (0, 0);
    for n in 0..3000 {
        let mut wrong = blob.clone();
        // The end of the header, or the planes, which are the last ones.
        let index = if n % 4 == 0 { 24 + n / 4 % 300 } else { bytes - 4 - 1 - (n * 7919) % planes };
        let value = (random.next() * 127.0) as i8 as u8;
        wrong[index] = value;
        sign(&mut wrong);
        let Ok(organ) = Organ::<2>::read(&wrong) else {
            refused += 1;
            continue;
        };
        kept += 1;
        for space in &organ.spaces {
            for d in [[0.0; 3], [0.004, -0.003, 0.006], [0.02; 3], [1e30, 0.0, -3.0], [f32::NAN; 3]] {
                if let Some(found) = space.estimate(Method::Kernel, d) {
                    let numbers = found.force_n.iter().chain(found.stiffness_n_m.as_flattened());
                    assert!(numbers.into_iter().chain(&found.energy_j).all(|x| x.is_finite()), "{found:?}");
                }
            }
        }
    }
    assert!(refused > 100 && kept > 500, "{refused} refused, {kept} kept");
    for len in (0..bytes).step_by(97) {
        assert!(Organ::<2>::read(&blob[..len]).is_err());
    }
}

/// Arbitrary samples: the command is finite and within the limit, and zero after a fault until it is reset.
#[test]
fn any_samples_are_finite_and_within_the_limit() {
    let blob = blob();
    let organ = read(&blob);
    let mut config = Config::new(Method::Kernel);
    config.limits.max_speed_m_s = 1e30;
    config.limits.max_position_m = 1e30;
    // The search for the largest stiffness would take longer than the test.
    config.limits.max_stiffness_n_m = f32::INFINITY;
    let controller = Controller::new(&organ, config).expect("the blob has a kernel");
    let (mut random, mut state) = (Random(29), State::new());
    let (mut engaged, mut latched) = (0, 0);
    let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -0.0, 1e-45, 1e30, -1e38];
    state.arm();
    for tick in 0..200_000_u64 {
        let mut position_m = vec3::add(organ.spaces[0].active.rest_position_m, random.point(1.3 * RADIUS_M));
        // A stroke into the organ, and sometimes a number that is not finite.
        if tick % 64 < 32 {
            position_m = [0.0, 0.0, 0.002 - 1e-3 * (tick % 32) as f32];
        } else if tick % 61 == 0 {
            position_m[(tick % 3) as usize] = odd[(tick / 61 % 7) as usize];
        }
        let t_us = 1_000 * tick;
        let command = controller.tick(
            &mut state,
            t_us,
            Some(&Sample { t_us, position_m, buttons: (tick % 7 == 0).into(), ..Sample::default() }),
        );
        let force = vec3::norm(command.hand_force_n);
        assert!(force <= 8.0 && (force == 0.0 || state.phase() == Phase::Active), "{tick}: {command:?}");
        engaged += u32::from(command.engaged.is_some());
        if matches!(state.phase(), Phase::SafeZero(_)) {
            latched += 1;
            state.reset();
            state.arm();
        }
    }
    assert!(engaged > 1_000 && latched > 100, "{engaged}, {latched}");
}
