//! The grip: its motion in the hand, the forces of the motors, and the record of the force on the hand.
//!
//! The host's hand model holds a mechanism with mass, damping and friction. Time advances in whole steps, so
//! that the same commands at the same times give the same bits for any polling.

use super::kinematics::Pose;
use crate::force_record::ForceRecord;
use crate::mechanism::{Path, Waypoint};
use palpate_core::{Vec3, vec3};
use palpate_host::device::hand::{Drag, Hand, HandConfig};
use palpate_host::device::workspace::Reach;
use std::time::Duration;

/// Integration step, us: a tenth of the bound of [`Hand::integrate`].
const STEP_US: u64 = 50;
/// Middle of the range of the grip, m.
const MIDDLE_M: Vec3 = [0.0, 0.0, 0.1165];
/// Half range of the grip, m: a little more than the 40 mm of the workspace, and less than the stretched
/// legs.
const REACH_M: Vec3 = [0.041, 0.041, 0.0415];
const REACH: Reach = Reach::Box { half_m: REACH_M };
/// Torque of one motor count, N m; the torque has the opposite sign of the command. Source: libnifalcon.
pub const NM_PER_MOTOR_COUNT: [f64; 3] = [-1e-4; 3];

/// Mechanism and hand.
#[derive(Debug, Clone)]
pub struct Grip {
    hand: Hand,
    drag: Drag,
    path: Path,
    /// Start of the hand's path, us; before it the hand holds the start of the path.
    start_us: Option<u64>,
    /// Time without a command after which the grip stands still, us.
    freeze_after_us: Option<u64>,
    commanded_us: u64,
    now_us: u64,
    motors: [i16; 3],
    nm_per_count: [f64; 3],
    pose: Pose,
    record: ForceRecord,
}

impl Grip {
    /// A grip held at the start of a path.
    ///
    /// # Panics
    ///
    /// If the start of the path is out of reach of the legs.
    #[must_use]
    pub fn new(config: HandConfig, drag: Drag, waypoints: Vec<Waypoint>) -> Self {
        let path = Path::new(waypoints);
        let start_m = within_reach(path.at(0).unwrap_or(MIDDLE_M));
        Self {
            hand: Hand::new(config, start_m),
            drag,
            path,
            start_us: None,
            freeze_after_us: None,
            commanded_us: 0,
            now_us: 0,
            motors: [0; 3],
            nm_per_count: NM_PER_MOTOR_COUNT,
            pose: Pose::at(start_m).expect("the mechanism's stops are within reach of its legs"),
            record: ForceRecord::empty(0),
        }
    }

    /// The same with other motors: torque of one count of each command, N m.
    #[must_use]
    pub const fn with_motors(mut self, nm_per_count: [f64; 3]) -> Self {
        self.nm_per_count = nm_per_count;
        self
    }

    /// Lets hand and grip stand still while no command has arrived for `after`. A host whose clock is not
    /// real time would otherwise see them move by more than one tick between two commands.
    pub const fn freeze_without_commands(&mut self, after: Duration) {
        self.freeze_after_us = Some(after.as_micros() as u64);
    }

    /// Position of the grip, device frame, m.
    #[must_use]
    pub const fn position_m(&self) -> Vec3 {
        self.hand.position_m()
    }

    /// True counts of the encoder wheels.
    #[must_use]
    pub fn counts(&self) -> [i32; 3] {
        self.pose.counts()
    }

    /// Record of the force on the hand.
    #[must_use]
    pub const fn force_record(&self) -> &ForceRecord {
        &self.record
    }

    /// Resets the record; the present force stays.
    pub fn reset_record(&mut self) {
        self.record.reset_record();
    }

    /// Starts the hand's path, unless it has started.
    pub fn begin(&mut self) {
        self.start_us.get_or_insert(self.now_us);
    }

    /// Gives the hand another path; its times count from now.
    pub fn follow(&mut self, waypoints: Vec<Waypoint>) {
        (self.path, self.start_us) = (Path::new(waypoints), Some(self.now_us));
    }

    /// Sets the motor command.
    pub fn command(&mut self, at_us: u64, motors: [i16; 3], homed: bool) {
        (self.motors, self.commanded_us) = (motors, at_us);
        self.record.command(at_us, self.motors_n(), motors, homed);
    }

