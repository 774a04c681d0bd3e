//! A simulated hand on a device: what `palpate demo` holds, and what the tests drive.
//!
//! The hand follows a [`Palpation`]; the force of the controller acts on it, so the loop is closed as with a real arm: a soft organ
//! yields, a stiff one stops the hand. Without a mechanism the device is ideal: no mass, no delay, only an encoder. With one it is the
//! device of a [`Profile`].

use super::hand::{Drag, Hand, HandConfig};
use super::impedance::{Counting, Impedance, ImpedanceConfig, counted};
use super::palpation::{Palpation, RandomConfig, RandomPalpation};
use super::profile::Profile;
use super::script::{Script, StrokeConfig};
use super::workspace::Workspace;
use super::{Device, DeviceError, DeviceInfo};
use palpate_core::{Organ, Sample, Vec3, vec3};

/// The hand and its device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedConfig {
    /// The hand.
    pub hand: HandConfig,
    /// Time that one exchange stands for, us.
    pub step_us: u32,
    /// Integration steps an exchange.
    pub substeps: u32,
    /// Step of the position encoder of an ideal device, m.
    pub quantum_m: f32,
    /// The mechanism; `None` is an ideal device in the model's own frame.
    pub mechanism: Option<SimulatedMechanism>,
    /// The strokes of the tour.
    pub strokes: StrokeConfig,
    /// Palpation at random instead of the tour.
    pub random: Option<RandomConfig>,
}

impl Default for SimulatedConfig {
    fn default() -> Self {
        Self {
            hand: HandConfig::default(),
            step_us: 1_000,
            substeps: 10,
            quantum_m: 30.0e-6,
            mechanism: None,
            strokes: StrokeConfig::default(),
            random: None,
        }
    }
}

impl SimulatedConfig {
    /// The usual hand on the device of a profile.
    #[must_use]
    pub fn on(profile: &Profile) -> Self {
        Self {
            step_us: profile.period_us(),
            // 50 us at 1 kHz: delays are rounded to it.
            substeps: 20,
            mechanism: Some(SimulatedMechanism::of(profile)),
            ..Self::default()
        }
    }
}

/// A mechanism and where it is in the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedMechanism {
    /// What it is like.
    pub impedance: ImpedanceConfig,
    /// Where its workspace lies in the model.
    pub workspace: Workspace,
    /// Largest stiffness of the model that it renders, N/m.
    pub max_stiffness_n_m: f32,
}

impl SimulatedMechanism {
    /// That of a profile.
    #[must_use]
    pub fn of(profile: &Profile) -> Self {
        Self {
            impedance: ImpedanceConfig::of(profile),
            workspace: profile.workspace,
            max_stiffness_n_m: profile.max_model_stiffness_n_m(),
        }
    }
}

/// The energy that went through the handle, J. Positive goes to the hand.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Work {
    /// From the motors.
    pub motors_j: f64,
    /// From damping and friction of the mechanism, never positive.
    pub drag_j: f64,
}

impl Work {
    /// From the device as a whole.
    #[must_use]
    pub fn of_device_j(&self) -> f64 {
        self.motors_j + self.drag_j
    }
}

/// The simulated hand. A function of (organ, configuration, forces): every exchange is one step, whatever the clock.
///
/// It does not follow `now_us`: a stalled computer stops this hand's time instead of letting it jump, and a run can be repeated
/// bit for bit.
#[derive(Debug, Clone)]
pub struct SimulatedHand {
    config: SimulatedConfig,
    palpation: Palpation,
    hand: Hand,
    mechanism: Option<Impedance>,
    /// What an ideal device holds until the next force comes.
    held_n: Vec3,
    work: Work,
    step: u64,
}

impl SimulatedHand {
    /// A hand over the first active node, about to press.
    #[must_use]
    pub fn new<const N: usize>(organ: &Organ<'_, N>, config: SimulatedConfig) -> Self {
        let palpation = match config.random {
            Some(random) => Palpation::Random(RandomPalpation::new(organ, random)),
            None => Palpation::Tour(Script::new(organ, &config.strokes)),
        };
        Self::with_palpation(palpation, config)
    }

