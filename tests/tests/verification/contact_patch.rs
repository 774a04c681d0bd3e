//! Area and greatest pressure under a sphere, as the window shows them, compared with Hertz and with a sum over the skin.
//!
//! Hertz 1882: a rigid sphere of radius R presses on an elastic half space with E* = E / (1 - nu^2) and the force F on a
//! disc of radius a,
//!
//! a^3 = 3 F R / (4 E*),   p_0 = 3 F / (2 pi a^2) in the middle.
//!
//! The layer changes both: it softens the contact, and skin beside the disc lies in it, too.

use std::f64::consts::PI;
use std::sync::Arc;

use nalgebra::Vector3;
use palpate_core::format::Sphere;
use palpate_precompute::fem::material::{Material, Value};
use palpate_precompute::fem::{
    Body, CoatedSphere, Constraints, Layer, Model, Pose, Problem, Solver, Sphere as Coated,
};
use palpate_precompute::mesh::{Surface, TetMesh};
use palpate_tests::nodes_where;
use palpate_viewer::Patch;

const RADIUS_M: f64 = 0.01;
const YOUNG_PA: f64 = 15e3;
const POISSON: f64 = 0.3;

/// Places of the planes of nodes from the middle of the touch: close there, and each gap twice the one before.
fn graded(near: usize, edge_m: f64, far: usize) -> Vec<f64> {
    let mut at = vec![0.0];
    let mut gap_m = edge_m;
    for n in 0..near + far {
        if n >= near {
            gap_m *= 2.0;
        }
        at.push(at[n] + gap_m);
    }
    at
}

/// A block whose upper face is z = 0, with small elements where the sphere presses.
fn block() -> TetMesh {
    let (across, down) = (graded(5, 1.2e-3, 3), graded(3, 1.5e-3, 3));
    let half = across.len() - 1;
    let mut mesh = TetMesh::cuboid([2 * half, 2 * half, down.len() - 1], 1.0);
    for x in &mut mesh.nodes_m {
        let [i, j, k] = x.map(|at| at.round() as usize);
        let at = |n: usize| if n < half { -across[half - n] } else { across[n - half] };
        *x = [at(i), at(j), -down[down.len() - 1 - k]];
    }
    mesh.check().expect("a valid mesh");
    mesh
}

/// A sphere on the block, depth by depth.
struct Press {
    mesh: TetMesh,
    triangles: Vec<[u32; 3]>,
    solver: Solver,
    state: Vec<f64>,
    layer: Layer,
}

/// What is found at a depth.
struct Found {
    force_n: f64,
    patch: Patch,
    /// Size of the sum of pressure and normal over the skin, N.
    summed_n: f64,
    /// Greatest pressure of the layer on the area at rest, Pa.
    greatest_pa: f64,
}

impl Press {
    fn new() -> Self {
        let mesh = block();
        let bottom_m = mesh.nodes_m.iter().map(|x| x[2]).fold(0.0, f64::min);
        let fixed = nodes_where(&mesh, |x| x[2] == bottom_m);
        let given = [("young_pa", Value::Number(YOUNG_PA)), ("poisson", Value::Number(POISSON))];
        let law = Material::from_parameters("linear", &given).expect("a law");
        let body = Body::new(&mesh, &Model::uniform(law, &fixed)).expect("every element has volume");
        let (layer, state) = (Layer::of(RADIUS_M), body.rest_state.clone());
        let sphere = CoatedSphere::new(&body, RADIUS_M, layer, [0.0; 3]);
        let free = Problem::with(Arc::new(body), None, Constraints::Elimination);
        let solver = Solver::new(Arc::new(free.at(sphere)));
        Self { triangles: Surface::of(&mesh).triangles, mesh, solver, state, layer }
    }

