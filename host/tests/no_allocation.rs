//! The path of the tick does not allocate: exchange, controller, histogram, queue and hand-over, over more
//! than 10^6 ticks, 150,000 per method.

use crate::{core_blobs, fake_solver, synthetic};
use assert_no_alloc::assert_no_alloc;
use core::time::Duration;
use palpate_core::{AlignedBytes, Config, Controller, Method, Organ, Phase, Sample, State, vec3};
use palpate_host::device::DeviceState;
use palpate_host::device::falcon::kinematics::Kinematics;
use palpate_host::device::falcon::packet::{ALL_HOMED, Reply};
use palpate_host::device::falcon::{Falcon, FalconConfig, Ftdi, Mode};
use palpate_host::device::maker::{self, Measured, Opened};
use palpate_host::device::palpation::RandomConfig;
use palpate_host::device::profile::Profile;
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::live::{self, LiveField};
use palpate_host::model::{self, TouchMemory};
use palpate_host::rt::{Clock, Controls, HapticLoop, LoopConfig, Outputs, TickRecord, VirtualClock};
use palpate_host::settings::controller_config;
use palpate_host::{Device, DeviceError, DeviceErrorKind};

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

/// The loop's side of a device behind a maker's library or service, and the proxy's exchange.
#[test]
fn exchanges_with_a_proxy_without_an_allocation() {
    let profile = Profile::bundled("touch").expect("bundled");
    let clock_ns = Arc::new(AtomicU64::new(0));
    let now_ns = clock_ns.clone();
    let (part, session) = maker::beside(&profile, Box::new(move || now_ns.load(Ordering::Relaxed)));
    let mut exchange = part(0.0);
    exchange.set_state(DeviceState::Homed);
    let opened = Opened { name: "a maker's".into(), max_force_n: 0.0, max_stiffness_n_m: 0.0 };
    let mut device = session(opened);
    device.set_armed(true);
    let mut felt_n = 0.0;
    assert_no_alloc(|| {
        for ms in 1..100_000_u64 {
            clock_ns.store(ms * 1_000_000, Ordering::Relaxed);
            felt_n += exchange.force_n(ms * 1_000_000)[0];
            exchange.publish(&Measured { t_ns: ms * 1_000_000, ..Measured::default() });
            let sample = device.exchange(1_000 * ms, [1.0, 0.0, 0.0]);
            assert!(matches!(sample, Ok(Some(_))) && !device.was_zeroed());
            let _ = device.reported_n();
            device.reset();
        }
    });
    assert!(felt_n > 99_000.0, "{felt_n}");
}

