//! A hand of two fingers holds an emulated device against a wall or an organ, and the device is knocked once.
//!
//! The organ is made stiffer by a gain g: its force, and every limit and margin of the controller, are multiplied
//! by g, as if all constants of the material were. So K = g k, with the stiffness k that the hand feels at rest.

use palpate_core::{Config, Controller, Method, Organ, Phase, Sample, State, vec3};
use palpate_host::device::hand::{Hand, HandConfig};
use palpate_host::device::impedance::{Impedance, ImpedanceConfig};
use palpate_host::device::profile::Profile;

use crate::cmd::bench::public::jets::Jets;
use crate::cmd::bench::public::organs::Ready;
use crate::failure::Failure;

/// Force of the hold, N.
const PRELOAD_N: f32 = 1.0;
/// Height at which the hand begins, m.
const START_M: f32 = 3e-3;
/// Times of the approach and of the rest before the knock, s.
const APPROACH_S: f32 = 0.4;
const REST_S: f32 = 0.4;
/// Observed seconds after the knock; the energy is that of the first one. The guard takes up to two to stop a limit
/// cycle.
const SECONDS: usize = 3;
/// End of each second in which the motion is observed, s.
const WINDOW_S: f32 = 0.25;
/// The knock, N and s.
const KNOCK_N: f32 = 0.5;
const KNOCK_S: f32 = 0.005;
/// Integration step of hand and mechanism, s.
const STEP_S: f32 = 5e-5;
/// Encoder steps within which a hand counts as still, and the same without an encoder, m.
const STILL_STEPS: f32 = 3.0;
const STILL_M: f32 = 20e-6;
/// Largest share of the motion of the last second but one in the last one, if it decays. A limit cycle keeps its own.
const DECAYED: f32 = 0.8;
/// Energy that the device may give to the hand while it holds, J: the margin of the controller's energy guard.
const GIVEN_J: f64 = 5e-3;
/// Time before the first tick, us, so that no sample has a negative time.
const EPOCH_US: u64 = 1_000_000;

/// What computes the force at the wall.
#[derive(Debug, Clone, Copy)]
pub(super) enum Renderer<'r> {
    /// F = K x, without a controller.
    Wall,
    /// An organ by a method in the controller, with or without its energy guard.
    Organ { organ: &'r Organ<'r>, method: Method, guard: bool },
    /// The organ by the jets of a live solver beside the loop, in the controller without its energy guard.
    Live { ready: &'r Ready, organ: &'r Organ<'r> },
}

/// Result of a hold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hold {
    /// Peak-to-peak motion at the end of each second after the knock, m; zero after the hold is decided.
    pub(super) motion_m: [f32; SECONDS],
    /// Net energy that the device gave to the hand in the first second after the knock, J.
    pub(super) given_j: f64,
    /// Whether the controller was active to the end.
    pub(super) active: bool,
    /// Largest force of the motors, N.
    pub(super) peak_n: f32,
}

impl Hold {
    /// The device gave little energy, and the controller did not latch a fault. The hand may tremble.
    fn gives_little(&self) -> bool {
        self.active && self.given_j <= GIVEN_J
    }

    /// The device gave little energy, and no oscillation remains.
    pub(super) fn is_still(&self, quantum_m: f32) -> bool {
        let [first_m, before_m, last_m] = self.motion_m;
        let still_m = (STILL_STEPS * quantum_m).max(STILL_M);
        self.gives_little() && (first_m <= still_m || last_m <= still_m || last_m < DECAYED * before_m)
    }
}

/// Stiffness of an organ by a method at rest along the outward normal, N/m.
fn rest_stiffness_n_m(organ: &Organ<'_>, method: Method) -> Result<f64, Failure> {
    const DEPTH_M: f32 = 1e-4;
    let space = organ.spaces.first().ok_or_else(|| Failure::work("the blob has no active node"))?;
    let normal = space.active.outward_normal;
    let force = space.force(method, vec3::scale(normal, -DEPTH_M));
    let force = force.ok_or_else(|| Failure::work(format!("the blob has no table for {}", method.name())))?;
    Ok(f64::from(-vec3::dot(force.force_n, normal) / DEPTH_M))
}

/// The force along the outward normal, from the height of the tool.
enum Loop<'r, 's> {
    Wall { stiffness_n_m: f32 },
    Controlled { controlled: Box<Controlled<'r>>, jets: Option<Jets<'s>> },
}

struct Controlled<'r> {
    controller: Controller<'r, 'r>,
    state: State,
    gain: f32,
    rest_m: [f32; 3],
    normal: [f32; 3],
}