    /// A hand that does as it is told.
    #[must_use]
    pub fn with_palpation(palpation: Palpation, config: SimulatedConfig) -> Self {
        let mut wanted_m = palpation.target_m();
        let mechanism = config.mechanism.map(|SimulatedMechanism { impedance, workspace, .. }| {
            let middle_m = workspace.device_origin_m;
            let from_middle_m =
                impedance.reach.nearest_m(vec3::sub(workspace.to_device_m(wanted_m), middle_m));
            wanted_m = vec3::add(middle_m, from_middle_m);
            let step_s = config.step_us as f32 * 1e-6 / config.substeps.max(1) as f32;
            Impedance::new(impedance, from_middle_m, step_s)
        });
        Self {
            hand: Hand::new(config.hand, wanted_m),
            palpation,
            mechanism,
            held_n: vec3::ZERO,
            config,
            work: Work::default(),
            step: 0,
        }
    }

    /// True position of the hand in the model, before tremor and encoder.
    #[must_use]
    pub fn position_m(&self) -> Vec3 {
        self.frame().map_or(self.hand.position_m(), |frame| frame.to_model_m(self.hand.position_m()))
    }

    /// True position of the hand in the device's frame; that of the model, where the device is ideal.
    #[must_use]
    pub const fn device_position_m(&self) -> Vec3 {
        self.hand.position_m()
    }

    /// Energy that went through the handle since the beginning.
    #[must_use]
    pub const fn work(&self) -> Work {
        self.work
    }

    fn frame(&self) -> Option<Workspace> {
        self.config.mechanism.map(|mechanism| mechanism.workspace)
    }

    /// Moves the hand on by one step under the force that was sent before it.
    fn integrate(&mut self) {
        let SimulatedConfig { substeps, step_us, .. } = self.config;
        let dt_s = step_us as f32 * 1e-6 / substeps.max(1) as f32;
        let frame = self.frame();
        let wanted_m = |palpation: &Palpation| match frame {
            Some(frame) => frame.to_device_m(palpation.target_m()),
            None => palpation.target_m(),
        };
        for _ in 0..substeps.max(1) {
            let from_m = wanted_m(&self.palpation);
            self.palpation.advance(dt_s);
            let to_m = wanted_m(&self.palpation);
            let (given_n, drag) = match &mut self.mechanism {
                Some(mechanism) => (mechanism.motor_n(), mechanism.config().drag),
                None => (self.held_n, Drag::default()),
            };
            let before_m = self.hand.position_m();
            let taken_j = self.hand.push(from_m, to_m, given_n, &drag, dt_s);
            let moved_m = vec3::sub(self.hand.position_m(), before_m);
            self.work.motors_j += f64::from(vec3::dot(given_n, moved_m));
            self.work.drag_j -= f64::from(taken_j);
            if let (Some(mechanism), Some(frame)) = (&mut self.mechanism, frame) {
                let from_middle_m = vec3::sub(self.hand.position_m(), frame.device_origin_m);
                let held_m = mechanism.config().reach.nearest_m(from_middle_m);
                if held_m != from_middle_m {
                    self.hand.stop_at(vec3::add(frame.device_origin_m, held_m));
                }
                mechanism.note(held_m, self.palpation.buttons());
            }
        }
    }
}

