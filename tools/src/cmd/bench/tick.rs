//! `palpate bench tick`: time of one whole tick of the loop, including contact over many active nodes and a
//! surface.

use std::f64::consts::TAU;
use std::hint::black_box;
use std::time::Instant;

use clap::Args as ClapArgs;
use hdrhistogram::Histogram;
use palpate_core::{ActiveNode, Config, Method, Organ, Sample, Surface, Vec3, vec3};
use palpate_host::device::{Device, DeviceError, DeviceInfo};
use palpate_host::model::{self, TouchMemory};
use palpate_host::rt::{Clock, Controls, HapticLoop, LoopConfig, Outputs, TickRecord, VirtualClock};
use serde::Serialize;

use super::common::{Out, Pinned};
use super::core::tables::Tables;
use crate::failure::Failure;
use crate::output;

/// Radius of the synthetic organ, m.
const RADIUS_M: f64 = 0.06;
/// Maximum number of ticks before contact; the hand comes down once in 830.
const MAX_APPROACH_TICKS: u64 = 2_000;
/// More than the last-level cache of most processors.
const EVICTED_BYTES: usize = 64 << 20;

/// Measure the time of one whole tick.
///
/// A tick has device, contact with the surface, sliding over blended spaces, limits, histograms and queues.
///
/// A simulated hand touches a synthetic sphere near its top at random positions, presses, strokes over the
/// triangles and leaves it again. Every active node has separate tables, so that they compete for the caches
/// as those of an organ do. `hot` runs tick after tick. `cold` empties the caches before each tick, which is
/// slower than a loop at 1 kHz on an otherwise idle machine. Both begin with the first tick in contact.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Number of active nodes, at most 256
    #[arg(long, value_name = "N", default_value_t = 200)]
    active: usize,
    /// Minimum number of vertices of the surface
    #[arg(long, value_name = "N", default_value_t = 2_000)]
    surface: usize,
    /// Number of points of each grid: 514, 1418, 4168
    #[arg(long, value_name = "N", default_value_t = 514)]
    grid: usize,
    /// Methods, separated by commas
    #[arg(long, value_name = "M,N", value_delimiter = ',', value_parser = crate::cmd::pack::method, default_value = "energy,tricubic,trilinear")]
    method: Vec<Method>,
    /// Number of ticks with hot caches; a fiftieth of it with cold ones
    #[arg(long, value_name = "N", default_value_t = 200_000)]
    ticks: u64,
    #[command(flatten)]
    pinned: Pinned,
    #[command(flatten)]
    out: Out,
}

/// One method.
#[derive(Debug, Serialize)]
struct Row {
    method: &'static str,
    caches: &'static str,
    active: usize,
    surface_vertices: usize,
    ticks: u64,
    /// Share of the ticks in contact, and of those the share with more than one space.
    touching: f64,
    blended: f64,
    p50_ns: u64,
    p99_ns: u64,
    p999_ns: u64,
    max_ns: u64,
    /// Largest change per tick of the force on the hand, N.
    largest_step_n: f32,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    if !(3..=256).contains(&args.active) || args.surface > 100_000 {
        return Err(Failure::input("give 3 to 256 active nodes and at most 100,000 vertices"));
    }
    let out = args.out.ready([])?;
    let pinned = args.pinned.pin();
    let ball = Ball::new(args.surface, args.active)?;
    let tables = Tables::made_up(args.grid)?;
    let tables: Vec<Tables> = (0..args.active).map(|_| tables.clone()).collect();
    let organ = ball.organ(&tables);
    let mut rows = Vec::new();
    for &method in &args.method {
        for (caches, ticks) in [("hot", args.ticks), ("cold", args.ticks / 50)] {
            let row = measure(&organ, method, caches, ticks.max(1))?;
            // Printed at once, because each row takes a while.
            eprintln!("palpate: {} {caches}: p50 {} ns, p99 {} ns", row.method, row.p50_ns, row.p99_ns);
            rows.push(row);
        }
    }
    out.write(|| output::csv(&rows), &rows, || table(&rows, &pinned))
}