impl<'r> Controlled<'r> {
    fn new(
        organ: &'r Organ<'r>,
        method: Method,
        guard: bool,
        stiffness_n_m: f32,
        profile: &Profile,
    ) -> Result<Self, Failure> {
        let gain = stiffness_n_m / rest_stiffness_n_m(organ, method)? as f32;
        let mut config = Config::new(method);
        let quantum_m = profile.mechanism.encoder_quantum_m.unwrap_or(0.0);
        let (limits, passivity) = (&mut config.limits, &mut config.passivity);
        limits.max_force_n = profile.max_force_n / gain;
        limits.max_slew_n_per_s /= gain;
        limits.ramp_s = 0.0;
        // The cap is what a session sets from the figures that are measured here. A finite value that is never
        // reached.
        limits.max_stiffness_n_m = 1e9;
        config.contact.release_tension_n /= gain;
        passivity.margin_j /= gain;
        passivity.fault_j /= gain;
        passivity.max_damping_n_s_m /= gain;
        passivity.force_delay_us = profile.force_delay_us;
        passivity.position_step_m = passivity.position_step_m.max(quantum_m);
        config.contact.release_height_m = config.contact.release_height_m.max(4.0 * quantum_m);
        config.contact.grasp_button = 0;
        if !guard {
            passivity.max_damping_n_s_m = 0.0;
            passivity.fault_j = f32::INFINITY;
        }
        let controller = Controller::new(organ, config).map_err(Failure::work)?;
        let active = &organ.spaces[0].active;
        let mut state = State::new();
        state.arm();
        let (rest_m, normal) = (active.rest_position_m, active.outward_normal);
        Ok(Self { controller, state, gain, rest_m, normal })
    }
}

impl Loop<'_, '_> {
    /// Force along the outward normal, and whether the controller is active.
    fn force_n(&mut self, now_us: u64, taken_us: u64, height_m: f32) -> (f32, bool) {
        match self {
            Self::Wall { stiffness_n_m } => (*stiffness_n_m * (-height_m).max(0.0), true),
            Self::Controlled { controlled, jets } => {
                let Controlled { controller, state, gain, rest_m, normal } = &mut **controlled;
                let position_m = vec3::add(*rest_m, vec3::scale(*normal, height_m));
                let sample = Sample { t_us: taken_us, position_m, ..Sample::default() };
                let command = match jets {
                    Some(jets) => controller.tick_on(state, now_us, Some(&sample), jets),
                    None => controller.tick(state, now_us, Some(&sample)),
                };
                (*gain * vec3::dot(command.hand_force_n, *normal), command.phase == Phase::Active)
            }
        }
    }
}

/// Presses, holds and knocks a device, at the rate of its profile, and observes it for some seconds.
pub(super) fn hold(renderer: Renderer<'_>, stiffness_n_m: f64, profile: &Profile) -> Result<Hold, Failure> {
    let stiffness_n_m = stiffness_n_m as f32;
    let mut live = match renderer {
        Renderer::Live { ready, .. } => Some(ready.live()?),
        Renderer::Wall | Renderer::Organ { .. } => None,
    };
    let period_s = 1e-6 * f64::from(profile.period_us());
    let jets = live.as_mut().map(|(solver, contact)| Jets::new(solver, *contact, period_s));
    let mut loop_ = match renderer {
        Renderer::Wall => Loop::Wall { stiffness_n_m },
        Renderer::Organ { organ, .. } | Renderer::Live { organ, .. } => {
            let (method, guard) = match renderer {
                Renderer::Organ { method, guard, .. } => (method, guard),
                _ => (Method::Energy, false),
            };
            let controlled = Controlled::new(organ, method, guard, stiffness_n_m, profile)?;
            Loop::Controlled { controlled: Box::new(controlled), jets }
        }
    };
    let mechanism = ImpedanceConfig::of(profile);
    let mut hand = Hand::new(HandConfig::LIGHT, [START_M, 0.0, 0.0]);
    let mut device = Impedance::new(mechanism, hand.position_m(), STEP_S);
    let deep_m = -PRELOAD_N / stiffness_n_m - PRELOAD_N / HandConfig::LIGHT.stiffness_n_m;
    let target = |t_s: f32| {
        let share = (t_s / APPROACH_S).min(1.0);
        [START_M + (deep_m - START_M) * share * share * (3.0 - 2.0 * share), 0.0, 0.0]
    };
    let period_us = u64::from(profile.period_us());
    let steps_per_tick = (period_us as f32 * 1e-6 / STEP_S).round().max(1.0) as u64;
    let knocked_s = APPROACH_S + REST_S;
    let observed_s = knocked_s + KNOCK_S;
    let ticks = ((observed_s + SECONDS as f32) * 1e6) as u64 / period_us;
    let ticks_of_energy = ((observed_s + 1.0) * 1e6) as u64 / period_us;
    let still_m = (STILL_STEPS * mechanism.encoder_quantum_m).max(STILL_M);
    let mut result = Hold { motion_m: [0.0; SECONDS], given_j: 0.0, active: true, peak_n: 0.0 };
    let mut ranges = [(f32::MAX, f32::MIN); SECONDS];
    let mut command_n = 0.0;
    for tick in 0..ticks {
        // The device gets the force of the tick before, as in a session.
        device.command([command_n, 0.0, 0.0]);
        for step in 0..steps_per_tick {
            let t_s = (tick * steps_per_tick + step) as f32 * STEP_S;
            let motor_n = device.motor_n();
            let is_knocked = (knocked_s..observed_s).contains(&t_s);
            let total_n = [motor_n[0] + if is_knocked { KNOCK_N } else { 0.0 }, 0.0, 0.0];
            let before_m = hand.position_m()[0];
            let drag_j = hand.integrate(target(t_s), target(t_s + STEP_S), total_n, &mechanism.drag, STEP_S);
            device.record(hand.position_m(), 0);
            if t_s >= observed_s {
                let x = hand.position_m()[0];
                result.peak_n = result.peak_n.max(motor_n[0].abs());
                if tick < ticks_of_energy {
                    result.given_j += f64::from(motor_n[0] * (x - before_m)) - f64::from(drag_j);
                }
                let since_s = t_s - observed_s;
                if since_s.fract() >= 1.0 - WINDOW_S
                    && let Some(range) = ranges.get_mut(since_s as usize)
                {
                    *range = (range.0.min(x), range.1.max(x));
                }
            }
        }
        let now_us = EPOCH_US + (tick + 1) * period_us;
        let reading_m = device.reading(vec3::ZERO).0[0];
        let (force_n, active) =
            loop_.force_n(now_us, now_us - u64::from(profile.position_delay_us), reading_m);
        command_n = force_n;
        result.active &= active;
        result.motion_m = ranges.map(|(low, high)| (high - low).max(0.0));
        if tick >= ticks_of_energy && (!result.gives_little() || result.motion_m[0] <= still_m) {
            break;
        }
    }
    Ok(result)
}

