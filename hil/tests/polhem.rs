//! The driver of the Polhem on an emulated device over a pseudo terminal: checks beyond the contract of all
//! devices.

use palpate_core::{Fault, Method, Organ, Phase, vec3};
use palpate_hil::rig::{Rig, SerialRig, Wire};
use palpate_hil::session::{Bench, Session, golden_organ, press, with_loop};
use palpate_hil::{EmulatedPolhem, Faults, PtyTransport};
use palpate_host::DeviceErrorKind;
use palpate_host::device::fence::Fence;
use palpate_host::device::nonblocking_port::NonBlockingPort;
use palpate_host::device::polhem::{Polhem, PolhemConfig};
use palpate_host::rt::TickRecord;
use std::time::Duration;

fn rig() -> SerialRig<EmulatedPolhem> {
    SerialRig::new(Wire::Pty, 11)
}

/// Runs `test` with the disarmed loop on the golden organ.
fn on_organ(test: impl FnOnce(&mut Bench<'_, '_>)) {
    let blob = golden_organ();
    let organ: Organ<'_> = Organ::read(blob.bytes()).expect("golden");
    with_loop(&mut rig(), &organ, Method::Energy, test).expect("it opens");
}

/// Under any fault the force is finite, within the force and slew limits, and zero unless active.
fn assert_safe(records: &[TickRecord]) {
    let mut before = vec3::ZERO;
    for record in records {
        let force_n = record.hand_force_n;
        assert!(vec3::is_finite(force_n) && vec3::norm(force_n) <= 8.0, "{record:?}");
        let step_n = vec3::distance(force_n, before);
        assert!(force_n == vec3::ZERO || step_n <= 2.001, "{step_n} N in one tick: {record:?}");
        assert!(record.phase == Phase::Active || force_n == vec3::ZERO, "{record:?}");
        before = force_n;
    }
}

#[test]
fn a_device_that_never_wakes_is_a_timeout() {
    let (_link, driver) = PtyTransport::pair().expect("a pseudo terminal");
    let config = PolhemConfig { wake_timeout: Duration::from_millis(250), ..PolhemConfig::default() };
    let port = NonBlockingPort::from_port(driver).expect("it is open");
    let refused = Polhem::with_port(Box::new(port), config);
    assert_eq!(refused.err().map(|error| error.kind()), Some(DeviceErrorKind::Timeout));
}

#[test]
fn a_scaled_workspace_has_the_stiffness_of_its_model() {
    let mut rig = rig();
    let (mut workspace, cap_n_m) = (rig.profile().workspace, rig.profile().cap().n_m);
    workspace.scale = 2.0;
    let mut session = Session::homed(&mut rig, workspace).expect("it opens");
    assert_eq!(session.device().info().max_stiffness_n_m, cap_n_m / 2.0);
}

/// The loop stops for 60 ms with a force on the motors; only the guard writes to the line. The device has no
/// watchdog.
#[test]
fn a_stalled_loop_is_zeroed_past_the_driver_until_the_fence_opens() {
    let mut rig = rig();
    let workspace = rig.profile().workspace;
    let mut session = Session::homed(&mut rig, workspace).expect("it opens");
    let fence = Fence::default();
    let path = session.device().guard_path(&fence).expect("it is open");
    let force_n = [0.5, -0.5, 1.5];
    let is_felt = |session: &Session<'_>| session.rig.force_record().force_n != vec3::ZERO;
    for _ in 0..10 {
        session.tick(force_n).expect("a fault-free link");
    }
    for ms in 1..=60 {
        if ms == 10 {
            fence.page().close();
            session.guard_zero(&fence, path.as_ref()).expect("room");
        }
        session.pass(1_000);
        assert_eq!(is_felt(&session), ms < 10, "{ms} ms");
    }
    // The loop resumes and sends its force as before. The lines of driver and guard stay separate.
    for _ in 0..300 {
        session.tick(force_n).expect("a fault-free link");
        assert!(!is_felt(&session), "not for a single tick");
    }
    fence.open();
    for _ in 0..10 {
        session.tick(force_n).expect("a fault-free link");
    }
    let felt_n = session.rig.force_record().force_n;
    assert!(vec3::distance(felt_n, force_n) <= session.rig.traits().motor_step_n, "{felt_n:?}");
}

/// A fault hits one frame about every 50 ms, a request and a reply in turn. Two faults within a few
/// milliseconds may latch zero, as runs of the fault matrix do.
#[test]
fn the_loop_recovers_from_single_faults() {
    for (name, faults) in [
        ("drop", Faults { drop: 1.0, ..Faults::NONE }),
        ("truncate", Faults { truncate: 1.0, ..Faults::NONE }),
        ("delay", Faults { delay: 1.0, delay_us: 3_000, ..Faults::NONE }),
        ("duplicate", Faults { duplicate: 1.0, ..Faults::NONE }),
        ("stall", Faults { stall: 1.0, stall_us: 3_000, ..Faults::NONE }),
        ("noise", Faults { noise: 1.0, ..Faults::NONE }),
    ] {
        on_organ(|bench| {
            let path = press(bench.rig, 0.006, 0.014);
            bench.rig.follow(path);
            bench.controls.arm();
            let mut records = Vec::new();
            for round in 0..40 {
                let (to_device, to_host) =
                    if round % 2 == 0 { (faults, Faults::NONE) } else { (Faults::NONE, faults) };
                bench.rig.set_faults(to_device, to_host);
                records.extend(bench.run(1).expect("connected"));
                bench.rig.set_faults(Faults::NONE, Faults::NONE);
                records.extend(bench.run(50 + round % 7).expect("connected"));
            }
            assert_safe(&records);
            let counts = bench.rig.counts();
            assert!((15..=40).contains(&counts.total()), "{name}: {counts:?}");
            assert_eq!(records.last().map(|record| record.phase), Some(Phase::Active), "{name}: {counts:?}");
            assert!(bench.rig.force_record().force_n[2] > 0.3, "{name}");
        });
    }
}

/// Delayed replies are fresh bytes with old contents. They must not count as fresh samples.
#[test]
fn a_link_that_is_always_late_is_stale() {
    for delay_us in [12_000, 30_000, 50_000] {
        on_organ(|bench| {
            bench.rig.set_faults(Faults::NONE, Faults { delay: 1.0, delay_us, ..Faults::NONE });
            bench.run(200).expect("connected");
            let before = bench.rig.counts().delayed;
            bench.controls.arm();
            let records = bench.run(300).expect("connected");
            assert_safe(&records);
            assert!(bench.rig.counts().delayed > before + 5, "the link carries data continuously");
            assert!(records.iter().all(|record| record.engaged.is_none()), "never on old data");
            assert_eq!(
                records.last().map(|record| record.phase),
                Some(Phase::SafeZero(Fault::Stale)),
                "{delay_us}"
            );
        });
    }
}
