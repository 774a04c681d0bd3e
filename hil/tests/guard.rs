//! The guard with emulated devices, in real time: hosts and guards that are killed or stopped.
//!
//! Host and guard are processes of `palpate-hil process`. Event orders are asserted strictly. Times are
//! asserted by their best value, so that a busy machine passes; `--nocapture` prints them.

use nix::sys::signal::{Signal, kill};
use palpate_core::{Vec3, vec3};
use palpate_hil::fault::FaultKind;
use palpate_hil::hosts::{self, Device as TestedDevice, Host, Role, TARGET, Testbed, is_running, wait};
use palpate_hil::matrix::{Ended, MAX_TIME_TO_ZERO, Run, Table};
use palpate_host::guard::DEFAULT_LIMIT_MS;
use std::path::Path;
use std::time::{Duration, Instant};

/// The guard's limit, ms. It is longer than the product's, because a test machine itself stops
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
fn no_single_death_leaves_a_force_on() {
    let runs = hosts::runs(program(), TEST_LIMIT_MS, 24, 3);
    for run in &runs {
        let is_host = matches!(run.fault, FaultKind::HostKilled | FaultKind::HostPaused);
        let by = if is_host { Ended::Guard } else { Ended::Host };
        assert_eq!((run.violation(), run.ended), (None, by), "{run:?}");
        assert!(run.largest_n > 0.4, "{run:?}");
    }
    for fault in FaultKind::PROCESSES {
        assert_eq!(runs.iter().filter(|run| run.fault == fault).count(), 6);
    }
    assert_eq!(hosts::medians(&runs).len(), 2);
}

/// With the product's limit, the best of some runs of each device and signal must meet the target. A
/// systematic delay affects every run, a pause of the machine only a few. `palpate-hil matrix` prints the
/// typical times.
#[test]
fn the_force_after_a_death_is_zeroed_in_time() {
    /// Fewer runs are not judged.
    const MIN_RUNS: usize = 5;
    const MAX_RUNS: u64 = 12;
    /// For the runs of one device and signal, on a machine so busy that hosts rarely hold a force.
    const TIMEOUT: Duration = Duration::from_secs(25);
    let cells = TestedDevice::ALL.into_iter();
    for (device, fault) in cells.flat_map(|device| FaultKind::PROCESSES.map(|fault| (device, fault))) {
        let (mut times, start) = (Vec::new(), Instant::now());
        for seed in 0..MAX_RUNS {
            let run = hosts::run(program(), DEFAULT_LIMIT_MS, Role::Host, device, fault, seed);
            assert_ne!(run.ended, Ended::TimedOut("no zero"), "{}, {fault:?}", device.name());
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

/// The same without a guard, which shows that the guard removes the force.
#[test]
fn a_killed_host_without_a_guard_leaves_the_force() {
    let (testbed, host) = holding(Role::Unguarded);
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
    // The host sends its force as before, and the fence keeps it back.
    assert_zero_and_alive_for(&testbed, Duration::from_millis(300));
    assert!(is_running(host.guard().expect("it has one")));

    host.send("reset");
    wait("the force again", || testbed.observed().force_n == FORCE_N);
}

#[test]
fn a_host_whose_guard_is_killed_zeroes_the_device_and_ends() {
    let (testbed, mut host) = holding(Role::Host);
    kill(host.guard().expect("it has one"), Signal::SIGKILL).expect("the process runs");
    assert!(host.end());
    wait("its last line", || host.has_printed("end GuardLost"));
    assert_eq!(testbed.observed().force_n, vec3::ZERO);
}

/// A guard that is stopped does not guard. The host notices within the limit, and a reset is refused until the
/// guard is back.
#[test]
fn a_stopped_guard_is_no_guard() {
    let (testbed, host) = holding(Role::Host);
    let guard = host.guard().expect("it has one");
    kill(guard, Signal::SIGSTOP).expect("the process runs");
    wait("zero", || testbed.observed().force_n == vec3::ZERO);
    wait("report that it was zeroed", || host.has_printed("zeroed"));
    host.send("reset");
    assert_zero_and_alive_for(&testbed, Duration::from_millis(300));
    kill(guard, Signal::SIGCONT).expect("the process runs");
    assert_zero_and_alive_for(&testbed, Duration::from_millis(300));
    host.send("reset");
    wait("the force again", || testbed.observed().force_n == FORCE_N);
}

/// A guard that was stopped is resumed by the death of its session, and zeroes the device.
#[test]
fn a_host_killed_under_a_stopped_guard_is_zeroed() {
    // Orphans come to this process, as under many service managers. Otherwise the kernel itself resumes the
    // stopped processes of a group that the death orphans.
    nix::sys::prctl::set_child_subreaper(true).expect("Linux");
    let (testbed, host) = holding(Role::Host);
    let guard = host.guard().expect("it has one");
    kill(guard, Signal::SIGSTOP).expect("the process runs");
    host.signal(Signal::SIGKILL);
    wait("zero", || testbed.observed().force_n == vec3::ZERO);
    assert!(testbed.is_zero_for(Duration::from_millis(100)));
}

/// What remains: both are stopped before either notices. The force stays until one of them resumes.
#[test]
fn a_host_and_its_guard_stopped_at_once_leave_the_force() {
    let (testbed, host) = holding(Role::Host);
    let guard = host.guard().expect("it has one");
    kill(guard, Signal::SIGSTOP).expect("the process runs");
    host.signal(Signal::SIGSTOP);
    std::thread::sleep(Duration::from_millis(400));
    println!("force with host and guard stopped: {:?} N", testbed.observed().force_n);
    kill(guard, Signal::SIGCONT).expect("the process runs");
    wait("zero", || testbed.observed().force_n == vec3::ZERO);
    host.signal(Signal::SIGCONT);
    assert!(testbed.is_zero_for(Duration::from_millis(100)));
}
