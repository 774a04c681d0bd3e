//! The supervisor with emulated devices, in real time: hosts that are killed, stopped or hang.
//!
//! Host and supervisor are processes of `palpate-hil process`. Event orders are asserted strictly. Times are
//! asserted by their best value, so that a busy machine passes; `--nocapture` prints them.

use nix::sys::signal::{Signal, kill};
use palpate_core::{Vec3, vec3};
use palpate_hil::hosts::{self, Device as TestedDevice, Host, Role, TARGET, Testbed, is_running, wait};
use palpate_hil::matrix::{Ended, FaultKind, MAX_TIME_TO_ZERO, Run, Table};
use palpate_hil::{EmulatedFalcon, FalconConfig, MemoryFtdi};
use palpate_host::Device;
use palpate_host::device::DeviceState;
use palpate_host::device::falcon::{self, Falcon};
use palpate_host::supervisor::{DEFAULT_LIMIT_MS, Supervised, serve};
use palpate_host::sys::Policy;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// Silence limit of the supervisor, ms. It is longer than the product's, because a test machine itself stops
/// for longer.
const TEST_LIMIT_MS: u32 = 250;

/// The commanded force, N.
const FORCE_N: Vec3 = [0.0, 0.0, 1.5];

/// The program of the processes.
fn program() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_palpate-hil"))
}

/// A Polhem and a host that holds its force.
fn holding(role: Role) -> (Testbed, Host) {
    let testbed = Testbed::new(TestedDevice::Polhem);
    let host = testbed.host(program(), role, TEST_LIMIT_MS, FORCE_N);
    testbed.hold(&host, FORCE_N).expect("the host holds its force");
    (testbed, host)
}

/// Checks that the force stays zero for this time, and that requests continue.
fn assert_zero_and_alive_for(testbed: &Testbed, time: Duration) {
    let before = testbed.observed().requests;
    assert!(testbed.is_zero_for(time), "{:?}", testbed.observed());
    wait("a further request to the device", || testbed.observed().requests > before);
}

/// A few runs of each device and signal, as in the table of docs/measurements.md.
#[test]
fn killed_and_stopped_hosts_are_zeroed_until_reset() {
    let runs = hosts::runs(program(), TEST_LIMIT_MS, 18, 3);
    for run in &runs {
        let by = if run.rig == TestedDevice::Link.name() { Ended::Watchdog } else { Ended::Supervisor };
        assert_eq!((run.violation(), run.ended), (None, by), "{run:?}");
        assert!(run.largest_n > 0.4, "{run:?}");
    }
    assert_eq!(runs.iter().filter(|run| run.fault == FaultKind::HostPaused).count(), 9);
    assert_eq!(hosts::medians(&runs).len(), 3);
}

/// With the product's limit, the best of some runs of each device and signal must meet the target. A
/// systematic delay affects every run, a pause of the machine only a few. `palpate-hil matrix` prints the
/// typical times.
#[test]
fn the_force_of_a_lost_host_is_zeroed_in_time() {
    /// Fewer runs are not judged.
    const MIN_RUNS: usize = 5;
    const MAX_RUNS: u64 = 12;
    /// For the runs of one device and signal, on a machine so busy that hosts rarely hold a force.
    const TIMEOUT: Duration = Duration::from_secs(25);
    let lost = [FaultKind::HostKilled, FaultKind::HostPaused];
    for (device, fault) in TestedDevice::ALL.into_iter().flat_map(|device| lost.map(|fault| (device, fault)))
    {
        let (mut times, start) = (Vec::new(), Instant::now());
        for seed in 0..MAX_RUNS {
            let run = hosts::run(program(), DEFAULT_LIMIT_MS, device, fault, seed);
            times.extend(hosts::time_to_safe(&run));
            if times.last().is_some_and(|time| *time <= TARGET) || start.elapsed() > TIMEOUT {
                break;
            }
        }
        println!("{}, {fault:?}: {times:.1?}", device.name());
        let is_in_time = times.iter().any(|time| *time <= TARGET);
        assert!(is_in_time || times.len() < MIN_RUNS, "{}, {fault:?}: {times:.1?}", device.name());
        if !is_in_time {
            println!("{}, {fault:?}: not judged, because this machine pauses too often", device.name());
        }
    }
}

/// A host that cannot be brought up is a row of the table and a violation; the other runs are unaffected.
#[test]
fn a_host_that_cannot_be_brought_up_is_a_failed_run() {
    let runs = hosts::runs(Path::new("/bin/false"), TEST_LIMIT_MS, 6, 3);
    let violation: Vec<_> = runs.iter().map(Run::violation).collect();
    assert_eq!(violation, [Some("no force"); 6]);
    let table = Table(&runs).to_string();
    assert_eq!(table.matches("| no force 1 |").count(), 6, "{table}");
}

