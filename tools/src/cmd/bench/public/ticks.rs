//! Time of the controller's tick over many ticks of random palpation.

use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use palpate_core::{Config, Method, Organ, Sample, State};
use palpate_host::Device;
use palpate_host::device::palpation::RandomConfig;
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::model::{TouchMemory, controllers};
use palpate_host::sys::{RtRequest, enter_real_time};

use super::figures::{Best, Others, Row, Section, Table};
use super::jets::Jets;
use super::organs::Ready;
use super::ours::LIVE;
use super::run::{Context, finished};
use crate::failure::Failure;

/// Name of the section.
pub(super) const KEY: &str = "tick";

/// Rows of its tables: key, name, and share of the ticks below.
pub(super) const ROWS: [(&str, &str, f64); 4] = [
    ("p50_us", "median, \u{b5}s", 0.5),
    ("p99_us", "99 %, \u{b5}s", 0.99),
    ("p9999_us", "99.99 %, \u{b5}s", 0.9999),
    ("max_us", "largest, \u{b5}s", 1.0),
];

/// Ticks of each method. Live has this share of them, because its solver works between them.
const TICKS: [u64; 2] = [1_000_000, 50_000];
const LIVE_SHARE: u64 = 10;
/// Period of the loop.
const PERIOD_US: u64 = 1000;
/// Ticks between two looks at Ctrl-C.
const LOOK: u64 = 1 << 16;

/// Times of the ticks of a method, or of a live solver's jets, ns.
fn measure(
    organ: &Organ<'_>,
    method: Method,
    live: Option<&Ready>,
    ticks: u64,
    context: &Context<'_>,
) -> Result<Histogram<u64>, Failure> {
    let mut solver = live.map(Ready::live).transpose()?;
    let mut jets =
        solver.as_mut().map(|(solver, contact)| Jets::new(solver, *contact, 1e-6 * PERIOD_US as f64));
    let random = Some(RandomConfig::new(1));
    let mut hand = SimulatedHand::new(organ, SimulatedConfig { random, ..SimulatedConfig::default() });
    let mut memory = TouchMemory::default();
    let controller =
        controllers(&[organ], Config::new(method), &mut memory).map_err(Failure::work)?.remove(0);
    let mut state = State::new();
    state.arm();
    let mut times = Histogram::new(3).map_err(Failure::work)?;
    let mut force_n = [0.0; 3];
    for tick in 0..ticks {
        if tick % LOOK == 0 {
            context.go_on()?;
        }
        let now_us = tick * PERIOD_US;
        let sample: Option<Sample> = hand.exchange(now_us, force_n).map_err(Failure::work)?;
        let begun = Instant::now();
        let command = match &mut jets {
            Some(jets) => controller.tick_on(&mut state, now_us, sample.as_ref(), jets),
            None => controller.tick(&mut state, now_us, sample.as_ref()),
        };
        let whole = begun.elapsed();
        let own = whole.saturating_sub(jets.as_mut().map_or(Duration::ZERO, Jets::take_solving));
        times.record(own.as_nanos() as u64).map_err(Failure::work)?;
        force_n = command.hand_force_n;
    }
    Ok(times)
}

/// Measures the section on every organ.
pub(super) fn section(organs: &[Ready], context: &Context<'_>) -> Result<Section, Failure> {
    let start = Instant::now();
    let tables = organs.iter().map(|ready| table(ready, context)).collect::<Result<Vec<_>, Failure>>()?;
    Ok(finished(
        context,
        KEY,
        "Worst tick",
        &[
            "The loop must answer within a millisecond, always. Times depend on the machine. The largest number of instructions of a \
             tick does not: in a clone the second command counts it, on the organ of its tests. \u{201c}live\u{201d} is the tick that \
             evaluates the jets; its solver works in another process and is not counted.",
        ],
        &["TICKS=100000 firmware-like-core/check-worst-case"],
        start.elapsed().as_secs_f64(),
        tables,
    ))
}

/// The ticks of every method of an organ.
fn table(ready: &Ready, context: &Context<'_>) -> Result<Table, Failure> {
    let ticks = TICKS[usize::from(context.quick)];
    let organ = ready.organ()?;
    // A thread of its own, so that its priority ends with it.
    let results = std::thread::scope(|scope| {
        let work = || {
            let cpu = std::thread::available_parallelism().map_or(0, |n| n.get() - 1);
            // Without SCHED_FIFO: the kernel stops a real-time thread that never sleeps for 50 ms a second.
            let (report, _held) = enter_real_time(&RtRequest { cpu: Some(cpu), ..RtRequest::none() });
            let of = |method: &Method| measure(&organ, *method, None, ticks, context);
            let live = || measure(&organ, Method::Energy, Some(ready), ticks / LIVE_SHARE, context);
            let times = ready.scene.methods.iter().map(of).chain(std::iter::once_with(live));
            let times: Result<Vec<_>, Failure> = times.collect();
            times.map(|times| (times, format!("CPU {cpu}: {}", report.affinity)))
        };
        scope.spawn(work).join().unwrap_or_else(|_| Err(Failure::work("the thread of the ticks panicked")))
    });
    let (histograms, pinned) = results?;
    let mut table = Table::new(
        &format!("{KEY}.{}", ready.scene.name),
        &format!(
            "{} ticks of random palpation on the organ \u{201c}{}\u{201d}",
            crate::words::count(ticks as usize),
            ready.scene.name
        ),
        &format!(
            "Wall time of the controller's tick: contact, force and limits, without the device, on one thread ({pinned}). \
             Live has a tenth of the ticks; here its solver works between them, so the caches are cold. The largest value includes every interrupt and every other program of the machine."
        ),
        "measure",
        ready.scene.methods.iter().map(|method| method.name().to_owned()).chain([LIVE.to_owned()]).collect(),
    );
    table.others = Others::Declared;
    for (key, name, share) in ROWS {
        let values = histograms.iter().map(|times| 1e-3 * times.value_at_quantile(share) as f64);
        // The largest is that of the machine as much as of a method.
        let best = if share < 1.0 { Best::Least } else { Best::None };
        table.rows.push(Row::new(key, name, best, values.collect()));
    }
    Ok(table)
}
