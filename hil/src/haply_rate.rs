//! How fast the driver of the Inverse Service is: its exchanges with the emulated service, in turn with a bare echo over
//! WebSocket, which shows what this machine gives.

use crate::haply::{Service, World};
use core::fmt;
use hdrhistogram::Histogram;
use palpate_host::Device;
use palpate_host::device::maker::cycles::Cycle;
use palpate_host::device::maker::haply::{Address, Driver};
use palpate_host::device::maker::{self};
use palpate_host::device::profile::Profile;
use palpate_host::sys::{RtRequest, enter_real_time, monotonic_ns};
use std::io;
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};

/// Time between two exchanges, as in the proxy.
const PERIOD: Duration = Duration::from_micros(500);
/// Least rate in every second, Hz.
const RATE_HZ: u64 = 1_000;
/// Largest ratio of the 99.9th percentiles.
const RATIO: f64 = 1.5;
/// Real-time priorities of the exchanges, and of the echo as of the emulated service.
const PRIORITIES: (i32, i32) = (51, 80);
/// Largest time that is distinguished, ns.
const LONGEST_NS: u64 = 1_000_000_000;

/// What was measured.
#[derive(Debug)]
pub struct Measured {
    /// From a command to its reply, ns.
    pub driver_ns: Histogram<u64>,
    /// From a text to its echo, ns.
    pub echo_ns: Histogram<u64>,
    /// Exchanges in the slowest second.
    pub slowest_hz: u64,
    /// Cycles whose reply came in a later one.
    pub late: u64,
    /// Largest force on the hand, and the limit, N.
    pub largest_n: (f64, f64),
}

impl Measured {
    /// Ratio of the 99.9th percentiles of driver and echo.
    #[must_use]
    pub fn ratio(&self) -> f64 {
        let of = |times: &Histogram<u64>| times.value_at_quantile(0.999) as f64;
        of(&self.driver_ns) / of(&self.echo_ns)
    }

    /// The target that is not met.
    #[must_use]
    pub fn violation(&self) -> Option<String> {
        let (largest_n, limit_n) = self.largest_n;
        if self.slowest_hz < RATE_HZ {
            Some(format!("{} exchanges in a second, fewer than {RATE_HZ}", self.slowest_hz))
        } else if self.ratio() > RATIO {
            Some(format!("p99.9 is {:.2} times that of the echo, more than {RATIO}", self.ratio()))
        } else if largest_n == 0.0 {
            Some("no force has reached the hand".into())
        } else if largest_n > limit_n {
            Some(format!("{largest_n} N, more than {limit_n}"))
        } else {
            None
        }
    }
}

impl fmt::Display for Measured {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let us = |times: &Histogram<u64>, share: f64| times.value_at_quantile(share) as f64 * 1e-3;
        writeln!(f, "round trip, us      p50      p99    p99.9      max   number")?;
        for (name, times) in [("driver", &self.driver_ns), ("echo", &self.echo_ns)] {
            let [p50, p99, p999, max] = [0.5, 0.99, 0.999, 1.0].map(|share| us(times, share));
            writeln!(f, "{name:<14} {p50:>8.1} {p99:>8.1} {p999:>8.1} {max:>8.1} {:>8}", times.len())?;
        }
        let (largest_n, limit_n) = self.largest_n;
        writeln!(f, "p99.9, driver to echo: {:.2}", self.ratio())?;
        writeln!(
            f,
            "exchanges in the slowest second: {}; replies in a later cycle: {}",
            self.slowest_hz, self.late
        )?;
        writeln!(f, "largest force {largest_n:.2} N, limit {limit_n:.2} N")
    }
}

/// A text and its echo, one after another.
struct Echo(WebSocket<TcpStream>);

impl Echo {
    fn start() -> io::Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let address = listener.local_addr()?;
        std::thread::spawn(move || {
            let (_, _held) =
                enter_real_time(&RtRequest { fifo_priority: Some(PRIORITIES.1), ..RtRequest::none() });
            let Ok((stream, _)) = listener.accept() else { return };
            let _ = stream.set_nodelay(true);
            let Ok(mut socket) = tungstenite::accept(stream) else { return };
            while let Ok(message) = socket.read() {
                if message.is_text() && socket.send(message).is_err() {
                    return;
                }
            }
        });
        let stream = TcpStream::connect(address)?;
        stream.set_nodelay(true)?;
        let (socket, _) =
            tungstenite::client(format!("ws://{address}/"), stream).map_err(io::Error::other)?;
        Ok(Self(socket))
    }

    /// Time from a text of the length of a command to its echo, ns.
    fn round_trip_ns(&mut self) -> io::Result<u64> {
        let text = "x".repeat(110);
        let before_ns = monotonic_ns();
        self.0.send(Message::text(text)).map_err(io::Error::other)?;
        self.0.read().map_err(io::Error::other)?;
        Ok(monotonic_ns() - before_ns)
    }
}

/// Measures for this long.
pub fn measure(time: Duration) -> io::Result<Measured> {
    let profile = Profile::bundled("haply").ok_or(io::ErrorKind::NotFound)?;
    let limit_n = f64::from(profile.max_force_n);
    let service = Service::start(World::default())?;
    let address: Address = service.address().parse().map_err(io::Error::other)?;
    let (proxy, session) = maker::beside(&profile, Box::new(monotonic_ns));
    let opened = Driver::open(&address, proxy, Box::new(monotonic_ns)).map_err(io::Error::other)?;
    let (mut driver, opened, _news) = opened;
    let (mut device, mut echo) = (session(opened), Echo::start()?);
    device.set_armed(true);
    let new = || Histogram::<u64>::new_with_bounds(1, LONGEST_NS, 3).map_err(io::Error::other);
    let (mut driver_ns, mut echo_ns) = (new()?, new()?);
    let (mut slowest_hz, mut in_second, mut late) = (u64::MAX, 0, 0);
    let (_, _held) = enter_real_time(&RtRequest { fifo_priority: Some(PRIORITIES.0), ..RtRequest::none() });
    let begun = Instant::now();
    let (mut due, mut second) = (begun, 1);
    for n in 0_u64.. {
        let elapsed = begun.elapsed();
        if elapsed >= Duration::from_secs(second) {
            slowest_hz = slowest_hz.min(in_second);
            (second, in_second) = (second + 1, 0);
        }
        if elapsed >= time {
            break;
        }
        if n.is_multiple_of(2) {
            let x = 2.0 * (elapsed.as_secs_f32() * 6.0).sin();
            match device.exchange(elapsed.as_micros() as u64, [x, 0.0, 1.0]) {
                // The first is before the driver's first cycle.
                Err(error) if !error.kind().is_transient() => return Err(io::Error::other(error)),
                _ => {}
            }
        }
        // In turn, so that neither is always the first after the sleep.
        if n % 4 < 2 {
            echo_ns.saturating_record(echo.round_trip_ns()?);
        }
        driver.run();
        match driver.round_trip_ns() {
            Some(ns) => {
                driver_ns.saturating_record(ns);
                in_second += 1;
            }
            None => late += 1,
        }
        if n % 4 >= 2 {
            echo_ns.saturating_record(echo.round_trip_ns()?);
        }
        due = (due + PERIOD).max(Instant::now() - PERIOD);
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
    }
    driver.close();
    let largest_n = (service.with(|world| world.held().largest_n), limit_n);
    Ok(Measured { driver_ns, echo_ns, slowest_hz, late, largest_n })
}
