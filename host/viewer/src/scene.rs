//! The objects in the picture: deformed organ, ghost of its rest shape, nodes, tool and force.

use super::camera::Projection;
use super::image::{Image, StrokeMask};
use super::material::Material;
use super::palette::{ColourMap, linear};
use super::raster::{Raster, Vertex};
use super::reach::Reach;
use super::shapes::Shapes;
use super::smooth::Smooth;
use super::tool::Tool;
use super::touched::Touched;
use super::viewpoint;
use crate::deformation::Deformation;
use glam::{Vec2, Vec3};
use palpate_core::{Organ, Space, vec3};
use palpate_host::first_place::MAX_NAMED;
use palpate_host::rt::TickRecord;

/// Colour of the force, here and in the overlay.
pub const FORCE_COLOUR: u32 = 0x57_d2ea;
/// Colour of active nodes.
pub const ACTIVE_COLOUR: u32 = 0xf2_efe6;
/// Colour of fixed nodes.
pub const FIXED_COLOUR: u32 = 0x4a_6788;
/// Colour of the ghost.
const GHOST_COLOUR: u32 = 0xdf_e9f2;
/// Smallest force that is drawn as an arrow, N.
const MIN_FORCE_N: f32 = 0.02;
/// Full length of the force arrow for an organ without a force limit.
const USUAL_MAX_FORCE_N: f32 = 5.0;

/// Smallest displacement at which the ghost is drawn, as a share of the colour map's full scale.
const MIN_GHOST: f32 = 0.06;
/// Opacity of the ghost's mesh relative to its outline.
const GHOST_MESH: f32 = 0.42;

/// Radius of the marker of an active node, in radii of the organ.
const MARKER: f32 = 0.018;
/// Radius of the markers of many contact points, which must not cover the organ.
const DOT: f32 = 0.005;
/// Edge length below which the mesh is not drawn, pixels of a picture 720 high; from twice this length its
/// opacity is full.
const MIN_EDGE_PX: f32 = 12.0;

/// Edge of a surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edge {
    pub(super) ends: [u32; 2],
    /// Normals of the triangles on both sides; on a border both are equal.
    pub(super) normals: [Vec3; 2],
}

/// Data that is constant during a session, and reused buffers.
#[derive(Debug, Clone)]
pub struct Scene {
    radius_m: f32,
    edges: Vec<Edge>,
    smooth: Smooth,
    fixed: Vec<bool>,
    /// Variation of the tissue's colour at each vertex.
    colour_variation: Vec<f32>,
    /// Surface vertex of each active node.
    active: Vec<Option<usize>>,
    /// Mean length of an edge, m.
    edge_m: f32,
    map: ColourMap,
    vertices: Vec<Vertex>,
    shapes: Shapes,
    mask: StrokeMask,
    reach: Reach,
    tool: Tool,
}

impl Scene {
    /// Prepares the data of an organ.
    #[must_use]
    pub fn new<const N: usize>(organ: &Organ<'_, N>, rest: &Deformation) -> Self {
        let (_, radius_m) = viewpoint::bounds(rest);
        let edges = edges(organ.surface.triangles, rest.rest_m());
        let length_m = |edge: &Edge| {
            let [a, b] = edge.ends.map(|vertex| rest.rest_m()[vertex as usize]);
            a.distance(b)
        };
        let active =
            organ.spaces.iter().map(|space| organ.surface.node.iter().position(|n| *n == space.active.node));
        Self {
            radius_m,
            edge_m: edges.iter().map(length_m).sum::<f32>() / edges.len().max(1) as f32,
            edges,
            colour_variation: rest.rest_m().iter().map(|rest_m| colour_variation(*rest_m)).collect(),
            active: active.collect(),
            smooth: Smooth::new(organ.surface.triangles, rest.rest_m().len()),
            fixed: organ.surface.fixed.iter().map(|fixed| *fixed != 0).collect(),
            map: ColourMap::new(),
            vertices: Vec::new(),
            shapes: Shapes::default(),
            mask: StrokeMask::default(),
            reach: Reach::default(),
            tool: Tool::new(organ.tool, radius_m),
        }
    }

