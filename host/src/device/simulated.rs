//! A simulated hand on a device, for `palpate demo` and the tests.
//!
//! The hand follows a [`Palpation`], and the controller's force acts on it, so the loop is closed as with a
//! real arm: a soft organ yields, a stiff one stops the hand. Without a mechanism the device is ideal: no
//! mass, no delay, only an encoder. With one it is the device of a [`Profile`].

use super::hand::{Drag, Hand, HandConfig};
use super::impedance::{Counting, Impedance, ImpedanceConfig, counted};
use super::palpation::{Palpation, RandomConfig, RandomPalpation};
use super::profile::Profile;
use super::script::{Script, StrokeConfig};
use super::workspace::Workspace;
use super::{Device, DeviceError, DeviceInfo};
use palpate_core::{Organ, Orientation, Sample, Vec3, vec3};

/// How far the grip of a simulated hand tilts with a capsule, rad, and the periods, s.
const TILT_RAD: f32 = 0.5;
const TILT_S: [f64; 2] = [4.3, 6.1];

/// The hand and its device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedConfig {
    /// The hand.
    pub hand: HandConfig,
    /// Time step of one exchange, us.
    pub step_us: u32,
    /// Integration steps per exchange.
    pub substeps: u32,
    /// Resolution of an ideal device's encoder, m.
    pub quantum_m: f32,
    /// The mechanism; `None` is an ideal device in the model frame.
    pub mechanism: Option<SimulatedMechanism>,
    /// The strokes of the tour.
    pub strokes: StrokeConfig,
    /// Random palpation instead of the tour.
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
    /// The default hand on the device of a profile.
    #[must_use]
    pub fn for_profile(profile: &Profile) -> Self {
        Self {
            step_us: profile.period_us(),
            // 50 us at 1 kHz: delays are rounded to it.
            substeps: 20,
            mechanism: Some(SimulatedMechanism::of(profile)),
            ..Self::default()
        }
    }
}

/// A mechanism and its placement in the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedMechanism {
    /// Parameters of the mechanism.
    pub impedance: ImpedanceConfig,
    /// Placement of its workspace in the model.
    pub workspace: Workspace,
    /// Largest stiffness of the model that it renders, N/m.
    pub max_stiffness_n_m: f32,
}

impl SimulatedMechanism {
    /// The mechanism of a profile.
    #[must_use]
    pub fn of(profile: &Profile) -> Self {
        Self {
            impedance: ImpedanceConfig::of(profile),
            workspace: profile.workspace,
            max_stiffness_n_m: profile.max_model_stiffness_n_m(),
        }
    }
}

/// Energy that passed through the handle, J. Positive values go to the hand.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Work {
    /// Work of the motors.
    pub motors_j: f64,
    /// Work of damping and friction of the mechanism; never positive.
    pub drag_j: f64,
}

impl Work {
    /// Work of the whole device.
    #[must_use]
    pub fn device_j(&self) -> f64 {
        self.motors_j + self.drag_j
    }
}

/// The simulated hand, a function of (organ, configuration, forces): every exchange is one step.
///
/// It ignores `now_us`: while the computer stalls, the hand's time does not advance, and a run can be
/// repeated bit for bit.
#[derive(Debug, Clone)]
pub struct SimulatedHand {
    config: SimulatedConfig,
    palpation: Palpation,
    hand: Hand,
    mechanism: Option<Impedance>,
    /// Force of an ideal device, held until the next force.
    held_n: Vec3,
    work: Work,
    step: u64,
    /// How far the grip tilts where the motion does not say it, rad.
    tilt_rad: f32,
}

impl SimulatedHand {
    /// A hand above the first active node, before a press.
    #[must_use]
    pub fn new<const N: usize>(organ: &Organ<'_, N>, config: SimulatedConfig) -> Self {
        let palpation = match config.random {
            Some(random) => Palpation::Random(RandomPalpation::new(organ, random)),
            None => Palpation::Tour(Script::new(organ, &config.strokes)),
        };
        let tilt_rad = if organ.tool.half_axis_m().is_some() { TILT_RAD } else { 0.0 };
        Self { tilt_rad, ..Self::with_palpation(palpation, config) }
    }

    /// That of the motion. On a tour with a capsule the grip tilts about x and y, with two periods.
    fn orientation(&self, time_s: f64) -> Orientation {
        let angle_rad = |period_s: f64| {
            self.tilt_rad * ((time_s / period_s).fract() as f32 * core::f32::consts::TAU).sin()
        };
        let [x, y] = TILT_S.map(angle_rad);
        self.palpation.orientation().unwrap_or_else(|| Orientation::of_vector([x, y, 0.0]))
    }

