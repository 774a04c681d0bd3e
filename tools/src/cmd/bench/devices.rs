//! `palpate bench devices`: computing time of the Falcon's driver per tick, with the error where one is
//! known.

use std::hint::black_box;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_host::device::falcon::kinematics::{Kinematics, Solution};
use palpate_host::device::falcon::motor::MotorConfig;
use palpate_host::device::falcon::packet::{ALL_HOMED, Decoder, Reply};
use serde::Serialize;

use super::common::{Out, Pinned};
use crate::failure::Failure;
use crate::output;

/// Positions along the trajectory of the hand.
const POSITIONS: u32 = 4_096;
/// Number of rounds, of which the median is reported.
const ROUNDS: usize = 21;
/// One byte in this number is damaged.
const DAMAGED: usize = 40;

/// Measure decoder, kinematics and motor mapping of the Falcon's driver.
///
/// Nanoseconds each, pinned, median of 21 rounds.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    #[command(flatten)]
    pinned: Pinned,
    #[command(flatten)]
    out: Out,
}

/// One part of the driver.
#[derive(Debug, Serialize)]
struct Figure {
    part: &'static str,
    /// Time per packet, pose or force, ns.
    ns: f64,
    /// Executions per second.
    per_second: f64,
    /// The known error.
    error: String,
}

/// Median time per item of `work`, which processes `count` items, ns.
fn time(count: usize, mut work: impl FnMut()) -> f64 {
    let mut rounds: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let begun = Instant::now();
            work();
            begun.elapsed().as_nanos() as f64 / count as f64
        })
        .collect();
    rounds.sort_by(f64::total_cmp);
    rounds[ROUNDS / 2]
}

fn figure(part: &'static str, ns: f64, error: String) -> Figure {
    Figure { part, ns, per_second: 1e9 / ns, error }
}

/// A trajectory around the workspace at up to 0.8 m/s, one position per millisecond, m.
fn way() -> Vec<[f64; 3]> {
    let at = |n: u32| {
        let t = f64::from(n) * 1e-3;
        [0.04 * (13.0 * t).sin(), 0.04 * (11.0 * t).cos(), 0.12 + 0.03 * (17.0 * t).sin()]
    };
    (0..POSITIONS).map(at).collect()
}

fn decoder(counts: &[[i16; 3]]) -> [Figure; 2] {
    let packets = counts.iter().map(|&encoders| Reply { encoders, buttons: 3, homed: ALL_HOMED }.encode());
    let mut stream: Vec<u8> = packets.flatten().collect();
    let decoded = |stream: &[u8]| {
        let mut decoder = Decoder::default();
        // In pieces as the chip sends them: at most 62 bytes per transfer.
        stream.chunks(62).fold((0, 0), |(whole, damaged), bytes| {
            let decoded = decoder.push(black_box(bytes));
            (whole + decoded.whole, damaged + decoded.damaged)
        })
    };
    let measure = |part, stream: &[u8]| {
        let (whole, damaged) = decoded(stream);
        let ns = time(counts.len(), || {
            black_box(decoded(stream));
        });
        figure(part, ns, format!("{whole} whole, {damaged} damaged of {}", counts.len()))
    };
    let sound = measure("decoder, a packet", &stream);
    for byte in stream.iter_mut().step_by(DAMAGED) {
        *byte = 0xff;
    }
    [sound, measure("decoder, packet of a stream with one of 40 bytes damaged", &stream)]
}

fn kinematics(way: &[[f64; 3]], counts: &[[i16; 3]]) -> [Figure; 2] {
    let solved = |from_last: bool| {
        let mut kinematics = Kinematics::default();
        let (mut largest_m, mut most, mut kept) = (0.0_f64, 0, 0);
        for (place, counts) in way.iter().zip(counts) {
            if !from_last {
                kinematics = Kinematics::default();
            }
            match kinematics.solve(black_box(*counts)) {
                Solution::Solved { iterations } => most = iterations.max(most),
                Solution::Kept => kept += 1,
            }
            let off = |axis: usize| kinematics.pose().position_m[axis] - place[axis];
            largest_m = largest_m.max((0..3).map(|axis| off(axis).powi(2)).sum::<f64>().sqrt());
        }
        (largest_m, most, kept)
    };
    let measure = |part, from_last| {
        let (largest_m, most, kept) = solved(from_last);
        let ns = time(way.len(), || {
            black_box(solved(from_last));
        });
        let error =
            format!("largest {:.0} um, of counts; at most {most} steps, {kept} not found", 1e6 * largest_m);
        figure(part, ns, error)
    };
    [
        measure("pose from counts, from the last one", true),
        measure("pose from counts, from the centre", false),
    ]
}

fn motors(counts: &[[i16; 3]]) -> Figure {
    let mut kinematics = Kinematics::default();
    let poses: Vec<_> = counts
        .iter()
        .map(|&counts| {
            kinematics.solve(counts);
            *kinematics.pose()
        })
        .collect();
    let config = MotorConfig::default();
    // Within the capability of three motors everywhere on the trajectory.
    let force_n = [0.6_f32, -0.8, 1.0];
    let ns = time(poses.len(), || {
        for pose in &poses {
            black_box(config.commands(pose, pose, black_box(force_n)));
        }
    });
    let off = |pose: &palpate_host::device::falcon::kinematics::Pose| {
        let commands = config.commands(pose, pose, force_n);
        let torques: [f64; 3] = std::array::from_fn(|m| f64::from(commands[m]) / config.counts_per_n_m[m]);
        let rendered = pose.force_n(torques);
        (0..3).map(|axis| (rendered[axis] - f64::from(force_n[axis])).powi(2)).sum::<f64>().sqrt()
    };
    let largest_n = poses.iter().map(off).fold(0.0, f64::max);
    figure("motors from a force", ns, format!("largest {:.1} mN, of counts", 1e3 * largest_n))
}

/// Runs the command.
pub(super) fn run(args: &Args) -> Result<(), Failure> {
    let out = args.out.ready([])?;
    let pinned = args.pinned.pin();
    let way = way();
    let mechanism = Kinematics::default();
    let counts: Vec<[i16; 3]> =
        way.iter().map(|&place| mechanism.counts(place).expect("within reach")).collect();
    let mut figures: Vec<Figure> = decoder(&counts).into();
    figures.extend(kinematics(&way, &counts));
    figures.push(motors(&counts));
    let csv = || output::csv(&figures);
    out.write(csv, &figures, || {
        let mut table = format!("{pinned}\n{:<58} {:>9} {:>12}  error\n", "part", "ns", "a second");
        for figure in &figures {
            let Figure { part, ns, per_second, error } = figure;
            table.push_str(&format!("{part:<58} {ns:>9.1} {per_second:>12.0}  {error}\n"));
        }
        table
    })
}
