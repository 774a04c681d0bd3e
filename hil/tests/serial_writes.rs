//! How long a write to a serial port blocks a real-time thread on a busy machine: through `serialport`, which
//! calls poll(2) first, and through the port of the drivers.

use palpate_host::device::nonblocking_port::NonBlockingPort;
use palpate_host::sys::{RtRequest, enter_real_time, monotonic_ns, sleep_until_ns};
use serialport::{SerialPort, TTYPort};
use std::io::{Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

const REQUEST: &[u8] = b"0.00000 0.00000 0.00000\n";
const PERIOD_NS: u64 = 1_000_000;
const WRITES: u64 = 20_000;

/// Durations of writes, us.
#[derive(Debug, Default)]
struct WriteTimes {
    us: Vec<u64>,
    full: u64,
}

impl WriteTimes {
    fn of(mut write: impl FnMut() -> std::io::Result<usize>, waits: &mut Self) {
        let start = monotonic_ns();
        waits.full += u64::from(write().is_err());
        waits.us.push((monotonic_ns() - start) / 1_000);
    }

    fn line(&mut self) -> String {
        self.us.sort_unstable();
        let at = |share: f64| self.us[((self.us.len() - 1) as f64 * share) as usize];
        let late = self.us.iter().filter(|us| **us > 1_000).count();
        format!(
            "median {} us, 99.9 % {} us, worst {} us, {late} of {} above 1 ms, {} without room",
            at(0.5),
            at(0.999),
            at(1.0),
            self.us.len(),
            self.full
        )
    }
}

/// The far end: echoes all input with a higher priority than the measured thread, as a device would.
fn answer(mut far: TTYPort, over: &AtomicBool) {
    let _ = enter_real_time(&RtRequest { fifo_priority: Some(52), ..RtRequest::none() });
    far.set_timeout(Duration::from_millis(20)).expect("a time limit");
    let mut bytes = [0; 256];
    while !over.load(Ordering::Relaxed) {
        if let Ok(count) = far.read(&mut bytes) {
            let _ = far.write(&bytes[..count]);
        }
    }
}

#[test]
#[ignore = "a measurement of 20 s with four busy threads; run by hand with --nocapture for the serial writes in docs/safety.md"]
fn writes_beside_busy_cpus() {
    let (far_polled, mut polled) = TTYPort::pair().expect("a pseudo terminal");
    let (far_prompt, prompt) = TTYPort::pair().expect("a pseudo terminal");
    let mut prompt = NonBlockingPort::from_port(prompt).expect("it has a name");
    let over = AtomicBool::new(false);
    let [mut by_serialport, mut by_driver] = [WriteTimes::default(), WriteTimes::default()];
    std::thread::scope(|scope| {
        for far in [far_polled, far_prompt] {
            scope.spawn(|| answer(far, &over));
        }
        for _ in 0..4 {
            scope.spawn(|| {
                while !over.load(Ordering::Relaxed) {
                    std::hint::spin_loop()
                }
            });
        }
        let (report, _held) = enter_real_time(&RtRequest { keep_awake: false, ..RtRequest::default() });
        println!("{}", report.line());
        let start = monotonic_ns();
        let mut bytes = [0; 256];
        for tick in 0..WRITES {
            sleep_until_ns(start + tick * PERIOD_NS);
            WriteTimes::of(|| polled.write(REQUEST), &mut by_serialport);
            WriteTimes::of(|| prompt.write(REQUEST), &mut by_driver);
            // Input is read without blocking, as the drivers do.
            for port in [&mut polled as &mut dyn SerialPort, &mut prompt] {
                if port.bytes_to_read().is_ok_and(|count| count > 0) {
                    let _ = port.read(&mut bytes);
                }
            }
        }
        over.store(true, Ordering::Relaxed);
    });
    println!("serialport: {}\ndrivers:    {}", by_serialport.line(), by_driver.line());
    assert!(by_driver.us.last() <= by_serialport.us.last(), "the drivers' port is slower");
}
