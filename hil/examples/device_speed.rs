//! What a packet and a pose of a Falcon cost on one core: what docs/devices.md quotes. Frames of the device link: `link_speed` of the core.
//!
//! `cargo run --release -p palpate-hil --example device_speed`

use palpate_host::device::falcon::kinematics::Kinematics;
use palpate_host::device::falcon::motor::MotorConfig;
use palpate_host::device::falcon::packet::{ALL_HOMED, Decoder, Reply};
use std::hint::black_box;
use std::time::Instant;

const REPEATS: usize = 5;

/// The median of a few runs of `count` calls, each of which must succeed.
fn measure(what: &str, count: u32, mut call: impl FnMut(u32) -> bool) {
    let mut times: Vec<f64> = (0..REPEATS)
        .map(|_| {
            let start = Instant::now();
            let good = (0..count).filter(|i| call(*i)).count();
            assert_eq!(good, count as usize, "{what}: one failed");
            start.elapsed().as_nanos() as f64 / f64::from(count)
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let ns = times[REPEATS / 2];
    println!("{what:<36} {ns:6.0} ns, {:6.2} million a second", 1e3 / ns);
}

/// Counts along a way through the workspace, 0.3 mm a step: 0.3 m/s at 1 kHz.
fn way() -> Vec<[i16; 3]> {
    let mechanism = Kinematics::default();
    let place = |i: u32| {
        let turn = f64::from(i) * 0.01;
        [0.03 * turn.cos(), 0.03 * turn.sin(), 0.12 + 0.02 * (0.37 * turn).sin()]
    };
    (0..10_000).filter_map(|i| mechanism.counts(place(i))).collect()
}

fn main() {
    let packet = Reply { encoders: [-516, 20, 871], homed: ALL_HOMED, ..Reply::default() }.encode();
    let mut decoder = Decoder::default();
    measure("decode a packet", 2_000_000, |_| decoder.push(black_box(&packet)).whole == 1);
    let way = way();
    let mut mechanism = Kinematics::default();
    let mut at = 0;
    measure("counts to pose", 1_000_000, |_| {
        at = (at + 1) % way.len();
        mechanism.solve(black_box(way[at])) != palpate_host::device::falcon::kinematics::Solution::Kept
    });
    let (motor, pose) = (MotorConfig::default(), *mechanism.pose());
    measure("force to motors", 2_000_000, |i| {
        motor.commands(black_box(&pose), black_box(&pose), [1.0, -2.0, i as f32 * 1e-6]) != [0; 3]
    });
}
