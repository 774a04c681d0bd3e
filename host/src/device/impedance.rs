//! Model of an impedance device's mechanism: mass, damping, friction, a position that is quantised and
//! delayed, a force that is quantised and delayed.
//!
//! ```text
//! force of a tick -> delay -> saturation, quantisation -> hand and mechanism
//! hand and mechanism -> quantisation -> delay -> sample
//! ```
//!
//! Everything is in the device frame. The delays are ring buffers that are allocated once.

use super::hand::Drag;
use super::profile::Profile;
use super::workspace::Reach;
use palpate_core::{Vec3, vec3};

/// Rounding of positions to encoder counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Counting {
    /// Round down, as an optical encoder does.
    Floor,
    /// Round to the nearest count.
    Round,
}

/// Parameters of a mechanism.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImpedanceConfig {
    /// Mass, damping and friction at the handle.
    pub drag: Drag,
    /// Resolution of the position, m; 0 for none.
    pub encoder_quantum_m: f32,
    /// Rounding of positions.
    pub counting: Counting,
    /// Delay of the position, us.
    pub position_delay_us: u32,
    /// Delay of the force, us.
    pub force_delay_us: u32,
    /// Largest force of the motors, vector sum, N.
    pub max_force_n: f32,
    /// Resolution of the force, N; 0 for none.
    pub motor_quantum_n: f32,
    /// Range of the handle, from the middle of the workspace.
    pub reach: Reach,
}

impl ImpedanceConfig {
    /// The mechanism of a profile, with the profile's assumptions for missing values.
    #[must_use]
    pub fn of(profile: &Profile) -> Self {
        let Profile { mechanism, assumed, .. } = profile;
        Self {
            drag: Drag {
                mass_kg: mechanism.mass_kg.unwrap_or(assumed.mass_kg),
                damping_n_s_m: mechanism.damping.map_or(assumed.damping_n_s_m, |damping| damping.n_s_m),
                coulomb_n: mechanism.coulomb_n.unwrap_or(assumed.coulomb_n),
            },
            encoder_quantum_m: mechanism.encoder_quantum_m.unwrap_or(0.0),
            counting: Counting::Floor,
            position_delay_us: profile.position_delay_us,
            force_delay_us: profile.force_delay_us,
            max_force_n: profile.max_force_n,
            motor_quantum_n: mechanism.motor_quantum_n.unwrap_or(0.0),
            reach: profile.reach,
        }
    }
}

/// Delays values by a fixed number of steps.
#[derive(Debug, Clone)]
struct DelayLine<T> {
    slots: Box<[T]>,
    next: usize,
}

impl<T: Copy> DelayLine<T> {
    fn new(steps: usize, filled_with: T) -> Self {
        Self { slots: vec![filled_with; steps].into_boxed_slice(), next: 0 }
    }

    /// Takes the value of this step and returns the value of `steps` steps ago.
    fn pass(&mut self, value: T) -> T {
        let Some(slot) = self.slots.get_mut(self.next) else { return value };
        let oldest = core::mem::replace(slot, value);
        self.next = (self.next + 1) % self.slots.len();
        oldest
    }
}

/// Position of a handle and its buttons.
pub type Reading = (Vec3, u32);

/// State of the mechanism.
#[derive(Debug, Clone)]
pub struct Impedance {
    config: ImpedanceConfig,
    positions: DelayLine<Reading>,
    forces: DelayLine<Vec3>,
    /// Force of the last command; held until the next one.
    command_n: Vec3,
    reading: Reading,
}

impl Impedance {
    /// A mechanism without force whose handle is at `from_middle_m`. Delays are rounded to steps of `step_s`.
    #[must_use]
    pub fn new(config: ImpedanceConfig, from_middle_m: Vec3, step_s: f32) -> Self {
        let steps = |delay_us: u32| (delay_us as f32 * 1e-6 / step_s).round() as usize;
        let reading = (from_middle_m, 0);
        Self {
            positions: DelayLine::new(steps(config.position_delay_us), reading),
            forces: DelayLine::new(steps(config.force_delay_us), vec3::ZERO),
            command_n: vec3::ZERO,
            reading,
            config,
        }
    }

    /// Its parameters.
    #[must_use]
    pub const fn config(&self) -> &ImpedanceConfig {
        &self.config
    }

    /// Commands a force. It acts after the delay and is held until the next one acts.
    pub fn command(&mut self, force_n: Vec3) {
        // A value that is not finite gives no force, like the integer conversion of a driver.
        self.command_n = if vec3::is_finite(force_n) { force_n } else { vec3::ZERO };
    }

    /// Force of the motors in this integration step.
    pub fn motor_n(&mut self) -> Vec3 {
        let arrived_n = self.forces.pass(self.command_n);
        let (held_n, _) = palpate_core::clamp_force(arrived_n, self.config.max_force_n);
        // Round towards zero, so that a step never raises the force above the limit.
        let quantum_n = self.config.motor_quantum_n;
        if quantum_n > 0.0 { held_n.map(|newtons| (newtons / quantum_n).trunc() * quantum_n) } else { held_n }
    }

