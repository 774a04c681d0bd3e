//! The dearest live tick: contact points with full tables, a frame in every tick, and a tool that jumps.

use palpate_core::{
    AlignedBytes, Command, Config, Controller, Jet, JetFlags, JetMemory, Organ, Sample, State, TouchSurface,
    Vec3, vec3,
};

/// Contact points with tables.
const CONTACTS: usize = 64;
/// Jets of each.
const JETS: usize = 256;
/// Ticks of a touch; the first two enter the body.
const TOUCH: u64 = 32;

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

    /// In a cube of half-width 20 mm.
    fn displacement(&mut self) -> Vec3 {
        std::array::from_fn(|_| 0.02 * self.unit())
    }
}

/// One frame and one tick, as a haptic loop does them.
#[inline(never)]
fn counted_tick(
    controller: &Controller<'_, '_>,
    state: &mut State,
    sample: &Sample,
    memory: &mut JetMemory<CONTACTS, JETS>,
    frame: &[u8],
) -> Command {
    if let Ok(jet) = Jet::decode(frame) {
        memory.insert(&jet);
    }
    controller.tick_on(state, sample.t_us, Some(sample), memory)
}

/// A jet of a spring of 300 N/m with a little curvature. Every 64th announces a jump of the body, and of those
/// every 32nd contradicts all others of its contact point.
fn jet(noise: &mut Noise) -> Jet {
    let control_m = noise.displacement();
    let (flush_before, jumps) = (noise.next().is_multiple_of(64), noise.next().is_multiple_of(32));
    let jump_n = if flush_before && jumps { [1.0, 0.5, -1.0].map(|x| 4.0 * x) } else { vec3::ZERO };
    Jet {
        contact: (noise.next() % CONTACTS as u32) as u16,
        sequence: noise.next(),
        flags: JetFlags { flush_before, ..JetFlags::default() },
        control_m,
        energy_j: 150.0 * vec3::dot(control_m, control_m),
        force_n: vec3::add(vec3::scale(control_m, 300.0), jump_n),
        stiffness_n_m: [300.0, 0.0, 0.0, 300.0, 0.0, 300.0],
        third_n_m2: std::array::from_fn(|_| 100.0 * noise.unit()),
        trust_m: 0.012 + 0.008 * noise.unit(),
        coupling: None,
        model: 0,
    }
}

/// The space of the organ at each of the 200 surface vertices nearest to its node, so that the tool holds three
/// of them and slides.
fn spread(organ: &mut Organ<'_>) -> Option<()> {
    let one = organ.spaces.first()?.clone();
    let [x, y, z] = organ.surface.position_m;
    let mut vertices: Vec<(Vec3, u32)> = x
        .iter()
        .zip(y)
        .zip(z)
        .zip(organ.surface.node)
        .map(|(((x, y), z), node)| ([*x, *y, *z], *node))
        .collect();
    let distance = |vertex: &(Vec3, u32)| vec3::distance(vertex.0, one.active.rest_position_m);
    vertices.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
    organ.spaces.clear();
    for (at_m, node) in vertices.into_iter().take(200) {
        let mut space = one.clone();
        (space.active.node, space.active.rest_position_m) = (node, at_m);
        organ.spaces.push(space).ok()?;
    }
    Some(())
}

/// Counts of a run.
pub struct Run {
    pub engaged: u64,
    pub faults: u64,
    /// Time of each tick, nanoseconds.
    pub times_ns: Vec<u64>,
}

/// Ticks on the bodies' surface of a blob.
pub fn run(blob: &AlignedBytes, ticks: u64) -> Result<Run, String> {
    let mut organ: Box<Organ<'_>> = Box::new(Organ::read(blob).map_err(|error| error.to_string())?);
    let node = organ.spaces.first().ok_or("no space")?.active.clone();
    spread(&mut organ).ok_or("no surface")?;
    let mut config = Config::live();
    // Jumps of the position are intended here and must not fault.
    config.limits.max_speed_m_s = f32::MAX;
    config.limits.max_position_m = f32::MAX;
    config.passivity.fault_j = f32::INFINITY;
    let mut words = vec![0; TouchSurface::words(&organ)];
    let surface = TouchSurface::new(&organ, &mut words);
    let controller = Controller::new(&organ, config).map_err(|error| error.to_string())?.on_surface(surface);

    let mut noise = Noise(1);
    let mut memory = Box::new(JetMemory::<CONTACTS, JETS>::new());
    for number in 0..CONTACTS * JETS {
        memory.insert(&Jet { contact: (number % CONTACTS) as u16, ..jet(&mut noise) });
    }
    // Computed in advance, so that few instructions lie between two ticks.
    let frames: Vec<_> = (0..ticks).map(|_| jet(&mut noise).encode()).collect();
    let samples: Vec<_> = (1..=ticks).map(|tick| sample(&mut noise, &node, tick)).collect();
    let (mut state, mut run) = (State::new(), Run { engaged: 0, faults: 0, times_ns: Vec::new() });
    run.times_ns.reserve(samples.len());
    state.arm();
    for (sample, frame) in samples.iter().zip(&frames) {
        let start = std::time::Instant::now();
        let command = counted_tick(&controller, &mut state, sample, &mut memory, frame);
        run.times_ns.push(start.elapsed().as_nanos() as u64);
        run.engaged += u64::from(command.weights.iter().filter(|node| node.weight > 0.0).count() == 3);
        if command.phase != palpate_core::Phase::Active {
            run.faults += 1;
            state.reset();
            state.arm();
        }
    }
    Ok(run)
}

/// In through the node, then displacements into the body.
fn sample(noise: &mut Noise, node: &palpate_core::ActiveNode, tick: u64) -> Sample {
    let phase = tick % TOUCH;
    let along = |height_m: f32| vec3::scale(node.outward_normal, height_m);
    let d = match phase {
        0 => along(2e-3),
        1 => vec3::add(along(-2e-3), [1e-4 * noise.unit(), 1e-4 * noise.unit(), 1e-4 * noise.unit()]),
        _ => {
            let d = noise.displacement();
            let out_m = vec3::dot(d, node.outward_normal);
            if out_m > 0.0 { vec3::add(d, along(-2.0 * out_m)) } else { d }
        }
    };
    Sample { t_us: 1_000 * tick, position_m: vec3::add(node.rest_position_m, d), ..Sample::default() }
}
