//! The condensed potential W(d): h = dW/dd, S = dh/dd, W_ijk = dS/dd and du/dd for every law and field pair.

use std::sync::Arc;

use nalgebra::Vector3;
use palpate_precompute::fem::material::Material;
use palpate_precompute::fem::{
    Body, CoatedSphere, Configuration, Constraints, Contact, Fingertip, Handle, Layer, Model, Order, Pad,
    PadProfile, PressurePair, Problem, Region, Solver, solve_body_force,
};
use palpate_precompute::num::THIRD_INDICES;
use palpate_tests::{beam, livers, mooney_rivlin, nearest_node, nodes_where, st_venant_kirchhoff};

/// A body and its name in the output.
pub(super) struct Case {
    pub(super) name: String,
    pub(super) body: Arc<Body>,
    pub(super) contact: Contact,
    pub(super) constraints: Constraints,
}

fn case(name: &str, change: impl FnOnce(&mut Model)) -> Case {
    let mesh = beam();
    let fixed = nodes_where(&mesh, |x| x[0] == 0.0);
    let mut model = Model::uniform(mooney_rivlin(), &fixed);
    change(&mut model);
    let body = solve_body_force(Body::new(&mesh, &model).expect("every element has volume"))
        .expect("the rest state converges");
    let handle = Handle::node(nearest_node(&mesh, [0.06, 0.02, 0.04]));
    let (body, contact) = (Arc::new(body), handle.into());
    Case { name: name.into(), body, contact, constraints: Constraints::Elimination }
}

/// With quadratic elements everywhere or nowhere the body is that of the order, with its digits.
#[test]
fn the_ends_of_quadratic_elements_near_the_tool_are_the_orders() {
    let law = |m: &mut Model, order| {
        m.regions = vec![mooney_rivlin().into(), st_venant_kirchhoff().into()];
        m.region_of_tet = (0..96).map(|tet| u16::from(tet >= 60)).collect();
        m.order = order;
    };
    let quadratic = case("quadratic", |m| law(m, Order::Quadratic));
    let linear = case("linear", |m| {
        law(m, Order::Linear);
        m.pressure_pair = PressurePair::Stabilised;
    });
    let with = |reach_m| Case {
        name: String::new(),
        body: Arc::new(quadratic.body.quadratic_near([0.04, 0.02, 0.02], reach_m)),
        contact: quadratic.contact.clone(),
        constraints: quadratic.constraints,
    };
    for (reach_m, of_order) in [(1.0, &quadratic), (0.0, &linear)] {
        let [found, wanted] = [&with(reach_m), of_order].map(|case| {
            let mut solver = solver(case);
            let rest = solver.rest().expect("the beam is fixed");
            let at = solver.advance(&rest.seed, [0.004, -0.003, -0.008]).expect("the beam converges");
            (solver.problem().unknowns(), *at.jet())
        });
        assert_eq!(found.0, wanted.0);
        let error = Vector3::from(found.1.force_n) - Vector3::from(wanted.1.force_n);
        assert!(error.norm() < 1e-9 * Vector3::from(wanted.1.force_n).norm(), "{}: {error}", of_order.name);
        assert!((found.1.energy_j / wanted.1.energy_j - 1.0).abs() < 1e-9);
    }
}

/// The same body under a fingertip on a face of the skin.
fn under_a_pad(case: &Case, profile: PadProfile) -> Case {
    let tip = Fingertip { radius_m: 0.025, stiffness_pa_m: 1e6, profile };
    let pad = Pad::new(&case.body, tip, [0.055, 0.017, 0.04]).expect("the point is on the skin");
    let name = format!("{}, pad", case.name);
    Case { name, body: case.body.clone(), contact: pad.into(), constraints: case.constraints }
}

/// The same body under a sphere with its layer, which touches nothing at rest.
fn under_a_sphere(case: &Case) -> Case {
    // A thick layer, because the fourth derivatives of the energy jump where a point comes into the layer.
    let layer = Layer { thickness_m: 0.004, pressure_pa: 1e5 };
    let top = case.body.rest_position_m(nearest_node(&beam(), [0.06, 0.02, 0.04]));
    // A beam that sags is not level.
    let clear_m = if case.body.external_force_n.iter().all(|f| *f == 0.0) { 1e-4 } else { 2e-3 };
    let start_m = [top[0] - 0.005, top[1] - 0.003, top[2] + 0.016 + clear_m];
    let sphere = CoatedSphere::new(&case.body, 0.012, layer, start_m);
    let name = format!("{}, sphere", case.name);
    Case { name, body: case.body.clone(), contact: sphere.into(), constraints: case.constraints }
}

/// The same with quadratic elements only near the contact point.
fn near_the_pad(case: &Case, reach_m: f64) -> Case {
    let centre_m = case.contact.pad().expect("a pad").centre_m;
    let body = Arc::new(case.body.quadratic_near(centre_m, reach_m));
    let (name, contact) = (format!("{}, P2 near it", case.name), case.contact.clone());
    Case { name, body, contact, constraints: case.constraints }
}

