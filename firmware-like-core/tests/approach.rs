//! How a touch of a live sphere or capsule begins.

use palpate_core::format::{Capsule, Sphere, Tool};
use palpate_core::vec3::{self, Vec3};
use palpate_core::{
    AlignedBytes, Config, Controller, Jet, JetMemory, Organ, Orientation, Phase, Sample, State, TouchSurface,
};

use crate::common::jets::flat;
use crate::common::{Recipe, sphere};

const SPHERE: Sphere = Sphere { radius_m: 0.009, layer_m: 0.001 };
const BALL_M: f32 = 0.04;

/// A live organ with this surface under a tool.
fn organ(body: (Vec<Vec3>, Vec<[u32; 3]>), tool: Tool) -> AlignedBytes {
    let bare =
        Recipe { lattice_table: false, rbf: false, hermite: false, displacement: false, ..Recipe::default() };
    Recipe { nodes: body.0[..1].to_vec(), body: Some(body), ..bare }
        .blob_with(|draft| draft.preamble.tool = tool)
}

/// The ticks of a way in which the tool touches.
fn touches(blob: &AlignedBytes, way: &[Vec3], orientation: Orientation) -> Vec<bool> {
    let organ = Organ::<1>::read(blob).expect("good");
    let mut words = vec![0; TouchSurface::words(&organ)];
    let surface = TouchSurface::new(&organ, &mut words);
    assert!(surface.is_some());
    let controller = Controller::new(&organ, Config::live()).expect("sound").on_surface(surface);
    let mut memory = Box::new(JetMemory::<1, 8>::new());
    assert!(memory.insert(&Jet { trust_m: 0.02, ..flat(0, [0.0; 3], vec3::ZERO) }));
    let mut state = State::new();
    assert!(state.arm());
    let tick = |(n, position_m): (u64, &Vec3)| {
        let t_us = 1_000_000 + 1_000 * n;
        let sample = Sample { t_us, position_m: *position_m, orientation, ..Sample::default() };
        let command = controller.tick_on(&mut state, t_us, Some(&sample), &mut *memory);
        assert_eq!(command.phase, Phase::Active);
        command.engaged.is_some()
    };
    (0..).zip(way).map(tick).collect()
}

/// From one place to the next ones, a millimetre a tick.
fn along(places_m: &[Vec3]) -> Vec<Vec3> {
    let pairs = places_m.windows(2).flat_map(|pair| {
        let (from_m, way_m) = (pair[0], vec3::sub(pair[1], pair[0]));
        let ticks = (vec3::norm(way_m) / 1e-3).ceil() as u32;
        (0..ticks).map(move |n| vec3::add(from_m, vec3::scale(way_m, n as f32 / ticks as f32)))
    });
    pairs.collect()
}

#[test]
fn a_touch_begins_where_the_layer_does() {
    let blob = organ(sphere(BALL_M, 3), Tool::Sphere(SPHERE));
    let way = along(&[[0.0, 0.0, 0.08], [0.0, 0.0, 0.03]]);
    let touches = touches(&blob, &way, Orientation::IDENTITY);
    let first = touches.iter().position(|is| *is).expect("it comes to it");
    assert!((way[first][2] - BALL_M - SPHERE.reach_m()).abs() < 1.5e-3, "{:?}", way[first]);
    assert!(touches[first..].iter().all(|is| *is));
}

/// From inside, or from where it overlaps the skin, it goes out and comes back.
#[test]
fn a_tool_that_starts_inside_touches_nothing_until_it_has_left() {
    let blob = organ(sphere(BALL_M, 3), Tool::Sphere(SPHERE));
    for start_m in [0.0, 0.02, 0.035, 0.043] {
        let way = along(&[[0.0, 0.0, start_m], [0.0, 0.0, 0.06], [0.0, 0.0, 0.035]]);
        let touches = touches(&blob, &way, Orientation::IDENTITY);
        let out = way.iter().position(|place_m| place_m[2] > 0.055).expect("it goes out");
        assert!(touches[..out].iter().all(|is| !is), "from {start_m}: {touches:?}");
        assert_eq!(touches.last(), Some(&true), "from {start_m}");
    }
}

