//! The state machine from opening a device to its force, and several models in one session.

use crate::synthetic::{self, Shape};
use core::sync::atomic::{AtomicBool, Ordering};
use palpate_core::{AlignedBytes, Config, Controller, Fault, Method, Organ, Phase, Sample, Vec3, vec3};
use palpate_host::device::DeviceState;
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::model::{self, TouchMemory};
use palpate_host::rt::{
    Clock, Controls, HapticLoop, LoopConfig, Outputs, SessionState, TickRecord, VirtualClock,
};
use palpate_host::session::{SessionOptions, TouchStatistics};
use palpate_host::sys::RtRequest;
use palpate_host::{Device, DeviceError, DeviceInfo, run_session};

/// A hand on a device whose buttons and state follow scripts, by the number of the call. A call without buttons
/// has no sample.
struct Scripted {
    hand: SimulatedHand,
    calls: u64,
    buttons: fn(u64) -> Option<u32>,
    state: fn(u64) -> DeviceState,
}

impl Device for Scripted {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.calls += 1;
        let sample = self.hand.exchange(now_us, hand_force_n)?;
        let buttons = (self.buttons)(self.calls);
        Ok(sample.zip(buttons).map(|(sample, more)| Sample { buttons: sample.buttons | more, ..sample }))
    }

    fn stop(&mut self) {}

    fn info(&self) -> DeviceInfo {
        DeviceInfo { self_arming: false, ..self.hand.info() }
    }

    fn state(&self) -> DeviceState {
        (self.state)(self.calls)
    }
}

/// A button that no hand presses.
const ARM_BUTTON: u32 = 1 << 7;

