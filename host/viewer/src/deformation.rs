//! The deformed surface at 30 Hz: displacements from the space's table, then positions and normals.

use glam::Vec3;
use palpate_core::{NodeWeight, Organ, vec3};

/// Current surface of an organ. Buffers are reused from frame to frame.
#[derive(Debug, Clone)]
pub struct Deformation {
    displacement_m: Vec<[f32; 3]>,
    /// Displacement of one space, before blending.
    one_m: Vec<[f32; 3]>,
    rest_m: Vec<Vec3>,
    position_m: Vec<Vec3>,
    normal: Vec<Vec3>,
}

impl Deformation {
    /// The organ at rest.
    #[must_use]
    pub fn at_rest<const N: usize>(organ: &Organ<'_, N>) -> Self {
        let [x, y, z] = organ.surface.position_m;
        let rest_m: Vec<Vec3> = x.iter().zip(y).zip(z).map(|((&x, &y), &z)| Vec3::new(x, y, z)).collect();
        let mut surface = Self {
            displacement_m: vec![vec3::ZERO; rest_m.len()],
            one_m: vec![vec3::ZERO; rest_m.len()],
            position_m: rest_m.clone(),
            normal: vec![Vec3::ZERO; rest_m.len()],
            rest_m,
        };
        surface.recompute(organ.surface.triangles);
        surface
    }

    /// Moves the surface to the configuration given by the weights of the spaces (`shares`) and the tool
    /// displacement d.
    ///
    /// u = sum w_i u_i(d), with the weights of the force. Without a positive weight the surface is at rest. A
    /// blob packed without displacements leaves the surface at rest.
    pub fn update<const N: usize>(
        &mut self,
        organ: &Organ<'_, N>,
        shares: &[NodeWeight; 3],
        displacement_m: [f32; 3],
    ) {
        self.displacement_m.fill(vec3::ZERO);
        for share in shares.iter().filter(|share| share.weight > 0.0) {
            let Some(space) = organ.spaces.get(usize::from(share.space)) else { continue };
            space.displacement_into(displacement_m, &mut self.one_m);
            for (sum, one) in self.displacement_m.iter_mut().zip(&self.one_m) {
                *sum = vec3::add(*sum, vec3::scale(*one, share.weight));
            }
        }
        self.recompute(organ.surface.triangles);
    }

    /// Moves the surface by the displacements that `fill` writes, one of each vertex, m.
    pub fn show(&mut self, triangles: &[[u32; 3]], fill: impl FnOnce(&mut [[f32; 3]])) {
        fill(&mut self.displacement_m);
        self.recompute(triangles);
    }

    fn recompute(&mut self, triangles: &[[u32; 3]]) {
        for ((position, rest), moved) in
            self.position_m.iter_mut().zip(&self.rest_m).zip(&self.displacement_m)
        {
            *position = *rest + Vec3::from_array(*moved);
        }
        self.normal.fill(Vec3::ZERO);
        for triangle in triangles {
            let corners = triangle.map(|corner| corner as usize);
            let [a, b, c] = corners.map(|corner| self.position_m[corner]);
            // Twice the area times the unit normal, so the mean is weighted by area.
            let area = (b - a).cross(c - a);
            for corner in corners {
                self.normal[corner] += area;
            }
        }
        for normal in &mut self.normal {
            *normal = normal.normalize_or_zero();
        }
    }

    /// Rest position of each surface vertex, m.
    #[must_use]
    pub fn rest_m(&self) -> &[Vec3] {
        &self.rest_m
    }

    /// Current position of each surface vertex, m.
    #[must_use]
    pub fn position_m(&self) -> &[Vec3] {
        &self.position_m
    }

    /// Current outward unit normal of each surface vertex; zero for a vertex without triangles.
    #[must_use]
    pub fn normal(&self) -> &[Vec3] {
        &self.normal
    }

    /// Length of a vertex's displacement, m.
    #[must_use]
    pub fn magnitude_m(&self, vertex: usize) -> f32 {
        self.displacement_m.get(vertex).map_or(0.0, |moved| vec3::norm(*moved))
    }

    /// Largest displacement, m.
    #[must_use]
    pub fn largest_m(&self) -> f32 {
        self.displacement_m.iter().map(|moved| vec3::norm(*moved)).fold(0.0, f32::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{self, Shape};

    #[test]
    fn the_active_node_moves_by_the_displacement_and_returns_to_rest() {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let mut surface = Deformation::at_rest(&organ);
        let node = organ.spaces[1].active.node as usize;
        let d = [0.004, -0.013, 0.006];
        let whole = [NodeWeight { space: 1, weight: 1.0 }, NodeWeight::default(), NodeWeight::default()];
        surface.update(&organ, &whole, d);
        let moved = surface.position_m()[node] - surface.rest_m()[node];
        // The dent is linear in d, so interpolation between lattice points is exact. The scale is the
        // fall-off at the node.
        let held = moved.length() / vec3::norm(d);
        assert!(held > 0.5 && held <= 1.0 + 1e-4, "{held}");
        assert!((moved.normalize() - Vec3::from_array(vec3::normalize_or_zero(d))).length() < 1e-3);
        assert!((surface.largest_m() - moved.length()).abs() < 2e-3);
        // Half of this space and half of one that displaces this node little: the result lies between.
        let half = [
            NodeWeight { weight: 0.5, ..whole[0] },
            NodeWeight { space: 2, weight: 0.5 },
            NodeWeight::default(),
        ];
        surface.update(&organ, &half, d);
        let blended = surface.position_m()[node] - surface.rest_m()[node];
        assert!(blended.length() > 0.5 * moved.length() && blended.length() < 0.8 * moved.length());
        surface.update(&organ, &[NodeWeight::default(); 3], d);
        assert_eq!(surface.position_m(), surface.rest_m());
        assert_eq!(surface.largest_m(), 0.0);
    }

    #[test]
    fn normals_point_outwards() {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let surface = Deformation::at_rest(&organ);
        for (position, normal) in surface.position_m().iter().zip(surface.normal()) {
            assert!(position.dot(*normal) > 0.0 && (normal.length() - 1.0).abs() < 1e-4);
        }
    }
}
