//! Surfaces of bodies.

use palpate_core::vec3::{self, Vec3};

use super::distance;

/// A sphere of triangles: an icosahedron whose edges are halved `halvings` times.
pub fn sphere(radius_m: f32, halvings: u32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let golden = (1.0 + 5.0_f32.sqrt()) / 2.0;
    let mut vertices: Vec<Vec3> = Vec::new();
    for (one, other) in [(1.0, golden), (-1.0, golden), (1.0, -golden), (-1.0, -golden)] {
        vertices.extend([[0.0, one, other], [one, other, 0.0], [other, 0.0, one]]);
    }
    let edge = 2.0_f32;
    let near = |a: &Vec3, b: &Vec3| (distance(*a, *b) - edge).abs() < 1e-3;
    let mut triangles = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                let [p, q, r] = [a, b, c].map(|i: usize| vertices[i]);
                if near(&p, &q) && near(&q, &r) && near(&r, &p) {
                    let area = vec3::cross(vec3::sub(q, p), vec3::sub(r, p));
                    let outward = vec3::dot(area, p) > 0.0;
                    triangles.push(if outward { [a, b, c] } else { [a, c, b] }.map(|i| i as u32));
                }
            }
        }
    }
    for _ in 0..halvings {
        let mut middles = std::collections::HashMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                let sum = vec3::add(vertices[a as usize], vertices[b as usize]);
                vertices.push(vec3::scale(sum, 0.5));
                vertices.len() as u32 - 1
            })
        };
        let halved = triangles.iter().flat_map(|&[a, b, c]| {
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        });
        triangles = halved.collect();
    }
    let onto = |vertex: &Vec3| vec3::scale(vec3::normalize_or_zero(*vertex), radius_m);
    (vertices.iter().map(onto).collect(), triangles)
}
