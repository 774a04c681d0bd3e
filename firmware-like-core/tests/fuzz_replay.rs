//! The fuzzer's bodies over the inputs it kept, over the seeds it began with, and over seeded mutations of both: every run of the tests
//! is a short run of the fuzzer. `check-fuzz` is the long one.

mod common;

use std::path::{Path, PathBuf};

use common::Recipe;
use palpate_core::link::{self, DeviceFault, DeviceMessage, HostMessage};

#[path = "../fuzz/bodies.rs"]
mod bodies;

fn corpus(target: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target)
}

/// The kept inputs, in the order of their names.
fn kept(target: &str) -> Vec<Vec<u8>> {
    let folder = corpus(target);
    let entries = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.expect("readable").path()).collect();
    paths.sort();
    assert!(paths.len() >= 3, "{}: the corpus is lost", folder.display());
    paths.iter().map(|path| std::fs::read(path).expect("readable")).collect()
}

/// Small blobs with every kind of table, hole and fold.
fn blobs() -> Vec<Vec<u8>> {
    let small = || Recipe { radius_m: 0.01, slopes: 2, outlier: Some([0, -1, 0]), ..Recipe::default() };
    let recipes = [
        small(),
        Recipe { nodes: vec![[0.0; 3], [0.1, 0.0, 0.02]], rbf: false, ..small() },
        Recipe { solved: |ijk| ijk != [0, 1, 0], displacement: false, ..small() },
        Recipe { fold: |ijk| ijk == [0; 3], lattice_table: false, slopes: 0, ..small() },
        Recipe { hermite: false, displacement: false, ..small() },
    ];
    recipes.iter().map(|recipe| recipe.blob().bytes().to_vec()).collect()
}

struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % n.max(1)
    }
}

/// One to four bytes changed, a number put in, or a piece cut out.
fn mutated(input: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = input.to_vec();
    if bytes.is_empty() {
        return vec![random.below(256) as u8];
    }
    match random.below(4) {
        0 => {
            let at = random.below(bytes.len());
            let number = [u32::MAX, 0x7fc0_0000, 0x7f80_0000, 0, 1 << 31][random.below(5)].to_le_bytes();
            bytes.iter_mut().skip(at).zip(number).for_each(|(byte, new)| *byte = new);
        }
        1 => {
            let from = random.below(bytes.len());
            bytes.drain(from..(from + 1 + random.below(16)).min(input.len()));
        }
        _ => {
            for _ in 0..=random.below(4) {
                // Mostly near the front, where headers are.
                let end = if random.below(2) == 0 { bytes.len() } else { bytes.len().min(700) };
                let at = random.below(end);
                bytes[at] = random.below(256) as u8;
            }
        }
    }
    bytes
}

fn replay(inputs: &[Vec<u8>], mutations: usize, body: fn(&[u8])) {
    let mut random = Random(7);
    for input in inputs {
        body(input);
        for _ in 0..mutations {
            body(&mutated(input, &mut random));
        }
    }
}

#[test]
fn blobs_are_refused_or_good() {
    replay(&blobs(), 400, bodies::blob);
    replay(&kept("blob"), 3, bodies::blob);
}

#[test]
fn frames_are_refused_or_obeyed_safely() {
    replay(&conversations(), 2000, |line| _ = bodies::frames(line));
    replay(&kept("frames"), 50, |line| _ = bodies::frames(line));
}

#[test]
fn ticks_are_finite_and_within_limits() {
    replay(&strokes(), 100, bodies::tick);
    replay(&kept("tick"), 5, bodies::tick);
}