impl Device for SimulatedHand {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.integrate();
        // The loop sends a force with the exchange after the tick that found it: this one acts from now on, not during the step
        // that led here.
        self.held_n = hand_force_n;
        self.step += 1;
        let time_s = self.step as f64 * f64::from(self.config.step_us) * 1e-6;
        let tremor_m = self.hand.tremor_m(time_s);
        let (Some(mechanism), Some(frame)) = (&mut self.mechanism, self.config.mechanism) else {
            let seen_m = vec3::add(self.hand.position_m(), tremor_m);
            let position_m = counted(seen_m, self.config.quantum_m, Counting::Round);
            return Ok(Some(Sample { t_us: now_us, position_m, buttons: self.palpation.buttons() }));
        };
        let workspace = frame.workspace;
        mechanism.command(workspace.to_device_n(hand_force_n));
        let (from_middle_m, buttons) = mechanism.reading(tremor_m);
        let position_m = workspace.to_model_m(vec3::add(workspace.device_origin_m, from_middle_m));
        let t_us = now_us.saturating_sub(u64::from(mechanism.config().position_delay_us));
        Ok(Some(Sample { t_us, position_m, buttons }))
    }

    fn stop(&mut self) {
        // Nothing drives this hand but its own spring: without a force it just goes on.
        if let Some(mechanism) = &mut self.mechanism {
            mechanism.command(vec3::ZERO);
        }
    }

    fn info(&self) -> DeviceInfo {
        let palpation = match self.config.random {
            Some(random) => format!("palpating at random, seed {}", random.seed),
            None => format!("seed {}", self.config.hand.seed),
        };
        let ideal = DeviceInfo {
            name: format!("simulated hand ({palpation})"),
            self_arming: true,
            max_force_n: f32::INFINITY,
            max_stiffness_n_m: f32::INFINITY,
            resolution_m: self.config.quantum_m,
        };
        match self.config.mechanism {
            None => ideal,
            Some(SimulatedMechanism { impedance, workspace, max_stiffness_n_m }) => DeviceInfo {
                name: format!("simulated hand and mechanism ({palpation})"),
                max_force_n: impedance.max_force_n,
                max_stiffness_n_m,
                resolution_m: impedance.encoder_quantum_m * workspace.scale,
                ..ideal
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;
    use palpate_core::{Config, Controller, Method, State};

    fn run(config: SimulatedConfig, stiffness_n_m: f32, steps: u64) -> Vec<(Vec3, Vec3, Vec3)> {
        let blob = synthetic::organ(&synthetic::Shape { stiffness_n_m, ..synthetic::Shape::default() });
        let organ: Organ<'_> = Organ::read(bytemuck::cast_slice(&blob)).expect("a sound blob");
        let controller = Controller::new(&organ, Config::new(Method::Trilinear)).expect("has the method");
        let mut hand = SimulatedHand::new(&organ, config);
        let (mut state, mut force) = (State::new(), vec3::ZERO);
        state.arm();
        (1..=steps)
            .map(|tick| {
                let now_us = tick * 1_000;
                let sample = hand.exchange(now_us, force).expect("never fails").expect("always samples");
                let command = controller.tick(&mut state, now_us, Some(&sample));
                assert_eq!(command.phase, palpate_core::Phase::Active, "tick {tick}");
                force = command.hand_force_n;
                (sample.position_m, command.displacement_m, command.reaction_n)
            })
            .collect()
    }

    #[test]
    fn the_same_seed_gives_the_same_bits_and_another_seed_others() {
        let one = run(SimulatedConfig::default(), 300.0, 9_000);
        assert_eq!(one, run(SimulatedConfig::default(), 300.0, 9_000));
        let hand = HandConfig { seed: 2, ..HandConfig::default() };
        assert_ne!(one, run(SimulatedConfig { hand, ..SimulatedConfig::default() }, 300.0, 9_000));
    }

    /// From soft to as stiff as a Falcon may render: strokes reach the organ, stay bounded, and no oscillation builds up.
    #[test]
    fn strokes_are_bounded_and_stable_on_soft_and_stiff_organs() {
        for stiffness_n_m in [100.0, 300.0, 1000.0, 2500.0] {
            let trace = run(SimulatedConfig::default(), stiffness_n_m, 14_000);
            let deepest = trace.iter().map(|(_, d, _)| vec3::norm(*d)).fold(0.0, f32::max);
            assert!(deepest > 0.004 && deepest < 0.045, "{stiffness_n_m}: {deepest}");
            // Largest step between two ticks: a stroke is slow, a limit cycle is not.
            let fastest =
                trace.windows(2).map(|pair| vec3::distance(pair[0].0, pair[1].0)).fold(0.0, f32::max);
            assert!(fastest < 0.6e-3, "{stiffness_n_m}: {fastest} m a tick");
        }
    }

    #[test]
    fn a_press_reaches_most_of_its_depth_because_the_hand_leans_in() {
        let depth = |persistence| {
            let hand = HandConfig { persistence, tremor_m: 0.0, ..HandConfig::default() };
            let config = SimulatedConfig { hand, ..SimulatedConfig::default() };
            run(config, 200.0, 1_060).iter().map(|(_, d, _)| vec3::norm(*d)).fold(0.0, f32::max)
        };
        let (passive, persistent) = (depth(0.0), depth(0.8));
        assert!(passive < 0.0115 && persistent > 0.0125 && persistent < 0.0165, "{passive} {persistent}");
    }

    #[test]
    fn samples_lie_on_the_encoder_grid() {
        for (position, _, _) in run(SimulatedConfig::default(), 300.0, 500) {
            for metres in position {
                let counts = metres / 30.0e-6;
                assert!((counts - counts.round()).abs() < 1e-2, "{metres}");
            }
        }
    }

    #[test]
    fn it_pushes_and_pulls() {
        let trace = run(SimulatedConfig::default(), 300.0, 7_000);
        let blob = synthetic::organ(&synthetic::Shape::default());
        let organ: Organ<'_> = Organ::read(bytemuck::cast_slice(&blob)).expect("a sound blob");
        let normal = organ.spaces[0].outward_normal;
        let along: Vec<f32> = trace.iter().map(|(_, _, h)| vec3::dot(*h, normal)).collect();
        assert!(along.iter().copied().fold(0.0, f32::min) < -1.0, "presses into the body");
        assert!(along.iter().copied().fold(0.0, f32::max) > 1.0, "pulls out of it");
    }

    fn on(profile: &Profile, palpation: Palpation, hand: HandConfig) -> SimulatedHand {
        SimulatedHand::with_palpation(palpation, SimulatedConfig { hand, ..SimulatedConfig::on(profile) })
    }

    fn still(at_m: Vec3) -> Palpation {
        // Higher than anything touches: it stays there for a second, then goes on.
        Palpation::Tour(Script::press_and_hold(at_m, [0.0, 0.0, 1.0], -Script::PRESS_FROM_M, 3_600.0))
    }

    /// A force of a tick is in the next samples but two: a cycle in the loop, the link each way, and the mass.
    #[test]
    fn the_loop_and_the_link_hold_a_force_back() {
        let mut profile = Profile::bundled("simulated").expect("bundled");
        (profile.position_delay_us, profile.force_delay_us) = (1_000, 2_000);
        (profile.mechanism.encoder_quantum_m, profile.mechanism.coulomb_n) = (None, None);
        let mut hand = on(&profile, still([0.0, 0.0, 0.05]), HandConfig::LIGHT);
        let seen: Vec<f32> = (1..=9_u64)
            .map(|tick| {
                let force_n = if tick == 1 { [5.0, 0.0, 0.0] } else { vec3::ZERO };
                let sample =
                    hand.exchange(tick * 1_000, force_n).expect("never fails").expect("always samples");
                assert_eq!(sample.t_us, (tick - 1) * 1_000, "as old as the link is long");
                sample.position_m[0]
            })
            .collect();
        // Sent at the first exchange, it acts from 2 ms later for 1 ms, and is seen 1 ms after that.
        assert!(seen[..4].iter().all(|x| *x == 0.0), "{seen:?}");
        assert!(seen[4] > 1e-6 && seen[5] > seen[4], "{seen:?}");
        // 5 N on 0.15 kg for 1 ms: 33 mm/s.
        assert!(((seen[5] - seen[4]) / 33.3e-6 - 1.0).abs() < 0.05, "{seen:?}");
    }

    #[test]
    fn a_profile_says_where_the_hand_is_and_how_far_it_goes() {
        let profile = Profile::bundled("falcon").expect("bundled");
        let mut hand = on(&profile, still([0.03, 0.02, 0.01]), HandConfig::default());
        let sample = hand.exchange(2_000, vec3::ZERO).expect("never fails").expect("always samples");
        // Three steps of the encoder, because three metres of the model are one of the hand.
        assert!(vec3::distance(sample.position_m, [0.03, 0.02, 0.015]) < 3.0 * 3.0 * 54e-6, "{sample:?}");
        assert!(vec3::distance(hand.device_position_m(), [0.01, 0.02 / 3.0, 0.125]) < 1e-4);
        // A metre away the hand wants to be; the handle stops at 40 mm, 120 mm of the model.
        let mut hand = on(&profile, still([1.0, 0.0, 0.0]), HandConfig::default());
        for tick in 0..2_000_u64 {
            let sample =
                hand.exchange(tick * 1_000, vec3::ZERO).expect("never fails").expect("always samples");
            let away_m = vec3::norm(sample.position_m);
            assert!((0.1195..0.1210).contains(&away_m), "{away_m}");
        }
        let info = hand.info();
        assert_eq!(info.max_force_n, 8.0);
        assert!((info.max_stiffness_n_m - 1_000.0 / 3.0).abs() < 1e-3);
    }

    /// What the motors give goes into the hand's motion and the mechanism's drag, to the last part in a hundred.
    #[test]
    fn the_energy_that_goes_through_the_handle_is_all_accounted_for() {
        let profile = Profile::bundled("simulated").expect("bundled");
        let limp = HandConfig { stiffness_n_m: 0.0, ..HandConfig::LIGHT };
        let mut hand = on(&profile, still([0.0, 0.0, 0.05]), limp);
        for tick in 0..200_u64 {
            hand.exchange(tick * 1_000, [0.5, 0.0, 0.0]).expect("never fails");
        }
        let (work, mass_kg) = (hand.work(), 0.1 + limp.mass_kg);
        let motion_j = 0.5 * f64::from(mass_kg * vec3::norm_squared(hand.hand.velocity_m_s()));
        assert!(work.motors_j > 0.01 && work.drag_j < -1e-3, "{work:?}");
        assert!((work.of_device_j() / motion_j - 1.0).abs() < 0.01, "{work:?}, {motion_j} J of motion");
    }
}
