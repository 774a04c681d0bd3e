//! Choice of the initial view of an organ: the place where a session opens is visible, strokes are in profile,
//! the long axis is across the picture, and the fixed part is visible.

use super::camera::OrbitCamera;
use super::pick;
use crate::deformation::Deformation;
use glam::{Vec2, Vec3};
use palpate_core::{Organ, Space};
use palpate_host::first_place::{MAX_NAMED, first_place};

/// Number of directions tried round the up axis.
const AZIMUTHS: usize = 48;
/// Elevations tried, rad.
const ELEVATIONS: [f32; 2] = [0.26, 0.44];
/// Elevations tried if none of the others shows that place, rad.
const STEEPER: [f32; 3] = [0.70, 0.95, -0.20];
/// Smallest cosine between the view and the normal of that place.
const MIN_FACING: f32 = 0.5;
/// Largest thickness of surface between the eye and a visible active node, in radii of the organ.
const MAX_COVER: f32 = 0.02;
/// Cosine between the view and the normal of an active node at which strokes are seen best: neither end-on
/// nor hidden.
const PROFILE: f32 = 0.5;
/// Free area of the picture, across and down, as a share of its size; the rest is for text.
const FREE_AREA: Vec2 = Vec2::new(0.60, 0.64);
/// Space for tool and arrow above an active node, in radii of the organ.
const MARKER_SPACE: f32 = 0.30;

/// A camera with the whole organ in the free area of the picture.
///
/// If such a view exists, the place where a session opens ([`first_place`]) faces the eye and is not hidden, so
/// that the user sees where to touch. A model does not define the up direction. The organ's long axis is across
/// the picture, seen from the side that the active nodes face, and the model axis nearest to the resulting up
/// direction becomes up.
#[must_use]
pub fn choose<const N: usize>(organ: &Organ<'_, N>, rest: &Deformation, aspect: f32) -> OrbitCamera {
    let (centre_m, radius_m) = bounds(rest);
    let first = organ.spaces.get(first_place(organ));
    let shown = shown(organ);
    let normals: Vec<Vec3> =
        shown.iter().map(|space| Vec3::from_array(space.active.outward_normal)).collect();
    let up = up_axis(&normals, longest_axis(rest.rest_m(), centre_m));
    // The other nodes may face elsewhere; the first must not be on the underside.
    let up = if normals.first().is_some_and(|first| up.dot(*first) < -0.25) { -up } else { up };
    let fixed: Vec<Vec3> = rest
        .normal()
        .iter()
        .zip(organ.surface.fixed)
        .filter(|(_, fixed)| **fixed != 0)
        .map(|(normal, _)| *normal)
        .collect();
    let camera = |azimuth: usize, elevation_rad: f32| {
        let mut camera = OrbitCamera::framing(centre_m, radius_m, up.any_orthonormal_vector(), up);
        camera.azimuth_rad = core::f32::consts::TAU * azimuth as f32 / AZIMUTHS as f32;
        camera.elevation_rad = elevation_rad;
        camera
    };
    let merit = |camera: &OrbitCamera| {
        let projection = camera.projection(1, 1);
        let view = projection.to_eye.row(2);
        let right = projection.to_eye.row(0);
        let (low, high) = rest
            .rest_m()
            .iter()
            .map(|point| right.dot(*point - centre_m))
            .fold((0.0_f32, 0.0_f32), |(low, high), x| (low.min(x), high.max(x)));
        let width = (high - low) / (2.0 * radius_m);
        profile(&normals, view) + 1.4 * width + 0.35 * share_in_sight(&fixed, view)
    };
    // The best view that shows the first active node. The visibility is tested for few views, because it
    // tests every triangle.
    let best = |elevations: &[f32]| {
        let all =
            elevations.iter().flat_map(|elevation| (0..AZIMUTHS).map(|azimuth| camera(azimuth, *elevation)));
        let mut ranked: Vec<(f32, OrbitCamera)> = all.map(|camera| (merit(&camera), camera)).collect();
        ranked.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        let framed = ranked.into_iter().map(|(_, camera)| OrbitCamera {
            distance_m: distance_m(shown, rest, &camera, aspect),
            ..camera
        });
        framed
            .into_iter()
            .find(|camera| first.is_none_or(|space| shows(camera, organ, rest, space, MAX_COVER * radius_m)))
    };
    best(&ELEVATIONS).or_else(|| best(&STEEPER)).unwrap_or_else(|| {
        // The node is at the bottom of a hole: look straight into it.
        let facing = normals.first().copied().unwrap_or(Vec3::ZERO);
        let camera = OrbitCamera::framing(centre_m, radius_m, facing, up);
        OrbitCamera { distance_m: distance_m(shown, rest, &camera, aspect), ..camera }
    })
}

/// The active nodes that a view is chosen for: all of a few. Many face every way, so of these it is the first place.
fn shown<'s, 'o, const N: usize>(organ: &'s Organ<'o, N>) -> &'s [Space<'o>] {
    let first = first_place(organ);
    if organ.spaces.len() > MAX_NAMED { &organ.spaces[first..=first] } else { &organ.spaces }
}