    fn at(&mut self, depth_m: f64) -> Found {
        let reach_m = Coated { radius_m: RADIUS_M, layer: self.layer }.reach_m();
        let centre = Vector3::new(0.0, 0.0, reach_m - depth_m);
        let pose = Pose::translation(centre.into());
        let here = self.solver.solve_at(&pose, &self.state).expect("it converges");
        self.state.clone_from(&here.seed.state);
        let rest = |node: u32| Vector3::from(self.mesh.nodes_m[node as usize]);
        let moved = |node: u32| Vector3::from_column_slice(&self.state[3 * node as usize..][..3]);
        let place = |node: u32| rest(node) + moved(node) - centre;
        let force_n = Vector3::from(here.seed.jet.force_n).norm();
        let sphere = Sphere { radius_m: RADIUS_M as f32, layer_m: (reach_m - RADIUS_M) as f32 };
        let single = |node| place(node).map(|x| x as f32).into();
        let patch = Patch::of(&self.triangles, single, sphere, force_n as f32).expect("it presses");
        // The layer of the solver has one point on each of these triangles.
        let (mut sum_n, mut greatest_pa) = (Vector3::zeros(), 0.0_f64);
        for corners in &self.triangles {
            let [a, b, c] = corners.map(rest);
            let part_m2 = 0.5 * (b - a).cross(&(c - a)).norm() / f64::from(PARTS * PARTS);
            let [a, b, c] = corners.map(place);
            for middle in middles() {
                let at = middle[0] * a + middle[1] * b + middle[2] * c;
                let overlap = ((reach_m - at.norm()) / self.layer.thickness_m).max(0.0);
                let pressure_pa = self.layer.pressure_pa * overlap.powi(3);
                sum_n += part_m2 * pressure_pa * at.normalize();
                greatest_pa = greatest_pa.max(pressure_pa);
            }
        }
        Found { force_n, patch, summed_n: sum_n.norm(), greatest_pa }
    }
}

/// Number of parts of an edge in the sum over the skin.
const PARTS: u32 = 12;

/// Weights of the corners in the middles of the parts of a triangle: those of the whole triangles of a lattice.
fn middles() -> impl Iterator<Item = [f64; 3]> {
    let thirds = 3 * PARTS;
    // In thirds of a part the middles are the places whose three weights leave the same rest, 1 or 2.
    let all = (0..thirds).flat_map(move |i| (0..thirds - i).map(move |j| [i, j, thirds - i - j]));
    let is_middle =
        |at: &[u32; 3]| !at[0].is_multiple_of(3) && at.iter().all(|weight| weight % 3 == at[0] % 3);
    all.filter(is_middle).map(move |at| at.map(|weight| f64::from(weight) / f64::from(thirds)))
}

/// The pressures add up to the force, and the area grows with the depth. From 2 mm on the greatest pressure is that of Hertz, and
/// the area is 15 to 25 % larger, because the layer is soft.
#[test]
fn the_patch_under_a_sphere_is_that_of_hertz_and_of_the_layer() {
    assert_eq!(middles().count(), (PARTS * PARTS) as usize);
    let mut press = Press::new();
    let (mut before_m2, mut before_n) = (0.0, 0.0);
    for depth_mm in [1.0, 1.5, 2.0, 2.5, 3.0, 3.5] {
        let Found { force_n, patch, summed_n, greatest_pa } = press.at(1e-3 * depth_mm);
        let (area_m2, largest_pa) = (f64::from(patch.area_m2), f64::from(patch.largest_pa));
        let disc_m = (3.0 * force_n * RADIUS_M * (1.0 - POISSON * POISSON) / (4.0 * YOUNG_PA)).cbrt();
        let disc_m2 = PI * disc_m * disc_m;
        let (area, pressure) = (area_m2 / disc_m2, largest_pa / (1.5 * force_n / disc_m2));
        let (sum, layer) = (summed_n / force_n, largest_pa / greatest_pa);
        println!(
            "{depth_mm} mm, {force_n:.3} N: area {:.2} cm2, {area:.2} of Hertz; pressure {largest_pa:.0} Pa, \
             {pressure:.3} of Hertz, {layer:.3} of the layer; sum {sum:.3} of the force",
            1e4 * area_m2
        );
        assert!(area_m2 > before_m2 && force_n > before_n, "both grow with the depth");
        (before_m2, before_n) = (area_m2, force_n);
        assert!((sum - 1.0).abs() < 0.03, "{sum}: the solver has one point on a triangle");
        assert!((layer - 1.0).abs() < 0.12, "{layer}: on the area at rest, and on the deformed one");
        if depth_mm >= 2.0 {
            // A light touch is in the layer alone.
            assert!((1.1..1.3).contains(&area), "{area}");
            assert!((pressure - 1.0).abs() < 0.08, "{pressure}");
        }
    }
}