/// Of the faces at a sharp edge one looks away from a tool that is outside.
#[test]
fn a_touch_begins_at_a_sharp_edge_from_every_side() {
    let [back, edge]: [f32; 2] = [-0.05, 0.0];
    let at = |x: f32, y: f32, z: f32| [x, y, z];
    // A wedge of 30 degrees along the y axis.
    let corners = vec![
        at(back, -0.05, 0.0134),
        at(back, -0.05, -0.0134),
        at(edge, -0.05, 0.0),
        at(back, 0.05, 0.0134),
        at(back, 0.05, -0.0134),
        at(edge, 0.05, 0.0),
    ];
    let faces = vec![[0, 1, 2], [3, 5, 4], [0, 2, 5], [0, 5, 3], [1, 4, 5], [1, 5, 2], [0, 3, 4], [0, 4, 1]];
    let blob = organ((corners, faces), Tool::Sphere(SPHERE));
    for degrees in (-100..=100).step_by(5) {
        let angle = (degrees as f32).to_radians();
        let far_m = [0.03 * angle.cos(), 0.003, 0.03 * angle.sin()];
        let way = along(&[far_m, [0.0, 0.003, 0.0]]);
        let touches = touches(&blob, &way, Orientation::IDENTITY);
        let first = touches.iter().position(|is| *is).unwrap_or_else(|| panic!("{degrees} degrees"));
        assert!(
            (0.008..0.0111).contains(&vec3::distance(way[first], [0.0, 0.003, 0.0])),
            "{degrees} {:?}",
            way[first]
        );
    }
}

/// The end of a capsule, its side, and its middle.
#[test]
fn a_touch_of_a_capsule_begins_where_its_axis_is_near() {
    let half_axis_m = [0.025, 0.0, 0.0];
    let blob = organ(sphere(BALL_M, 3), Tool::Capsule(Capsule { sphere: SPHERE, half_axis_m }));
    let quarter = core::f32::consts::FRAC_PI_2;
    for (turn, offset_m, ahead_m) in [
        // With its end first, with its side, and with its end beside the ball.
        ([0.0, quarter, 0.0], [0.0, 0.0, 0.0], 0.025),
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 0.0),
        ([0.0, 0.0, 0.0], [0.012, 0.0, 0.0], 0.0),
    ] {
        let way = along(&[[offset_m[0], 0.0, 0.11], [offset_m[0], 0.0, 0.045]]);
        let touches = touches(&blob, &way, Orientation::of_vector(turn));
        let first = touches.iter().position(|is| *is).expect("it comes to it");
        let gap_m = way[first][2] - ahead_m - BALL_M;
        // The skin of the ball is a polyhedron, and a touch begins a tenth of the reach early at most.
        assert!(gap_m < 1.13 * SPHERE.reach_m() && gap_m > SPHERE.reach_m() - 2e-3, "{turn:?}: {gap_m}");
    }
    // One end is inside.
    let way = along(&[[0.06, 0.0, 0.0], [0.06, 0.0, 0.0205]]);
    assert!(touches(&blob, &way, Orientation::IDENTITY).iter().all(|is| !is));
}

/// The cap of the ball below z = -0.03 is fixed.
#[test]
fn a_tool_that_goes_through_the_fixed_part_touches_nothing_until_it_has_left() {
    let body = sphere(BALL_M, 3);
    let fixed: Vec<u8> = body.0.iter().map(|place_m| u8::from(place_m[2] < -0.03)).collect();
    let half_axis_m = [0.0, 0.0, 0.012];
    for (tool, ahead_m) in
        [(Tool::Sphere(SPHERE), 0.0), (Tool::Capsule(Capsule { sphere: SPHERE, half_axis_m }), 0.012)]
    {
        let bare = Recipe {
            lattice_table: false,
            rbf: false,
            hermite: false,
            displacement: false,
            ..Recipe::default()
        };
        let recipe = Recipe { nodes: body.0[..1].to_vec(), body: Some(body.clone()), ..bare };
        let blob = recipe.blob_with(|draft| {
            draft.preamble.tool = tool;
            draft.preamble.surface.fixed = draft.area.push(&fixed);
        });
        let at = |z: f32| [0.001, 0.002, z];
        let way = along(&[at(-0.08), at(-0.03), at(-0.09), at(-0.045 - ahead_m)]);
        let touches = touches(&blob, &way, Orientation::IDENTITY);
        let inside = way.iter().position(|place_m| place_m[2] + ahead_m > -0.038).expect("it goes in");
        let out =
            way.iter().skip(inside).position(|place_m| place_m[2] < -0.085).expect("it leaves") + inside;
        let outside = way.iter().position(|place_m| place_m[2] + ahead_m > -0.042).expect("it comes");
        assert!(touches[outside] && touches[inside..out].iter().all(|is| !is), "{touches:?}");
        assert_eq!(touches.last(), Some(&true));
        // Elsewhere the skin gives way.
        let soft = along(&[[0.001, 0.002, 0.08], [0.001, 0.002, 0.03]]);
        assert_eq!(self::touches(&blob, &soft, Orientation::IDENTITY).last(), Some(&true));
    }
}
