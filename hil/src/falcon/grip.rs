//! The grip: what a hand moves, what the motors push, and what the hand felt of it.
//!
//! The host's own model of a hand holds a mechanism with mass, damping and friction. Time goes on in whole steps, so that the same commands
//! at the same times give the same bits however often somebody looks.

use super::kinematics::Pose;
use crate::felt::Felt;
use crate::mechanism::{Path, Waypoint};
use palpate_core::{Vec3, vec3};
use palpate_host::device::hand::{Drag, Hand, HandConfig};
use palpate_host::device::workspace::Reach;
use std::time::Duration;

/// Step of integration, us: the bound of [`Hand::push`] with a whole order to spare.
const STEP_US: u64 = 50;
/// Middle of where the mechanism lets the grip go, m.
const MIDDLE_M: Vec3 = [0.0, 0.0, 0.1165];
/// And how far from there, m: a little more than the 40 mm of the workspace, and short of where a leg is stretched.
const REACH_M: Vec3 = [0.041, 0.041, 0.0415];
const REACH: Reach = Reach::Box { half_m: REACH_M };
/// Torque of one count of each motor's command, N m; the command acts against its sign. As libnifalcon has it.
pub const NM_PER_MOTOR_COUNT: [f64; 3] = [-1e-4; 3];

/// Mechanism and hand.
#[derive(Debug, Clone)]
pub struct Grip {
    hand: Hand,
    drag: Drag,
    path: Path,
    /// When the hand began its path, us; before that it holds the grip at the path's beginning.
    begun_us: Option<u64>,
    /// Without a command for so long the grip stands still, us.
    stands_us: Option<u64>,
    commanded_us: u64,
    now_us: u64,
    motors: [i16; 3],
    nm_per_count: [f64; 3],
    pose: Pose,
    felt: Felt,
}

impl Grip {
    /// A grip held at the beginning of a path.
    ///
    /// # Panics
    ///
    /// If the path begins where the legs do not reach.
    #[must_use]
    pub fn new(config: HandConfig, drag: Drag, waypoints: Vec<Waypoint>) -> Self {
        let path = Path::new(waypoints);
        let start_m = within_reach(path.at(0).unwrap_or(MIDDLE_M));
        Self {
            hand: Hand::new(config, start_m),
            drag,
            path,
            begun_us: None,
            stands_us: None,
            commanded_us: 0,
            now_us: 0,
            motors: [0; 3],
            nm_per_count: NM_PER_MOTOR_COUNT,
            pose: Pose::at(start_m).expect("the mechanism's stops are within reach of its legs"),
            felt: Felt::nothing(0),
        }
    }

    /// The same with motors of its own: torque of one count of each command, N m.
    #[must_use]
    pub const fn with_motors(mut self, nm_per_count: [f64; 3]) -> Self {
        self.nm_per_count = nm_per_count;
        self
    }

    /// From now on hand and grip stand still while no command has come for so long: for a host whose time is not real, and to which a grip that moves on
    /// by more than that host's tick would be faster than any hand.
    pub const fn stand_without_commands(&mut self, after: Duration) {
        self.stands_us = Some(after.as_micros() as u64);
    }

    /// Where the grip is, device frame, m.
    #[must_use]
    pub const fn position_m(&self) -> Vec3 {
        self.hand.position_m()
    }

    /// What the encoders' wheels stand at.
    #[must_use]
    pub fn counts(&self) -> [i32; 3] {
        self.pose.counts()
    }

    /// What the hand felt.
    #[must_use]
    pub const fn felt(&self) -> &Felt {
        &self.felt
    }

    /// Begins the record anew; what acts now goes on to act.
    pub fn forget(&mut self) {
        self.felt.forget();
    }

    /// The hand sets out on its path, unless it has.
    pub fn begin(&mut self) {
        self.begun_us.get_or_insert(self.now_us);
    }

    /// The hand leaves its path for another one, whose times count from now.
    pub fn follow(&mut self, waypoints: Vec<Waypoint>) {
        (self.path, self.begun_us) = (Path::new(waypoints), Some(self.now_us));
    }

    /// The motors get another command.
    pub fn command(&mut self, at_us: u64, motors: [i16; 3], homed: bool) {
        (self.motors, self.commanded_us) = (motors, at_us);
        self.felt.command(at_us, self.motors_n(), motors, homed);
    }

    /// The motors lose their command without one, as when the board is reset.
    pub fn power_off(&mut self, at_us: u64) {
        self.motors = [0; 3];
        self.felt.switch(at_us, true);
        self.felt.feel(vec3::ZERO);
    }

    /// What the motors do to the hand where it is now.
    fn motors_n(&self) -> Vec3 {
        self.pose
            .force_n(core::array::from_fn(|motor| f64::from(self.motors[motor]) * self.nm_per_count[motor]))
    }

