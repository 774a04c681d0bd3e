//! Stand-alone emulators: a Polhem on a pseudo terminal, a Falcon on the USB of a virtual machine.
//!
//! `palpate-hil --seconds 60`, and in another shell `palpate run FILE.blob --device polhem:/dev/pts/N`.
//! `palpate-hil falcon --usbredir SOCKET`, and then QEMU with `-device qemu-xhci,id=x -chardev socket,id=c,path=SOCKET,reconnect=1
//! -device usb-redir,bus=x.0,chardev=c`: its guest sees 0403:cb48.

use clap::{Args, Parser, Subcommand};
use palpate_hil::bench::{Options, serve};
use palpate_hil::{EmulatedPolhem, Faults, Faulty, Handle, PtyTransport, Waypoint};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Emulated haptic devices. Without a command: a Polhem / WoodenHaptics on a pseudo terminal.
#[derive(Debug, Parser)]
#[command(name = "palpate-hil", version, args_conflicts_with_subcommands = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    polhem: Polhem,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Emulated Novint Falcon on the USB of a QEMU guest, in real time.
    Falcon(Falcon),
}

#[derive(Debug, Args)]
struct Falcon {
    /// Unix socket to listen on for QEMU's usb-redir; made anew.
    #[arg(long, value_name = "SOCKET")]
    usbredir: PathBuf,
    /// Unix socket to listen on for orders, a line each: plug SEED, home, press, lift, strike, calm, forget, report, end.
    #[arg(long, value_name = "SOCKET")]
    control: Option<PathBuf>,
    /// How long to run at most, seconds.
    #[arg(long, default_value_t = 600.0)]
    seconds: f64,
}

#[derive(Debug, Args)]
struct Polhem {
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
    let Arguments { command, polhem } = Arguments::parse();
    match command {
        None => serve_polhem(&polhem),
        Some(Command::Falcon(Falcon { usbredir, control, seconds })) => {
            anyhow::ensure!(seconds >= 0.0 && seconds.is_finite(), "--seconds is not {seconds}");
            let options = Options { usbredir, control, longest: Duration::from_secs_f64(seconds) };
            serve(&options, &mut std::io::stdout())?;
            Ok(())
        }
    }
}

fn serve_polhem(&Polhem { seconds, faults: rate, seed }: &Polhem) -> anyhow::Result<()> {
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
    let mut link = Faulty::new(link, faults, seed);
    let mut device = EmulatedPolhem::new(Handle::new(strokes(seconds)));
    let begun = Instant::now();
    while begun.elapsed().as_secs_f64() < seconds {
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
