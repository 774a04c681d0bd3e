//! Strokes of the tool: engage, press, release, grasp.

use crate::common::Recipe;
use palpate_core::vec3::{self, Vec3};
use palpate_core::{Config, ContactConfig, Controller, Method, Organ, Sample, State};

/// Two active nodes 5 cm apart, both with the normal +z.
fn two_nodes() -> Recipe {
    Recipe { nodes: vec![[0.0; 3], [0.05, 0.0, 0.0]], rbf: false, displacement: false, ..Recipe::default() }
}

/// The engaged space and the displacement of its node.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Touch {
    space: u16,
    displacement_m: Vec3,
}

/// A hand that plays strokes at the planes of the nodes.
struct Hand<'o> {
    controller: Controller<'o, 'o, 2>,
    state: State,
    now_us: u64,
}

impl<'o> Hand<'o> {
    fn new(organ: &'o Organ<'o, 2>) -> Self {
        let mut config = Config::new(Method::Trilinear);
        config.contact = ContactConfig { grasp_button: 0b10, ..ContactConfig::default() };
        config.limits.max_speed_m_s = 1e6;
        let controller = Controller::new(organ, config).expect("packed");
        let mut state = State::new();
        state.arm();
        Self { controller, state, now_us: 0 }
    }

    /// Takes samples of HIP and buttons; returns the touch after each of them.
    fn play(&mut self, stroke: &[(Vec3, u32)]) -> Vec<Option<Touch>> {
        let mut touch = |&(position_m, buttons): &(Vec3, u32)| {
            self.now_us += 1_000;
            let sample = Sample { t_us: self.now_us, position_m, buttons, ..Sample::default() };
            let command = self.controller.tick(&mut self.state, self.now_us, Some(&sample));
            let space = command.engaged?;
            assert_eq!((command.weights[0].weight, command.weights[1].weight), (1.0, 0.0), "a single space");
            Some(Touch { space, displacement_m: command.displacement_m })
        };
        stroke.iter().map(&mut touch).collect()
    }
}

macro_rules! hand {
    ($organ:ident, $hand:ident) => {
        let blob = two_nodes().blob();
        let $organ = Organ::read(&blob).expect("good");
        let mut $hand = Hand::new(&$organ);
    };
}

fn at(z_mm: f32) -> (Vec3, u32) {
    ([0.0, 0.0, z_mm * 1e-3], 0)
}

#[test]
fn touch_begins_on_the_plane_and_without_force() {
    hand!(organ, hand);
    let touches = hand.play(&[at(3.0), at(1.0), at(0.0), at(-1.0)]);
    assert_eq!((touches[0], touches[1]), (None, None));
    let first = touches[2].expect("z = 0 is on the plane");
    assert_eq!((first.space, first.displacement_m), (0, [0.0; 3]));
    for method in [Method::Trilinear, Method::Tricubic, Method::Hybrid] {
        assert_eq!(organ.spaces[0].force(method, first.displacement_m).expect("packed").force_n, [0.0; 3]);
    }
    let [x, y, z] = touches[3].expect("still engaged").displacement_m;
    assert_eq!((x, y), (0.0, 0.0));
    assert!((z + 1e-3).abs() < 1e-9);
}

/// An oblique path passes through the plane between two samples: the anchor is the crossing, not the sample.
#[test]
fn the_anchor_is_the_crossing_point() {
    hand!(organ, hand);
    let last_m = [0.004, 0.002, -0.001];
    let touches = hand.play(&[([0.000, 0.0, 0.003], 0), (last_m, 0)]);
    let [x, y, z] = vec3::sub(last_m, touches[1].expect("engaged").displacement_m);
    assert!((x - 0.003).abs() < 1e-8 && (y - 0.0015).abs() < 1e-8 && z.abs() < 1e-8, "{x} {y} {z}");
}