#[cfg(test)]
mod tests {
    use palpate_host::device::profile::Damping;

    use super::*;

    /// A profile without Coulomb friction, which would stop small oscillations.
    fn smooth(name: &str, rate_hz: u32) -> Profile {
        let mut profile = Profile::bundled(name).expect("bundled").at_period(1_000_000 / rate_hz);
        (profile.mechanism.coulomb_n, profile.assumed.coulomb_n) = (None, 0.0);
        profile
    }

    #[test]
    fn a_soft_wall_holds_still_and_a_stiff_one_shakes_the_hand() {
        for name in ["omega", "falcon"] {
            let profile = smooth(name, 1000);
            let quantum_m = profile.mechanism.encoder_quantum_m.expect("an encoder");
            let soft = hold(Renderer::Wall, 300.0, &profile).expect("no controller to refuse");
            assert!(soft.is_still(quantum_m), "{name}: {soft:?}");
            assert!((soft.peak_n - PRELOAD_N).abs() < 0.4, "{name}: held with {} N", soft.peak_n);
            let stiff = hold(Renderer::Wall, 20_000.0, &profile).expect("no controller to refuse");
            assert!(!stiff.is_still(quantum_m) && stiff.motion_m[0] > 5.0 * quantum_m, "{name}: {stiff:?}");
        }
    }

    #[test]
    fn a_limit_cycle_is_no_stillness_and_a_slow_decay_is() {
        let is_still = |motion_um: [f32; 3]| {
            let motion_m = motion_um.map(|um| 1e-6 * um);
            Hold { motion_m, given_j: 1e-3, active: true, peak_n: 2.7 }.is_still(10e-6)
        };
        // What the guard leaves of 1,100 um on an omega.3 at 1 kHz and 3,570 N/m.
        assert!(!is_still([780.0, 756.0, 744.0]) && !is_still([31.0, 31.0, 31.0]));
        // It stops 330 um at 2 kHz in the second second; without friction a soft wall decays slowly.
        assert!(is_still([333.0, 0.0, 0.0]) && is_still([700.0, 500.0, 390.0]));
        assert!(is_still([29.0, 0.0, 0.0]));
    }

    #[test]
    fn a_faster_loop_and_more_damping_allow_a_stiffer_wall() {
        let is_still = |rate_hz, damping: f32, stiffness| {
            let mut profile = smooth("omega", rate_hz);
            profile.mechanism.damping = Some(Damping { n_s_m: damping, measured: true });
            hold(Renderer::Wall, stiffness, &profile).expect("no controller to refuse").is_still(10e-6)
        };
        assert!(is_still(500, 1.0, 600.0) && !is_still(500, 1.0, 3_000.0));
        assert!(is_still(4000, 1.0, 2_500.0) && is_still(500, 4.0, 2_500.0));
    }
}