    /// Records the position of the handle after this step, and the buttons.
    pub fn record(&mut self, from_middle_m: Vec3, buttons: u32) {
        self.reading = self.positions.pass((from_middle_m, buttons));
    }

    /// Current reading of the device: quantised and delayed. Tremor is not part of the simulated motion and
    /// is not delayed.
    #[must_use]
    pub fn reading(&self, tremor_m: Vec3) -> Reading {
        let (true_m, buttons) = self.reading;
        let seen_m = vec3::add(true_m, tremor_m);
        (counted(seen_m, self.config.encoder_quantum_m, self.config.counting), buttons)
    }
}

/// Position rounded to a quantum.
pub(super) fn counted(seen_m: Vec3, quantum_m: f32, counting: Counting) -> Vec3 {
    if quantum_m <= 0.0 {
        return seen_m;
    }
    seen_m.map(|metres| {
        let counts = metres / quantum_m;
        quantum_m
            * match counting {
                Counting::Floor => counts.floor(),
                Counting::Round => counts.round(),
            }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_S: f32 = 5e-5;

    fn config() -> ImpedanceConfig {
        ImpedanceConfig {
            drag: Drag::default(),
            encoder_quantum_m: 50e-6,
            counting: Counting::Floor,
            position_delay_us: 1_107,
            force_delay_us: 107,
            max_force_n: 3.3,
            motor_quantum_n: 0.01,
            reach: Reach::Ball { radius_m: 0.1 },
        }
    }

    #[test]
    fn forces_and_positions_arrive_after_their_delay() {
        let mut device = Impedance::new(config(), vec3::ZERO, STEP_S);
        device.command([1.0, 0.0, 0.0]);
        // 107 us are two steps of 50 us.
        let arrived: Vec<f32> = (0..5).map(|_| device.motor_n()[0]).collect();
        assert_eq!(arrived, [0.0, 0.0, 1.0, 1.0, 1.0]);
        device.command(vec3::ZERO);
        let arrived: Vec<f32> = (0..4).map(|_| device.motor_n()[0]).collect();
        assert_eq!(arrived, [1.0, 1.0, 0.0, 0.0]);
        // 1107 us are 22 steps. A button has the delay of its position.
        let mut seen = Vec::new();
        for step in 1..=40_u16 {
            device.record([1e-3 * f32::from(step), 0.0, 0.0], u32::from(step));
            seen.push(device.reading(vec3::ZERO));
        }
        assert_eq!(seen[21], ([0.0; 3], 0));
        for (index, (position_m, buttons)) in seen.iter().enumerate().skip(22) {
            assert_eq!(*buttons as usize, index - 21);
            // The last bit of a whole count can round either way.
            let late_m = 1e-3 * (index - 21) as f32 - position_m[0];
            assert!((-1e-8..=50.1e-6).contains(&late_m), "{late_m}");
        }
    }

    #[test]
    fn without_a_delay_values_arrive_at_once() {
        let prompt = ImpedanceConfig { position_delay_us: 0, force_delay_us: 0, ..config() };
        let mut device = Impedance::new(prompt, vec3::ZERO, STEP_S);
        device.command([0.0, 2.0, 0.0]);
        assert_eq!(device.motor_n(), [0.0, 2.0, 0.0]);
        device.record([0.0, 1.0, 0.0], 7);
        assert_eq!(device.reading(vec3::ZERO).1, 7);
    }

    #[test]
    fn motors_saturate_together_and_quantise_towards_zero() {
        let prompt = ImpedanceConfig { force_delay_us: 0, ..config() };
        let mut device = Impedance::new(prompt, vec3::ZERO, STEP_S);
        device.command([30.0, -40.0, 0.0]);
        let [x, y, _] = device.motor_n();
        assert!((x - 1.98).abs() < 0.011 && (y + 2.64).abs() < 0.011 && vec3::norm([x, y, 0.0]) <= 3.3);
        device.command([0.019, -0.019, 0.009]);
        let stepped = device.motor_n();
        assert!(vec3::distance(stepped, [0.01, -0.01, 0.0]) < 1e-7, "{stepped:?}");
        device.command([f32::NAN, 1.0, 0.0]);
        assert_eq!(device.motor_n(), vec3::ZERO);
    }

    #[test]
    fn encoders_round_down_or_to_the_nearest() {
        let at = |metres: f32, counting| counted([metres, 0.0, 0.0], 1e-3, counting)[0];
        assert_eq!((at(1.9e-3, Counting::Floor), at(1.9e-3, Counting::Round)), (1e-3, 2e-3));
        assert_eq!((at(-0.1e-3, Counting::Floor), at(-0.1e-3, Counting::Round)), (-1e-3, 0.0));
        assert_eq!(counted([0.123; 3], 0.0, Counting::Floor), [0.123; 3]);
    }
}
