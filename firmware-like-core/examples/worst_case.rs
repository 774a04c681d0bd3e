//! Ticks with expensive samples, for `check-worst-case`, which counts the instructions of each one.
//!
//! `cargo run --release -p palpate-core --features std --example worst_case -- FILE.blob METHOD TICKS`
//!
//! The method `jets` is the live tick.

use std::process::ExitCode;

use palpate_core::{
    AlignedBytes, Command, Config, Controller, Method, Organ, Phase, Sample, Space, State, Vec3,
};

#[allow(unreachable_pub, reason = "shared with `live_tick`")]
mod live;

/// The function that callgrind counts, by its name.
#[inline(never)]
fn counted_tick(
    controller: &Controller<'_, '_>,
    state: &mut State,
    now_us: u64,
    sample: Option<&Sample>,
) -> Command {
    controller.tick(state, now_us, sample)
}

/// Pseudo-random numbers, the same in every run.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as u32
    }

    /// In [-1, 1).
    fn unit(&mut self) -> f32 {
        (self.next() >> 7) as f32 / 8_388_608.0 - 1.0
    }

    /// One element of a slice.
    fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.next() as usize % of.len()]
    }
}

/// Displacements at and near grid points, faces and the rim, outside the ball, tiny and huge ones.
fn displacement(noise: &mut Noise, space: &Space<'_>) -> Vec3 {
    let (spacing_m, radius_m) = (space.lattice().spacing_m(), space.lattice().radius_m());
    let uniform = |noise: &mut Noise| -> Vec3 { std::array::from_fn(|_| 1.05 * radius_m * noise.unit()) };
    let beside = |x: f32, noise: &mut Noise| noise.pick(&[x, x.next_up(), x.next_down()]);
    match noise.next() % 8 {
        0..3 => uniform(noise),
        // Grid points, edges and faces.
        3 => {
            let snapped = noise.next();
            let mut d = uniform(noise);
            for (axis, x) in d.iter_mut().enumerate() {
                if snapped >> axis & 1 == 1 {
                    *x = beside((*x / spacing_m).round() * spacing_m, noise);
                }
            }
            d
        }
        4 | 5 => {
            let d = uniform(noise);
            let length = d.iter().map(|x| x * x).sum::<f32>().sqrt();
            let reach = radius_m * noise.pick(&[1.0, 1.0 - 1e-6, 1.0 + 1e-6, 1.5, 100.0]) / length;
            d.map(|x| x * reach)
        }
        6 => {
            let odd = [0.0, -0.0, 1e-42, -1e-42, f32::MIN_POSITIVE, 1e-20, 1e-6, -1e-6];
            std::array::from_fn(|_| noise.pick(&odd))
        }
        _ => std::array::from_fn(|_| noise.pick(&[radius_m, -radius_m, 0.3, -0.3, spacing_m, 0.0])),
    }
}

fn run(path: &str, method: &str, ticks: u64) -> Result<(), String> {
    let bytes = std::fs::read(path).map_err(|error| format!("{path}: {error}"))?;
    let blob = AlignedBytes::from(&bytes);
    if method == "jets" {
        let live::Run { engaged, faults, .. } = live::run(&blob, ticks)?;
        println!("jets: {ticks} ticks, {engaged} of them on three contact points, {faults} faults");
        return Ok(());
    }
    let organ: Organ<'_> = Organ::read(&blob).map_err(|error| format!("{path}: {error}"))?;
    let space = organ.spaces.first().ok_or("no space")?;
    let mut config = Config::new(Method::from_name(method).ok_or_else(|| format!("no method {method}"))?);
    // Jumps of the position are intended here and must not fault.
    config.limits.max_speed_m_s = f32::MAX;
    config.limits.max_position_m = f32::MAX;
    config.contact.grasp_slip = f32::MAX;
    config.contact.grasp_distance_m = f32::MAX;
    config.passivity.fault_j = f32::INFINITY;
    let controller = Controller::new(&organ, config).map_err(|error| error.to_string())?;

    // Computed in advance, so that few instructions lie between two ticks.
    let mut noise = Noise(1);
    let samples: Vec<Option<Sample>> = (1..=ticks).map(|tick| sample(&mut noise, space, tick)).collect();
    let (mut state, mut engaged, mut faults) = (State::new(), 0_u64, 0_u64);
    state.arm();
    for (tick, sample) in (1..).zip(&samples) {
        let command = counted_tick(&controller, &mut state, tick * 1000, sample.as_ref());
        engaged += u64::from(command.engaged.is_some());
        if command.phase != Phase::Active {
            faults += 1;
            state.reset();
            state.arm();
        }
    }
    println!("{method}: {ticks} ticks, {engaged} of them in contact, {faults} faults");
    Ok(())
}

/// A grasp at rest, then 30 displacements; sometimes no sample, an old one, or one that is not finite.
fn sample(noise: &mut Noise, space: &Space<'_>, tick: u64) -> Option<Sample> {
    let phase = tick % 32;
    let mut position_m = space.active.rest_position_m;
    if phase > 1 {
        for (x, d) in position_m.iter_mut().zip(displacement(noise, space)) {
            *x += d;
        }
    }
    let kind = noise.next() % 256;
    let t_us = if kind == 1 { tick.saturating_sub(20) * 1000 } else { tick * 1000 };
    if kind == 2 {
        position_m[1] = noise.pick(&[f32::NAN, f32::INFINITY, f32::NEG_INFINITY]);
    }
    (kind != 0).then_some(Sample { t_us, position_m, buttons: u32::from(phase != 0), ..Sample::default() })
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, method, ticks] = arguments.as_slice() else {
        eprintln!("usage: worst_case FILE.blob METHOD TICKS");
        return ExitCode::from(2);
    };
    match ticks
        .parse()
        .map_err(|error| format!("{ticks}: {error}"))
        .and_then(|ticks| run(path, method, ticks))
    {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("worst_case: {message}");
            ExitCode::FAILURE
        }
    }
}