/// What a driver says to a device, and what the device answers.
fn conversations() -> Vec<Vec<u8>> {
    let session = 0x1234_5678;
    let torque_unm = [1, -2, i32::MAX];
    let command =
        |seq| HostMessage::Command { session, seq, t_host_us: 1000 * seq, torque_unm, valid_for_us: 5000 };
    let hello = HostMessage::Hello { version: link::VERSION, nonce: 7 };
    let (enable, home) = (HostMessage::Enable { session, seq: 2 }, HostMessage::Home { session, seq: 1 });
    let said = [hello, home, enable, command(3), command(4), HostMessage::Disable { session, seq: 5 }];
    let state =
        |seq_echo| DeviceMessage::State { seq_echo, t_dev_us: 1, encoders: [1, -1, 0], buttons: 1, flags: 7 };
    let answered = [state(0), state(u32::MAX), DeviceMessage::Fault { code: DeviceFault::Watchdog }];
    let mut to_device = Vec::new();
    for message in &said {
        to_device.extend(link::encode(message, &mut [0; link::MAX_FRAME]).expect("fits"));
    }
    let mut to_host = Vec::new();
    for message in &answered {
        to_host.extend(link::encode(message, &mut [0; link::MAX_FRAME]).expect("fits"));
    }
    let cut = to_device.iter().copied().skip(5).chain(to_host.iter().copied().take(40)).collect();
    // As messages with their length, in the present session, which is 1 to the body.
    let mut framed = vec![1];
    let here =
        |seq| HostMessage::Command { session: 1, seq, t_host_us: 1000 * seq, torque_unm, valid_for_us: 5000 };
    let (home, enable) =
        (HostMessage::Home { session: 1, seq: 1 }, HostMessage::Enable { session: 1, seq: 3 });
    for message in [hello, home, here(2), enable, here(4), here(4), here(5), hello, here(1)] {
        let bytes = postcard::to_allocvec(&message).expect("encoded");
        framed.push(bytes.len() as u8);
        framed.extend(bytes);
    }
    // The last commands' lengths with three times 3 ms each: the watchdog bites. Then all that must not wake the device again.
    let with_len = |line: &mut Vec<u8>, messages: &[HostMessage], time: u8| {
        for message in messages {
            let bytes = postcard::to_allocvec(message).expect("encoded");
            line.push(bytes.len() as u8 | time);
            line.extend(bytes);
        }
    };
    let enable = HostMessage::Enable { session: 1, seq: 2 };
    let (again, home) =
        (HostMessage::Enable { session: 1, seq: 10 }, HostMessage::Home { session: 1, seq: 11 });
    let disable = HostMessage::Disable { session: 1, seq: 12 };
    let (mut late, mut broken) = (framed.clone(), framed.clone());
    with_len(&mut late, &[enable, here(4)], 0xc0);
    late.extend([0xc0, 0xc0]);
    with_len(&mut late, &[again, home, disable, here(13), here(14)], 0);
    // The hardware breaks while enabled.
    with_len(&mut broken, &[enable, here(4)], 0);
    broken.push(63);
    [to_device, to_host, cut]
        .into_iter()
        .map(|line| [vec![0], line].concat())
        .chain([framed, late, broken])
        .collect()
}

/// A conversation that goes on to a torque, or the seeds would say nothing.
#[test]
fn the_seeds_of_frames_reach_a_torque() {
    assert!(conversations().iter().any(|line| bodies::frames(line)), "no seed enables the device");
}

/// Steps of [`bodies::tick`]: a grasp and a walk, ticks without samples, a fault and its reset.
fn strokes() -> Vec<Vec<u8>> {
    let step = |kind: u8, buttons: u8, at: [u32; 3]| {
        let mut bytes = vec![kind, 0xe8, 3, 10, buttons];
        bytes.extend_from_slice(bytemuck::cast_slice(&at));
        bytes
    };
    let middle = 1 << 31;
    let walk = |n: u32| [middle + (n << 24), middle - (n << 23), middle];
    let touch = (0..40).flat_map(|n| step(0, u8::from(n > 1), walk(n))).collect::<Vec<u8>>();
    let silent = (0..20).flat_map(|n| step(if n > 3 { 63 << 2 } else { 0 }, u8::from(n > 1), walk(n)));
    let fault =
        [step(1, 0, [f32::NAN.to_bits(); 3]), step(61 << 2, 0, walk(1)), step(60 << 2, 0, walk(1))].concat();
    let header = |method: u8, options: u8| vec![method, options];
    vec![
        [header(6, 1), touch.clone()].concat(),
        [header(2, 4), silent.collect()].concat(),
        [header(5, 3), touch, fault, step(61 << 2, 0, walk(2))].concat(),
    ]
}

#[test]
#[ignore = "writes the first inputs of check-fuzz: run by hand when the blob layout or the protocol changes"]
fn write_seeds() {
    for (target, seeds) in [("blob", blobs()), ("frames", conversations()), ("tick", strokes())] {
        std::fs::create_dir_all(corpus(target)).expect("a folder");
        for (number, seed) in seeds.iter().enumerate() {
            std::fs::write(corpus(target).join(format!("seed-{number}")), seed).expect("written");
        }
    }
}
