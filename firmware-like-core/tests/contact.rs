//! Scripted strokes: touch, press, slide, let go, grasp.

mod common;

use common::Recipe;
use palpate_core::contact::{Contact, ContactState};
use palpate_core::vec3::{self, Vec3};
use palpate_core::{ContactConfig, ContactKind, Method, Organ};

const CONFIG: ContactConfig = ContactConfig {
    capture_radius_m: 0.02,
    release_tension_n: 0.2,
    release_height_m: 0.2e-3,
    friction: 0.3,
    grasp_slip: 1.1,
    grasp_distance_m: 3e-3,
    grasp_button: 0b10,
};

/// Two active nodes 5 cm apart, both with the normal +z.
fn two_nodes() -> Recipe {
    Recipe { nodes: vec![[0.0; 3], [0.05, 0.0, 0.0]], rbf: false, displacement: false, ..Recipe::default() }
}

/// A space in touch and how far its node is displaced.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Touch {
    space: u16,
    displacement_m: Vec3,
    kind: ContactKind,
}

/// Plays a stroke of HIPs on the planes of the nodes; gives the touch after each sample.
fn play(contact: &mut Contact, organ: &Organ<'_, 2>, stroke: &[(Vec3, u32)]) -> Vec<Option<Touch>> {
    let mut touch = |&(hip_m, buttons): &(Vec3, u32)| {
        let at = contact.update(&CONFIG, &organ.spaces, None, hip_m, buttons)?;
        assert_eq!((at.shares[0].weight, at.shares[1].weight, at.foot), (1.0, 0.0, None), "one alone");
        let displacement_m = vec3::sub(hip_m, at.anchor_m);
        Some(Touch { space: at.heaviest(), displacement_m, kind: at.kind })
    };
    stroke.iter().map(&mut touch).collect()
}

fn at(z_mm: f32) -> (Vec3, u32) {
    ([0.0, 0.0, z_mm * 1e-3], 0)
}

#[test]
fn touch_begins_on_the_plane_and_without_force() {
    let blob = two_nodes().blob();
    let organ = Organ::read(blob.bytes()).expect("good");
    let mut contact = Contact::new();
    let touches = play(&mut contact, &organ, &[at(3.0), at(1.0), at(0.0), at(-1.0)]);
    assert_eq!((touches[0], touches[1]), (None, None));
    let first = touches[2].expect("z = 0 is on the plane");
    assert_eq!((first.space, first.displacement_m, first.kind), (0, [0.0; 3], ContactKind::Push));
    for method in [Method::Trilinear, Method::Tricubic, Method::Hybrid] {
        assert_eq!(organ.spaces[0].force(method, first.displacement_m).expect("packed").force_n, [0.0; 3]);
    }
    let [x, y, z] = touches[3].expect("still in touch").displacement_m;
    assert_eq!((x, y), (0.0, 0.0));
    assert!((z + 1e-3).abs() < 1e-9);
}

/// A fast oblique sample goes through the plane: the anchor is the crossing, not the sample.
#[test]
fn the_anchor_is_the_crossing_point() {
    let blob = two_nodes().blob();
    let organ = Organ::read(blob.bytes()).expect("good");
    let mut contact = Contact::new();
    play(&mut contact, &organ, &[([0.000, 0.0, 0.003], 0), ([0.004, 0.002, -0.001], 0)]);
    let ContactState::Engaged(at) = contact.state() else { panic!("not engaged") };
    let [x, y, z] = at.anchor_m;
    assert!((x - 0.003).abs() < 1e-8 && (y - 0.0015).abs() < 1e-8 && z.abs() < 1e-8, "{x} {y} {z}");
}

#[test]
fn contact_begins_only_by_a_crossing_near_a_node() {
    let blob = two_nodes().blob();
    let organ = Organ::read(blob.bytes()).expect("good");
    // Inside from the start, from inside to outside, and along below the plane.
    let mut contact = Contact::new();
    let touches = play(&mut contact, &organ, &[at(-3.0), at(-2.0), at(0.0), at(-1.0), at(2.0)]);
    assert!(touches.iter().all(Option::is_none), "{touches:?}");
    // Through the plane, but out of reach of both nodes: 25 mm from each.
    let far = |z| ([0.025, 0.0, z], 0);
    assert!(play(&mut Contact::new(), &organ, &[far(0.002), far(-0.002)]).iter().all(Option::is_none));
    // Nearer to the second.
    let second = |z| ([0.04, 0.0, z], 0);
    let touches = play(&mut Contact::new(), &organ, &[second(0.001), second(-0.001)]);
    assert_eq!(touches[1].expect("touches").space, 1);
}