    /// Removes the motor command, as a reset of the board does.
    pub fn power_off(&mut self, at_us: u64) {
        self.motors = [0; 3];
        self.record.set_off(at_us, true);
        self.record.set_force(vec3::ZERO);
    }

    /// Force of the motors on the hand at the present position, N.
    fn motors_n(&self) -> Vec3 {
        self.pose
            .force_n(core::array::from_fn(|motor| f64::from(self.motors[motor]) * self.nm_per_count[motor]))
    }

    /// Advances by the next whole step if it ends by `until_us`. Returns the encoder counts then.
    pub fn step(&mut self, until_us: u64) -> Option<[i32; 3]> {
        let next_us = self.now_us + STEP_US;
        if next_us > until_us {
            return None;
        }
        if self
            .freeze_after_us
            .is_some_and(|freeze_after_us| next_us.saturating_sub(self.commanded_us) > freeze_after_us)
        {
            self.start_us = self.start_us.map(|start_us| start_us + STEP_US);
            self.now_us = next_us;
            return Some(self.counts());
        }
        let from_m = self.target_m(self.now_us);
        let to_m = self.target_m(next_us);
        let (force_n, before_m) = (self.record.force_n, self.hand.position_m());
        let drag_j = self.hand.integrate(from_m, to_m, force_n, &self.drag, STEP_US as f32 * 1e-6);
        let held_m = within_reach(self.hand.position_m());
        if held_m != self.hand.position_m() {
            self.hand.stop_at(held_m);
        }
        self.now_us = next_us;
        self.record.add_motion(vec3::sub(held_m, before_m), drag_j);
        let seen_m = vec3::add(held_m, self.hand.tremor_m(next_us as f64 * 1e-6));
        self.pose = Pose::at(within_reach(seen_m)).unwrap_or(self.pose);
        self.record.set_force(self.motors_n());
        Some(self.counts())
    }

    fn target_m(&self, t_us: u64) -> Vec3 {
        let since_us = self.start_us.map_or(0, |start_us| t_us.saturating_sub(start_us));
        self.path.at(since_us).unwrap_or(MIDDLE_M)
    }
}