fn table(rows: &[Row], pinned: &str) -> String {
    let mut text = format!(
        "{} active nodes, {} vertices; {pinned}\n{:<10} {:<5} {:>8} {:>8} {:>8} {:>9} {:>9} {:>9} {:>9} {:>9}",
        rows.first().map_or(0, |row| row.active),
        rows.first().map_or(0, |row| row.surface_vertices),
        "method",
        "cache",
        "ticks",
        "touch",
        "blended",
        "p50 ns",
        "p99 ns",
        "p99.9 ns",
        "max ns",
        "step mN"
    );
    for row in rows {
        text += &format!(
            "\n{:<10} {:<5} {:>8} {:>6.1} % {:>6.1} % {:>9} {:>9} {:>9} {:>9} {:>9.1}",
            row.method,
            row.caches,
            row.ticks,
            100.0 * row.touching,
            100.0 * row.blended,
            row.p50_ns,
            row.p99_ns,
            row.p999_ns,
            row.max_ns,
            1e3 * row.largest_step_n
        );
    }
    text
}

fn measure(organ: &Organ<'_>, method: Method, caches: &'static str, ticks: u64) -> Result<Row, Failure> {
    let mut memory = TouchMemory::default();
    let controllers =
        model::controllers(&[organ], Config::new(method), &mut memory).map_err(Failure::work)?;
    let (producer, mut records) = rtrb::RingBuffer::new(16);
    let (latest, _newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let outputs = Outputs { records: producer, latest };
    let mut haptic = HapticLoop::with_models(
        &controllers,
        Stroke::default(),
        &clock,
        LoopConfig::default(),
        &controls,
        outputs,
    );
    let mut times = Histogram::<u64>::new_with_bounds(1, 10_000_000_000, 3).map_err(Failure::work)?;
    let mut touch = palpate_host::session::TouchStatistics::default();
    let (mut blended, mut evicted) = (0_u64, vec![1_u8; if caches == "cold" { EVICTED_BYTES } else { 0 }]);
    let mut begin = 0;
    // Arming inside the organ gives no force, so the hand must first come from outside. Otherwise all of the
    // few cold ticks would be without contact.
    loop {
        clock.wait_until(begin * 1_000_000, 0);
        haptic.tick(begin, 0, begin * 1_000_000).map_err(Failure::work)?;
        begin += 1;
        if records.pop().map_err(Failure::work)?.engaged.is_some() {
            break;
        }
        if begin == MAX_APPROACH_TICKS {
            return Err(Failure::work(format!("{}: the stroke has no contact", method.name())));
        }
    }
    for index in begin..begin + ticks {
        clock.wait_until(index * 1_000_000, 0);
        evicted.iter_mut().step_by(64).for_each(|byte| *byte = byte.wrapping_add(1));
        black_box(&mut evicted);
        let begun = Instant::now();
        let ended = haptic.tick(index, 0, index * 1_000_000);
        times.saturating_record(begun.elapsed().as_nanos() as u64);
        ended.map_err(Failure::work)?;
        let record = records.pop().map_err(Failure::work)?;
        touch.add(&record);
        blended += u64::from(record.shares.iter().filter(|share| share.weight > 0.0).count() > 1);
        if let palpate_core::Phase::SafeZero(fault) = record.phase {
            return Err(Failure::work(format!("{}: the stroke ended in {}", method.name(), fault.name())));
        }
    }
    Ok(Row {
        method: method.name(),
        caches,
        active: organ.spaces.len(),
        surface_vertices: organ.surface.node.len(),
        ticks,
        touching: touch.engaged_ticks as f64 / ticks as f64,
        blended: blended as f64 / touch.engaged_ticks.max(1) as f64,
        p50_ns: times.value_at_quantile(0.5),
        p99_ns: times.value_at_quantile(0.99),
        p999_ns: times.value_at_quantile(0.999),
        max_ns: times.max(),
        largest_step_n: touch.largest_step_n,
    })
}

/// A hand that presses, strokes and leaves the top of the ball repeatedly at different positions.
#[derive(Debug, Default)]
struct Stroke {
    calls: u64,
}

impl Device for Stroke {
    fn exchange(&mut self, now_us: u64, _: Vec3) -> Result<Option<Sample>, DeviceError> {
        let t = self.calls as f64 * 1e-3;
        self.calls += 1;
        // Slow motions with unrelated periods, which do not repeat: at most 8 mm deep, 0.1 m/s along the
        // surface.
        let (tilt, turn) = (0.26 * (TAU * t / 3.7).sin(), 0.26 * (TAU * t / 2.9).cos());
        let depth_m = 0.005 + 0.008 * (TAU * t / 0.83).sin();
        // Within the first 200 vertices of 2,000, except the corners.
        let direction = [tilt.sin(), turn.sin() * tilt.cos(), tilt.cos() * turn.cos()];
        let position_m = direction.map(|x| (x * (RADIUS_M - depth_m)) as f32);
        Ok(Some(Sample { t_us: now_us, position_m, buttons: 0 }))
    }

    fn stop(&mut self) {}

    fn info(&self) -> DeviceInfo {
        DeviceInfo {
            name: "a stroke".into(),
            self_arming: true,
            max_force_n: f32::INFINITY,
            max_stiffness_n_m: f32::INFINITY,
            resolution_m: 0.0,
        }
    }
}

/// A sphere of rings. Its vertices are in the order of their height, so the first ones are at the top.
struct Ball {
    node: Vec<u32>,
    planes: [Vec<f32>; 3],
    triangles: Vec<[u32; 3]>,
    fixed: Vec<u8>,
    active: usize,
}

impl Ball {
    fn new(vertices: usize, active: usize) -> Result<Self, Failure> {
        let rings = (1..400_u32).find(|rings| (2 * rings * rings + 2) as usize >= vertices);
        let rings = rings.ok_or_else(|| Failure::input("too many vertices"))?;
        let around = 2 * rings;
        let mut points: Vec<[f64; 3]> = vec![[0.0, 0.0, RADIUS_M]];
        for ring in 1..=rings {
            let polar = TAU / 2.0 * f64::from(ring) / f64::from(rings + 1);
            for step in 0..around {
                let turn = TAU * f64::from(step) / f64::from(around);
                points.push([
                    RADIUS_M * polar.sin() * turn.cos(),
                    RADIUS_M * polar.sin() * turn.sin(),
                    RADIUS_M * polar.cos(),
                ]);
            }
        }
        points.push([0.0, 0.0, -RADIUS_M]);
        let (at, last) =
            (|ring: u32, step: u32| 1 + (ring - 1) * around + step % around, points.len() as u32 - 1);
        let mut triangles = Vec::new();
        for step in 0..around {
            triangles.push([0, at(1, step), at(1, step + 1)]);
            triangles.push([last, at(rings, step + 1), at(rings, step)]);
            for ring in 1..rings {
                let (a, b) = (at(ring, step), at(ring, step + 1));
                let (c, d) = (at(ring + 1, step), at(ring + 1, step + 1));
                triangles.extend([[a, c, b], [b, c, d]]);
            }
        }
        Ok(Self {
            node: (0..points.len() as u32).collect(),
            planes: [0, 1, 2].map(|axis: usize| points.iter().map(|p| p[axis] as f32).collect()),
            fixed: vec![0; points.len()],
            triangles,
            active,
        })
    }

    fn organ<'a>(&'a self, tables: &'a [Tables]) -> Organ<'a> {
        let mut organ = Organ::empty();
        organ.max_force_n = 8.0;
        let [x, y, z] = &self.planes;
        organ.surface = Surface {
            node: &self.node,
            position_m: [x, y, z],
            triangles: &self.triangles,
            fixed: &self.fixed,
        };
        for (vertex, tables) in tables.iter().enumerate().take(self.active) {
            let rest_position_m = [x[vertex], y[vertex], z[vertex]];
            let mut space = tables.space();
            space.active = ActiveNode {
                node: vertex as u32,
                rest_position_m,
                outward_normal: vec3::normalize_or_zero(rest_position_m),
                ..ActiveNode::default()
            };
            organ.spaces.push(space).expect("at most 256 are requested");
        }
        organ
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Few cold ticks are measured. Before the first contact they would measure nothing.
    #[test]
    fn both_rows_begin_in_touch() {
        let ball = Ball::new(300, 30).expect("small enough");
        let tables = Tables::made_up(514).expect("a grid");
        let tables: Vec<Tables> = (0..30).map(|_| tables.clone()).collect();
        let organ = ball.organ(&tables);
        for caches in ["hot", "cold"] {
            let row = measure(&organ, Method::Tricubic, caches, 20).expect("it touches");
            assert_eq!((row.ticks, row.touching), (20, 1.0), "{caches}");
        }
    }
}