    /// The colour map of the organ.
    #[must_use]
    pub const fn map(&self) -> &ColourMap {
        &self.map
    }

    /// The tool.
    pub(super) const fn tool(&self) -> Tool {
        self.tool
    }

    /// Draws all solids. `full_scale_m` is the displacement at the bright end of the colour map.
    pub fn draw_solids<const N: usize>(
        &mut self,
        raster: &mut Raster,
        organ: &Organ<'_, N>,
        surface: &Deformation,
        record: &TickRecord,
        full_scale_m: f32,
    ) {
        let fixed = linear(FIXED_COLOUR);
        self.vertices.clear();
        self.vertices.extend(surface.position_m().iter().zip(surface.normal()).enumerate().map(
            |(i, (&position_m, &normal))| {
                let own = self.map.linear(surface.magnitude_m(i) / full_scale_m) * self.colour_variation[i];
                let albedo = if self.fixed.get(i) == Some(&true) { fixed } else { own };
                Vertex { position_m, normal, albedo }
            },
        ));
        self.smooth.refine(&mut self.vertices);
        raster.draw(&self.vertices, self.smooth.triangles(), Material::Tissue);

        for (i, space) in places(organ) {
            let Some(radius) = marker(i, organ.spaces.len(), record) else { continue };
            let at_m = self.marker_m(surface, i, space);
            let radius_m = radius * self.radius_m;
            self.shapes.sphere(raster, at_m, radius_m, linear(ACTIVE_COLOUR), Material::Plain);
        }
        if let Some(sample) = &record.sample {
            self.tool = self.tool.turned(organ.tool, sample.orientation);
        }
        let hip = Vec3::from_array(record.hip_m);
        let partner = record.live.and_then(|live| live.partner);
        for at_m in
            [Some(hip), partner.map(|partner| Vec3::from_array(partner.position_m))].into_iter().flatten()
        {
            self.tool.draw_solid(&mut self.shapes, raster, at_m);
        }
        self.draw_force(raster, organ, record, hip);
    }

    /// Where an active node is marked: it moves with the nearest vertex of the skin.
    fn marker_m(&self, surface: &Deformation, index: usize, space: &Space<'_>) -> Vec3 {
        let rest_m = Vec3::from_array(space.active.rest_position_m);
        let vertex = self.active.get(index).copied().flatten();
        let moved_m = vertex.and_then(|at| Some(*surface.position_m().get(at)? - *surface.rest_m().get(at)?));
        rest_m + moved_m.unwrap_or(Vec3::ZERO)
    }

    /// Draws the force on the body as in a free-body diagram: a push ends at its point of application, a pull
    /// starts there.
    fn draw_force<const N: usize>(
        &mut self,
        raster: &mut Raster,
        organ: &Organ<'_, N>,
        record: &TickRecord,
        hip: Vec3,
    ) {
        let force_n = Vec3::from_array(record.reaction_n);
        let Some(space) = record.engaged.and_then(|index| organ.spaces.get(usize::from(index))) else {
            return;
        };
        let size_n = force_n.length();
        if size_n < MIN_FORCE_N {
            return;
        }
        let direction = force_n / size_n;
        // The square root keeps a small force visible and the largest force inside the picture.
        let largest_n = if organ.max_force_n.is_finite() { organ.max_force_n } else { USUAL_MAX_FORCE_N };
        let length_m = self.radius_m * 0.52 * (size_n / largest_n).min(1.5).sqrt();
        let gap_m = self.tool.height_m() + 0.010 * self.radius_m;
        let pushes = direction.dot(Vec3::from_array(space.active.outward_normal)) < 0.0;
        let ends = if pushes {
            (hip - direction * (gap_m + length_m), hip - direction * gap_m)
        } else {
            (hip + direction * gap_m, hip + direction * (gap_m + length_m))
        };
        let radius_m = 0.0125 * self.radius_m;
        self.shapes.arrow(raster, ends, radius_m, linear(FORCE_COLOUR), Material::Luminous);
    }

