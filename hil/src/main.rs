//! Stand-alone emulator: opens a pseudo terminal, prints its name and behaves like a Polhem until its time is over.
//!
//! `palpate-hil --seconds 60`, and in another shell `palpate run FILE.blob --device polhem:/dev/pts/N`.

use clap::Parser;
use palpate_hil::{EmulatedPolhem, Faults, Faulty, Handle, PtyTransport, Waypoint};
use std::time::{Duration, Instant};

/// Emulated Polhem / WoodenHaptics on a pseudo terminal.
#[derive(Debug, Parser)]
#[command(name = "palpate-hil", version)]
struct Arguments {
    /// How long to run, seconds.
    #[arg(long, default_value_t = 60.0)]
    seconds: f64,
    /// Share of the frames that is lost, cut, damaged or 3 ms late, each, 0 to 1.
    #[arg(long, default_value_t = 0.0)]
    faults: f32,
    /// Seed of the faults.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let rate = arguments.faults;
    anyhow::ensure!((0.0..=1.0).contains(&rate), "--faults is a share from 0 to 1, not {rate}");
    let (link, driver) = PtyTransport::pair()?;
    {
        use serialport::SerialPort;
        println!("{}", driver.name().unwrap_or_default());
    }
    let faults = Faults {
        drop: rate,
        truncate: rate,
        corrupt: rate,
        delay: rate,
        delay_us: 3_000,
        ..Faults::default()
    };
    let mut link = Faulty::new(link, faults, arguments.seed);
    let mut device = EmulatedPolhem::new(Handle::new(strokes(arguments.seconds)));
    let begun = Instant::now();
    while begun.elapsed().as_secs_f64() < arguments.seconds {
        device.poll(begun.elapsed().as_micros() as u64, &mut link)?;
        std::thread::sleep(Duration::from_micros(100));
    }
    println!("{} requests, {} refused, {:?}", device.requests(), device.refused(), link.counts());
    // Held open to here: without a driver the terminal would otherwise be gone.
    drop(driver);
    Ok(())
}

/// Up and down along z, 12 mm either way, four seconds a stroke.
fn strokes(seconds: f64) -> Vec<Waypoint> {
    let count = (seconds / 2.0).ceil().max(1.0) as u64;
    (0..=count)
        .map(|i| Waypoint {
            t_us: i * 2_000_000,
            position_m: [0.0, 0.0, if i % 2 == 0 { 0.012 } else { -0.012 }],
        })
        .collect()
}
