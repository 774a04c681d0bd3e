//! Hand, device and controller as a closed loop in virtual time. Included by path, also by the tests across
//! the crates.
#![allow(dead_code)]

use palpate_core::{Config, Method, Organ, Phase, State, vec3};
use palpate_host::Device;
use palpate_host::device::hand::HandConfig;
use palpate_host::device::palpation::{Palpation, RandomConfig};
use palpate_host::device::profile::Profile;
use palpate_host::device::script::Script;
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand, Work};
use palpate_host::model::{TouchMemory, controllers};
use palpate_host::settings::controller_config;
use std::collections::VecDeque;

/// Whether the profile's stiffness cap applies. Everything else is unchanged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Cap {
    On,
    Off,
}

/// The controller's settings of `palpate run` for a hand on the device of a profile.
pub(crate) fn config(
    organ: &Organ<'_>,
    method: Method,
    (hand, profile): (&SimulatedHand, &Profile),
    cap: Cap,
) -> Config {
    let mut config = controller_config(&[organ], method, &hand.info(), Some(profile));
    if cap == Cap::Off {
        // A finite value that is never reached.
        config.limits.max_stiffness_n_m = 1e9;
        // The energy guard would damp most of the oscillation; another test covers the guard alone.
        config.passivity.max_damping_n_s_m = 0.0;
        config.passivity.fault_j = f32::INFINITY;
        // A fade must not catch the tool that an unstable loop throws off.
        config.limits.fade_s = 0.0;
    }
    config
}

/// The same device without Coulomb friction, which would stop small oscillations.
pub(crate) fn frictionless(profile: &Profile) -> Profile {
    let mut smooth = profile.clone();
    smooth.mechanism.coulomb_n = None;
    smooth.assumed.coulomb_n = 0.0;
    smooth
}

/// A hand resting on the handle: 4.4 N s/m, about the lightest whole-hand grip, without compensation and
/// tremor.
pub(crate) const RELAXED: HandConfig =
    HandConfig { mass_kg: 0.1, stiffness_n_m: 300.0, damping_ratio: 0.4, ..HandConfig::LIGHT };

/// Result of a press, a hold and a release.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HoldResult {
    /// Largest stiffness of the organ at the hand without a cap, N/m.
    pub(crate) stiffest_n_m: f32,
    /// Factor on the forces.
    pub(crate) share: f32,
    /// Peak-to-peak position of the hand in the device frame in the last second of the hold (or before a
    /// fault), m.
    pub(crate) peak_to_peak_m: f32,
    /// Energy that the device gave to the hand in that second, J.
    pub(crate) hold_j: f64,
    /// Energy over the whole cycle, from free to free, J.
    pub(crate) cycle_j: f64,
    /// Largest force for the hand, N.
    pub(crate) peak_n: f32,
    /// Phase at the end.
    pub(crate) phase: Phase,
}

const HOLD_S: f32 = 4.0;

/// A disturbance by the motors: an oscillation that continues after it is self-excited.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Disturbance {
    /// 3 N for 10 ms, one second into the hold.
    Once,
    Never,
}

const DISTURBANCE_N: f32 = 3.0;
const DISTURBANCE_S: core::ops::Range<f32> = 2.0..2.01;

/// A hand on the device of a profile presses a node of an organ, is optionally disturbed, holds still, and
/// releases.
pub(crate) fn hold(
    organ: &Organ<'_>,
    method: Method,
    space: usize,
    depth_m: f32,
    (hand, profile): (HandConfig, &Profile),
    cap: Cap,
    disturbance: Disturbance,
) -> HoldResult {
    let node = &organ.spaces[space];
    let script =
        Script::press_and_hold(node.active.rest_position_m, node.active.outward_normal, depth_m, HOLD_S);
    let simulated = SimulatedConfig { hand, ..SimulatedConfig::for_profile(profile) };
    let mut hand = SimulatedHand::with_palpation(Palpation::Tour(script), simulated);
    let mut memory = TouchMemory::default();
    let controllers = controllers(&[organ], config(organ, method, (&hand, profile), cap), &mut memory);
    let controller = controllers.expect("has the method")[0];
    let period_us = u64::from(profile.period_us());
    let ticks = |seconds: f32| (seconds * 1e6) as u64 / period_us;
    let last_second = ticks(HOLD_S)..ticks(1.0 + HOLD_S);
    let mut held = HoldResult {
        stiffest_n_m: controller.stiffest_n_m() * profile.workspace.scale,
        share: controller.hand_scale(),
        peak_to_peak_m: 0.0,
        hold_j: 0.0,
        cycle_j: 0.0,
        peak_n: 0.0,
        phase: Phase::Active,
    };
    let (mut state, mut force_n) = (State::new(), vec3::ZERO);
    state.arm();
    let mut recent = Vec::new();
    let disturbed = ticks(DISTURBANCE_S.start)..ticks(DISTURBANCE_S.end);
    let disturbance_n = vec3::scale(
        node.active.outward_normal,
        if disturbance == Disturbance::Once { DISTURBANCE_N } else { 0.0 },
    );
    let mut work_before = Work::default();
    for tick in 0..ticks(3.0 + HOLD_S) {
        let now_us = tick * period_us;
        let applied_n = if disturbed.contains(&tick) { vec3::add(force_n, disturbance_n) } else { force_n };
        let sample = hand.exchange(now_us, applied_n).expect("never fails").expect("always samples");
        let command = controller.tick(&mut state, now_us, Some(&sample));
        force_n = command.hand_force_n;
        assert!(vec3::is_finite(force_n) && vec3::is_finite(hand.device_position_m()), "tick {tick}");
        held.peak_n = held.peak_n.max(vec3::norm(force_n));
        held.phase = command.phase;
        if tick < last_second.end {
            recent.push(hand.device_position_m());
        }
        if tick == last_second.start {
            work_before = hand.work();
        }
        if tick + 1 == last_second.end {
            held.hold_j = hand.work().device_j() - work_before.device_j();
        }
        if command.phase != Phase::Active {
            break;
        }
    }
    held.cycle_j = hand.work().device_j();
    let last = &recent[recent.len().saturating_sub(ticks(1.0) as usize)..];
    for axis in 0..3 {
        let along = || last.iter().map(|position_m| position_m[axis]);
        let range_m = along().fold(f32::MIN, f32::max) - along().fold(f32::MAX, f32::min);
        held.peak_to_peak_m = held.peak_to_peak_m.max(range_m);
    }
    held
}