    /// Draws the rest shape where it differs from the present one: its outline, and its mesh faintly.
    pub fn draw_ghost(
        &mut self,
        raster: &Raster,
        projection: &Projection,
        surface: &Deformation,
        full_scale_m: f32,
        image: &mut Image,
    ) {
        if surface.largest_m() < 0.5e-3 {
            return;
        }
        let line = (image.height() as f32 / 720.0).max(0.6);
        let (left, top, width, height) = moved_box(projection, surface, full_scale_m, image);
        self.mask.reset(left, top, width, height);
        // A mesh that is too fine would cover the organ; then only the outline is drawn.
        let distance_m = projection.eye_m.distance(surface.rest_m().first().copied().unwrap_or_default());
        let edge_px = self.edge_m * projection.focal_px / distance_m.max(1e-6) / line;
        let mesh = GHOST_MESH * ((edge_px - MIN_EDGE_PX) / MIN_EDGE_PX).clamp(0.0, 1.0);
        let weight_of = |vertex: u32| {
            let t =
                ((surface.magnitude_m(vertex as usize) / full_scale_m - MIN_GHOST) / 0.30).clamp(0.0, 1.0);
            t * t * (3.0 - 2.0 * t)
        };
        for edge in &self.edges {
            let [weight_a, weight_b] = edge.ends.map(weight_of);
            if weight_a.max(weight_b) <= 0.0 {
                continue;
            }
            let [a, b] = edge.ends.map(|vertex| surface.rest_m()[vertex as usize]);
            let [one, other] = edge.normals.map(|normal| normal.dot(projection.eye_m - a) > 0.0);
            let outline = one != other;
            // Back faces are hidden by the ghost itself.
            let strength = match (outline, one) {
                (true, _) => 1.0,
                (false, true) => mesh,
                (false, false) => 0.0,
            };
            if strength <= 0.0 {
                continue;
            }
            let (Some((from, near_from)), Some((to, near_to))) =
                (projection.project(a), projection.project(b))
            else {
                continue;
            };
            self.mask.segment_where(from.to_array(), to.to_array(), 0.45 * line, |x, y, t| {
                let inverse_depth = near_from + (near_to - near_from) * t;
                let weight = strength * (weight_a + (weight_b - weight_a) * t);
                // Slightly nearer, so that a line on the surface is not interrupted.
                let hidden = raster.inverse_depth_at(x, y) > inverse_depth * 1.002;
                match (hidden, outline) {
                    (false, _) => weight,
                    (true, true) => 0.25 * weight,
                    (true, false) => 0.0,
                }
            });
        }
        self.mask.paint(image, GHOST_COLOUR, 0.62);
    }

    /// Draws the boundary of the reachable region of the touched node, or of the node nearest to a free tool.
    pub fn draw_reach<const N: usize>(
        &mut self,
        view: (&Raster, &Projection),
        organ: &Organ<'_, N>,
        record: &TickRecord,
        image: &mut Image,
    ) {
        let away = |space: &Space<'_>| vec3::distance(space.active.rest_position_m, record.hip_m);
        let engaged = record.engaged.map(usize::from);
        let nearest = || {
            (0..organ.spaces.len()).min_by(|a, b| away(&organ.spaces[*a]).total_cmp(&away(&organ.spaces[*b])))
        };
        let shown = engaged.or_else(nearest).and_then(|index| Some((index, organ.spaces.get(index)?)));
        if let Some(shown) = shown {
            self.reach.draw(shown, view, image);
        }
    }

