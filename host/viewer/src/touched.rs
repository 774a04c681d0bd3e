//! Where the tool touches: contact point, normal of the skin, and depth.

use glam::Vec3;
use palpate_core::format::Sphere;
use palpate_core::{Organ, nearest_on_triangle, vec3};
use palpate_host::rt::TickRecord;

/// Places on half of the axis of a capsule that are compared.
const AXIS_STEPS: i16 = 4;

/// The place of an axis through the origin that is nearest to a point; the origin if the axis has no length.
pub(super) fn nearest_on_axis(half_m: Vec3, point_m: Vec3) -> Vec3 {
    let length2 = half_m.length_squared();
    if length2 > 0.0 { half_m * (point_m.dot(half_m) / length2).clamp(-1.0, 1.0) } else { Vec3::ZERO }
}

/// The tool relative to the skin at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Touched {
    /// The tool, m: of a fingertip the middle of its pad, of a sphere its centre, of a capsule the deepest place of its axis.
    pub(super) tool_m: Vec3,
    /// Distance from there to what touches, m: the reach of a sphere.
    pub(super) reach_m: f32,
    /// The contact point on the skin at rest, m. Of a free tool, the nearest place that can be touched.
    pub(super) contact_m: Vec3,
    /// Outward unit normal of the skin there.
    pub(super) normal: Vec3,
    /// Whether it touches.
    pub(super) is_engaged: bool,
}

impl Touched {
    /// The place of a record; `None` for an organ without active nodes.
    ///
    /// Touched: x_c = HIP - d, and n = sum w_i n_i over the engaged spaces.
    ///
    /// A capsule has the half axis `half_m`; other tools have none.
    pub(super) fn of<const N: usize>(
        organ: &Organ<'_, N>,
        record: &TickRecord,
        half_m: Vec3,
    ) -> Option<Self> {
        let tool_m = Vec3::from_array(record.hip_m);
        if let Some(sphere) = organ.tool.sphere() {
            let steps: i16 = if half_m == Vec3::ZERO { 0 } else { AXIS_STEPS };
            let places =
                (-steps..=steps).map(|step| tool_m + half_m * (f32::from(step) / f32::from(steps.max(1))));
            let all = places.filter_map(|centre_m| Self::of_sphere(organ, sphere, centre_m, record));
            return all.max_by(|one, other| one.depth_m().total_cmp(&other.depth_m()));
        }
        let engaged = record.engaged.and_then(|index| organ.spaces.get(usize::from(index)));
        let Some(engaged) = engaged else {
            let away = |place_m: [f32; 3]| vec3::distance(place_m, record.hip_m);
            let nearest = organ
                .spaces
                .iter()
                .map(|space| &space.active)
                .min_by(|one, other| away(one.rest_position_m).total_cmp(&away(other.rest_position_m)))?;
            let contact_m = Vec3::from_array(nearest.rest_position_m);
            let normal = Vec3::from_array(nearest.outward_normal);
            return Some(Self { tool_m, reach_m: 0.0, contact_m, normal, is_engaged: false });
        };
        let shares = record.shares.iter().filter(|share| share.weight > 0.0);
        let normals = shares.filter_map(|share| {
            let space = organ.spaces.get(usize::from(share.space))?;
            Some(Vec3::from_array(space.active.outward_normal) * share.weight)
        });
        let normal = normals.sum::<Vec3>().try_normalize();
        Some(Self {
            tool_m,
            reach_m: 0.0,
            contact_m: tool_m - Vec3::from_array(record.displacement_m),
            normal: normal.unwrap_or(Vec3::from_array(engaged.active.outward_normal)),
            is_engaged: true,
        })
    }

    /// A sphere at the point of the skin at rest that is nearest to its centre.
    fn of_sphere<const N: usize>(
        organ: &Organ<'_, N>,
        sphere: Sphere,
        tool_m: Vec3,
        record: &TickRecord,
    ) -> Option<Self> {
        let [x, y, z] = organ.surface.position_m;
        let at = |vertex: u32| [x, y, z].map(|plane| plane.get(vertex as usize).copied().unwrap_or(0.0));
        let nearest = |corners: &[u32; 3]| {
            let corners = corners.map(at);
            (Vec3::from_array(nearest_on_triangle(corners, tool_m.to_array())), corners.map(Vec3::from_array))
        };
        let away = |point_m: &Vec3| point_m.distance_squared(tool_m);
        let all = organ.surface.triangles.iter().map(nearest);
        let (contact_m, [a, b, c]) = all.min_by(|one, other| away(&one.0).total_cmp(&away(&other.0)))?;
        let outward = (b - a).cross(c - a).normalize_or_zero();
        let towards = (tool_m - contact_m).normalize_or(outward);
        let normal = if towards.dot(outward) < 0.0 { -towards } else { towards };
        let touched = Self { tool_m, reach_m: sphere.reach_m(), contact_m, normal, is_engaged: false };
        let is_engaged = record.reaction_n != vec3::ZERO && touched.depth_m() > 0.0;
        Some(Self { is_engaged, ..touched })
    }

    /// Depth of the tool below the skin at rest, m; negative outside. Of a sphere, that of its lowest point.
    pub(super) fn depth_m(&self) -> f32 {
        self.below_m() + self.reach_m
    }

    /// Depth of its place below the skin at rest, -d.n, m; negative outside.
    pub(super) fn below_m(&self) -> f32 {
        (self.contact_m - self.tool_m).dot(self.normal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{self, Shape};
    use palpate_core::NodeWeight;

    #[test]
    fn the_depth_is_the_displacement_along_the_normal() {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let active = &organ.spaces[1].active;
        let (normal, rest_m) =
            (Vec3::from_array(active.outward_normal), Vec3::from_array(active.rest_position_m));
        let aside = normal.any_orthonormal_vector();
        let d = aside * 0.004 - normal * 0.006;
        let record = TickRecord {
            hip_m: (rest_m + d).to_array(),
            displacement_m: d.to_array(),
            engaged: Some(1),
            shares: [NodeWeight { space: 1, weight: 1.0 }, NodeWeight::default(), NodeWeight::default()],
            ..TickRecord::EMPTY
        };
        let touched = Touched::of(&organ, &record, Vec3::ZERO).expect("active nodes");
        assert!((touched.depth_m() - 0.006).abs() < 1e-6 && touched.is_engaged);
        assert!(touched.contact_m.distance(rest_m) < 1e-6 && touched.normal.distance(normal) < 1e-5);
        // Between two places the normal is between theirs.
        let half = |space| NodeWeight { space, weight: 0.5 };
        let record = TickRecord { shares: [half(0), half(1), NodeWeight::default()], ..record };
        let between = Touched::of(&organ, &record, Vec3::ZERO).expect("active nodes").normal;
        let other = Vec3::from_array(organ.spaces[0].active.outward_normal);
        assert!((between.dot(normal) - between.dot(other)).abs() < 1e-5 && between.dot(normal) < 0.999);
        // A free tool is above the nearest place.
        let record =
            TickRecord { hip_m: (rest_m + 0.010 * normal).to_array(), engaged: None, ..TickRecord::EMPTY };
        let free = Touched::of(&organ, &record, Vec3::ZERO).expect("active nodes");
        assert!((free.depth_m() + 0.010).abs() < 1e-6 && !free.is_engaged && free.contact_m == rest_m);
    }
}
