//! The loop with a fake solver: on a thread with a virtual clock, and as a process that is killed and stopped.

#[path = "live/hammer.rs"]
mod hammer;
#[path = "live/lost.rs"]
mod lost;
#[path = "live/process.rs"]
mod process;
#[path = "live/start.rs"]
mod start;

use crate::fake_solver::{FakeSolver, force_n};
use crate::synthetic::{self, Shape};
use palpate_core::{Config, Controller, Coverage, Organ, Phase, Sample, Solver, Vec3, vec3};
use palpate_host::live::{LiveField, local};
use palpate_host::rt::{Clock, Controls, HapticLoop, LoopConfig, Outputs, TickRecord, VirtualClock};
use palpate_host::session::TouchStatistics;
use palpate_host::{Device, DeviceError, DeviceInfo};

/// A hand that presses into the first node, moves sideways there, and lifts off; from zero to zero.
pub(crate) struct Press {
    rest_m: Vec3,
    normal: Vec3,
    along: Vec3,
    depth_m: f32,
    /// Presses a second; 0 presses once and stays.
    rate_hz: f32,
}

impl Press {
    pub(crate) fn on(organ: &Organ<'_>, depth_m: f32, rate_hz: f32) -> Self {
        let active = &organ.spaces[0].active;
        let normal = active.outward_normal;
        let along = vec3::normalize_or_zero([normal[1], -normal[0], 0.0]);
        Self { rest_m: active.rest_position_m, normal, along, depth_m, rate_hz }
    }
}

impl Device for Press {
    fn exchange(&mut self, now_us: u64, _: Vec3) -> Result<Option<Sample>, DeviceError> {
        let t_s = now_us as f32 * 1e-6;
        let share = match self.rate_hz {
            0.0 => (2.0 * t_s).min(1.0),
            rate_hz => (core::f32::consts::PI * rate_hz * t_s).sin().powi(2),
        };
        let height_m = 2e-3 - (self.depth_m + 2e-3) * share;
        let aside_m = 4e-3 * share * (40.0 * t_s).sin();
        let position_m = vec3::add(self.rest_m, vec3::scale(self.normal, height_m));
        let position_m = vec3::add(position_m, vec3::scale(self.along, aside_m));
        Ok(Some(Sample { t_us: now_us, position_m, ..Sample::default() }))
    }

    fn stop(&mut self) {}

    fn info(&self) -> DeviceInfo {
        DeviceInfo {
            name: "press".into(),
            self_arming: true,
            max_force_n: 8.0,
            max_stiffness_n_m: 3e3,
            resolution_m: 0.0,
        }
    }
}

/// Whether the force of a tick is the analytic one, within 10 mN.
pub(crate) fn is_right(record: &TickRecord) -> bool {
    record.engaged.is_none() || vec3::distance(record.reaction_n, force_n(record.displacement_m)) < 0.010
}

/// A touch in which the solver keeps up: the right force in every tick, and small steps from jet to jet.
#[test]
fn presses_are_rendered_from_the_jets_of_a_solver() {
    let blob = synthetic::organ(&Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let controller = Controller::new(&organ, Config::live()).expect("jets need no table");
    let (end, for_loop, view) = local(0);
    let mut solver = FakeSolver::new(end, organ.spaces.len() as u16);
    let (records, mut drained) = rtrb::RingBuffer::new(10);
    let (latest, _newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let (press, outputs) = (Press::on(&organ, 0.012, 2.0), Outputs { records, latest });
    let jets = LiveField::new(for_loop).expect("memory");
    let mut haptic =
        HapticLoop::live(controller, jets, press, &clock, LoopConfig::default(), &controls, outputs);
    let (mut touch, mut fastest_m_s) = (TouchStatistics::default(), 0.0_f32);
    for tick in 1..=4_000 {
        let now_ns = tick * 1_000_000;
        clock.wait_until(now_ns, 0);
        let hand = solver.turn(now_ns);
        fastest_m_s = fastest_m_s.max(vec3::norm(hand.velocity_m_s));
        haptic.tick(tick, 0, now_ns).expect("the hand never fails");
        let record = drained.pop().expect("a record");
        let hand = solver.end.hand();
        assert_eq!((hand.tick, hand.hip_m, hand.displacement_m), (tick, record.hip_m, record.displacement_m));
        assert_eq!((hand.engaged, hand.is_engaged), (record.shares, record.engaged.is_some()));
        let live = record.live.expect("a live tick");
        assert_eq!((live.jets, live.sequence, live.solver), (hand.taken, hand.sequence, Solver::Alive));
        assert!(record.phase == Phase::Active && is_right(&record), "{record:?}");
        assert!(record.coverage != Some(Coverage::Extrapolated), "{record:?}");
        touch.add(&record);
    }
    // 12 mm in a quarter of a second.
    assert!((0.06..0.3).contains(&fastest_m_s), "{fastest_m_s}");
    assert_eq!((touch.contacts, touch.extrapolated_share()), (8, 0.0));
    assert!(touch.peak_reaction_n > 2.5 && touch.hand_overs >= 8, "{touch:?}");
    assert!(touch.largest_hand_over_n < 0.1, "{touch:?}");
    assert!(touch.first_force_us.is_some_and(|first_us| (10_000..200_000).contains(&first_us)), "{touch:?}");
    assert!(solver.sent > 6 && view.meter().solver(4_000_000_000) == Solver::Alive);
}

/// Without a jet there is no force, and the solver is told which contact lacks one.
#[test]
fn a_touch_without_jets_has_no_force_and_says_what_is_missing() {
    let blob = synthetic::organ(&Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let controller = Controller::new(&organ, Config::live()).expect("jets need no table");
    let (mut end, for_loop, _view) = local(0);
    let (records, mut drained) = rtrb::RingBuffer::new(10);
    let (latest, _newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let (press, outputs) = (Press::on(&organ, 0.004, 0.0), Outputs { records, latest });
    let jets = LiveField::new(for_loop).expect("memory");
    let mut haptic =
        HapticLoop::live(controller, jets, press, &clock, LoopConfig::default(), &controls, outputs);
    let mut lacking = 0;
    for tick in 1..=400 {
        clock.wait_until(tick * 1_000_000, 0);
        end.heart().beat(tick * 1_000_000);
        // A damaged frame is refused, and no jet.
        let mut damaged = crate::fake_solver::jet(0, 7, vec3::ZERO);
        damaged.force_n[0] = f32::NAN;
        assert!(tick != 200 || end.try_send(&damaged));
        haptic.tick(tick, 0, tick * 1_000_000).expect("the hand never fails");
        let (record, hand) = (drained.pop().expect("a record"), end.hand());
        // The damping of a tool that waits for jets, 2 N s/m.
        assert!(vec3::norm(record.hand_force_n) <= 3.0 * vec3::norm(hand.velocity_m_s), "{record:?}");
        assert!(record.engaged.is_some() || record.hand_force_n == vec3::ZERO || tick > 200, "{record:?}");
        assert_eq!((hand.taken, hand.refused), if tick < 200 { (0, 0) } else { (1, 1) });
        let is_touching = record.engaged.is_some();
        assert_eq!(hand.missing, [is_touching, false, false]);
        assert_eq!(hand.is_extrapolated, is_touching);
        lacking += u64::from(is_touching);
    }
    assert!(lacking > 100, "{lacking}");
}