    /// Pixel of each active node that is visible and not touched.
    pub fn visible_nodes<const N: usize>(
        &self,
        organ: &Organ<'_, N>,
        (raster, projection): (&Raster, &Projection),
        surface: &Deformation,
        record: &TickRecord,
        found: &mut Vec<Option<Vec2>>,
    ) {
        found.clear();
        found.extend(places(organ).map(|(i, space)| {
            let touched = record.engaged.is_some_and(|index| usize::from(index) == i);
            let (pixel, inverse_depth) = projection.project(self.marker_m(surface, i, space))?;
            let front = raster.inverse_depth_at(pixel.x as i32, pixel.y as i32);
            let hidden = front > 0.0 && front.recip() < inverse_depth.recip() - 0.05 * self.radius_m;
            (!touched && !hidden).then_some(pixel)
        }));
    }

    /// Draws the pad of a fingertip, and what the skin hides of the tool.
    pub(super) fn draw_tool(&mut self, view: (&Raster, &Projection), touched: &Touched, image: &mut Image) {
        self.tool.draw_translucent(touched, view, &mut self.mask, image);
    }
}

/// The active nodes, which are places of the body. The one space of a live sphere is none.
fn places<'o, 'a, const N: usize>(organ: &'o Organ<'a, N>) -> impl Iterator<Item = (usize, &'o Space<'a>)> {
    let is_of_sphere = organ.tool.sphere().is_some() && organ.contact.triangles.is_empty();
    organ.spaces.iter().enumerate().filter(move |_| !is_of_sphere)
}

/// Radius of the marker of active node `index` of `count`, in radii of the organ; `None` where the tool stands.
fn marker(index: usize, count: usize, record: &TickRecord) -> Option<f32> {
    let is = |space: u16| usize::from(space) == index;
    if count <= MAX_NAMED {
        return (!record.engaged.is_some_and(is)).then_some(MARKER);
    }
    // The corners of the triangle between which the force is blended.
    let shared = record.engaged.is_some()
        && record.shares.iter().any(|share| share.weight > 0.0 && share.weight < 1.0 && is(share.space));
    if shared { Some(MARKER) } else { (!record.engaged.is_some_and(is)).then_some(DOT) }
}

/// Rectangle of the picture with the visibly displaced part of the rest shape: left, top, width, height.
fn moved_box(
    projection: &Projection,
    surface: &Deformation,
    full_scale_m: f32,
    image: &Image,
) -> (i32, i32, usize, usize) {
    let places = surface.rest_m().iter().enumerate();
    let moved = places.filter(|(i, _)| surface.magnitude_m(*i) > MIN_GHOST * full_scale_m);
    let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
    for (pixel, _) in moved.filter_map(|(_, place)| projection.project(*place)) {
        (low, high) = (low.min(pixel), high.max(pixel));
    }
    let size = Vec2::new(image.width() as f32, image.height() as f32);
    // Edges extend beyond the last displaced vertex by one neighbour, and strokes have a width.
    let margin = Vec2::splat(0.05 * size.y);
    let (low, high) = ((low - margin).max(Vec2::ZERO), (high + margin).min(size));
    if low.cmplt(high).all() {
        let (extent, corner) = ((high - low).ceil(), low.floor());
        (corner.x as i32, corner.y as i32, extent.x as usize, extent.y as usize)
    } else {
        (0, 0, 0, 0)
    }
}

/// Every edge once, with the normals of its two triangles.
pub(super) fn edges(triangles: &[[u32; 3]], position_m: &[Vec3]) -> Vec<Edge> {
    let mut sides: Vec<([u32; 2], Vec3)> = triangles
        .iter()
        .flat_map(|&[a, b, c]| {
            let [p, q, r] = [a, b, c].map(|corner| position_m[corner as usize]);
            let normal = (q - p).cross(r - p);
            [[a, b], [b, c], [c, a]].map(|[i, j]| ([i.min(j), i.max(j)], normal))
        })
        .collect();
    sides.sort_by_key(|(ends, _)| *ends);
    sides
        .chunk_by(|(one, _), (other, _)| one == other)
        .map(|same| Edge { ends: same[0].0, normals: [same[0].1, same[same.len() - 1].1] })
        .collect()
}

