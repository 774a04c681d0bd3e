//! A Polhem that loses its power and answers as if nothing had been: what its driver sees, and what it cannot.

use palpate_core::{Method, Organ, Phase, Vec3, vec3};
use palpate_hil::rig::{self, Mishap, Rig};
use palpate_hil::session::{self, Session};
use palpate_hil::{Faults, Waypoint};
use palpate_host::device::DeviceState;

fn polhem() -> Box<dyn Rig> {
    let kind = rig::all().into_iter().find(|kind| kind.name == "polhem-memory").expect("it is listed");
    (kind.make)(3)
}

/// Power goes while the hand leans on an organ; it answers nothing for some ticks, or is back at once.
#[test]
fn a_polhem_that_lost_its_power_is_no_device_until_it_is_opened_anew() {
    let blob = session::golden_organ();
    let organ = Organ::read(blob.bytes()).expect("golden");
    for dark_ticks in [0, 5, 300] {
        let mut rig = polhem();
        session::with_loop(&mut *rig, &organ, Method::Energy, |bench| {
            let path = session::press(bench.rig, 0.006, 0.014);
            bench.rig.follow(path);
            bench.controls.arm();
            bench.run(800).expect("a sound link");
            assert!(bench.rig.felt().force_n[2] > 0.3, "{:?}", bench.rig.felt());
            assert!(bench.rig.strike(Mishap::PowerCycle));
            let dark = Faults { drop: 1.0, ..Faults::NONE };
            bench.rig.set_faults(dark, dark);
            bench.run(dark_ticks).expect("the cable is in");
            bench.rig.set_faults(Faults::NONE, Faults::NONE);
            // After a long silence the driver waits a while before it asks again.
            let records = bench.run(100).expect("the cable is in");
            assert!(records[2..].iter().all(|record| record.sample.is_none()), "{dark_ticks}");
            bench.rig.forget();
            for _ in 0..5 {
                // Neither helps: it has no homing that could be done again.
                bench.controls.reset();
                bench.controls.arm();
                for record in bench.run(50).expect("the cable is in") {
                    assert_eq!((record.sample, record.device), (None, DeviceState::Unhomed), "{dark_ticks}");
                    assert_ne!(record.phase, Phase::Active, "{dark_ticks}");
                }
            }
            assert_eq!(bench.rig.felt().largest_force_n, 0.0, "{dark_ticks}");
        })
        .expect("it opens");
        let workspace = rig.profile().workspace;
        let mut session = Session::homed(&mut *rig, workspace).expect("it opens anew");
        assert!(session.tick(vec3::ZERO).expect("a sound link").is_some());
    }
}

/// What is left: where the counters begin there is nothing to be seen, and next to nothing is wrong.
#[test]
fn a_power_cycle_where_the_counters_begin_cannot_be_told() {
    let mut rig = polhem();
    let workspace = rig.profile().workspace;
    let begin_m = begins_at(&mut *rig);
    for (off_m, is_seen) in [(0.001, false), (0.003, true)] {
        let mut rig = polhem();
        let mut session = Session::homed(&mut *rig, workspace).expect("it opens");
        let position_m = vec3::add(begin_m, [off_m, 0.0, 0.0]);
        session.rig.follow(vec![
            Waypoint { t_us: 0, position_m: vec3::ZERO },
            Waypoint { t_us: 300_000, position_m },
        ]);
        for _ in 0..1_000 {
            session.tick(vec3::ZERO).expect("a sound link");
        }
        session.rig.strike(Mishap::PowerCycle);
        for _ in 0..20 {
            let _ = session.tick(vec3::ZERO);
        }
        assert_eq!(session.state() == DeviceState::Unhomed, is_seen, "{off_m} m");
    }
}

/// Where a device says that it is when it has just been given power.
fn begins_at(rig: &mut dyn Rig) -> Vec3 {
    rig.strike(Mishap::PowerCycle);
    rig.reported_m()
}