#[test]
fn a_million_ticks_without_an_allocation() {
    // Holes, branch jumps and every method.
    let blob = AlignedBytes::from(include_bytes!("../../firmware-like-core/golden/organ-514.blob"));
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    for method in Method::OF_LATTICE {
        // With the surface, and two alternating models.
        let mut memory = TouchMemory::default();
        let controllers = model::controllers(&[&organ, &organ], Config::new(method), &mut memory);
        let controllers = controllers.expect("has the method");
        // Both states of each queue: it fills up, and then every push fails.
        let (records, mut drained) = rtrb::RingBuffer::new(60_000);
        let (latest, mut newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
        let controls = Controls::default();
        let hand = SimulatedHand::new(&organ, SimulatedConfig::default());
        let clock = VirtualClock::default();
        let outputs = Outputs { records, latest };
        let config = LoopConfig::default();
        let haptic = HapticLoop::with_models(&controllers, hand, &clock, config, &controls, outputs);
        let (recording, mut recorded) = rtrb::RingBuffer::new(30_000);
        let mut haptic = haptic.with_recording(Some(recording));
        let mut engaged = 0;
        assert_no_alloc(|| {
            for index in 0..150_000_u64 {
                let deadline_ns = index * 1_000_000;
                clock.wait_until(deadline_ns, 0);
                if index % 997 == 0 {
                    controls.select((index / 997 % 2) as u8);
                }
                haptic.tick(index, 0, deadline_ns).expect("the simulated hand never fails");
                let record = newest.read();
                assert!(record.tick == index && record.phase == Phase::Active);
                engaged += u64::from(record.engaged.is_some());
            }
        });
        assert!(engaged > 50_000, "the strokes touch the organ by {method:?}: {engaged}");
        assert_eq!(core::iter::from_fn(|| drained.pop().ok()).count(), 60_000);
        assert_eq!(core::iter::from_fn(|| recorded.pop().ok()).count(), 30_000);
    }
}

/// A live session: jets arrive in some ticks and not in others, in more contacts than touch, and are recorded
/// until the queue is full; damaged frames are refused.
#[test]
fn jets_of_a_solver_without_an_allocation() {
    let blob = synthetic::organ(&synthetic::Shape { patch: 60, ..synthetic::Shape::default() });
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let mut memory = TouchMemory::default();
    let controllers = model::controllers(&[&organ], Config::live(), &mut memory).expect("no table is needed");
    let (mut solver, for_loop, _view) = live::local(100);
    let (recording, mut recorded) = rtrb::RingBuffer::new(5_000);
    let jets = LiveField::new(for_loop).expect("memory").with_recording(Some(recording));
    let random = Some(RandomConfig::new(3));
    let hand = SimulatedHand::new(&organ, SimulatedConfig { random, ..SimulatedConfig::default() });
    let (records, _drained) = rtrb::RingBuffer::new(1_000);
    let (latest, mut newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let (controls, clock, config) = (Controls::default(), VirtualClock::default(), LoopConfig::default());
    let outputs = Outputs { records, latest };
    let mut haptic = HapticLoop::live(controllers[0], jets, hand, &clock, config, &controls, outputs);
    let (mut forced, mut sequence, contacts) = (0, 0, organ.spaces.len() as u32);
    assert_no_alloc(|| {
        for index in 0..150_000_u64 {
            let deadline_ns = index * 1_000_000;
            clock.wait_until(deadline_ns, 0);
            // Silent for a while, and gone.
            if index % 20_000 < 19_000 {
                solver.heart().beat(deadline_ns);
            }
            let at = solver.hand();
            let contact = if sequence < contacts {
                sequence
            } else {
                u32::from(at.engaged[sequence as usize % 3].space)
            };
            let mut jet = fake_solver::jet(contact as u16, sequence, at.displacement_m);
            jet.energy_j = if sequence % 50 == 49 { f32::NAN } else { jet.energy_j };
            if index % 7 < 3 && solver.try_send(&jet) {
                sequence += 1;
            }
            if newest.read().phase != Phase::Active {
                controls.reset();
                controls.arm();
            }
            haptic.tick(index, 0, deadline_ns).expect("the simulated hand never fails");
            let record = newest.read();
            assert!(record.tick == index && vec3::is_finite(record.hand_force_n));
            forced += u64::from(record.hand_force_n != vec3::ZERO);
        }
    });
    assert!(forced > 20_000 && sequence > 50_000, "{forced} ticks with force, {sequence} jets");
    let hand = solver.hand();
    assert!(hand.refused >= sequence / 50 - 1 && hand.taken >= sequence - 1, "{hand:?}");
    assert_eq!(core::iter::from_fn(|| recorded.pop().ok()).count(), 5_000);
}

/// The kernel method has no lattice, so it has its own blob. The forces are arbitrary: faults are reset and
/// the controller armed again.
#[test]
fn a_kernel_without_an_allocation() {
    let blob = core_blobs::kernel::blob();
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let controller = Controller::new(&organ, Config::new(Method::Kernel)).expect("it has a kernel");
    let (node, mut state) = (&organ.spaces[0], State::new());
    let (mut engaged, mut forced) = (0, 0);
    assert_no_alloc(|| {
        for tick in 0..150_000_u64 {
            if state.phase() != Phase::Active {
                state.reset();
                state.arm();
            }
            // In and out, twice per second.
            let height_m = 0.003 + 0.006 * (tick as f32 * 4.0 * core::f32::consts::PI / 1e3).cos();
            let position_m =
                vec3::add(node.active.rest_position_m, vec3::scale(node.active.outward_normal, height_m));
            let t_us = 1_000 * tick;
            let command =
                controller.tick(&mut state, t_us, Some(&Sample { t_us, position_m, ..Sample::default() }));
            assert!(vec3::norm(command.hand_force_n) <= 8.0);
            engaged += u32::from(command.engaged.is_some());
            forced += u32::from(command.hand_force_n != vec3::ZERO);
        }
    });
    assert!(engaged > 30_000 && forced > 20_000, "{engaged}, {forced}");
}

/// The hand of `palpate run --profile falcon`: mechanism, delays, drags over a patch of active nodes.
#[test]
fn sliding_on_a_mechanism_without_an_allocation() {
    let blob = synthetic::organ(&synthetic::Shape { patch: 60, ..synthetic::Shape::default() });
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let profile = Profile::bundled("falcon").expect("bundled");
    let random = Some(RandomConfig::new(2));
    let hand =
        SimulatedHand::new(&organ, SimulatedConfig { random, ..SimulatedConfig::for_profile(&profile) });
    let config = controller_config(&[&organ], Method::Trilinear, &hand.info(), Some(&profile));
    let mut memory = TouchMemory::default();
    let controllers = model::controllers(&[&organ], config, &mut memory).expect("has the method");
    let (records, mut drained) = rtrb::RingBuffer::new(1_000);
    let (latest, mut newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let (controls, clock) = (Controls::default(), VirtualClock::default());
    let outputs = Outputs { records, latest };
    let mut haptic =
        HapticLoop::with_models(&controllers, hand, &clock, LoopConfig::default(), &controls, outputs);
    let (mut blended, mut moved, mut before) = (0_u64, 0_u64, TickRecord::EMPTY);
    assert_no_alloc(|| {
        for index in 0..150_000_u64 {
            let deadline_ns = index * 1_000_000;
            clock.wait_until(deadline_ns, 0);
            haptic.tick(index, 0, deadline_ns).expect("the simulated hand never fails");
            let record = *newest.read();
            assert!(record.tick == index && record.phase == Phase::Active);
            let answers =
                |record: &TickRecord| record.shares.iter().filter(|share| share.weight > 0.0).count();
            blended += u64::from(answers(&record) > 1);
            moved +=
                u64::from(answers(&record) > 1 && answers(&before) > 1 && record.shares != before.shares);
            before = record;
        }
    });
    assert!(blended > 20_000 && moved > 1_000, "{blended} ticks of several nodes, {moved} of them sliding");
    assert_eq!(core::iter::from_fn(|| drained.pop().ok()).count(), 1_000);
}

/// A chip whose device is homed after its first reply and whose grip moves back and forth. It replies to
/// every request and stores no history.
#[derive(Default)]
struct Echo {
    requested: AtomicU32,
    answered: AtomicU32,
}

/// A grip that moves by one count per reply, slower than a hand.
fn encoders(reply: u32) -> [i16; 3] {
    let middle = Kinematics::default().counts([0.0, 0.0, 0.12]).expect("within reach");
    let away = (reply % 400).abs_diff(200) as i16;
    middle.map(|count| count + away)
}

impl Ftdi for Echo {
    fn control(&self, _request: u8, _value: u16) -> Result<(), DeviceError> {
        Ok(())
    }

    fn write(&self, bytes: &[u8], _timeout: Duration) -> Result<usize, DeviceError> {
        self.requested.fetch_add(1, Ordering::Relaxed);
        Ok(bytes.len())
    }

    fn read(&self, buffer: &mut [u8], _timeout: Duration) -> Result<usize, DeviceError> {
        let reply = self.answered.load(Ordering::Relaxed);
        if reply == self.requested.load(Ordering::Relaxed) {
            return Err(DeviceError::new(DeviceErrorKind::Timeout));
        }
        self.answered.store(reply + 1, Ordering::Relaxed);
        let homed = if reply == 0 { 0 } else { ALL_HOMED };
        let reply = Reply { encoders: encoders(reply), homed, ..Reply::default() };
        buffer[..2].copy_from_slice(&[0x01, 0x60]);
        buffer[2..18].copy_from_slice(&reply.encode());
        Ok(18)
    }
}

#[test]
fn a_falcon_exchange_without_an_allocation() {
    let config = FalconConfig { mode: Mode::Polled, ..FalconConfig::default() };
    let mut falcon = Falcon::start(Arc::new(Echo::default()), config, None).expect("it answers");
    let mut samples = 0;
    assert_no_alloc(|| {
        for tick in 0..200_000_u64 {
            let force_n = [0.5, -1.0, (tick % 100) as f32 * 0.05];
            let sample = falcon.exchange(tick * 1_000, force_n).expect("a link");
            samples += u32::from(sample.is_some());
        }
    });
    assert!(samples > 199_000, "{samples}");
}

/// Run by the next test in a separate process, because the trap ends the process.
#[test]
#[ignore = "started by allocation_in_the_tick_ends_the_process, ends its process"]
fn injected_allocation() {
    let grown = assert_no_alloc(|| vec![1_u8; 64]);
    assert_eq!(grown.len(), 64);
}

#[test]
fn allocation_in_the_tick_ends_the_process() {
    let this = std::env::current_exe().expect("a test has a file");
    let status = std::process::Command::new(this)
        .args(["--ignored", "--exact", "no_allocation::injected_allocation"])
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .status()
        .expect("it starts");
    assert!(!status.success(), "an allocation inside the trap must not pass");
}