/// Slight variation of the tissue's colour with the rest position: a product of sine waves with mean 1.
fn colour_variation(rest_m: Vec3) -> f32 {
    let p = rest_m * 420.0;
    let waves = (p.x + 1.7 * (0.6 * p.y).sin()).sin()
        + (1.3 * p.y + 1.4 * (0.8 * p.z).sin()).sin()
        + (1.1 * p.z + 1.9 * (0.7 * p.x).sin()).sin();
    1.0 + 0.05 * waves
}

/// Full scale of the colour map: 1, 2 or 5 times a power of ten in mm, at least 5 mm.
#[must_use]
pub fn nice_scale_m(largest_m: f32) -> f32 {
    let mut step_mm = 5.0_f32;
    for factor in [2.0, 1.5, 4.0 / 3.0, 1.25, 2.0, 2.0, 2.0, 2.5].into_iter().cycle().take(24) {
        if step_mm * 1e-3 >= largest_m {
            break;
        }
        step_mm *= factor;
    }
    step_mm * 1e-3
}

/// |h| and displacement of a record, N and m.
#[must_use]
pub fn magnitudes(record: &TickRecord) -> (f32, f32) {
    (vec3::norm(record.reaction_n), vec3::norm(record.displacement_m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{self, Shape};
    use palpate_core::NodeWeight;

    #[test]
    fn of_many_active_nodes_only_those_between_which_it_touches_are_large() {
        let share = |space, weight| NodeWeight { space, weight };
        let free = TickRecord::EMPTY;
        let between = TickRecord {
            engaged: Some(5),
            shares: [share(5, 0.6), share(40, 0.3), share(7, 0.1)],
            ..TickRecord::EMPTY
        };
        let at_one = TickRecord { shares: [share(5, 1.0), share(0, 0.0), share(0, 0.0)], ..between };
        // A few are all large, but where the tool stands.
        assert_eq!([0, 5].map(|index| marker(index, 6, &free)), [Some(MARKER); 2]);
        assert_eq!([0, 5].map(|index| marker(index, 6, &at_one)), [Some(MARKER), None]);
        let many = |record: &TickRecord| [0, 5, 7, 40].map(|index| marker(index, 490, record));
        assert_eq!(many(&free), [Some(DOT); 4]);
        assert_eq!(many(&between), [Some(DOT), Some(MARKER), Some(MARKER), Some(MARKER)]);
        assert_eq!(many(&at_one), [Some(DOT), None, Some(DOT), Some(DOT)]);
    }

    /// A contact point lies between the vertices of the skin.
    #[test]
    fn a_contact_point_is_marked_at_its_place() {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let rest = Deformation::at_rest(&organ);
        let scene = Scene::new(&organ, &rest);
        let mut space = organ.spaces[0].clone();
        space.active.rest_position_m = vec3::add(space.active.rest_position_m, [1e-3, 2e-3, 0.0]);
        let place_m = Vec3::from_array(space.active.rest_position_m);
        assert_eq!(scene.marker_m(&rest, 0, &space), place_m);
        let mut pushed = Deformation::at_rest(&organ);
        let (shares, d) = (
            [NodeWeight { space: 0, weight: 1.0 }, NodeWeight::default(), NodeWeight::default()],
            [0.0, 0.004, 0.0],
        );
        pushed.update(&organ, &shares, d);
        let moved_m = scene.marker_m(&pushed, 0, &space) - place_m;
        assert!((moved_m.y - 0.004).abs() < 5e-4 && moved_m.x.abs() < 5e-4, "{moved_m}");
    }

    #[test]
    fn the_colour_scale_has_round_ends_and_covers_the_maximum() {
        let found: Vec<u32> = [0.0, 4.9e-3, 5.1e-3, 12e-3, 19e-3, 22e-3, 49e-3]
            .iter()
            .map(|largest| (nice_scale_m(*largest) * 1e3).round() as u32)
            .collect();
        assert_eq!(found, [5, 5, 10, 15, 20, 25, 50]);
        assert!(nice_scale_m(3.0) >= 3.0);
    }
}