/// Every law, every field pair, and every boundary condition and load of the beam.
pub(super) fn cases() -> Vec<Case> {
    let mut all: Vec<Case> = livers()
        .into_iter()
        .map(|law| case(&format!("{} tet4", law.name()), |m| m.regions = vec![law.into()]))
        .collect();
    let stabilised = |m: &mut Model| m.pressure_pair = PressurePair::Stabilised;
    let quadratic = |m: &mut Model| m.order = Order::Quadratic;
    all.push(case("mooney-rivlin P1/P1 stabilised", stabilised));
    all.push(case("mooney-rivlin P2/P1", quadratic));
    all.push(case("st-venant-kirchhoff tet10", |m| {
        m.order = Order::Quadratic;
        m.regions = vec![st_venant_kirchhoff().into()];
    }));
    all.push(case("mooney-rivlin bulk 0.1 MPa", |m| {
        m.regions = vec![Region { material: mooney_rivlin(), bulk_modulus_pa: Some(1e5) }];
    }));
    all.push(case("two regions", |m| {
        m.regions = vec![mooney_rivlin().into(), st_venant_kirchhoff().into()];
        m.region_of_tet = (0..96).map(|tet| u16::from(tet >= 60)).collect();
    }));
    all.push(case("mooney-rivlin under gravity", |m| m.body_force_n_m3 = [0.0, 0.0, -1.0e4]));
    let mut multipliers = case("multipliers", |_| {});
    multipliers.constraints = Constraints::Multipliers;
    all.push(multipliers);
    let spheres: Vec<Case> = all.iter().map(under_a_sphere).collect();
    let pads: Vec<Case> = all
        .iter()
        .zip([PadProfile::Quartic, PadProfile::Hertz].into_iter().cycle())
        .map(|(case, profile)| under_a_pad(case, profile))
        .collect();
    // Only the pressed part of the body is quadratic.
    let is_near = |case: &&Case| case.body.order == Order::Quadratic;
    let near: Vec<Case> = pads.iter().filter(is_near).map(|case| near_the_pad(case, 0.035)).collect();
    all.extend(pads);
    all.extend(spheres);
    all.extend(near);
    let mut patch = case("rigid patch", |_| {});
    let mesh = beam();
    let tip = nodes_where(&mesh, |x| x[2] > 0.039 && (x[0] - 0.06).abs() < 0.01);
    let patch_of = Handle::patch(nearest_node(&mesh, [0.06, 0.02, 0.04]), &tip);
    assert!(patch_of.nodes.len() >= 3);
    patch.contact = patch_of.into();
    all.push(patch);
    all
}

pub(super) fn solver(case: &Case) -> Solver {
    let problem = Problem::with(case.body.clone(), Some(case.contact.clone()), case.constraints);
    Solver::new(Arc::new(problem))
}

#[test]
fn derivatives_of_the_condensed_potential_agree_with_differences() {
    println!("{:34} {:>9} {:>9} {:>9} {:>9}   relative difference", "", "h", "S", "W_ijk", "du/dd");
    for case in cases() {
        let mut solver = solver(&case);
        let rest = solver.rest().expect("the beam is fixed");
        let d = [0.004, -0.003, -0.008];
        let half =
            solver.advance(&rest.seed, d.map(|x| 0.5 * x)).expect("half of the displacement converges");
        let here = solver.advance(&half.seed, d).expect("the beam converges");
        // Fibres tighten within a stretch of 1 %. W is only C3 there, so the difference step must be short.
        let (fibres, sphere) = (case.name.starts_with("holzapfel"), case.name.ends_with("sphere"));
        assert!(Vector3::from(here.jet().force_n).norm() > 0.01, "{}: the tool presses", case.name);
        // A point that comes into a layer leaves a jump in the fourth derivative, which a step can meet.
        let step = if sphere {
            2e-7
        } else if fibres {
            2e-6
        } else {
            5e-5
        };
        let mut worst = [0.0f64; 4];
        for axis in 0..3 {
            let around = [-2.0, -1.0, 1.0, 2.0].map(|by| {
                let mut there = d;
                there[axis] += by * step;
                solver.advance(&here.seed, there).expect("a step of 0.2 mm converges")
            });
            // Fourth-order central difference.
            let slope = |value: &dyn Fn(&Configuration) -> f64| {
                let [a, b, c, d] = around.each_ref().map(value);
                (a - 8.0 * b + 8.0 * c - d) / (12.0 * step)
            };
            let size = Vector3::from(here.jet().force_n).norm();
            worst[0] = worst[0].max((slope(&|c| c.jet().energy_j) - here.jet().force_n[axis]).abs() / size);
            let size = here.jet().stiffness_n_m.norm();
            for row in 0..3 {
                let error = slope(&|c| c.jet().force_n[row]) - here.jet().stiffness_n_m[(row, axis)];
                worst[1] = worst[1].max(error.abs() / size);
            }
            let size = here.jet().third_n_m2.iter().fold(0.0f64, |m, t| m.max(t.abs()));
            for (third, [i, j, k]) in here.jet().third_n_m2.iter().zip(THIRD_INDICES) {
                // W_ijk from dS_ij/dd_k and its permutations.
                for (row, column, by) in [(i, j, k), (j, k, i), (i, k, j)] {
                    if by == axis {
                        let error = slope(&|c| c.jet().stiffness_n_m[(row, column)]) - third;
                        // The third derivative of the linear law is zero.
                        worst[2] = worst[2].max(error.abs() / size.max(here.jet().stiffness_n_m.norm()));
                    }
                }
            }
            for i in 0..case.body.displacement_len() {
                let error = slope(&|c| c.seed.state[i]) - here.seed.sensitivity[axis][i];
                worst[3] = worst[3].max(error.abs());
            }
        }
        let [h, s, third, u] = worst;
        println!("{:34} {h:9.1e} {s:9.1e} {third:9.1e} {u:9.1e}", case.name);
        // W is C3 with fibres: the third derivative has kinks, which limit the accuracy of the difference.
        let allowed = if fibres || sphere { [1e-8, 1e-7, 1e-6, 1e-6] } else { [1e-8, 1e-7, 1e-7, 1e-7] };
        assert!(worst.iter().zip(allowed).all(|(w, a)| *w < a), "{}", case.name);
        assert_eq!(here.unstable_modes, Some(0), "{}", case.name);
    }
}