fn play(
    organs: &[&Organ<'_>],
    (state, arm_button): (fn(u64) -> DeviceState, u32),
    ticks: u64,
    mut request: impl FnMut(u64, &Controls),
) -> Vec<TickRecord> {
    let mut memory = TouchMemory::default();
    let mut config = Config::new(Method::Hybrid);
    config.limits.max_stiffness_n_m = f32::INFINITY;
    let controllers = model::controllers(organs, config, &mut memory).expect("has the method");
    let (producer, mut records) = rtrb::RingBuffer::new(ticks as usize);
    let (latest, _newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let mut hand = SimulatedConfig::default();
    hand.strokes.seconds_per_node = 2.0;
    let hand = SimulatedHand::new(organs[0], hand);
    let buttons: fn(u64) -> Option<u32> =
        if arm_button == 0 { |_| Some(0) } else { |call| Some((call % 2) as u32 * ARM_BUTTON) };
    let device = Scripted { hand, calls: 0, buttons, state };
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let outputs = Outputs { records: producer, latest };
    let haptic = LoopConfig { arm_button, ..LoopConfig::default() };
    let mut haptic = HapticLoop::with_models(&controllers, device, &clock, haptic, &controls, outputs);
    for index in 0..ticks {
        request(index, &controls);
        clock.wait_until(index * 1_000_000, 0);
        haptic.tick(index, 0, index * 1_000_000).expect("it answers");
    }
    core::iter::from_fn(|| records.pop().ok()).collect()
}

/// With an arming request in every tick, it is armed only when homed. Losing the homing zeroes the force and
/// latches.
#[test]
fn an_unhomed_device_is_not_armed() {
    let blob = synthetic::organ(&Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let state = |call| match call {
        0..100 => DeviceState::Open,
        100..200 => DeviceState::FirmwareLoaded,
        200..300 | 2_500..2_600 => DeviceState::Unhomed,
        _ => DeviceState::Homed,
    };
    let records = play(&[&organ], (state, 0), 4_000, |tick, controls| match tick {
        3_000 => controls.reset(),
        3_200.. => controls.arm(),
        0..2_900 => controls.arm(),
        _ => {}
    });
    let of = |range: core::ops::Range<usize>| -> Vec<String> {
        let mut seen: Vec<String> =
            records[range].iter().map(|record| SessionState::of(record).to_string()).collect();
        seen.dedup();
        seen
    };
    assert_eq!(
        of(0..2_400),
        ["open", "firmware-loaded", "unhomed", "armed", "active"],
        "all states in order; homed is armed at once"
    );
    assert_eq!(of(2_400..4_000), ["active", "safe zero: not-ready", "homed, not armed", "armed", "active"]);
    for record in &records {
        if !SessionState::of(record).has_force() {
            assert_eq!(record.hand_force_n, vec3::ZERO, "{record:?}");
        }
    }
    assert_eq!(records[2_499].phase, Phase::SafeZero(Fault::NotReady));
    let touched = records.iter().filter(|record| vec3::norm(record.hand_force_n) > 0.5).count();
    assert!(touched > 300, "{touched}");
}

/// Without a window only the button arms: it must not arm an unhomed device either.
#[test]
fn the_button_does_not_arm_an_unhomed_device() {
    let blob = synthetic::organ(&Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let state = |call| if call <= 300 { DeviceState::Unhomed } else { DeviceState::Homed };
    let records = play(&[&organ], (state, ARM_BUTTON), 400, |_, _| ());
    let armed = records.iter().position(|record| record.phase != Phase::Disarmed);
    assert!(armed.is_some_and(|tick| (300..304).contains(&tick)), "{armed:?}");
}

/// The ticks of 1,000 at which the session becomes armed. It is reset before tick 500.
fn armed_at(button: fn(u64) -> Option<u32>, state: fn(u64) -> DeviceState) -> Vec<usize> {
    let blob = synthetic::organ(&Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let controller = Controller::new(&organ, Config::new(Method::Hybrid)).expect("has the method");
    let (producer, mut records) = rtrb::RingBuffer::new(1_000);
    let (latest, _newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let hand = SimulatedHand::new(&organ, SimulatedConfig::default());
    let device = Scripted { hand, calls: 0, buttons: button, state };
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let outputs = Outputs { records: producer, latest };
    let config = LoopConfig { arm_button: 0b10, ..LoopConfig::default() };
    let mut haptic = HapticLoop::new(controller, device, &clock, config, &controls, outputs);
    for index in 0..1_000 {
        if index == 500 {
            controls.reset();
        }
        clock.wait_until(index * 1_000_000, 0);
        haptic.tick(index, 0, index * 1_000_000).expect("it answers");
    }
    let armed: Vec<bool> =
        core::iter::from_fn(|| records.pop().ok()).map(|record| record.phase == Phase::Active).collect();
    (1..armed.len()).filter(|&tick| armed[tick] && !armed[tick - 1]).collect()
}

/// Held at the start, held through homing, held through a fault and its reset, or pressed while the link was
/// silent: only a press that follows a release arms.
#[test]
fn a_held_button_does_not_arm() {
    let homed: fn(u64) -> DeviceState = |_| DeviceState::Homed;
    assert_eq!(armed_at(|_| Some(0b10), homed), [0; 0], "held from the start");
    assert_eq!(armed_at(|call| Some(if call == 600 { 0 } else { 0b10 }), homed), [600], "then released");
    let homing: fn(u64) -> DeviceState =
        |call| if call < 300 { DeviceState::Unhomed } else { DeviceState::Homed };
    let button = |call| Some(if call < 100 { 0 } else { 0b10 });
    assert_eq!(armed_at(button, homing), [0; 0], "held through homing");
    // A press arms; a loss of homing latches a fault, which tick 500 resets.
    let lost: fn(u64) -> DeviceState =
        |call| if (390..400).contains(&call) { DeviceState::Unhomed } else { DeviceState::Homed };
    fn presses(call: u64, second: u64) -> Option<u32> {
        Some(if (100..110).contains(&call) || call >= second { 0b10 } else { 0 })
    }
    assert_eq!(armed_at(|call| presses(call, 450), lost), [99], "held through a reset");
    assert_eq!(armed_at(|call| presses(call, 550), lost), [99, 549], "pressed after it");
    fn silent(call: u64, pressed_from: u64) -> Option<u32> {
        match call {
            600..650 => None,
            call => Some(if call < pressed_from { 0 } else { 0b10 }),
        }
    }
    assert_eq!(armed_at(|call| silent(call, 620), homed), [0; 0], "pressed in a silence");
    assert_eq!(armed_at(|call| silent(call, 700), homed), [699], "pressed after it");
    // The other button does not arm, nor hide a press of this one.
    assert_eq!(armed_at(|_| Some(0b01), homed), [0; 0]);
    assert_eq!(armed_at(|call| Some(if call < 700 { 0b01 } else { 0b11 }), homed), [699]);
}

/// Allocates the organs one by one: an array of them, and the code that moves it, exceeds a test's stack.
fn read(blobs: &[AlignedBytes]) -> Vec<Organ<'_>> {
    blobs.iter().map(|blob| Organ::read(blob).expect("a valid blob")).collect()
}

/// Two models of one organ, one twice as stiff, that alternate every 50 ms under the pressing hand.
#[test]
fn models_change_under_the_hand_without_a_force_step() {
    let blobs =
        [250.0, 500.0].map(|stiffness_n_m| synthetic::organ(&Shape { stiffness_n_m, ..Shape::default() }));
    let organs = read(&blobs);
    let steady = play(&[&organs[1]], (|_| DeviceState::Homed, 0), 6_000, |_, controls| controls.arm());
    let both: Vec<&Organ<'_>> = organs.iter().collect();
    let changed = play(&both, (|_| DeviceState::Homed, 0), 6_000, |tick, controls| {
        controls.arm();
        if tick % 50 == 49 {
            // The index after the last one wraps round to the first.
            controls.select(if tick % 100 == 49 { 1 } else { 2 });
        }
    });
    let statistics = |records: &[TickRecord]| {
        let mut statistics = TouchStatistics::default();
        records.iter().for_each(|record| statistics.add(record));
        statistics
    };
    let (steady, mixed) = (statistics(&steady), statistics(&changed));
    let switches = changed.windows(2).filter(|pair| pair[0].model != pair[1].model).count();
    let under_force =
        changed.windows(2).filter(|p| p[0].model != p[1].model && vec3::norm(p[0].reaction_n) > 2.0);
    assert_eq!(switches, 120);
    assert!(under_force.count() > 20, "most changes happen while it presses or pulls");
    // The step of a model's own strokes, plus a thirtieth of the difference (up to 4 N), plus the response of
    // the hand. Without the fade it is the 1 N of the slew limit.
    assert!(
        mixed.largest_step_n < steady.largest_step_n + 0.2,
        "{} {}",
        mixed.largest_step_n,
        steady.largest_step_n
    );
    assert!(changed.iter().all(|record| record.phase == Phase::Active));
    assert_eq!(mixed.contacts, steady.contacts, "no contact was lost by a change");
}

/// Models of another body are refused before the device moves: picture, contact and names would not match.
#[test]
fn models_of_another_body_are_refused() {
    let shapes = [Shape::default(), Shape { subdivisions: 2, ..Shape::default() }];
    let blobs = shapes.map(|shape| synthetic::organ(&shape));
    let organs = read(&blobs);
    let options = SessionOptions { seconds: Some(0.1), ..SessionOptions::default() };
    let hand = SimulatedHand::new(&organs[0], SimulatedConfig::default());
    let both: Vec<&Organ<'_>> = organs.iter().collect();
    let stop = AtomicBool::new(false);
    let refused =
        run_session(&both, Config::new(Method::Hybrid), hand, &options, &stop, &mut |_: &TickRecord| {
            panic!("no tick may run")
        });
    let error = refused.expect_err("another surface").to_string();
    assert!(error.contains("blob 2 differs from the first in its surface"), "{error}");
}

/// The same in a session, by time.
#[test]
fn a_session_cycles_through_its_models() {
    let blob = synthetic::organ(&Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let options = SessionOptions {
        seconds: Some(0.5),
        real_time: RtRequest::none(),
        change_every: Some(core::time::Duration::from_millis(50)),
        ..SessionOptions::default()
    };
    let hand = SimulatedHand::new(&organ, SimulatedConfig::default());
    let mut models = std::collections::BTreeSet::new();
    let stop = AtomicBool::new(false);
    run_session(
        &[&organ, &organ, &organ],
        Config::new(Method::Hybrid),
        hand,
        &options,
        &stop,
        &mut |record: &TickRecord| {
            models.insert(record.model);
        },
    )
    .expect("it runs");
    assert_eq!(models.into_iter().collect::<Vec<_>>(), [0, 1, 2]);
    let hand = SimulatedHand::new(&organ, SimulatedConfig::default());
    let none = run_session::<_, 256>(
        &[],
        Config::new(Method::Hybrid),
        hand,
        &options,
        &stop,
        &mut |_: &TickRecord| (),
    );
    assert!(none.is_err() && !stop.load(Ordering::Relaxed));
}
