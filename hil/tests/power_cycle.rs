//! A power cycle of a Polhem, which answers afterwards as before: what its driver can detect.

use palpate_core::{Method, Organ, Phase, Vec3, vec3};
use palpate_hil::fault::FaultKind;
use palpate_hil::rig::{self, Rig};
use palpate_hil::session::{self, Session};
use palpate_hil::{Faults, Waypoint};
use palpate_host::device::DeviceState;

fn polhem() -> Box<dyn Rig> {
    let kind = rig::all().into_iter().find(|kind| kind.name == "polhem-memory").expect("it is listed");
    (kind.make)(3)
}

/// The power cycle happens while the hand presses on an organ. The device is silent for some ticks, or
/// answers at once.
#[test]
fn a_polhem_after_a_power_cycle_renders_nothing_until_it_is_opened_again() {
    let blob = session::golden_organ();
    let organ = Organ::read(blob.bytes()).expect("golden");
    for silent_ticks in [0, 5, 300] {
        let mut rig = polhem();
        session::with_loop(&mut *rig, &organ, Method::Energy, |bench| {
            let path = session::press(bench.rig, 0.006, 0.014);
            bench.rig.follow(path);
            bench.controls.arm();
            bench.run(800).expect("a fault-free link");
            assert!(bench.rig.force_record().force_n[2] > 0.3, "{:?}", bench.rig.force_record());
            assert!(bench.rig.inject(FaultKind::PowerCycle));
            let silence = Faults { drop: 1.0, ..Faults::NONE };
            bench.rig.set_faults(silence, silence);
            bench.run(silent_ticks).expect("the cable is in");
            bench.rig.set_faults(Faults::NONE, Faults::NONE);
            // After a long silence the driver pauses before its next request.
            let records = bench.run(100).expect("the cable is in");
            assert!(records[2..].iter().all(|record| record.sample.is_none()), "{silent_ticks}");
            bench.rig.reset_record();
            for _ in 0..5 {
                // Neither helps, because the device has no homing to repeat.
                bench.controls.reset();
                bench.controls.arm();
                for record in bench.run(50).expect("the cable is in") {
                    assert_eq!(
                        (record.sample, record.device),
                        (None, DeviceState::Unhomed),
                        "{silent_ticks}"
                    );
                    assert_ne!(record.phase, Phase::Active, "{silent_ticks}");
                }
            }
            assert_eq!(bench.rig.force_record().largest_force_n, 0.0, "{silent_ticks}");
        })
        .expect("it opens");
        let workspace = rig.profile().workspace;
        let mut session = Session::homed(&mut *rig, workspace).expect("it opens again");
        assert!(session.tick(vec3::ZERO).expect("a fault-free link").is_some());
    }
}

/// A power cycle at the reported start position cannot be detected, and the position error is small.
#[test]
fn a_power_cycle_at_the_start_position_is_undetectable() {
    let mut rig = polhem();
    let workspace = rig.profile().workspace;
    let begin_m = power_up_position_m(&mut *rig);
    for (off_m, is_seen) in [(0.001, false), (0.003, true)] {
        let mut rig = polhem();
        let mut session = Session::homed(&mut *rig, workspace).expect("it opens");
        let position_m = vec3::add(begin_m, [off_m, 0.0, 0.0]);
        session.rig.follow(vec![
            Waypoint { t_us: 0, position_m: vec3::ZERO },
            Waypoint { t_us: 300_000, position_m },
        ]);
        for _ in 0..1_000 {
            session.tick(vec3::ZERO).expect("a fault-free link");
        }
        session.rig.inject(FaultKind::PowerCycle);
        for _ in 0..20 {
            let _ = session.tick(vec3::ZERO);
        }
        assert_eq!(session.state() == DeviceState::Unhomed, is_seen, "{off_m} m");
    }
}

/// Position that the device reports after power-up.
fn power_up_position_m(rig: &mut dyn Rig) -> Vec3 {
    rig.inject(FaultKind::PowerCycle);
    rig.reported_m()
}