    /// A hand that follows the given motion.
    #[must_use]
    pub fn with_palpation(palpation: Palpation, config: SimulatedConfig) -> Self {
        let mut target_m = palpation.target_m();
        let mechanism = config.mechanism.map(|SimulatedMechanism { impedance, workspace, .. }| {
            let middle_m = workspace.device_origin_m;
            let from_middle_m =
                impedance.reach.nearest_m(vec3::sub(workspace.to_device_m(target_m), middle_m));
            target_m = vec3::add(middle_m, from_middle_m);
            let step_s = config.step_us as f32 * 1e-6 / config.substeps.max(1) as f32;
            Impedance::new(impedance, from_middle_m, step_s)
        });
        Self {
            hand: Hand::new(config.hand, target_m),
            palpation,
            mechanism,
            held_n: vec3::ZERO,
            config,
            work: Work::default(),
            step: 0,
            tilt_rad: 0.0,
        }
    }

    /// True position of the hand in the model frame, without tremor and encoder.
    #[must_use]
    pub fn position_m(&self) -> Vec3 {
        self.frame().map_or(self.hand.position_m(), |frame| frame.to_model_m(self.hand.position_m()))
    }

    /// True position of the hand in the device frame; equal to the model frame for an ideal device.
    #[must_use]
    pub const fn device_position_m(&self) -> Vec3 {
        self.hand.position_m()
    }

    /// Energy that passed through the handle since the start.
    #[must_use]
    pub const fn work(&self) -> Work {
        self.work
    }

    fn frame(&self) -> Option<Workspace> {
        self.config.mechanism.map(|mechanism| mechanism.workspace)
    }

    /// Moves the hand by one step under the force of the previous exchange.
    fn integrate(&mut self) {
        let SimulatedConfig { substeps, step_us, .. } = self.config;
        let dt_s = step_us as f32 * 1e-6 / substeps.max(1) as f32;
        let frame = self.frame();
        let target_m = |palpation: &Palpation| match frame {
            Some(frame) => frame.to_device_m(palpation.target_m()),
            None => palpation.target_m(),
        };
        for _ in 0..substeps.max(1) {
            let from_m = target_m(&self.palpation);
            self.palpation.advance(dt_s);
            let to_m = target_m(&self.palpation);
            let (motor_n, drag) = match &mut self.mechanism {
                Some(mechanism) => (mechanism.motor_n(), mechanism.config().drag),
                None => (self.held_n, Drag::default()),
            };
            let before_m = self.hand.position_m();
            let drag_j = self.hand.integrate(from_m, to_m, motor_n, &drag, dt_s);
            let moved_m = vec3::sub(self.hand.position_m(), before_m);
            self.work.motors_j += f64::from(vec3::dot(motor_n, moved_m));
            self.work.drag_j -= f64::from(drag_j);
            if let (Some(mechanism), Some(frame)) = (&mut self.mechanism, frame) {
                let from_middle_m = vec3::sub(self.hand.position_m(), frame.device_origin_m);
                let held_m = mechanism.config().reach.nearest_m(from_middle_m);
                if held_m != from_middle_m {
                    self.hand.stop_at(vec3::add(frame.device_origin_m, held_m));
                }
                mechanism.record(held_m, self.palpation.buttons());
            }
        }
    }
}

impl Device for SimulatedHand {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.integrate();
        let step_s = self.config.step_us as f32 * 1e-6;
        self.palpation.feel(self.position_m(), hand_force_n, step_s);
        // The loop sends the force of the previous tick: it acts from now on, not during the step that ends
        // here.
        self.held_n = hand_force_n;
        self.step += 1;
        let time_s = self.step as f64 * f64::from(self.config.step_us) * 1e-6;
        let tremor_m = self.hand.tremor_m(time_s);
        let orientation = self.orientation(time_s);
        let (Some(mechanism), Some(frame)) = (&mut self.mechanism, self.config.mechanism) else {
            let seen_m = vec3::add(self.hand.position_m(), tremor_m);
            let position_m = counted(seen_m, self.config.quantum_m, Counting::Round);
            return Ok(Some(Sample {
                t_us: now_us,
                position_m,
                buttons: self.palpation.buttons(),
                orientation,
            }));
        };
        let workspace = frame.workspace;
        mechanism.command(workspace.to_device_n(hand_force_n));
        let (from_middle_m, buttons) = mechanism.reading(tremor_m);
        let position_m = workspace.to_model_m(vec3::add(workspace.device_origin_m, from_middle_m));
        let t_us = now_us.saturating_sub(u64::from(mechanism.config().position_delay_us));
        Ok(Some(Sample { t_us, position_m, buttons, orientation }))
    }

    fn stop(&mut self) {
        // The hand moves by its own spring; without a force it continues.
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
mod tests;
