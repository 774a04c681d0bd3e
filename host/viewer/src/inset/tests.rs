//! The side view of a synthetic organ, pixel by pixel.

use super::*;
use crate::camera::OrbitCamera;
use crate::synthetic::{self, Shape};
use palpate_core::NodeWeight;

const SIZE: [usize; 2] = [1280, 720];

fn drawn(tool: Tool, depth_m: f32, is_engaged: bool, size: [usize; 2]) -> (Image, Option<Frame>) {
    drawn_with(tool, depth_m, is_engaged, size, |_| Regions::default())
}

/// The side view of the first active node, pressed by the tool to a depth, with the frame. The regions
/// follow from the touched place.
fn drawn_with(
    tool: Tool,
    depth_m: f32,
    is_engaged: bool,
    [width, height]: [usize; 2],
    regions: impl Fn(&Touched) -> Regions,
) -> (Image, Option<Frame>) {
    let shape = Shape { subdivisions: 5, ..Shape::default() };
    let blob = synthetic::organ(&shape);
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let active = &organ.spaces[0].active;
    let normal = Vec3::from_array(active.outward_normal);
    let contact_m = Vec3::from_array(active.rest_position_m);
    let touched =
        Touched { tool_m: contact_m - normal * depth_m, reach_m: 0.0, contact_m, normal, is_engaged };
    let mut surface = Deformation::at_rest(&organ);
    let whole = NodeWeight { space: 0, weight: f32::from(u8::from(is_engaged)) };
    let shares = [whole, NodeWeight::default(), NodeWeight::default()];
    surface.update(&organ, &shares, (-normal * depth_m).to_array());
    let camera = OrbitCamera::framing(Vec3::ZERO, 0.1, Vec3::new(0.1, -1.0, 0.3), Vec3::Z);
    let mut image = Image::new(width, height);
    let mut inset = Inset::new(&organ);
    inset.set_regions(&regions(&touched));
    let skin = (&surface, organ.surface.triangles);
    inset.draw((&touched, tool), skin, &camera.projection(width, height), &mut image);
    let frame = Frame::of(&image, inset.width_m);
    (image, frame)
}

/// Rows of a column with a colour, from the top.
fn rows(image: &Image, x: f32, is: impl Fn(i32, i32, i32) -> bool) -> Vec<usize> {
    let channel = |pixel: u32, shift: u32| (pixel >> shift & 255) as i32;
    let has = |y: &usize| {
        image.pixel(x as usize, *y).is_some_and(|p| is(channel(p, 16), channel(p, 8), channel(p, 0)))
    };
    (0..image.height()).filter(has).collect()
}

/// The thick line is the skin now, where the node is at the depth of the tool; the thin one is at rest.
#[test]
fn skin_and_tool_are_at_their_depths() {
    for depth_m in [0.004_f32, 0.009] {
        let (image, frame) = drawn(Tool::Ball(0.003), depth_m, true, SIZE);
        let frame = frame.expect("it fits");
        // Between the tool and the dimension, 4 mm beside the node.
        let beside = |depth_m: f32| frame.pixel(Vec2::new(-0.004, -depth_m));
        let skin = rows(&image, beside(0.0).x, |r, g, b| r > 200 && g > 120 && b < 150 && r - b > 80);
        let rest = rows(&image, beside(0.0).x, |r, g, b| r > 120 && (r - b).abs() < 30 && (r - g).abs() < 30);
        // The synthetic dent is 1 / (1 + r^2 / reach^2) of the depth, and the body curves away.
        let dent_m = depth_m / (1.0 + (0.004_f32 / 0.024).powi(2));
        let (at_rest, pressed) = (beside(0.0).y, beside(dent_m).y);
        assert!(!rest.is_empty() && (rest[0] as f32 - at_rest).abs() < 4.0, "{rest:?} {at_rest}");
        assert!(skin.iter().any(|y| (*y as f32 - pressed).abs() < 4.0), "{skin:?} {pressed}");
        let tool = frame.pixel(Vec2::new(0.0, -depth_m));
        let ball = rows(&image, tool.x, |r, g, b| r > 180 && g > 215 && b > 230);
        let middle = 0.5 * (ball[0] + ball[ball.len() - 1]) as f32;
        assert!((middle - tool.y).abs() <= 1.5, "{ball:?} {}", tool.y);
        // The section is 1.2 grid radii of 40 mm wide, in 286 pixels, and has the same scale across and down.
        let below = middle - frame.pixel(Vec2::ZERO).y;
        assert!((below - depth_m * 286.0 / 0.048).abs() <= 1.5, "{below}");
    }
}

