//! Time of a live tick with 256 jets of each contact point: decoding a frame, adding it, and the tick.
//!
//! `taskset -c 1 cargo run --release -p palpate-core --features std --example live_tick -- FILE.blob TICKS`

use std::error::Error;

use palpate_core::AlignedBytes;

#[allow(unreachable_pub, reason = "shared with `worst_case`")]
mod live;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: live_tick FILE.blob TICKS")?;
    let ticks: u64 = arguments.next().ok_or("usage: live_tick FILE.blob TICKS")?.parse()?;
    let blob = AlignedBytes::from(&std::fs::read(&path).map_err(|error| format!("{path}: {error}"))?);
    let live::Run { engaged, faults, mut times_ns } = live::run(&blob, ticks)?;
    times_ns.sort_unstable();
    let at = |share: f64| -> Result<u64, &str> {
        let index = (share * times_ns.len() as f64) as usize;
        times_ns.get(index.min(times_ns.len().saturating_sub(1))).copied().ok_or("no ticks")
    };
    println!(
        "{ticks} ticks, {engaged} on three contact points, {faults} faults: median {} ns, p99 {} ns, p99.9 {} ns, largest {} ns",
        at(0.5)?,
        at(0.99)?,
        at(0.999)?,
        at(1.0)?
    );
    Ok(())
}