/// Whether an active node faces this camera and no surface thicker than `skin_m` hides it.
fn shows<const N: usize>(
    camera: &OrbitCamera,
    organ: &Organ<'_, N>,
    rest: &Deformation,
    space: &Space<'_>,
    skin_m: f32,
) -> bool {
    let eye_m = camera.projection(1, 1).eye_m;
    let away = Vec3::from_array(space.active.rest_position_m) - eye_m;
    let direction = away.normalize_or_zero();
    if -direction.dot(Vec3::from_array(space.active.outward_normal)) < MIN_FACING {
        return false;
    }
    let hit = pick::hit(rest.rest_m(), organ.surface.triangles, (eye_m, direction));
    hit.is_none_or(|hit| hit.distance_m > away.length() - skin_m)
}

/// Centre and radius of the bounding box; a default size for a blob without a surface.
#[must_use]
pub fn bounds(rest: &Deformation) -> (Vec3, f32) {
    box_of(rest.rest_m())
}

/// Centre and radius of the bounding box of points; a default size for none.
pub(super) fn box_of(points_m: &[Vec3]) -> (Vec3, f32) {
    let low = points_m.iter().copied().fold(Vec3::INFINITY, Vec3::min);
    let high = points_m.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
    if points_m.is_empty() {
        return (Vec3::ZERO, 0.1);
    }
    (0.5 * (low + high), (0.5 * (high - low).length()).max(1e-6))
}

/// The up axis of the model when the long axis is across and the active nodes face the eye.
pub(super) fn up_axis(normals: &[Vec3], long: Vec3) -> Vec3 {
    let facing =
        normals.iter().sum::<Vec3>().try_normalize().unwrap_or(Vec3::new(0.3, -1.0, 0.4).normalize());
    let across = (long - facing * long.dot(facing)).normalize_or(facing.any_orthonormal_vector());
    let above = facing.cross(across);
    let nearest = |a: &Vec3, b: &Vec3| above.dot(*a).abs().total_cmp(&above.dot(*b).abs());
    let axis = Vec3::AXES.into_iter().max_by(nearest).unwrap_or(Vec3::Z);
    // If the active nodes clearly face up or down, they are put on the upper, illuminated side.
    if axis.dot(facing) < -0.25 { -axis } else { axis }
}

/// 1 if every stroke is seen in profile; below 0 if it is seen end-on or from behind.
fn profile(normals: &[Vec3], view: Vec3) -> f32 {
    let merit = |normal: &Vec3| {
        let deviation = (normal.dot(view) - PROFILE) / 0.5;
        (1.0 - deviation * deviation).max(-1.5)
    };
    normals.iter().map(merit).sum::<f32>() / normals.len().max(1) as f32
}

fn share_in_sight(normals: &[Vec3], view: Vec3) -> f32 {
    normals.iter().filter(|normal| normal.dot(view) > 0.1).count() as f32 / normals.len().max(1) as f32
}