/// A pad is as wide as it is, from its arc to its face.
#[test]
fn a_pad_has_its_size() {
    let (pad_m, depth_m) = (0.010, 0.005);
    let (image, frame) = drawn(Tool::Fingertip(pad_m), depth_m, true, SIZE);
    let frame = frame.expect("it fits");
    let edge = |r: i32, g: i32, b: i32| r > 110 && g > 150 && b > 160;
    let top = rows(&image, frame.pixel(Vec2::ZERO).x, edge);
    let [arc, face] = [PAD_HEIGHT * pad_m - depth_m, -depth_m].map(|y| frame.pixel(Vec2::new(0.0, y)).y);
    assert!((top[0] as f32 - arc).abs() < 2.5, "{top:?} {arc}");
    assert!((top[top.len() - 1] as f32 - face).abs() < 2.5, "{top:?} {face}");
    let y = face as usize;
    let row: Vec<usize> = (frame.left as usize..(frame.left + frame.width) as usize)
        .filter(|x| !rows(&image, *x as f32, edge).iter().all(|row| row.abs_diff(y) > 1))
        .collect();
    let width = (row[row.len() - 1] - row[0]) as f32;
    // The lines of the dimension begin beside the pad.
    let expected = 2.0 * pad_m * frame.per_m;
    assert!(width > expected - 3.0 && width < expected + 24.0, "{width} {expected}");
}

/// A region of 8 mm, 12 mm below the touched place: its boundary is where it is, and it is named. One
/// elsewhere is neither drawn nor named.
#[test]
fn a_region_is_drawn_where_it_is() {
    let octahedron = |middle_m: Vec3| {
        let corners = [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z];
        let triangles =
            vec![[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]];
        let offset_m = corners.map(|corner| (middle_m + 0.004 * corner).to_array()).to_vec();
        Regions { offset_m, weights: vec![Vec::new(); 6], triangles }
    };
    let violet = |r: i32, g: i32, b: i32| b > 150 && b - g > 40 && r > g;
    let drawn = |depth_m: f32| {
        let middle = |touched: &Touched| touched.contact_m - touched.normal * depth_m;
        drawn_with(Tool::Ball(0.003), 0.004, true, SIZE, |touched| octahedron(middle(touched)))
    };
    let (image, frame) = drawn(0.012);
    let frame = frame.expect("it fits");
    let found = rows(&image, frame.pixel(Vec2::ZERO).x, violet);
    let [top, bottom] = [-0.008, -0.016].map(|y| frame.pixel(Vec2::new(0.0, y)).y);
    // A section of an octahedron reaches between 1 / sqrt 3 and all of its half axis from its middle.
    let middle = 0.5 * (top + bottom);
    let half = 0.5 * (bottom - top);
    let [above, below] = [middle - found[0] as f32, found[found.len() - 1] as f32 - middle];
    assert!((0.55 * half..1.05 * half + 1.0).contains(&above), "{found:?} {top} {bottom}");
    assert!((0.55 * half..1.05 * half + 1.0).contains(&below), "{found:?} {top} {bottom}");
    let note = |image: &Image| {
        let columns = (frame.left + 0.6 * frame.width) as usize..(frame.left + frame.width) as usize;
        columns.filter(|x| rows(image, *x as f32, violet).iter().any(|y| *y > 670)).count()
    };
    let (elsewhere, _) = drawn(0.070);
    assert!(note(&image) > 20 && note(&elsewhere) == 0, "{} {}", note(&image), note(&elsewhere));
}

/// Without room, or with a free tool far away, there is no side view; near the skin there is.
#[test]
fn it_is_drawn_where_it_has_room_and_a_use() {
    let lit = |depth_m, is_engaged, size| {
        let (image, _) = drawn(Tool::Ball(0.003), depth_m, is_engaged, size);
        image.pixels().iter().filter(|pixel| **pixel != 0).count()
    };
    assert!(lit(0.004, true, SIZE) > 20_000 && lit(-0.004, false, SIZE) > 20_000);
    assert_eq!(lit(-0.04, false, SIZE), 0);
    for size in [[1, 1], [200, 900], [720, 720], [16, 9]] {
        lit(0.004, true, size);
    }
    assert_eq!(lit(0.004, true, [720, 720]), 0);
}

#[test]
fn the_depth_is_told_in_words() {
    let touched = |depth_m: f32, is_engaged| Touched {
        tool_m: Vec3::Z * -depth_m,
        reach_m: 0.0,
        contact_m: Vec3::ZERO,
        normal: Vec3::Z,
        is_engaged,
    };
    let words = [(0.00512, true), (-0.0131, true), (-0.00001, true), (-0.002, false)]
        .map(|(depth_m, is_engaged)| depth_in_words(&touched(depth_m, is_engaged)));
    assert_eq!(words, ["5.1 mm deep", "13.1 mm out", "0.0 mm deep", "not touching"]);
}
