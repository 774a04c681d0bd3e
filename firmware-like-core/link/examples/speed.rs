//! Measures the frames of the device link per second on one core.
//!
//! `cargo run --release -p palpate-link --example speed`

use std::hint::black_box;
use std::time::Instant;

use palpate_link::{DeviceMessage, FrameReader, HostMessage, MAX_FRAME, encode};

const FRAMES: u32 = 2_000_000;
const REPEATS: usize = 5;

/// Prints the median time of several runs.
fn measure(what: &str, mut frame: impl FnMut() -> bool) {
    let mut times: Vec<f64> = (0..REPEATS)
        .map(|_| {
            let start = Instant::now();
            let good = (0..FRAMES).filter(|_| frame()).count();
            assert_eq!(good, FRAMES as usize, "{what}: a frame was lost");
            start.elapsed().as_nanos() as f64 / f64::from(FRAMES)
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let ns = times[REPEATS / 2];
    println!("{what:<15} {ns:4.0} ns a frame, {:.1} million a second", 1e3 / ns);
}

fn main() {
    let command = HostMessage::Command {
        session: 0x1234_5678,
        seq: 1000,
        t_host_us: 123_456,
        torque_unm: [100_000, -200_000, 50],
        valid_for_us: 3000,
    };
    let state = DeviceMessage::State {
        seq_echo: 1000,
        t_dev_us: 123_456,
        encoders: [100, -2000, 70_000],
        buttons: 1,
        flags: 5,
    };
    let (mut first, mut second) = ([0; MAX_FRAME], [0; MAX_FRAME]);
    let (commands, states) =
        (encode(&command, &mut first).expect("fits"), encode(&state, &mut second).expect("fits"));
    let mut reader = FrameReader::<HostMessage>::new();
    measure("decode Command", || matches!(reader.read(&mut black_box(commands)), Some(Ok(_))));
    let mut reader = FrameReader::<DeviceMessage>::new();
    measure("decode State", || matches!(reader.read(&mut black_box(states)), Some(Ok(_))));
    let mut out = [0; MAX_FRAME];
    measure("encode Command", || encode(black_box(&command), &mut out).is_ok());
    measure("encode State", || encode(black_box(&state), &mut out).is_ok());
}
