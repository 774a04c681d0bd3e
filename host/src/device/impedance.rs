//! The mechanism of an impedance device, simulated: mass, damping, friction, a position read in steps and late, a force that comes in
//! steps and late.
//!
//! ```text
//! force of a tick -> delay -> saturation, steps of the motor -> hand and mechanism -> steps of the encoder -> delay -> sample
//! ```
//!
//! Everything is in the device's frame. Delays are kept in rings that are allocated once.

use super::hand::Drag;
use super::profile::Profile;
use super::workspace::Reach;
use palpate_core::{Vec3, vec3};

/// How an encoder turns a position into counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Counting {
    /// The count whose step the position is in: what a wheel with slots does.
    Floor,
    /// The nearest count.
    Round,
}

/// What a mechanism is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImpedanceConfig {
    /// Mass, damping and friction at the handle.
    pub drag: Drag,
    /// Step of the position, m; 0 for none.
    pub encoder_quantum_m: f32,
    /// How positions become steps.
    pub counting: Counting,
    /// How long a position is on its way, us.
    pub position_delay_us: u32,
    /// How long a force is on its way, us.
    pub force_delay_us: u32,
    /// Largest force of the motors together, N.
    pub max_force_n: f32,
    /// Step of the force, N; 0 for none.
    pub motor_quantum_n: f32,
    /// Where the handle can go, from the middle of the workspace.
    pub reach: Reach,
}

impl ImpedanceConfig {
    /// The mechanism of a profile: what is known, and what is assumed where nothing is.
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

/// Holds values back for a fixed number of steps.
#[derive(Debug, Clone)]
struct DelayLine<T> {
    slots: Box<[T]>,
    next: usize,
}

impl<T: Copy> DelayLine<T> {
    fn new(steps: usize, filled_with: T) -> Self {
        Self { slots: vec![filled_with; steps].into_boxed_slice(), next: 0 }
    }

    /// Takes the value of this step; gives the one of so many steps ago.
    fn pass(&mut self, value: T) -> T {
        let Some(slot) = self.slots.get_mut(self.next) else { return value };
        let oldest = core::mem::replace(slot, value);
        self.next = (self.next + 1) % self.slots.len();
        oldest
    }
}

/// Where a handle was, and what was pressed.
pub type Reading = (Vec3, u32);

/// The mechanism.
#[derive(Debug, Clone)]
pub struct Impedance {
    config: ImpedanceConfig,
    positions: DelayLine<Reading>,
    forces: DelayLine<Vec3>,
    /// Held until the next tick sends another.
    command_n: Vec3,
    reading: Reading,
}

impl Impedance {
    /// A mechanism without force, its handle at `from_middle_m`. Delays are rounded to steps of `step_s`.
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

    /// What it is like.
    #[must_use]
    pub const fn config(&self) -> &ImpedanceConfig {
        &self.config
    }

    /// Sends the motors another force, which they hold from when it arrives until the next arrives.
    pub fn command(&mut self, force_n: Vec3) {
        // What is no number gives no force, as a driver's conversion to an integer does.
        self.command_n = if vec3::is_finite(force_n) { force_n } else { vec3::ZERO };
    }

    /// What the motors give in this step of integration.
    pub fn motor_n(&mut self) -> Vec3 {
        let arrived_n = self.forces.pass(self.command_n);
        let (held_n, _) = palpate_core::limit::clamp_force(arrived_n, self.config.max_force_n);
        // Towards zero, so that a step never lifts the force over the limit.
        let quantum_n = self.config.motor_quantum_n;
        if quantum_n > 0.0 { held_n.map(|newtons| (newtons / quantum_n).trunc() * quantum_n) } else { held_n }
    }

    /// Takes note of where the handle is after this step, and what is pressed.
    pub fn note(&mut self, from_middle_m: Vec3, buttons: u32) {
        self.reading = self.positions.pass((from_middle_m, buttons));
    }

    /// What the device says now: steps of the encoder, some time ago. Tremor is no part of the motion and comes undelayed.
    #[must_use]
    pub fn reading(&self, tremor_m: Vec3) -> Reading {
        let (true_m, buttons) = self.reading;
        let seen_m = vec3::add(true_m, tremor_m);
        (counted(seen_m, self.config.encoder_quantum_m, self.config.counting), buttons)
    }
}

/// Position in steps of a quantum.
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
    fn forces_and_positions_arrive_after_their_delay_and_not_before() {
        let mut device = Impedance::new(config(), vec3::ZERO, STEP_S);
        device.command([1.0, 0.0, 0.0]);
        // 107 us are two steps of 50 us.
        let arrived: Vec<f32> = (0..5).map(|_| device.motor_n()[0]).collect();
        assert_eq!(arrived, [0.0, 0.0, 1.0, 1.0, 1.0]);
        device.command(vec3::ZERO);
        let arrived: Vec<f32> = (0..4).map(|_| device.motor_n()[0]).collect();
        assert_eq!(arrived, [1.0, 1.0, 0.0, 0.0]);
        // 1107 us are 22 steps; a button comes with its position.
        let mut seen = Vec::new();
        for step in 1..=40_u16 {
            device.note([1e-3 * f32::from(step), 0.0, 0.0], u32::from(step));
            seen.push(device.reading(vec3::ZERO));
        }
        assert_eq!(seen[21], ([0.0; 3], 0));
        for (index, (position_m, buttons)) in seen.iter().enumerate().skip(22) {
            assert_eq!(*buttons as usize, index - 21);
            // The last bit of a whole count may be on either side.
            let late_m = 1e-3 * (index - 21) as f32 - position_m[0];
            assert!((-1e-8..=50.1e-6).contains(&late_m), "{late_m}");
        }
    }

    #[test]
    fn without_a_delay_nothing_is_late() {
        let prompt = ImpedanceConfig { position_delay_us: 0, force_delay_us: 0, ..config() };
        let mut device = Impedance::new(prompt, vec3::ZERO, STEP_S);
        device.command([0.0, 2.0, 0.0]);
        assert_eq!(device.motor_n(), [0.0, 2.0, 0.0]);
        device.note([0.0, 1.0, 0.0], 7);
        assert_eq!(device.reading(vec3::ZERO).1, 7);
    }

    #[test]
    fn motors_saturate_together_and_step_towards_zero() {
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
    fn encoders_count_down_or_to_the_nearest() {
        let at = |metres: f32, counting| counted([metres, 0.0, 0.0], 1e-3, counting)[0];
        assert_eq!((at(1.9e-3, Counting::Floor), at(1.9e-3, Counting::Round)), (1e-3, 2e-3));
        assert_eq!((at(-0.1e-3, Counting::Floor), at(-0.1e-3, Counting::Round)), (-1e-3, 0.0));
        assert_eq!(counted([0.123; 3], 0.0, Counting::Floor), [0.123; 3]);
    }
}
