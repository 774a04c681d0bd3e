//! Comparison of a Cortex-M with the host; this file is compiled into both.
//!
//! Lines that begin with `answer` or `tick` must be equal on both; the others report costs.

use palpate_core::{
    Command, Config, Controller, Field, Jet, JetFlags, JetMemory, Limits, Method, NodeWeight, Organ, Sample,
    Solver, Space, State, Touch, Vec3,
};

const SPACES: usize = Limits::MICROCONTROLLER.spaces;
type SmallOrgan<'a> = Organ<'a, SPACES>;

/// The functions that differ between the two machines.
pub trait Bench {
    /// Writes a line.
    fn say(&mut self, line: Line) -> Result<(), Failed>;
    /// A clock that counts upwards, modulo 2^24.
    fn clock(&self) -> u32;
}

/// The blob was refused, or a line could not be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Failed;

/// Queries and ticks of every method in the blob, and of jets.
pub fn run(bench: &mut impl Bench, blob: &[u8]) -> Result<(), Failed> {
    let before = bench.clock();
    let organ = SmallOrgan::read_within(blob, &Limits::MICROCONTROLLER).map_err(|_| Failed)?;
    let reading = since(bench, before);
    bench.say(Line::new("read").number(reading))?;
    let space = organ.spaces.first().ok_or(Failed)?;
    for method in Method::ALL {
        if space.has(method) {
            answer(bench, space, method)?;
        }
    }
    for method in Method::ALL {
        if let Ok(controller) = Controller::new(&organ, Config::new(method)) {
            let tick = |state: &mut State, sample: &Sample| controller.tick(state, sample.t_us, Some(sample));
            touch(bench, method.name(), space, tick)?;
        }
    }
    jets(bench, &organ, space)?;
    bench.say(Line::new("organ").number(size_of::<SmallOrgan<'_>>() as u32))
}

fn since(bench: &impl Bench, before: u32) -> u32 {
    bench.clock().wrapping_sub(before) & 0x00ff_ffff
}

fn answer(bench: &mut impl Bench, space: &Space<'_>, method: Method) -> Result<(), Failed> {
    let mut count = Count::default();
    for (number, displacement_m) in (0_u32..).zip(queries(space.lattice().radius_m())) {
        let displacement_m = core::hint::black_box(displacement_m);
        let before = bench.clock();
        let answer = space.force(method, displacement_m);
        count.add(since(bench, before));
        let answer = answer.ok_or(Failed)?;
        let line = Line::new("answer").word(method.name()).number(number);
        bench.say(line.force(answer.force_n).word(answer.coverage.name()))?;
    }
    bench.say(count.line("query", method.name()))
}

/// Jets of a contact point that the live part of the comparison has memory for.
const JETS: usize = 32;

/// Half-width of the cube of their controls and of the queries, metres.
const SPREAD_M: f32 = 0.01;

/// Three contact points of which every tenth query or twentieth tick brings a jet, as a frame; the solver
/// comes and goes.
fn jets(bench: &mut impl Bench, organ: &SmallOrgan<'_>, space: &Space<'_>) -> Result<(), Failed> {
    let mut memory = JetMemory::<3, JETS>::new();
    let mut count = Count::default();
    let shares = [(0, 0.5), (1, 0.3), (2, 0.2)];
    let weights = shares.map(|(space, weight)| NodeWeight { space, weight });
    let mut controls = queries(SPREAD_M).skip(ODD.len());
    let mut now_us = 0;
    for (number, displacement_m) in (0_u32..).zip(queries(SPREAD_M)) {
        now_us += 1000;
        if number.is_multiple_of(10) {
            learn(&mut memory, number, controls.next())?;
        }
        memory.solver(if number % 400 < 300 { Solver::Alive } else { Solver::Gone });
        let displacement_m = core::hint::black_box(displacement_m);
        let touch = Touch { now_us, weights, displacement_m, hip_m: displacement_m, half_axis_m: None };
        let before = bench.clock();
        let answer = memory.force(&touch);
        count.add(since(bench, before));
        let answer = answer.ok_or(Failed)?;
        let energy_j = memory.energy_j((number % 3) as u16, displacement_m).ok_or(Failed)?;
        let line = Line::new("answer").word("jets").number(number).number(energy_j.to_bits());
        bench.say(line.force(answer.force_n).word(answer.coverage.name()))?;
    }
    bench.say(count.line("query", "jets"))?;
    memory.released(now_us);
    memory.solver(Solver::Alive);
    let controller = Controller::new(organ, Config::live()).map_err(|_| Failed)?;
    touch(bench, "jets", space, |state, sample| {
        let number = (sample.t_us / 1000) as u32;
        if number.is_multiple_of(20) {
            // A frame is sound, so it is never refused.
            let _ = learn(&mut memory, 3 * number, controls.next());
        }
        memory.solver(if number < 1_900 { Solver::Alive } else { Solver::Silent });
        controller.tick_on(state, sample.t_us, Some(sample), &mut memory)
    })
}

/// Decodes the frame of a jet of contact point `number % 3` and adds it.
fn learn(memory: &mut JetMemory<3, JETS>, number: u32, control_m: Option<Vec3>) -> Result<(), Failed> {
    let control_m = control_m.unwrap_or_default();
    let [x, y, z] = control_m;
    let jet = Jet {
        contact: (number % 3) as u16,
        sequence: number,
        flags: JetFlags { flush_before: number.is_multiple_of(70), ..JetFlags::default() },
        control_m,
        energy_j: 150.0 * (x * x + y * y + z * z),
        force_n: control_m.map(|x| 300.0 * x),
        stiffness_n_m: [310.0, 12.0, -7.0, 290.0, 5.0, 330.0],
        third_n_m2: [900.0, -400.0, 300.0, 250.0, -150.0, 800.0, -700.0, 600.0, 350.0, -5_000.0],
        trust_m: 0.003 + 0.001 * (number % 8) as f32,
        coupling: None,
        model: 0,
    };
    let jet = Jet::decode(&core::hint::black_box(jet.encode())).map_err(|_| Failed)?;
    if memory.insert(&jet) { Ok(()) } else { Err(Failed) }
}

/// Two presses into the organ, one tick per millisecond.
fn touch(
    bench: &mut impl Bench,
    name: &str,
    space: &Space<'_>,
    mut tick: impl FnMut(&mut State, &Sample) -> Command,
) -> Result<(), Failed> {
    let (mut state, mut count) = (State::new(), Count::default());
    state.arm();
    for step in 0..2000_u16 {
        // From 4 mm above the surface to 16 mm below and back.
        let along = f32::from(step % 1000) * 1e-3;
        let depth_m = 0.08 * along * (1.0 - along) - 0.004;
        let mut position_m = space.active.rest_position_m;
        for (x, n) in position_m.iter_mut().zip(space.active.outward_normal) {
            *x -= depth_m * n;
        }
        let now_us = 1000 * u64::from(step);
        let sample = core::hint::black_box(Sample { t_us: now_us, position_m, ..Sample::default() });
        let before = bench.clock();
        let command = tick(&mut state, &sample);
        count.add(since(bench, before));
        bench.say(Line::new("tick").word(name).number(step.into()).force(command.hand_force_n))?;
    }
    bench.say(count.line("ticks", name))
}

/// Minimum, maximum and sum of a count.
#[derive(Default)]
struct Count {
    least: Option<u32>,
    most: u32,
    sum: u64,
}

impl Count {
    fn add(&mut self, ticks: u32) {
        self.least = Some(self.least.map_or(ticks, |least| least.min(ticks)));
        self.most = self.most.max(ticks);
        self.sum += u64::from(ticks);
    }

    fn line(&self, word: &str, name: &str) -> Line {
        let line = Line::new(word).word(name).number(self.least.unwrap_or(0)).number(self.most);
        line.number((self.sum >> 32) as u32).number(self.sum as u32)
    }
}

/// Number of queries per method.
pub const QUERIES: usize = 1000;

/// Displacements that are extreme or not finite.
const ODD: [Vec3; 8] = [
    [0.0; 3],
    [f32::NAN, 0.0, 0.0],
    [0.0, f32::INFINITY, 0.0],
    [0.0, 0.0, f32::NEG_INFINITY],
    [1e-42, -1e-42, 0.0],
    [f32::MAX, f32::MIN, f32::MAX],
    [-0.0, -0.0, 1e30],
    [1.0, 0.0, 0.0],
];

/// The extreme displacements, then uniform ones in a cube slightly larger than the ball; the same in every
/// run.
pub fn queries(radius_m: f32) -> impl Iterator<Item = Vec3> {
    let mut bits = 12_345_u32;
    let mut next = move || {
        bits = bits.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        // 24 bits: exact in f32.
        ((bits >> 8) as f32 * (2.0 / 16_777_216.0) - 1.0) * (1.1 * radius_m)
    };
    ODD.into_iter().chain(core::iter::repeat_with(move || [next(), next(), next()])).take(QUERIES)
}

/// Length of the longest line.
pub const LINE_LEN: usize = 80;

/// A line of text; what exceeds its length is dropped.
#[derive(Debug)]
pub struct Line {
    bytes: [u8; LINE_LEN],
    len: usize,
}

impl Line {
    /// A line that begins with a word.
    pub fn new(word: &str) -> Self {
        let mut line = Self { bytes: [b' '; LINE_LEN], len: 0 };
        line.push_all(word);
        line
    }

    /// Adds another word.
    pub fn word(mut self, word: &str) -> Self {
        self.push(b' ');
        self.push_all(word);
        self
    }

    /// Adds a number in hexadecimal, eight digits.
    pub fn number(mut self, number: u32) -> Self {
        self.push(b' ');
        for nibble in number.to_be_bytes().into_iter().flat_map(|byte| [byte >> 4, byte & 15]) {
            self.push(if nibble < 10 { b'0' + nibble } else { b'a' - 10 + nibble });
        }
        self
    }

    /// Adds the bits of a force.
    pub fn force(self, [x, y, z]: Vec3) -> Self {
        self.number(x.to_bits()).number(y.to_bits()).number(z.to_bits())
    }

    /// The line with its end.
    pub fn text(&mut self) -> &[u8] {
        self.push(b'\n');
        self.bytes.get(..self.len).unwrap_or_default()
    }

    fn push_all(&mut self, word: &str) {
        for byte in word.bytes() {
            self.push(byte);
        }
    }

    fn push(&mut self, byte: u8) {
        if let Some(place) = self.bytes.get_mut(self.len) {
            *place = byte;
            self.len += 1;
        }
    }
}
