//! The places that a simulated hand touches.

use palpate_core::{Organ, Surface, Vec3, vec3};

use crate::first_place::first_place;

/// Number of places that a hand with a sphere touches.
const OF_A_SPHERE: usize = 8;

/// Positions of the tool in touch without a force, with outward normals: the active nodes, the first place to touch
/// first. A sphere touches vertices of the surface that are not fixed, each the farthest from those before.
pub(super) fn places<const N: usize>(organ: &Organ<'_, N>) -> Vec<(Vec3, Vec3)> {
    let Some(sphere) = organ.tool.sphere() else {
        let active = organ.spaces.iter().map(|space| &space.active);
        let mut places: Vec<_> =
            active.map(|active| (active.rest_position_m, active.outward_normal)).collect();
        places.rotate_left(first_place(organ));
        return places;
    };
    let half_m = organ.tool.half_axis_m().unwrap_or_default();
    let mut vertices = free_vertices(&organ.surface);
    let mut found = Vec::new();
    let start_m = organ.spaces.first().map_or(vec3::ZERO, |space| space.active.rest_position_m);
    // The first is the one nearest to where the tool begins.
    let nearest = |(a, _): &(Vec3, Vec3), (b, _): &(Vec3, Vec3)| {
        vec3::distance(*a, start_m).total_cmp(&vec3::distance(*b, start_m))
    };
    let mut next = (0..vertices.len()).min_by(|&a, &b| nearest(&vertices[a], &vertices[b]));
    while let Some(at) = next.filter(|_| found.len() < OF_A_SPHERE) {
        let (place_m, normal) = vertices.swap_remove(at);
        found.push((place_m, normal));
        let away = |&at: &usize| {
            let to = |&(other, _): &(Vec3, Vec3)| vec3::distance(vertices[at].0, other);
            found.iter().map(to).fold(f32::INFINITY, f32::min)
        };
        next = (0..vertices.len()).max_by(|a, b| away(a).total_cmp(&away(b)));
    }
    let centre = |(place_m, normal): (Vec3, Vec3)| {
        let reach_m = sphere.reach_m() + vec3::dot(half_m, normal).abs();
        (vec3::add(place_m, vec3::scale(normal, reach_m)), normal)
    };
    found.into_iter().map(centre).collect()
}

/// The vertices without a fixed neighbour, with the mean normals of their triangles.
fn free_vertices(surface: &Surface<'_>) -> Vec<(Vec3, Vec3)> {
    let count = surface.node.len();
    let at = |vertex: u32| surface.position_m.map(|plane| plane[vertex as usize]);
    let (mut normals, mut is_free) = (vec![vec3::ZERO; count], vec![true; count]);
    for triangle in surface.triangles {
        let [a, b, c] = triangle.map(at);
        let area = vec3::cross(vec3::sub(b, a), vec3::sub(c, a));
        let is_fixed = triangle.iter().any(|&vertex| surface.fixed[vertex as usize] != 0);
        for &vertex in triangle {
            let vertex = vertex as usize;
            normals[vertex] = vec3::add(normals[vertex], area);
            is_free[vertex] &= !is_fixed;
        }
    }
    let all = normals.into_iter().zip(is_free).zip(0..);
    all.filter(|((_, is_free), _)| *is_free)
        .map(|((normal, _), vertex)| (at(vertex), vec3::normalize_or_zero(normal)))
        .collect()
}
