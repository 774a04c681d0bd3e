//! The surface at a distance from a body: where the centre of a sphere is when it just touches the skin.
//!
//! It is the level set of the distance to the skin, cut from a grid by surface nets. Unlike the skin, it turns only
//! gradually round an edge: its radius of curvature is at least the distance. In a fold that is narrower than the sphere
//! it has no part.

use fast_surface_nets::ndshape::{RuntimeShape, Shape};
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};

use super::{SkinPoint, Surface, TetMesh, nearest_on_triangle};
use crate::num::vector::{cross, difference, distance, dot, unit};

/// Spacing of the grid, as a share of the distance.
const SPACING: f64 = 0.45;
/// Cells of the grid beyond the surface.
const BESIDE: f64 = 2.0;
/// Most points of the grid, 0.7 GB. A body with pieces far apart would need more.
const MOST_POINTS: f64 = 33e6;

/// A surface at a distance from the free skin of a body.
#[derive(Debug, Clone)]
pub(crate) struct Offset {
    /// Its vertices, m.
    pub(crate) places_m: Vec<[f64; 3]>,
    /// The point of the skin nearest to each vertex, and the unit direction from there to the vertex.
    pub(crate) feet: Vec<(SkinPoint, [f64; 3])>,
    /// Vertices at the corners of each triangle, counter-clockwise seen from outside.
    pub(crate) triangles: Vec<[u32; 3]>,
}

impl Offset {
    /// The surface at `distance_m` from a skin, without the part whose nearest points are not free; `None` if the body
    /// is too large for the grid.
    pub(crate) fn of(
        mesh: &TetMesh,
        skin: &Surface,
        is_free: impl Fn(&SkinPoint) -> bool,
        distance_m: f64,
    ) -> Option<Self> {
        let grid = Grid::round(mesh, distance_m)?;
        let corners: Vec<[[f64; 3]; 3]> =
            skin.triangles.iter().map(|corners| corners.map(|node| mesh.nodes_m[node as usize])).collect();
        let shape = RuntimeShape::<u32, 3>::new(grid.shape);
        let nearest = grid.nearest(&shape, &corners, distance_m);
        let levels = grid.levels(&shape, &nearest, distance_m);
        let mut net = SurfaceNetsBuffer::default();
        surface_nets(&levels, &shape, [0; 3], grid.shape.map(|n| n - 1), &mut net);
        let vertices: Vec<Option<Vertex>> = net
            .positions
            .iter()
            .map(|at| {
                let at_m = grid.place(at.map(f64::from));
                let foot = skin.nearest(mesh, at_m)?;
                let foot_m = foot.interpolate(|node| mesh.nodes_m[node as usize]);
                let normal = unit(difference(at_m, foot_m));
                let place_m = std::array::from_fn(|k| foot_m[k] + distance_m * normal[k]);
                (normal[0].is_finite() && is_free(&foot)).then_some((place_m, foot, normal))
            })
            .collect();
        let mut found = Self { places_m: Vec::new(), feet: Vec::new(), triangles: Vec::new() };
        let mut numbers = vec![None; vertices.len()];
        for corners in net.indices.chunks_exact(3) {
            let of = |k: usize| vertices[corners[k] as usize];
            let (Some(a), Some(b), Some(c)) = (of(0), of(1), of(2)) else { continue };
            let mut number = |k: usize, (place_m, foot, normal): Vertex| -> u32 {
                *numbers[corners[k] as usize].get_or_insert_with(|| {
                    found.places_m.push(place_m);
                    found.feet.push((foot, normal));
                    found.places_m.len() as u32 - 1
                })
            };
            let triangle = [number(0, a), number(1, b), number(2, c)];
            let outward = [0, 1, 2].map(|axis: usize| a.2[axis] + b.2[axis] + c.2[axis]);
            let turned = dot(cross(difference(b.0, a.0), difference(c.0, a.0)), outward) < 0.0;
            let [a, b, c] = triangle;
            found.triangles.push(if turned { [a, c, b] } else { triangle });
        }
        Some(found)
    }
}