/// Jitter of the encoder round the plane does not chatter; rising by more than the hysteresis lets go.
#[test]
fn release_has_hysteresis() {
    let blob = two_nodes().blob();
    let organ = Organ::read(blob.bytes()).expect("good");
    let mut contact = Contact::new();
    let jitter: Vec<_> = (0..40).map(|i| at(if i % 2 == 0 { 0.1 } else { -0.1 })).collect();
    let touches = play(&mut contact, &organ, &jitter);
    assert!(touches[1..].iter().all(Option::is_some), "engages once and stays");
    let touches = play(&mut contact, &organ, &[at(0.19), at(0.21), at(0.1), at(-0.1)]);
    assert!(touches[0].is_some() && touches[1].is_none() && touches[2].is_none());
    assert!(touches[3].is_some(), "and the next crossing touches again");
}

/// Let go below the plane it does not snap on again: it must come up first.
#[test]
fn what_slipped_off_must_come_up_first() {
    let blob = two_nodes().blob();
    let organ = Organ::read(blob.bytes()).expect("good");
    let hip = [0.0, 0.0, -0.001];
    let mut contact = Contact::new();
    play(&mut contact, &organ, &[at(1.0), at(-1.0)]);
    contact.release(hip);
    assert_eq!(contact.state(), ContactState::Free { previous_hip_m: Some(hip) });
    assert!(play(&mut contact, &organ, &[at(-2.0), at(-0.5), at(-1.0)]).iter().all(Option::is_none));
    assert!(play(&mut contact, &organ, &[at(0.5), at(-0.5)])[1].is_some());
}

#[test]
fn grasp_holds_until_the_button_is_released() {
    let blob = two_nodes().blob();
    let organ = Organ::read(blob.bytes()).expect("good");
    let hold = |z_mm: f32, buttons| (at(z_mm).0, buttons);
    let mut contact = Contact::new();
    let touches =
        play(&mut contact, &organ, &[hold(1.0, 0), hold(1.0, 0b10), hold(9.0, 0b11), hold(5.0, 0b01)]);
    assert!(touches[0].is_none());
    let first = touches[1].expect("grasped");
    assert_eq!((first.displacement_m, first.kind), ([0.0; 3], ContactKind::Grasp));
    assert!((touches[2].expect("pulls").displacement_m[2] - 8e-3).abs() < 1e-8, "no release by height");
    assert!(touches[3].is_none(), "button up");
    // Another button, or out of reach, does not grasp.
    assert!(play(&mut contact, &organ, &[hold(1.0, 0), hold(1.0, 0b01)])[1].is_none());
    for out in [30.0, 3.1] {
        assert!(play(&mut contact, &organ, &[hold(out, 0), hold(out, 0b10), hold(1.0, 0b10)])[2].is_none());
    }
}

/// A button that is down when the session starts is no press.
#[test]
fn a_held_button_is_no_press() {
    let blob = two_nodes().blob();
    let organ = Organ::read(blob.bytes()).expect("good");
    let held = (at(1.0).0, 0b10);
    assert!(play(&mut Contact::new(), &organ, &[held, held, held]).iter().all(Option::is_none));
}

/// Grasping what one presses keeps the anchor, so the force does not jump.
#[test]
fn push_becomes_grasp_in_place() {
    let blob = two_nodes().blob();
    let organ = Organ::read(blob.bytes()).expect("good");
    let mut contact = Contact::new();
    let touches = play(&mut contact, &organ, &[at(1.0), at(0.0), at(-2.0), (at(-2.0).0, 0b10)]);
    let (push, grasp) = (touches[2].expect("pushes"), touches[3].expect("grasps"));
    assert_eq!((push.kind, grasp.kind), (ContactKind::Push, ContactKind::Grasp));
    assert_eq!(push.displacement_m, grasp.displacement_m);
}