#[test]
fn contact_begins_only_at_a_crossing_near_a_node() {
    let blob = two_nodes().blob();
    let organ = Organ::read(&blob).expect("good");
    // A path that starts inside, one from inside to outside, and one along below the plane.
    let touches = Hand::new(&organ).play(&[at(-3.0), at(-2.0), at(0.0), at(-1.0), at(2.0)]);
    assert!(touches.iter().all(Option::is_none), "{touches:?}");
    // Through the plane, but 25 mm from each node, beyond the capture radius.
    let far = |z| ([0.025, 0.0, z], 0);
    assert!(Hand::new(&organ).play(&[far(0.002), far(-0.002)]).iter().all(Option::is_none));
    // Nearer to the second node.
    let second = |z| ([0.04, 0.0, z], 0);
    let touches = Hand::new(&organ).play(&[second(0.001), second(-0.001)]);
    assert_eq!(touches[1].expect("engaged").space, 1);
}

/// Encoder jitter round the plane causes no chatter; a height above the hysteresis disengages.
#[test]
fn release_has_hysteresis() {
    hand!(organ, hand);
    let jitter: Vec<_> = (0..40).map(|i| at(if i % 2 == 0 { 0.1 } else { -0.1 })).collect();
    let touches = hand.play(&jitter);
    assert!(touches[1..].iter().all(Option::is_some), "the tool engages once and stays engaged");
    let touches = hand.play(&[at(0.19), at(0.21), at(0.1), at(-0.1)]);
    assert!(touches[0].is_some() && touches[1].is_none() && touches[2].is_none());
    assert!(touches[3].is_some(), "the next crossing engages again");
}

/// A grasp that is lost below the plane does not become a push: the tool must first rise above the plane.
#[test]
fn after_a_release_below_the_plane_the_tool_must_come_up_first() {
    hand!(organ, hand);
    let grasped = |z_mm: f32| (at(z_mm).0, 0b10);
    let touches = hand.play(&[at(1.0), at(-1.0), grasped(-1.0), at(-1.0), at(-2.0), at(-0.5), at(-1.0)]);
    assert!(touches[1].is_some() && touches[2].is_some());
    assert!(touches[3..].iter().all(Option::is_none), "{touches:?}");
    assert!(hand.play(&[at(0.5), at(-0.5)])[1].is_some());
}

#[test]
fn a_grasp_holds_until_the_button_is_released() {
    let blob = two_nodes().blob();
    let organ = Organ::read(&blob).expect("good");
    let hold = |z_mm: f32, buttons| (at(z_mm).0, buttons);
    let touches = Hand::new(&organ).play(&[hold(1.0, 0), hold(1.0, 0b10), hold(9.0, 0b11), hold(5.0, 0b01)]);
    assert!(touches[0].is_none());
    assert_eq!(touches[1].expect("grasped").displacement_m, [0.0; 3]);
    assert!((touches[2].expect("pulls").displacement_m[2] - 8e-3).abs() < 1e-8, "no release by height");
    assert!(touches[3].is_none(), "button released");
    // The wrong button, or a distance too large from the surface, does not grasp.
    assert!(Hand::new(&organ).play(&[hold(1.0, 0), hold(1.0, 0b01)])[1].is_none());
    for out in [30.0, 3.1] {
        assert!(Hand::new(&organ).play(&[hold(out, 0), hold(out, 0b10), hold(1.0, 0b10)])[2].is_none());
    }
}

/// A button that is pressed when the session starts does not grasp.
#[test]
fn a_button_pressed_at_the_start_does_not_grasp() {
    hand!(organ, hand);
    let held = (at(1.0).0, 0b10);
    assert!(hand.play(&[held, held, held]).iter().all(Option::is_none));
}

/// A grasp that starts during a push keeps the anchor, so the force does not jump; from then on the tool can
/// pull.
#[test]
fn a_push_becomes_a_grasp_in_place() {
    hand!(organ, hand);
    let grasped = |z_mm: f32| (at(z_mm).0, 0b10);
    let touches = hand.play(&[at(1.0), at(0.0), at(-2.0), grasped(-2.0), grasped(5.0)]);
    let (push, grasp) = (touches[2].expect("pushes"), touches[3].expect("grasps"));
    assert_eq!(push.displacement_m, grasp.displacement_m);
    assert!(touches[4].is_some(), "a push would be released");
}
