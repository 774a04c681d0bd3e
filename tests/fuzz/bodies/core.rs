//! The bodies of the fuzz targets of the core, also run by the tests of the core: arbitrary bytes and the
//! invariants that must hold for them.

use std::sync::LazyLock;

use palpate_core::format::CHECKSUM;
use palpate_core::{
    AlignedBytes, Config, Controller, Limits, Method, Organ, Phase, Sample, Space, State, TouchSurface, Vec3,
    flags, vec3,
};

/// A blob whose length and checksum are corrected, so that the later checks are reached: it is refused, or
/// every query has a finite answer.
pub(crate) fn blob(data: &[u8]) {
    let mut bytes = AlignedBytes::from(data);
    if let Some(end) = bytes.len().checked_sub(4).filter(|end| *end >= 24) {
        let total = (bytes.len() as u64).to_le_bytes();
        bytes[16..24].copy_from_slice(&total);
        let checksum = CHECKSUM.checksum(&bytes[..end]);
        bytes[end..].copy_from_slice(&checksum.to_le_bytes());
    }
    let _ = Organ::<1>::read_within(&bytes, &Limits::MICROCONTROLLER);
    let Ok(organ) = Organ::<2>::read(&bytes) else { return };
    for space in &organ.spaces {
        for method in Method::ALL {
            ask(space, method);
        }
        let mut derived = space.planes().flags.to_vec();
        flags::derive(space.lattice(), &mut derived);
        assert_eq!(derived, space.planes().flags, "inconsistent flags");
        let of_solved = flags::TERMINATING | flags::INVERTED;
        assert!(derived.iter().all(|bits| bits & flags::SOLVED != 0 || bits & of_solved == 0));
        let mut surface = vec![vec3::ZERO; organ.surface.node.len().min(1000)];
        for displacement_m in places(space) {
            space.displacement_into(displacement_m, &mut surface);
            assert!(surface.iter().all(|u| vec3::is_finite(*u)), "a displacement that is not finite");
        }
    }
    for method in Method::ALL {
        let mut config = Config::new(method);
        config.limits.ramp_s = 0.0;
        let Ok(controller) = Controller::new(&organ, config) else { continue };
        let mut state = State::new();
        state.arm();
        for (tick, space) in (1_u64..).zip(organ.spaces.iter().cycle().take(8)) {
            // Grasped at rest, then pulled.
            let pulled_m = space.lattice().spacing_m().clamp(0.0, 1e-3) * (tick / 4) as f32;
            let position_m = vec3::add(space.active.rest_position_m, [0.0, pulled_m, 0.0]);
            let sample = Sample {
                t_us: 1000 * tick,
                position_m,
                buttons: (tick & 3 != 0) as u32,
                ..Sample::default()
            };
            let command = controller.tick(&mut state, sample.t_us, Some(&sample));
            assert!(vec3::norm(command.hand_force_n) <= controller.config().limits.max_force_n);
        }
    }
}

fn places(space: &Space<'_>) -> [Vec3; 8] {
    let (r, s) = (space.lattice().radius_m(), space.lattice().spacing_m());
    [
        [0.0; 3],
        [0.3 * s, 0.4 * s, -0.7 * s],
        [-s, s, 0.0],
        [0.99 * r, 0.01 * r, 0.0],
        [r, r, r],
        [-1e30, 1e-40, 0.0],
        [f32::NAN, 0.0, 0.0],
        [f32::MAX, f32::INFINITY, 0.0],
    ]
}

fn ask(space: &Space<'_>, method: Method) {
    for displacement_m in places(space) {
        let (force, estimate) = (space.force(method, displacement_m), space.estimate(method, displacement_m));
        assert_eq!(force.is_some(), space.has(method));
        assert_eq!(estimate.is_some(), space.has(method));
        if let (Some(force), Some(estimate)) = (force, estimate) {
            assert!(vec3::is_finite(force.force_n), "{method:?} at {displacement_m:?}: {force:?}");
            assert!(force.force_n.map(f32::to_bits) == estimate.force_n.map(f32::to_bits));
            assert!(estimate.energy_j.is_none_or(f32::is_finite), "{method:?}: {estimate:?}");
            if !vec3::is_finite(displacement_m) {
                let rest = space.force(method, vec3::ZERO).map(|rest| rest.force_n);
                assert_eq!(Some(force.force_n), rest, "a query that is not finite is answered at rest");
            }
            assert!(
                estimate.stiffness_n_m.iter().all(|row| vec3::is_finite(*row)),
                "{method:?}: {estimate:?}"
            );
        }
    }
}

static BYTES: LazyLock<AlignedBytes> =
    LazyLock::new(|| AlignedBytes::from(include_bytes!("../../../firmware-like-core/golden/organ-514.blob")));

/// The golden organ: unsolved points, folds, and every method of a lattice.
static GOLDEN: LazyLock<Box<Organ<'static>>> =
    LazyLock::new(|| Box::new(Organ::read(&BYTES).expect("the golden blob is good")));