#[test]
fn energy_is_the_work_along_a_path() {
    for case in cases() {
        let mut solver = solver(&case);
        let mut here = solver.rest().expect("the beam is fixed");
        let reaction = Vector3::from(here.jet().force_n).norm();
        assert!(here.jet().energy_j.abs() < 1e-15 && reaction < 1e-9, "{}: rest has no force", case.name);
        // Gauss-Legendre quadrature with five points on the straight path: the error is of tenth order in the
        // step.
        let end = [0.006, 0.004, -0.009];
        let nodes = [0.0469100770306680, 0.2307653449471585, 0.5, 0.7692346550528415, 0.953_089_922_969_332];
        let weights = [
            0.1184634425280945,
            0.2393143352496832,
            0.2844444444444444,
            0.2393143352496832,
            0.1184634425280945,
        ];
        // In pieces, because fibres that tighten, and points that come into a layer, leave kinks in the fourth
        // derivative.
        let (mut work, pieces) = (0.0, if case.name.ends_with("sphere") { 32 } else { 8 });
        for piece in 0..pieces {
            for (t, w) in nodes.into_iter().zip(weights) {
                let t = (f64::from(piece) + t) / f64::from(pieces);
                here = solver.advance(&here.seed, end.map(|x| t * x)).expect("the beam converges");
                work += w / f64::from(pieces) * Vector3::from(here.jet().force_n).dot(&Vector3::from(end));
            }
        }
        let energy = solver.advance(&here.seed, end).expect("the beam converges").jet().energy_j;
        let error = (work / energy - 1.0).abs();
        println!("{:34} energy against work along a path: {error:.1e}", case.name);
        assert!(error < 1e-7, "{}: work {work} J, energy {energy} J", case.name);
    }
}

#[test]
fn the_same_solve_gives_the_same_bits() {
    let case = case("mooney-rivlin", |_| {});
    let d = [0.003, 0.002, -0.011];
    let reach = |solver: &mut Solver, d: [f64; 3]| {
        let rest = solver.rest().expect("the beam is fixed");
        solver.advance(&rest.seed, d).expect("the beam converges")
    };
    let first = reach(&mut solver(&case), d);
    let mut used = solver(&case);
    let _ = reach(&mut used, [-0.002, 0.0, 0.004]);
    let second = reach(&mut used, d);
    assert_eq!(first.jet().force_n.map(f64::to_bits), second.jet().force_n.map(f64::to_bits));
    assert_eq!(first.jet().energy_j.to_bits(), second.jet().energy_j.to_bits());
    assert!(first.seed.state.iter().zip(&second.seed.state).all(|(a, b)| a.to_bits() == b.to_bits()));
}

#[test]
fn the_pressure_preserves_the_volume() {
    let volume = |law: Material| {
        let case = case(law.name(), |m| m.regions = vec![law.into()]);
        let mut solver = solver(&case);
        let rest = solver.rest().expect("the beam is fixed");
        solver.advance(&rest.seed, [0.0, 0.01, 0.012]).expect("the beam converges").volume_m3
    };
    let rest = beam().volume_m3();
    // Every pressure node has a free element here, so the constraints sum to the total volume.
    let change = volume(mooney_rivlin()) / rest - 1.0;
    println!("Mooney-Rivlin: volume change {change:.1e}");
    assert!(change.abs() < 1e-12);
    assert!(
        (volume(st_venant_kirchhoff()) / rest - 1.0).abs() > 1e-6,
        "the volume of a compressible body must change"
    );
}
