//! A simulated hand on an ideal impedance device: what `palpate demo` holds, and what the tests drive.
//!
//! The hand is a mass on a spring and damper whose neutral point follows a [`Script`]; the force of the controller acts on
//! the mass, so the loop is closed as with a real arm: a soft organ yields, a stiff one stops the hand.

use super::script::{Script, StrokeConfig};
use super::{Device, DeviceError, DeviceInfo};
use palpate_core::{Organ, Sample, Vec3, vec3};

/// The hand and its device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedConfig {
    /// Seed of the tremor.
    pub seed: u64,
    /// Time that one exchange stands for, us.
    pub step_us: u32,
    /// Integration steps an exchange.
    pub substeps: u32,
    /// Effective mass of hand and handle, kg.
    pub mass_kg: f32,
    /// Stiffness of the arm, N/m.
    pub stiffness_n_m: f32,
    /// Damping ratio of the arm; 1 is critical.
    pub damping_ratio: f32,
    /// Share of a lasting resistance that the hand makes up for by pushing on, below 1.
    ///
    /// A person told to press 15 mm deep presses harder in stiffer tissue. 0 is a purely passive arm.
    pub persistence: f32,
    /// Largest force the hand adds that way, N.
    pub max_effort_n: f32,
    /// Amplitude of the tremor (8 to 11 Hz), m.
    pub tremor_m: f32,
    /// Step of the position encoder, m.
    pub quantum_m: f32,
    /// The strokes.
    pub strokes: StrokeConfig,
}

impl Default for SimulatedConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            step_us: 1_000,
            substeps: 10,
            mass_kg: 0.2,
            stiffness_n_m: 450.0,
            damping_ratio: 1.0,
            persistence: 0.8,
            max_effort_n: 6.0,
            tremor_m: 1.0e-4,
            quantum_m: 30.0e-6,
            strokes: StrokeConfig::default(),
        }
    }
}

/// Time in which the hand notices a resistance and leans into it, s: the order of a voluntary reaction.
const REACTION_TIME_S: f32 = 0.2;
/// Sines of the tremor an axis.
const TREMOR_SINES: usize = 3;

/// Sinusoid of the tremor.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sine {
    rad_per_s: f32,
    phase_rad: f32,
}

/// The simulated hand. A function of (organ, configuration, forces): every exchange is one step, whatever the clock.
///
/// It does not follow `now_us`: a stalled computer stops this hand's time instead of letting it jump, and a run can be repeated
/// bit for bit.
#[derive(Debug, Clone)]
pub struct SimulatedHand {
    config: SimulatedConfig,
    script: Script,
    position_m: Vec3,
    velocity_m_s: Vec3,
    /// Extra push that makes up for a lasting resistance.
    effort_n: Vec3,
    tremor: [[Sine; TREMOR_SINES]; 3],
    step: u64,
}

impl SimulatedHand {
    /// A hand over the first active node, about to press.
    #[must_use]
    pub fn new<const N: usize>(organ: &Organ<'_, N>, config: SimulatedConfig) -> Self {
        Self::with_script(Script::new(organ, &config.strokes), config)
    }

    /// A hand that follows a given script.
    #[must_use]
    pub fn with_script(script: Script, config: SimulatedConfig) -> Self {
        let mut random = SplitMix(config.seed);
        let tremor = core::array::from_fn(|_| {
            core::array::from_fn(|_| Sine {
                rad_per_s: core::f32::consts::TAU * (8.0 + 3.0 * random.unit()),
                phase_rad: core::f32::consts::TAU * random.unit(),
            })
        });
        Self {
            position_m: script.target_m(),
            velocity_m_s: vec3::ZERO,
            effort_n: vec3::ZERO,
            script,
            config,
            tremor,
            step: 0,
        }
    }

    /// True position of the hand, before the encoder.
    #[must_use]
    pub const fn position_m(&self) -> Vec3 {
        self.position_m
    }