/// The golden organ with its space repeated at the 200 surface vertices nearest to its node, so that the tool
/// slides.
static EVERYWHERE: LazyLock<(Box<Organ<'static>>, TouchSurface<'static>)> = LazyLock::new(|| {
    let mut organ = GOLDEN.clone();
    let one = organ.spaces[0].clone();
    let [x, y, z] = organ.surface.position_m;
    let at = |vertex: usize| [x[vertex], y[vertex], z[vertex]];
    let mut vertices: Vec<usize> = (0..x.len()).collect();
    let distance = |vertex: &usize| vec3::distance(at(*vertex), one.active.rest_position_m);
    vertices.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
    organ.spaces.clear();
    for vertex in vertices.into_iter().take(200) {
        let mut space = one.clone();
        (space.active.node, space.active.rest_position_m) = (organ.surface.node[vertex], at(vertex));
        organ.spaces.push(space).expect("512 fit");
    }
    let memory: &'static mut [u32] = vec![0; TouchSurface::words(&organ)].leak();
    let surface = TouchSurface::new(&organ, memory).expect("the golden blob has a surface");
    (organ, surface)
});

/// Arbitrary samples at arbitrary times. The command is finite and within the limit, and zero after a fault
/// until reset and armed.
pub(crate) fn tick(data: &[u8]) {
    let (everywhere, surface) = &*EVERYWHERE;
    let Some((&[method, contact], mut rest)) = data.split_first_chunk::<2>() else { return };
    let organ: &Organ<'static> = if contact & 8 == 0 { &GOLDEN } else { everywhere };
    let mut config = Config::new(Method::OF_LATTICE[usize::from(method) % Method::OF_LATTICE.len()]);
    config.contact.friction = if contact & 16 == 0 { 0.3 } else { 0.0 };
    config.limits.max_speed_m_s = if contact & 1 == 0 { 2.0 } else { 1e30 };
    config.limits.max_position_m = if contact & 2 == 0 { 0.5 } else { 1e30 };
    // The search for the largest stiffness would take longer than all ticks.
    config.limits.max_stiffness_n_m = f32::INFINITY;
    config.limits.ramp_s = if contact & 4 == 0 { 0.0 } else { 0.5 };
    let controller = Controller::new(organ, config).expect("the golden blob has every method of a lattice");
    let controller = controller.on_surface((contact & 8 != 0).then_some(*surface));
    let node_m = organ.spaces[0].active.rest_position_m;
    let (mut state, mut now_us, mut latched) = (State::new(), 1_000_000_u64, false);
    let (mut before_us, mut before_n) = (now_us, vec3::ZERO);
    state.arm();
    while let Some((&step, after)) = rest.split_first_chunk::<17>() {
        rest = after;
        let [kind, dt_low, dt_high, age, buttons, position @ ..] = step;
        let raw: [u32; 3] = bytemuck::cast(position);
        // Any floats, or a position near the node.
        let near = |x: u32| (x >> 8) as f32 / 16_777_216.0 * 0.16 - 0.08;
        let position_m =
            if kind & 1 == 0 { vec3::add(node_m, raw.map(near)) } else { raw.map(f32::from_bits) };
        let dt_us = u64::from(u16::from_le_bytes([dt_low, dt_high]));
        now_us = if kind & 2 == 0 { now_us.wrapping_add(dt_us) } else { now_us.wrapping_sub(dt_us << 8) };
        let t_us = now_us.wrapping_add(1000).wrapping_sub(u64::from(age) * 100);
        let sample = Sample { t_us, position_m, buttons: buttons.into(), ..Sample::default() };
        match kind >> 2 {
            58 => state.hand_over(true),
            59 => state.hand_over(false),
            60 => {
                state.reset();
                latched = false;
            }
            61 => {
                let active = state.arm();
                assert_eq!(active, !latched, "only a reset clears a fault");
            }
            62 => state.disarm(),
            _ => {}
        }
        let command = controller.tick(&mut state, now_us, (kind >> 2 != 63).then_some(&sample));
        assert!(vec3::norm(command.hand_force_n) <= config.limits.max_force_n, "{command:?}");
        assert!(vec3::is_finite(command.hand_force_n) && vec3::is_finite(command.reaction_n), "{command:?}");
        assert!(vec3::is_finite(command.hip_m) && vec3::is_finite(command.displacement_m), "{command:?}");
        if command.phase != Phase::Active {
            assert_eq!(command.hand_force_n, vec3::ZERO, "zero unless active: {command:?}");
        }
        if command.hand_force_n != vec3::ZERO {
            let step_n = vec3::distance(command.hand_force_n, before_n);
            // The slew counts at most 2 ms of a tick.
            let elapsed_s = now_us.saturating_sub(before_us).min(2000) as f32 * 1e-6;
            let most_n = config.limits.max_slew_n_per_s * elapsed_s;
            assert!(step_n <= 1.001 * most_n + 1e-4, "{step_n} N of {most_n} N: {command:?}");
        }
        (before_us, before_n) = (now_us, command.hand_force_n);
        if latched {
            assert!(matches!(command.phase, Phase::SafeZero(_)), "a fault is latched: {command:?}");
        }
        latched = matches!(command.phase, Phase::SafeZero(_));
    }
}