/// The same without a supervisor, which shows that the supervisor removes the force.
#[test]
fn a_killed_host_without_a_supervisor_leaves_the_force() {
    let (testbed, host) = holding(Role::Unsupervised);
    host.signal(Signal::SIGKILL);
    let start = Instant::now();
    while start.elapsed() < MAX_TIME_TO_ZERO {
        assert_eq!(testbed.observed().force_n, FORCE_N, "the device has no watchdog");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn a_stopped_host_stays_zeroed_after_it_resumes_until_reset() {
    let (testbed, host) = holding(Role::Host);
    host.signal(Signal::SIGSTOP);
    wait("zero", || testbed.observed().force_n == vec3::ZERO);
    // Zero requests continue, one per limit, because one may be lost.
    assert_zero_and_alive_for(&testbed, Duration::from_millis(200));
    assert!(!host.has_printed("zeroed"), "the host is stopped");

    host.signal(Signal::SIGCONT);
    wait("report that it was zeroed", || host.has_printed("zeroed"));
    // The host sends its force as before, and the supervisor ignores it.
    assert_zero_and_alive_for(&testbed, Duration::from_millis(300));
    assert!(is_running(host.supervisor().expect("it has one")));

    host.send("reset");
    wait("the force again", || testbed.observed().force_n == FORCE_N);
}

/// Nothing can set zero force then; the host only detects the loss.
#[test]
fn a_killed_supervisor_ends_the_loop_and_leaves_the_force() {
    let (testbed, mut host) = holding(Role::Host);
    kill(host.supervisor().expect("it has one"), Signal::SIGKILL).expect("the process runs");
    assert!(host.end());
    wait("its last line", || host.has_printed("end Disconnected"));
    assert_eq!(testbed.observed().force_n, FORCE_N, "a hazard: docs/safety.md, section 6");
}

/// A supervisor that was stopped discards the commands of that time and does not report a silent host.
#[test]
fn a_resumed_supervisor_discards_old_commands() {
    let (testbed, host) = holding(Role::Host);
    let supervisor = host.supervisor().expect("it has one");
    kill(supervisor, Signal::SIGSTOP).expect("the process runs");
    std::thread::sleep(Duration::from_millis(100));
    kill(supervisor, Signal::SIGCONT).expect("the process runs");
    wait("requests", || {
        let before = testbed.observed().requests;
        std::thread::sleep(Duration::from_millis(20));
        testbed.observed().requests > before + 3
    });
    assert!(is_running(supervisor));
}

/// A Falcon in memory, whose supervisor is a thread. It is homed through the supervisor, and then its host
/// hangs. Times are the emulated device's.
#[test]
fn a_falcon_is_zeroed_when_its_host_hangs() {
    let config = FalconConfig { firmware_runs: true, ..FalconConfig::default() };
    let ftdi = MemoryFtdi::in_real_time(EmulatedFalcon::new(config));
    let seen = ftdi.open_again().expect("it is plugged in");
    let (host_end, supervisor_end) = UnixDatagram::pair().expect("a socket pair");
    let open = move || {
        let config = falcon::FalconConfig { mode: falcon::Mode::Polled, ..falcon::FalconConfig::default() };
        Falcon::start(Arc::new(ftdi), config, None).map_err(|error| error.to_string())
    };
    let supervisor = std::thread::spawn(move || serve(&supervisor_end, Policy::Other, open));
    let mut device = Supervised::with_socket(host_end, TEST_LIMIT_MS).expect("it opens the device");
    assert_eq!(device.state(), DeviceState::FirmwareLoaded);
    assert!(device.home(&AtomicBool::new(false)).expect("it is connected"), "the hand homes it");
    // A pause before the loop does not count as silence.
    std::thread::sleep(Duration::from_millis(100));
    assert!(!device.was_zeroed() && seen.falcon().force_record().largest_unhomed_n == 0.0);

    let start = Instant::now();
    let tick = |device: &mut Supervised| {
        std::thread::sleep(Duration::from_millis(1));
        let now_us = start.elapsed().as_micros() as u64;
        let sample = device.exchange(now_us, FORCE_N);
        assert!(
            !matches!(sample, Ok(Some(sample)) if sample.t_us > now_us),
            "{sample:?}: from before the loop"
        );
        seen.falcon().now_us()
    };
    let is_forced = || seen.falcon().force_record().off_since_us.is_none();
    let mut last_us = 0;
    wait("a force", || {
        last_us = tick(&mut device);
        if device.was_zeroed() {
            device.reset();
        }
        is_forced()
    });
    wait("zero", || !is_forced());
    let off_us = seen.falcon().force_record().off_since_us.expect("zero");
    println!(
        "host of a Falcon hangs: zero {:.1} ms after its last tick",
        off_us.saturating_sub(last_us) as f64 * 1e-3
    );
    for _ in 0..100 {
        tick(&mut device);
        assert!(!is_forced(), "a request resumed the force without a reset");
    }
    assert!(device.was_zeroed());
    wait("the force again", || {
        device.reset();
        tick(&mut device);
        is_forced()
    });
    drop(device);
    let served = supervisor.join().expect("no panic").expect("the host has connected");
    assert!(served.silences > 0, "{served:?}");
    // The last request is still in flight for some time.
    wait("zero after the end of the host", || !is_forced());
}