/// Place, m, nearest point of the skin, and direction from there.
type Vertex = ([f64; 3], SkinPoint, [f64; 3]);

/// A grid round a body.
struct Grid {
    low_m: [f64; 3],
    spacing_m: f64,
    /// Points along each axis.
    shape: [u32; 3],
}

impl Grid {
    fn round(mesh: &TetMesh, distance_m: f64) -> Option<Self> {
        let spacing_m = SPACING * distance_m;
        let beside_m = distance_m + BESIDE * spacing_m;
        let end = |axis: usize, from: f64, pick: fn(f64, f64) -> f64| {
            mesh.nodes_m.iter().map(|place| place[axis]).fold(from, pick)
        };
        let low_m = [0, 1, 2].map(|axis| end(axis, f64::INFINITY, f64::min) - beside_m);
        let high_m = [0, 1, 2].map(|axis| end(axis, f64::NEG_INFINITY, f64::max) + beside_m);
        let points = [0, 1, 2].map(|axis: usize| ((high_m[axis] - low_m[axis]) / spacing_m).ceil() + 1.0);
        let fits = points.iter().product::<f64>() <= MOST_POINTS;
        fits.then(|| Self { low_m, spacing_m, shape: points.map(|points| points as u32) })
    }

    fn place(&self, at: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| self.low_m[axis] + self.spacing_m * at[axis])
    }

    /// Distance of each grid point from the skin, m, if it is not far beyond that of the surface.
    fn nearest(
        &self,
        shape: &RuntimeShape<u32, 3>,
        corners: &[[[f64; 3]; 3]],
        distance_m: f64,
    ) -> Vec<Option<f64>> {
        let beside_m = distance_m + BESIDE * self.spacing_m;
        let mut nearest: Vec<Option<f64>> = vec![None; shape.size() as usize];
        for corners in corners {
            let range = [0, 1, 2].map(|axis: usize| {
                let along = corners.map(|corner| corner[axis]);
                let cell = |x_m: f64| ((x_m - self.low_m[axis]) / self.spacing_m).max(0.0) as u32;
                let (least, most) =
                    along.iter().fold((along[0], along[0]), |(least, most), &x| (least.min(x), most.max(x)));
                cell(least - beside_m)..(cell(most + beside_m) + 2).min(self.shape[axis])
            });
            let [xs, ys, zs] = range;
            for z in zs {
                for y in ys.clone() {
                    for x in xs.clone() {
                        let at_m = self.place([x, y, z].map(f64::from));
                        let away_m = distance(nearest_on_triangle(*corners, at_m).0, at_m);
                        let least = &mut nearest[shape.linearize([x, y, z]) as usize];
                        if away_m <= beside_m && least.is_none_or(|least_m| away_m < least_m) {
                            *least = Some(away_m);
                        }
                    }
                }
            }
        }
        nearest
    }

    /// Distance beyond the surface of each grid point, in grid spacings: negative inside it. Outside is what is connected
    /// to the end of the grid.
    fn levels(&self, shape: &RuntimeShape<u32, 3>, nearest: &[Option<f64>], distance_m: f64) -> Vec<f32> {
        let level = |point: usize| {
            nearest[point].map_or(BESIDE, |away_m| (away_m - distance_m) / self.spacing_m) as f32
        };
        let mut levels = vec![-(BESIDE as f32); nearest.len()];
        let mut is_outside = vec![false; nearest.len()];
        let mut open = vec![[0_u32; 3]];
        is_outside[shape.linearize([0; 3]) as usize] = true;
        while let Some(at) = open.pop() {
            for axis in 0..3 {
                for next in [at[axis].wrapping_sub(1), at[axis] + 1] {
                    let mut beside = at;
                    beside[axis] = next;
                    if next >= self.shape[axis] {
                        continue;
                    }
                    let point = shape.linearize(beside) as usize;
                    if !is_outside[point] && level(point) >= 0.0 {
                        is_outside[point] = true;
                        open.push(beside);
                    }
                }
            }
        }
        for (point, value) in levels.iter_mut().enumerate() {
            if is_outside[point] || nearest[point].is_some() && level(point) < 0.0 {
                *value = level(point);
            }
        }
        levels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_offset_of_a_block_is_rounded_and_closed_but_for_the_fixed_face() {
        let mesh = TetMesh::cuboid([6, 6, 2], 0.01);
        let skin = Surface::of(&mesh);
        let is_free = |foot: &SkinPoint| foot.interpolate(|n| mesh.nodes_m[n as usize])[2] > 1e-9;
        let offset = Offset::of(&mesh, &skin, is_free, 0.012).expect("a small grid");
        let mut uses = std::collections::HashMap::<[u32; 2], u32>::new();
        for &[a, b, c] in &offset.triangles {
            for [p, q] in [[a, b], [b, c], [c, a]] {
                *uses.entry([p.min(q), p.max(q)]).or_default() += 1;
            }
            let [p, q, r] = [a, b, c].map(|corner| offset.places_m[corner as usize]);
            let face = cross(difference(q, p), difference(r, p));
            let out = [a, b, c].map(|corner| offset.feet[corner as usize].1);
            assert!(out.iter().all(|normal| dot(unit(face), *normal) > 0.6), "{p:?} {face:?} {out:?}");
        }
        // Edges of one triangle lie where the fixed face is nearest.
        assert!(uses.values().all(|&uses| uses <= 2));
        for (edge, _) in uses.iter().filter(|(_, uses)| **uses == 1) {
            assert!(edge.iter().all(|&vertex| offset.places_m[vertex as usize][2] < 5e-3));
        }
        for (place_m, (foot, normal)) in offset.places_m.iter().zip(&offset.feet) {
            let foot_m = foot.interpolate(|node| mesh.nodes_m[node as usize]);
            let nearest = skin.nearest(&mesh, *place_m).expect("a skin");
            let nearest_m = nearest.interpolate(|node| mesh.nodes_m[node as usize]);
            assert!((distance(*place_m, nearest_m) - 0.012).abs() < 1e-4, "{place_m:?}");
            assert!((distance(*place_m, foot_m) - 0.012).abs() < 1e-12);
            assert!((dot(*normal, *normal) - 1.0).abs() < 1e-12);
        }
        // Above the middle it is a plane; beyond an edge it turns by the quarter of a circle.
        let is_above = |place: &&[f64; 3]| place[..2].iter().all(|x| (0.01..0.05).contains(x));
        assert!(offset.places_m.iter().filter(is_above).all(|place| (place[2] - 0.032).abs() < 1e-12));
        let turned = offset.feet.iter().filter(|(_, normal)| normal[0] > 0.5 && normal[2] > 0.5).count();
        assert!(turned > 10, "{turned}");
    }

    /// A spherical cavity, or a body thicker than the sphere, has no second surface inside.
    #[test]
    fn a_thick_body_has_one_surface() {
        let mesh = TetMesh::cuboid([5, 5, 5], 0.01);
        let skin = Surface::of(&mesh);
        let offset = Offset::of(&mesh, &skin, |_| true, 0.008).expect("a small grid");
        let inside = |place: &[f64; 3]| place.iter().all(|x| (0.0..0.05).contains(x));
        assert!(!offset.places_m.is_empty() && !offset.places_m.iter().any(inside));
    }

    #[test]
    fn a_grid_without_bound_is_refused() {
        let mesh = TetMesh::cuboid([2, 2, 2], 0.01);
        let skin = Surface::of(&mesh);
        assert!(Offset::of(&mesh, &skin, |_| true, 1e-5).is_none());
    }
}
