//! A controller on the analytic organ, for the tests of the tick.

use palpate_core::vec3::{self, Vec3};
use palpate_core::{AlignedBytes, Command, Config, Controller, Fault, Method, Organ, Phase, Sample, State};

use super::Recipe;

pub fn organ_blob() -> AlignedBytes {
    Recipe { nodes: vec![[0.0; 3], [0.05, 0.0, 0.0]], radius_m: 0.03, rbf: false, ..Recipe::default() }.blob()
}

pub fn config() -> Config {
    let mut config = Config::new(Method::Hybrid);
    config.limits.ramp_s = 0.0;
    config
}

pub fn sample(t_us: u64, position_m: Vec3) -> Sample {
    Sample { t_us, position_m, ..Sample::default() }
}

/// A controller and its state, ticked once per millisecond.
pub struct Bench<'o, 'a> {
    pub controller: Controller<'o, 'a, 2>,
    pub state: State,
    pub now_us: u64,
}

impl<'o, 'a> Bench<'o, 'a> {
    pub fn new(organ: &'o Organ<'a, 2>, config: Config) -> Self {
        let controller = Controller::new(organ, config).expect("the method is packed");
        let mut bench = Self { controller, state: State::new(), now_us: 1_000_000 };
        assert!(bench.state.arm());
        bench
    }

    pub fn at(&mut self, position_m: Vec3) -> Command {
        self.now_us += 1000;
        let sample = sample(self.now_us, position_m);
        self.controller.tick(&mut self.state, self.now_us, Some(&sample))
    }

    pub fn without_sample(&mut self) -> Command {
        self.now_us += 1000;
        self.controller.tick(&mut self.state, self.now_us, None)
    }

    /// Presses 5 mm deep at 0.2 m/s and stays until the force is steady.
    pub fn press(&mut self) -> Command {
        for step in 0..200 {
            self.at([0.0, 0.0, 1e-3 - 0.2e-3 * (step as f32).min(30.0)]);
        }
        let command = self.at([0.0, 0.0, -5e-3]);
        assert!(command.reaction_n[2] < -0.5 && command.hand_force_n[2] > 0.0, "pressed: {command:?}");
        command
    }
}

macro_rules! bench {
    ($bench:ident, $config:expr) => {
        let blob = $crate::common::bench::organ_blob();
        let organ = palpate_core::Organ::read(&blob).expect("good");
        let mut $bench = $crate::common::bench::Bench::new(&organ, $config);
    };
}

/// The force is zero in the same tick, and the fault is latched: neither good samples nor arming restore the
/// force.
pub fn assert_latched(mut bench: Bench<'_, '_>, fault: Fault) {
    assert_eq!(bench.state.phase(), Phase::SafeZero(fault));
    for step in 0..100 {
        let command = bench.at([0.0, 0.0, 1e-3 - 0.1e-3 * step as f32]);
        assert_eq!((command.hand_force_n, command.phase), ([0.0; 3], Phase::SafeZero(fault)));
        assert!(!bench.state.arm());
        bench.state.disarm();
    }
    bench.state.reset();
    assert_eq!(bench.state.phase(), Phase::Disarmed);
    assert_eq!(bench.at([0.0, 0.0, 1e-3]).hand_force_n, [0.0; 3]);
    assert!(bench.state.arm());
    bench.press();
}

pub fn assert_faults(command: Command, fault: Fault) {
    assert_eq!((command.hand_force_n, command.reaction_n, command.engaged), ([0.0; 3], [0.0; 3], None));
    assert_eq!(command.phase, Phase::SafeZero(fault));
    assert!(vec3::is_finite(command.hip_m));
}