fn within_reach(position_m: Vec3) -> Vec3 {
    vec3::add(MIDDLE_M, REACH.nearest_m(vec3::sub(position_m, MIDDLE_M)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steady() -> HandConfig {
        HandConfig { persistence: 0.0, tremor_m: 0.0, ..HandConfig::default() }
    }

    fn held(config: HandConfig) -> Grip {
        let at = Waypoint { t_us: 0, position_m: [0.0, 0.0, 0.12] };
        Grip::new(config, Drag { mass_kg: 0.15, damping_n_s_m: 1.0, coulomb_n: 0.0 }, vec![at])
    }

    fn run(grip: &mut Grip, until_us: u64) {
        while grip.step(until_us).is_some() {}
    }

    /// The force of one torque also stays bounded in the corners.
    #[test]
    fn the_stops_are_within_reach_of_the_legs() {
        for i in 0..1_000 {
            let share = |digit| f32::from(digit as u8) / 4.5 - 1.0;
            let away = [share(i % 10), share(i / 10 % 10), share(i / 100)];
            let at_m = vec3::add(MIDDLE_M, core::array::from_fn(|axis| away[axis] * REACH_M[axis]));
            let pose = Pose::at(at_m).expect("within reach");
            let largest_n = vec3::norm(pose.force_n([0.1, 0.0, 0.0]));
            assert!((1.0..10.0).contains(&largest_n), "{at_m:?}: {largest_n} N");
        }
    }

    #[test]
    fn a_command_acts_against_its_sign_until_the_next_one() {
        let mut grip = held(steady());
        grip.command(0, [-1_000; 3], true);
        let [x, y, z] = grip.force_record().force_n;
        assert!(z > 1.0 && x.abs() < 1e-4 && y.abs() < 1e-4);
        run(&mut grip, 2_000_000);
        // In equilibrium with the hand's stiffness of 450 N/m.
        let gone_m = grip.position_m()[2] - 0.12;
        assert!((gone_m * 450.0 - grip.force_record().force_n[2]).abs() < 0.02, "{gone_m}");
        assert_eq!((grip.force_record().off_since_us, grip.force_record().commands), (None, 1));
        grip.command(2_000_000, [0; 3], true);
        run(&mut grip, 4_000_000);
        assert!((grip.position_m()[2] - 0.12).abs() < 1e-5);
        assert_eq!(grip.force_record().off_since_us, Some(2_000_000));
    }

    #[test]
    fn the_record_holds_the_extrema_until_it_is_reset() {
        let mut grip = held(steady());
        grip.command(1, [-400; 3], false);
        let unhomed_n = vec3::norm(grip.force_record().force_n);
        grip.command(2, [-1_000; 3], true);
        grip.command(3, [0; 3], true);
        let felt = *grip.force_record();
        assert_eq!((felt.largest_motor, felt.last_command_us, felt.force_n), (1_000, Some(3), vec3::ZERO));
        assert!((felt.largest_unhomed_n - unhomed_n).abs() < 1e-6);
        assert!((felt.largest_force_n / unhomed_n - 2.5).abs() < 1e-4);
        assert!((felt.largest_step_n / unhomed_n - 1.5).abs() < 1e-4);
        assert!((felt.largest_drop_n / unhomed_n - 2.5).abs() < 1e-4);
        grip.reset_record();
        assert_eq!((grip.force_record().largest_force_n, grip.force_record().commands), (0.0, 0));
    }

    /// With a hand of zero stiffness the work of the motors is the kinetic energy.
    #[test]
    fn the_work_of_the_motors_is_the_kinetic_energy() {
        let limp = HandConfig { stiffness_n_m: 0.0, ..steady() };
        let at = Waypoint { t_us: 0, position_m: [0.0, 0.0, 0.10] };
        let drag = Drag { mass_kg: 0.15, damping_n_s_m: 0.0, coulomb_n: 0.0 };
        let mut grip = Grip::new(limp, drag, vec![at]);
        grip.command(0, [-300; 3], true);
        run(&mut grip, 100_000);
        let speed_m_s = vec3::norm(grip.hand.velocity_m_s());
        let motion_j = 0.5 * f64::from((limp.mass_kg + drag.mass_kg) * speed_m_s * speed_m_s);
        assert!(motion_j > 1e-3 && (grip.force_record().work_j / motion_j - 1.0).abs() < 0.01);
    }

    #[test]
    fn a_frozen_hand_resumes_at_its_position() {
        let path = vec![
            Waypoint { t_us: 0, position_m: [0.0, 0.0, 0.12] },
            Waypoint { t_us: 100_000, position_m: [0.0, 0.0, 0.13] },
        ];
        let drag = Drag { mass_kg: 0.15, damping_n_s_m: 1.0, coulomb_n: 0.0 };
        let mut grip = Grip::new(steady(), drag, path);
        grip.freeze_without_commands(Duration::from_millis(3));
        grip.begin();
        for t_us in (0..50_000).step_by(1_000) {
            grip.command(t_us, [0; 3], true);
            run(&mut grip, t_us);
        }
        // Without commands for half a second it moves for 3 ms, at any speed.
        run(&mut grip, 52_000);
        let position_m = grip.position_m();
        assert_ne!(vec3::norm(grip.hand.velocity_m_s()), 0.0);
        run(&mut grip, 550_000);
        assert_eq!(grip.position_m(), position_m);
        for t_us in (550_000..700_000).step_by(1_000) {
            grip.command(t_us, [0; 3], true);
            run(&mut grip, t_us);
        }
        assert!((grip.position_m()[2] - 0.13).abs() < 1e-3, "{:?}", grip.position_m());
    }

    #[test]
    fn the_polling_rate_changes_no_bit() {
        let path = vec![
            Waypoint { t_us: 0, position_m: [0.0, 0.0, 0.12] },
            Waypoint { t_us: 300_000, position_m: [0.02, 0.01, 0.2] },
        ];
        let drag = Drag { mass_kg: 0.15, damping_n_s_m: 1.0, coulomb_n: 0.2 };
        let mut often = Grip::new(HandConfig::default(), drag, path.clone());
        let mut seldom = Grip::new(HandConfig::default(), drag, path);
        for grip in [&mut often, &mut seldom] {
            grip.begin();
            grip.command(0, [100, -200, 300], true);
        }
        for us in (0..=400_000).step_by(7) {
            run(&mut often, us);
        }
        run(&mut often, 400_000);
        run(&mut seldom, 400_000);
        assert_eq!((often.position_m(), often.force_record()), (seldom.position_m(), seldom.force_record()));
        assert!((often.position_m()[2] - 0.158).abs() < 1e-6, "the stop limits it");
    }
}
