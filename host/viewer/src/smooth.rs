//! Smooths a coarse surface for display with Phong tessellation, which keeps the vertices of the mesh in
//! place.

use super::raster::Vertex;
use std::collections::HashMap;

/// Number of triangles above which a surface is not refined.
const FINE_TRIANGLES: usize = 12_000;
/// Displacement of an edge's midpoint from the chord towards the tangent planes (Boubekeur and Alexa 2008 use
/// 3/4).
const ROUNDNESS: f32 = 0.75;

/// The edges to split, level by level; computed once, applied in every frame.
#[derive(Debug, Clone, Default)]
pub struct Smooth {
    levels: Vec<Vec<[u32; 2]>>,
    triangles: Vec<[u32; 3]>,
}

impl Smooth {
    /// Plans the splits of a surface with this number of vertices.
    #[must_use]
    pub fn new(triangles: &[[u32; 3]], vertices: usize) -> Self {
        let mut smooth = Self { levels: Vec::new(), triangles: triangles.to_vec() };
        let mut count = vertices as u32;
        while !smooth.triangles.is_empty() && smooth.triangles.len() * 4 <= FINE_TRIANGLES {
            let mut middles = HashMap::new();
            let mut edges = Vec::new();
            let mut finer = Vec::with_capacity(smooth.triangles.len() * 4);
            for &[a, b, c] in &smooth.triangles {
                let [ab, bc, ca] = [[a, b], [b, c], [c, a]].map(|[i, j]| {
                    *middles.entry([i.min(j), i.max(j)]).or_insert_with(|| {
                        edges.push([i, j]);
                        count += 1;
                        count - 1
                    })
                });
                finer.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
            }
            smooth.levels.push(edges);
            smooth.triangles = finer;
        }
        smooth
    }

    /// Triangles after all splits.
    #[must_use]
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Subdivides edges of the original surface with this number of vertices: its mesh on the refined
    /// surface.
    #[must_use]
    pub fn pieces(&self, edges: &[[u32; 2]], vertices: usize) -> Vec<[u32; 2]> {
        let mut pieces = edges.to_vec();
        let mut first = vertices as u32;
        for level in &self.levels {
            let middles: HashMap<[u32; 2], u32> =
                level.iter().zip(first..).map(|([i, j], middle)| ([*i.min(j), *i.max(j)], middle)).collect();
            pieces = pieces
                .into_iter()
                .flat_map(|[i, j]| match middles.get(&[i.min(j), i.max(j)]) {
                    Some(&middle) => vec![[i, middle], [middle, j]],
                    None => vec![[i, j]],
                })
                .collect();
            first += level.len() as u32;
        }
        pieces
    }

    /// Appends the midpoints of all split edges.
    pub fn refine(&self, vertices: &mut Vec<Vertex>) {
        for edges in &self.levels {
            for [a, b] in edges {
                if let (Some(a), Some(b)) = (vertices.get(*a as usize), vertices.get(*b as usize)) {
                    let middle = middle(a, b);
                    vertices.push(middle);
                }
            }
        }
    }
}

fn middle(a: &Vertex, b: &Vertex) -> Vertex {
    let chord = 0.5 * (a.position_m + b.position_m);
    // Mean of the projections of the chord's midpoint onto both tangent planes.
    let lift = -0.5
        * ((chord - a.position_m).dot(a.normal) * a.normal + (chord - b.position_m).dot(b.normal) * b.normal);
    // Across a sharp edge the tangent planes are not a valid approximation.
    let share = if a.normal.dot(b.normal) > 0.2 { ROUNDNESS } else { 0.0 };
    Vertex {
        position_m: chord + share * lift,
        normal: (a.normal + b.normal).normalize_or(a.normal),
        albedo: 0.5 * (a.albedo + b.albedo),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn on_sphere(direction: Vec3) -> Vertex {
        let normal = direction.normalize();
        Vertex { position_m: normal, normal, albedo: Vec3::ONE }
    }

    #[test]
    fn an_octahedron_becomes_nearly_spherical_and_keeps_its_corners() {
        let mut vertices: Vec<Vertex> =
            [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z].map(on_sphere).to_vec();
        let corners = vertices.clone();
        let faces = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]];
        let smooth = Smooth::new(&faces, vertices.len());
        // Normals at right angles are a sharp edge, so start from the sphere's own midpoints.
        let mut once = vertices.clone();
        once.extend(
            smooth.levels[0]
                .iter()
                .map(|[a, b]| on_sphere(vertices[*a as usize].position_m + vertices[*b as usize].position_m)),
        );
        vertices = once;
        let finer = Smooth { levels: smooth.levels[1..].to_vec(), triangles: smooth.triangles.clone() };
        finer.refine(&mut vertices);
        assert_eq!(vertices[..6], corners);
        let used = smooth.triangles().iter().flatten().max().copied();
        assert_eq!(used, Some(vertices.len() as u32 - 1));
        for vertex in &vertices {
            // Midpoints on flat triangles would be at 0.82 of the radius.
            assert!((vertex.position_m.length() - 1.0).abs() < 0.06, "{}", vertex.position_m.length());
        }
    }

    #[test]
    fn a_flat_surface_stays_flat_and_a_fine_one_is_not_refined() {
        let flat =
            |x: f32, y: f32| Vertex { position_m: Vec3::new(x, y, 0.0), normal: Vec3::Z, albedo: Vec3::ONE };
        let mut vertices = vec![flat(0.0, 0.0), flat(1.0, 0.0), flat(0.0, 1.0)];
        let smooth = Smooth::new(&[[0, 1, 2]], 3);
        smooth.refine(&mut vertices);
        assert!(vertices.len() > 3 && vertices.iter().all(|vertex| vertex.position_m.z == 0.0));
        let mut ends: Vec<[u32; 2]> = smooth.pieces(&[[0, 1]], 3);
        assert_eq!(ends.len(), 1 << smooth.levels.len());
        ends.iter()
            .for_each(|piece| assert!(piece.iter().all(|&i| vertices[i as usize].position_m.y == 0.0)));
        assert_eq!((ends.remove(0)[0], ends.pop().map(|piece| piece[1])), (0, Some(1)));
        let many = vec![[0_u32, 1, 2]; FINE_TRIANGLES / 4 + 1];
        assert_eq!(Smooth::new(&many, 3).triangles().len(), many.len());
    }
}