    /// Moves the hand on by one step under a constant force.
    ///
    /// m a = k (target - x) + c (target' - x') + effort + F, semi-implicit Euler: v first, then x with the new v. Stable for
    /// k dt^2 / m far below 4; at 0.1 ms it is 2e-5, and 2e-4 with an organ of 3000 N/m in parallel.
    fn integrate(&mut self, force_n: Vec3) {
        let SimulatedConfig { mass_kg, stiffness_n_m, damping_ratio, substeps, step_us, .. } = self.config;
        let damping_n_s_m = 2.0 * damping_ratio * (stiffness_n_m * mass_kg).sqrt();
        let dt_s = step_us as f32 * 1e-6 / substeps.max(1) as f32;
        for _ in 0..substeps.max(1) {
            let before_m = self.script.target_m();
            self.script.advance(dt_s);
            let target_m = self.script.target_m();
            let target_m_s = vec3::scale(vec3::sub(target_m, before_m), dt_s.recip());
            let spring_n = vec3::scale(vec3::sub(target_m, self.position_m), stiffness_n_m);
            let damper_n = vec3::scale(vec3::sub(target_m_s, self.velocity_m_s), damping_n_s_m);
            let hand_n = vec3::add(vec3::add(spring_n, damper_n), self.effort_n);
            let push = vec3::scale(vec3::add(hand_n, force_n), dt_s / mass_kg);
            self.velocity_m_s = vec3::add(self.velocity_m_s, push);
            self.position_m = vec3::add(self.position_m, vec3::scale(self.velocity_m_s, dt_s));
            self.lean_in(force_n, dt_s);
        }
    }

    /// First-order low-pass of the resistance, bounded: slow enough that it cannot take part in an oscillation.
    fn lean_in(&mut self, force_n: Vec3, dt_s: f32) {
        let wanted_n = vec3::scale(force_n, -self.config.persistence);
        let change = vec3::scale(vec3::sub(wanted_n, self.effort_n), dt_s / REACTION_TIME_S);
        self.effort_n = vec3::add(self.effort_n, change);
        let size_n = vec3::norm(self.effort_n);
        if size_n > self.config.max_effort_n {
            self.effort_n = vec3::scale(self.effort_n, self.config.max_effort_n / size_n);
        }
    }

    fn tremor_at(&self, time_s: f64) -> Vec3 {
        // f64 time: in f32 the phase of an hour-long run would step.
        self.tremor.map(|sines| {
            let sum: f32 = sines
                .iter()
                .map(|sine| (f64::from(sine.rad_per_s) * time_s + f64::from(sine.phase_rad)).sin() as f32)
                .sum();
            sum * self.config.tremor_m / TREMOR_SINES as f32
        })
    }
}

impl Device for SimulatedHand {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.integrate(hand_force_n);
        self.step += 1;
        let time_s = self.step as f64 * f64::from(self.config.step_us) * 1e-6;
        let seen_m = vec3::add(self.position_m, self.tremor_at(time_s));
        let quantum_m = self.config.quantum_m;
        let position_m = if quantum_m > 0.0 {
            seen_m.map(|metres| (metres / quantum_m).round() * quantum_m)
        } else {
            seen_m
        };
        Ok(Some(Sample { t_us: now_us, position_m, buttons: self.script.buttons() }))
    }

    fn stop(&mut self) {
        // Nothing drives this hand but its own spring: without a force it just goes on.
    }

    fn info(&self) -> DeviceInfo {
        DeviceInfo {
            name: format!("simulated hand (seed {})", self.config.seed),
            self_arming: true,
            max_force_n: f32::INFINITY,
            max_stiffness_n_m: f32::INFINITY,
            resolution_m: self.config.quantum_m,
        }
    }
}

/// SplitMix64 (Steele, Lea and Flood 2014): a few numbers from a seed, the same on every machine.
struct SplitMix(u64);

impl SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1).
    fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1_u64 << 24) as f32
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
        assert_ne!(one, run(SimulatedConfig { seed: 2, ..SimulatedConfig::default() }, 300.0, 9_000));
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
            let config = SimulatedConfig { persistence, tremor_m: 0.0, ..SimulatedConfig::default() };
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
}