    /// Moves on by the next whole step if it ends by `until_us`; gives what the encoders stand at then.
    pub fn step(&mut self, until_us: u64) -> Option<[i32; 3]> {
        let next_us = self.now_us + STEP_US;
        if next_us > until_us {
            return None;
        }
        if self.stands_us.is_some_and(|stands_us| next_us.saturating_sub(self.commanded_us) > stands_us) {
            self.begun_us = self.begun_us.map(|begun_us| begun_us + STEP_US);
            self.now_us = next_us;
            return Some(self.counts());
        }
        let from_m = self.wanted_m(self.now_us);
        let to_m = self.wanted_m(next_us);
        let (force_n, before_m) = (self.felt.force_n, self.hand.position_m());
        let drag_j = self.hand.integrate(from_m, to_m, force_n, &self.drag, STEP_US as f32 * 1e-6);
        let held_m = within_reach(self.hand.position_m());
        if held_m != self.hand.position_m() {
            self.hand.stop_at(held_m);
        }
        self.now_us = next_us;
        self.felt.moved(vec3::sub(held_m, before_m), drag_j);
        let seen_m = vec3::add(held_m, self.hand.tremor_m(next_us as f64 * 1e-6));
        self.pose = Pose::at(within_reach(seen_m)).unwrap_or(self.pose);
        self.felt.feel(self.motors_n());
        Some(self.counts())
    }

    fn wanted_m(&self, t_us: u64) -> Vec3 {
        let since_us = self.begun_us.map_or(0, |begun_us| t_us.saturating_sub(begun_us));
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

    /// And a torque that is felt as 3 N in the middle does not become a blow in a corner.
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
    fn a_command_pushes_against_its_sign_until_the_next_one_comes() {
        let mut grip = held(steady());
        grip.command(0, [-1_000; 3], true);
        let [x, y, z] = grip.felt().force_n;
        assert!(z > 1.0 && x.abs() < 1e-4 && y.abs() < 1e-4);
        run(&mut grip, 2_000_000);
        // In balance with the arm of 450 N/m.
        let gone_m = grip.position_m()[2] - 0.12;
        assert!((gone_m * 450.0 - grip.felt().force_n[2]).abs() < 0.02, "{gone_m}");
        assert_eq!((grip.felt().off_since_us, grip.felt().commands), (None, 1));
        grip.command(2_000_000, [0; 3], true);
        run(&mut grip, 4_000_000);
        assert!((grip.position_m()[2] - 0.12).abs() < 1e-5);
        assert_eq!(grip.felt().off_since_us, Some(2_000_000));
    }

    #[test]
    fn what_the_hand_felt_is_kept_until_it_is_to_be_forgotten() {
        let mut grip = held(steady());
        grip.command(1, [-400; 3], false);
        let unhomed_n = vec3::norm(grip.felt().force_n);
        grip.command(2, [-1_000; 3], true);
        grip.command(3, [0; 3], true);
        let felt = *grip.felt();
        assert_eq!((felt.largest_motor, felt.last_command_us, felt.force_n), (1_000, Some(3), vec3::ZERO));
        assert!((felt.largest_unhomed_n - unhomed_n).abs() < 1e-6);
        assert!((felt.largest_force_n / unhomed_n - 2.5).abs() < 1e-4);
        assert!((felt.largest_step_n / unhomed_n - 1.5).abs() < 1e-4);
        assert!((felt.largest_drop_n / unhomed_n - 2.5).abs() < 1e-4);
        grip.forget();
        assert_eq!((grip.felt().largest_force_n, grip.felt().commands), (0.0, 0));
    }

    /// A limp hand: the work of the motors is the energy of the motion.
    #[test]
    fn the_work_of_the_motors_is_accounted_for() {
        let limp = HandConfig { stiffness_n_m: 0.0, ..steady() };
        let at = Waypoint { t_us: 0, position_m: [0.0, 0.0, 0.10] };
        let drag = Drag { mass_kg: 0.15, damping_n_s_m: 0.0, coulomb_n: 0.0 };
        let mut grip = Grip::new(limp, drag, vec![at]);
        grip.command(0, [-300; 3], true);
        run(&mut grip, 100_000);
        let speed_m_s = vec3::norm(grip.hand.velocity_m_s());
        let motion_j = 0.5 * f64::from((limp.mass_kg + drag.mass_kg) * speed_m_s * speed_m_s);
        assert!(motion_j > 1e-3 && (grip.felt().work_j / motion_j - 1.0).abs() < 0.01);
    }

    #[test]
    fn a_hand_that_waits_goes_on_where_it_was() {
        let way = vec![
            Waypoint { t_us: 0, position_m: [0.0, 0.0, 0.12] },
            Waypoint { t_us: 100_000, position_m: [0.0, 0.0, 0.13] },
        ];
        let drag = Drag { mass_kg: 0.15, damping_n_s_m: 1.0, coulomb_n: 0.0 };
        let mut grip = Grip::new(steady(), drag, way);
        grip.stand_without_commands(Duration::from_millis(3));
        grip.begin();
        for t_us in (0..50_000).step_by(1_000) {
            grip.command(t_us, [0; 3], true);
            run(&mut grip, t_us);
        }
        // Nothing for half a second, of which it moves for 3 ms, whatever its speed was.
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
    fn looking_often_changes_nothing() {
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
        assert_eq!((often.position_m(), often.felt()), (seldom.position_m(), seldom.felt()));
        assert!((often.position_m()[2] - 0.158).abs() < 1e-6, "the stop holds");
    }
}
