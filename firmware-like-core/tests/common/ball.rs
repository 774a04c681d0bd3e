//! A ball that is active everywhere, and a hand that touches it.

use palpate_core::vec3::{self, Vec3};
use palpate_core::{
    AlignedBytes, Command, Config, Controller, Method, Organ, Phase, Sample, State, TouchSurface,
};

use super::{Recipe, sphere};

/// Radius of the ball, m.
pub const RADIUS_M: f32 = 0.04;

/// Stiffness factors of the spaces, which differ by up to a third between neighbours.
pub fn uneven(node: u32) -> f64 {
    1.0 + 0.3 * (f64::from(node) * 2.4).sin()
}

/// A sphere of isotropic nodes of 400 N/m; the first `active` vertices are active nodes.
pub fn ball(stiffer: fn(u32) -> f64, active: usize) -> AlignedBytes {
    let body = sphere(RADIUS_M, 2);
    let nodes = body.0[..active].to_vec();
    let recipe = Recipe {
        nodes,
        normal: vec3::normalize_or_zero,
        stiffer,
        body: Some(body),
        radius_m: 0.02,
        force: |d| d.map(|x| 400.0 * f64::from(x)),
        ghost: |d| d.map(|x| 400.0 * f64::from(x)),
        rbf: false,
        hermite: false,
        displacement: false,
        ..Recipe::default()
    };
    recipe.blob()
}

/// A hand on an organ with a surface, ticked once per millisecond.
pub struct Hand<'o> {
    pub controller: Controller<'o, 'o>,
    pub state: State,
    pub now_us: u64,
}

impl<'o> Hand<'o> {
    pub fn new(organ: &'o Organ<'o>, memory: &'o mut Vec<u32>, friction: f32) -> Self {
        let mut config = Config::new(Method::Trilinear);
        config.limits.ramp_s = 0.0;
        config.contact.friction = friction;
        memory.resize(TouchSurface::words(organ), 0);
        let surface = TouchSurface::new(organ, memory);
        assert!(surface.is_some());
        let controller = Controller::new(organ, config).expect("packed").on_surface(surface);
        let mut state = State::new();
        assert!(state.arm());
        Self { controller, state, now_us: 1_000_000 }
    }

    pub fn at_with(&mut self, position_m: Vec3, buttons: u32) -> Command {
        self.now_us += 1_000;
        let sample = Sample { t_us: self.now_us, position_m, buttons, ..Sample::default() };
        let command = self.controller.tick(&mut self.state, self.now_us, Some(&sample));
        assert_eq!(command.phase, Phase::Active, "{command:?}");
        command
    }

    pub fn at(&mut self, position_m: Vec3) -> Command {
        self.at_with(position_m, 0)
    }
}

macro_rules! ball {
    ($hand:ident, $blob:expr, $friction:expr) => {
        let blob = $blob;
        let organ = <palpate_core::Organ<'_>>::read(&blob).expect("good");
        let mut memory = Vec::new();
        let mut $hand = $crate::common::ball::Hand::new(&organ, &mut memory, $friction);
    };
}