/// Smallest distance at which every point is inside the free area: |x| f <= share (D - z), solved for D.
fn distance_m(shown: &[Space<'_>], rest: &Deformation, camera: &OrbitCamera, aspect: f32) -> f32 {
    let (_, radius_m) = bounds(rest);
    let projection = camera.projection(1, 1);
    let share = FREE_AREA * Vec2::new(aspect, 1.0) * (0.5 * camera.field_of_view_rad).tan();
    let hands = shown.iter().map(|space| {
        Vec3::from_array(space.active.rest_position_m)
            + Vec3::from_array(space.active.outward_normal) * (MARKER_SPACE * radius_m)
    });
    rest.rest_m()
        .iter()
        .copied()
        .chain(hands)
        .map(|point| projection.to_eye * (point - camera.target_m))
        .map(|eye| eye.z + (eye.x.abs() / share.x).max(eye.y.abs() / share.y))
        .fold(0.2 * radius_m, f32::max)
}

/// Direction of the largest extent of a surface: power iteration on its covariance.
pub(super) fn longest_axis(points_m: &[Vec3], centre_m: Vec3) -> Vec3 {
    let mut axis = Vec3::new(0.6, 0.5, 0.4);
    for _ in 0..50 {
        let next: Vec3 = points_m.iter().map(|point| *point - centre_m).map(|p| p * p.dot(axis)).sum();
        axis = next.normalize_or(Vec3::X);
    }
    axis
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{self, Shape};

    #[test]
    fn all_points_are_in_the_free_area_and_the_nodes_face_the_eye() {
        for half_axes_m in [[0.085, 0.060, 0.045], [0.03, 0.12, 0.04], [0.02, 0.03, 0.09]] {
            let blob = synthetic::organ(&Shape { half_axes_m, ..Shape::default() });
            let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
            let rest = Deformation::at_rest(&organ);
            let projection = choose(&organ, &rest, 16.0 / 9.0).projection(1280, 720);
            let mut reached = Vec2::ZERO;
            for point in rest.rest_m() {
                let (pixel, _) = projection.project(*point).expect("in front");
                reached = reached.max((pixel - projection.centre_px).abs() / projection.centre_px);
            }
            assert!(reached.x <= FREE_AREA.x + 1e-3 && reached.y <= FREE_AREA.y + 1e-3, "{reached}");
            assert!(reached.x > 0.35 || reached.y > 0.35, "the organ is not tiny: {reached}");
            let view = projection.to_eye.row(2);
            let seen = organ
                .spaces
                .iter()
                .filter(|space| Vec3::from_array(space.active.outward_normal).dot(view) > 0.0);
            assert!(seen.count() >= 2);
        }
    }

    /// Independent test of the visibility of the first active node: its triangle is the first on the line of
    /// sight.
    fn first_is_visible(organ: &Organ<'_>) -> Result<OrbitCamera, String> {
        let rest = Deformation::at_rest(organ);
        let camera = choose(organ, &rest, 16.0 / 9.0);
        let eye_m = camera.projection(1280, 720).eye_m;
        let node_m = Vec3::from_array(organ.spaces[0].active.rest_position_m);
        let between = rest.rest_m().iter().filter(|point| {
            let along = (**point - eye_m).dot((node_m - eye_m).normalize());
            let deviation = (**point - eye_m - along * (node_m - eye_m).normalize()).length();
            along < eye_m.distance(node_m) - 0.010 && deviation < 0.004
        });
        let facing =
            Vec3::from_array(organ.spaces[0].active.outward_normal).dot((eye_m - node_m).normalize());
        match between.count() {
            0 if facing > 0.3 && (-0.3..1.0).contains(&camera.elevation_rad) => Ok(camera),
            hiding => Err(format!("{hiding} points hide it, facing {facing}, {camera:?}")),
        }
    }

    /// The first node is at any vertex, and the others are on the opposite side.
    #[test]
    fn the_first_active_node_is_visible() {
        let shape = Shape { subdivisions: 4, ..Shape::default() };
        let blob = synthetic::organ(&shape);
        let mut organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let [x, y, z] = organ.surface.position_m;
        for vertex in (0..x.len()).step_by(101) {
            let place_m = Vec3::new(x[vertex], y[vertex], z[vertex]);
            let half_m = Vec3::from_array(shape.half_axes_m);
            let normal = (place_m / (half_m * half_m)).normalize();
            for (index, space) in organ.spaces.iter_mut().enumerate() {
                let sign = if index == 0 { 1.0 } else { -1.0 };
                space.active.rest_position_m = (sign * place_m).to_array();
                space.active.outward_normal = (sign * normal).to_array();
            }
            first_is_visible(&organ).unwrap_or_else(|why| panic!("vertex {vertex} at {place_m}: {why}"));
        }
    }

    /// A lobe at the position of the default view.
    #[test]
    fn a_view_past_a_lobe_in_front_of_the_first_node_is_found() {
        let blob = synthetic::organ(&Shape { subdivisions: 4, ..Shape::default() });
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let plain = first_is_visible(&organ).expect("an ellipsoid hides nothing");
        let node_m = Vec3::from_array(organ.spaces[0].active.rest_position_m);
        let towards = (plain.projection(1, 1).eye_m - node_m).normalize();
        let lobe_m = node_m + 0.04 * towards;
        let surface = organ.surface;
        let count = surface.node.len() as u32;
        let planes: [Vec<f32>; 3] = core::array::from_fn(|axis| {
            let own = surface.position_m[axis];
            own.iter().copied().chain(own.iter().map(|x| lobe_m[axis] + 0.25 * x)).collect()
        });
        let nodes: Vec<u32> = (0..2 * count).collect();
        let fixed = vec![0; nodes.len()];
        let lobe = surface.triangles.iter().map(|triangle| triangle.map(|corner| corner + count));
        let triangles: Vec<[u32; 3]> = surface.triangles.iter().copied().chain(lobe).collect();
        let [x, y, z] = &planes;
        let mut organ = organ.clone();
        organ.surface = palpate_core::Surface {
            node: &nodes,
            position_m: [x, y, z],
            triangles: &triangles,
            fixed: &fixed,
        };
        // The blob's displacement modes do not include the lobe.
        for space in &mut organ.spaces {
            let planes = palpate_core::SpacePlanes { displacement: None, ..space.planes() };
            *space = Space::new(space.active.clone(), *space.lattice(), planes, 0).expect("valid planes");
        }
        let rest = Deformation::at_rest(&organ);
        assert!(!shows(&plain, &organ, &rest, &organ.spaces[0], 0.002), "it is behind the lobe");
        let around = first_is_visible(&organ).unwrap_or_else(|why| panic!("{why}"));
        assert_ne!((around.azimuth_rad, around.elevation_rad), (plain.azimuth_rad, plain.elevation_rad));
    }

    #[test]
    fn the_longest_axis_is_found() {
        let blob = synthetic::organ(&Shape { half_axes_m: [0.02, 0.09, 0.03], ..Shape::default() });
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let rest = Deformation::at_rest(&organ);
        assert!(longest_axis(rest.rest_m(), bounds(&rest).0).y.abs() > 0.99);
    }
}