/// Largest energy that a device with delay and quantisation may give to the hand in one contact, J: a tenth
/// of that of an oscillation, and less than is needed to lift a hand by 3 mm.
pub(crate) const MAX_GIVEN_J: f64 = 5e-3;

/// Result of random palpation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PalpationResult {
    /// Number of contacts.
    pub(crate) contacts: u64,
    /// Ticks in contact.
    pub(crate) engaged_ticks: u64,
    /// Largest force for the hand, N.
    pub(crate) peak_n: f32,
    /// Ticks with several engaged nodes.
    pub(crate) blended_ticks: u64,
    /// Ticks in which the energy guard added damping.
    pub(crate) damped_ticks: u64,
    /// Largest energy that the device gave to the hand in one contact, J.
    pub(crate) max_given_j: f64,
    /// Largest energy of its motors alone in one contact, J.
    pub(crate) max_from_motors_j: f64,
    /// Largest difference, in a contact, between the work counted by the guard and that of the motors, J.
    pub(crate) guard_error_j: f64,
    /// Phase at the end.
    pub(crate) phase: Phase,
    /// Final position of the hand, bit for bit.
    pub(crate) position_bits: [u32; 3],
}

/// A hand on the device of a profile palpates at random.
pub(crate) fn palpate(
    organ: &Organ<'_>,
    method: Method,
    (hand, profile): (HandConfig, &Profile),
    (seed, seconds): (u64, f32),
    cap: Cap,
) -> PalpationResult {
    let random = Some(RandomConfig::new(seed));
    let simulated = SimulatedConfig { hand, random, ..SimulatedConfig::for_profile(profile) };
    let mut hand = SimulatedHand::new(organ, simulated);
    let mut memory = TouchMemory::default();
    let controllers = controllers(&[organ], config(organ, method, (&hand, profile), cap), &mut memory);
    let controller = controllers.expect("has the method")[0];
    let period_us = u64::from(profile.period_us());
    let mut found = PalpationResult {
        contacts: 0,
        engaged_ticks: 0,
        peak_n: 0.0,
        blended_ticks: 0,
        damped_ticks: 0,
        max_given_j: f64::MIN,
        max_from_motors_j: f64::MIN,
        guard_error_j: 0.0,
        phase: Phase::Active,
        position_bits: [0; 3],
    };
    let (mut state, mut force_n) = (State::new(), vec3::ZERO);
    state.arm();
    // The guard's count is for the time of the samples, which is earlier by the link's delay.
    let delay_ticks = f64::from(profile.position_delay_us) / period_us as f64;
    let mut motors_j: VecDeque<f64> = [0.0; 16].into();
    let (mut engaged, mut at_touch, mut guard_at_touch_j) = (false, [0.0; 3], 0.0);
    for tick in 0..(seconds * 1e6) as u64 / period_us {
        let now_us = tick * period_us;
        let sample = hand.exchange(now_us, force_n).expect("never fails").expect("always samples");
        let command = controller.tick(&mut state, now_us, Some(&sample));
        force_n = command.hand_force_n;
        assert!(vec3::is_finite(force_n) && vec3::is_finite(hand.device_position_m()), "tick {tick}");
        found.peak_n = found.peak_n.max(vec3::norm(force_n));
        motors_j.rotate_right(1);
        motors_j[0] = hand.work().motors_j;
        let (whole, part) = (delay_ticks as usize, delay_ticks.fract());
        let delayed_j = (1.0 - part) * motors_j[whole] + part * motors_j[whole + 1];
        let now_j = [hand.work().device_j(), hand.work().motors_j, delayed_j];
        let [device_j, from_motors_j, of_guard_j] = [0, 1, 2].map(|i| now_j[i] - at_touch[i]);
        match (engaged, command.engaged.is_some()) {
            (false, true) => {
                (at_touch, guard_at_touch_j) = (now_j, f64::from(command.hand_work_j));
                found.contacts += 1;
            }
            (true, false) => {
                found.max_given_j = found.max_given_j.max(device_j);
                found.max_from_motors_j = found.max_from_motors_j.max(from_motors_j);
            }
            (true, true) => {
                let counted_j = f64::from(command.hand_work_j) - guard_at_touch_j;
                found.guard_error_j = found.guard_error_j.max((counted_j - of_guard_j).abs());
            }
            (false, false) => {}
        }
        found.damped_ticks += u64::from(command.damped);
        found.blended_ticks +=
            u64::from(command.weights.iter().filter(|share| share.weight > 0.0).count() > 1);
        engaged = command.engaged.is_some();
        found.engaged_ticks += u64::from(engaged);
        found.phase = command.phase;
        if command.phase != Phase::Active {
            break;
        }
    }
    found.position_bits = hand.device_position_m().map(f32::to_bits);
    found
}
