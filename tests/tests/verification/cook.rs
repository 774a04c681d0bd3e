//! Cook's membrane: a tapered panel, clamped at the left and sheared at the right, in plane strain.
//!
//! Published displacements of the top right corner: E = 70, nu = 1/3, shear force 100: 32.20 (Code_Aster),
//! 32.27 (CalculiX), 32.28 (Elmer), collected by the CoFEA benchmark. Nearly incompressible, E = 250, nu =
//! .4999, force 100: 7.769 (Kasper and Taylor 2000, mixed-enhanced strain). With nu near 1/2, tet4 locks,
//! tet10 converges slowly, and P2/P1 has neither problem.

use nalgebra::Vector3;
use palpate_precompute::fem::material::{Lame, LinearElastic, Material, MooneyRivlin};
use palpate_precompute::fem::{Body, Model, Order, Region, solve_body_force};
use palpate_precompute::mesh::TetMesh;

/// Vertical displacement of the top right corner (48, 60) with `n` x `n` cells, one cell thick, under a shear
/// force per thickness.
fn tip(n: usize, order: Order, region: Region, force: f64) -> f64 {
    let mut mesh = TetMesh::cuboid([n, n, 1], 1.0 / n as f64);
    let thickness = 16.0 / n as f64;
    for x in &mut mesh.nodes_m {
        let (s, t) = (x[0], x[1]);
        *x = [48.0 * s, 44.0 * s + t * (44.0 - 28.0 * s), x[2] * n as f64 * thickness];
    }
    let mesh = TetMesh::new(mesh.nodes_m, mesh.tets).expect("the panel is a valid mesh");
    let count = mesh.nodes_m.len() as u32;
    let at_left = |node: &u32| mesh.nodes_m[*node as usize][0] == 0.0;
    let model = Model {
        order,
        regions: vec![region.clone()],
        rollers: (0..count).map(|node| (node, [false, false, true])).collect(),
        ..Model::uniform(region.material, &(0..count).filter(at_left).collect::<Vec<_>>())
    };
    let mut body = Body::new(&mesh, &model).expect("every element has volume");
    let at_right = |x: &[f64; 3]| (x[0] - 48.0).abs() < 1e-9;
    // Uniform shear over the right face, 16 x thickness; each face of a tet carries its share of the area.
    let mut loads = vec![0.0; body.nodes_m.len()];
    for (element, tet) in mesh.tets.iter().enumerate() {
        let face: Vec<u32> =
            tet.iter().copied().filter(|&node| at_right(&mesh.nodes_m[node as usize])).collect();
        if let [a, b, c] = face[..] {
            let [a, b, c] = [a, b, c].map(|node| Vector3::from(mesh.nodes_m[node as usize]));
            let share = 0.5 * (b - a).cross(&(c - a)).norm() / (16.0 * thickness) * force * thickness / 3.0;
            let nodes = body.nodes_of(element);
            let loaded = nodes[if order == Order::Linear { 0..4 } else { 4..10 }].iter();
            for &node in loaded.filter(|&&node| at_right(&body.nodes_m[node as usize])) {
                loads[node as usize] += share;
            }
        }
    }
    for (node, load) in loads.iter().enumerate() {
        body.external_force_n[3 * node + 1] = *load;
    }
    let body = solve_body_force(body).expect("the panel converges");
    let corner = (0..count).find(|&node| {
        let x = mesh.nodes_m[node as usize];
        at_right(&x) && (x[1] - 60.0).abs() < 1e-9
    });
    body.rest_state[3 * corner.expect("the panel has its corner") as usize + 1]
}

fn row(name: &str, sizes: &[usize], order: Order, region: Region, force: f64) -> f64 {
    let tips: Vec<f64> = sizes.iter().map(|&n| tip(n, order, region.clone(), force)).collect();
    println!("{name:34} {}", tips.iter().map(|t| format!("{t:8.4}")).collect::<Vec<_>>().join(" "));
    tips[tips.len() - 1]
}

#[test]
fn cooks_membrane_matches_published_displacements() {
    let linear = |young, poisson| -> Region {
        Material::LinearElastic(LinearElastic { lame: Lame::from_young_poisson(young, poisson) }).into()
    };
    println!("vertical displacement of the corner, 4 8 16 32 cells a side");
    let (few, many) = ([4, 8, 16], [4, 8, 16, 32]);
    let tet4 = row("linear nu = 1/3, tet4", &many, Order::Linear, linear(70.0, 1.0 / 3.0), 100.0);
    let tet10 = row("linear nu = 1/3, tet10", &few, Order::Quadratic, linear(70.0, 1.0 / 3.0), 100.0);
    let locked = row("linear nu = .4999, tet4", &many, Order::Linear, linear(250.0, 0.4999), 100.0);
    let nearly = row("linear nu = .4999, tet10", &few, Order::Quadratic, linear(250.0, 0.4999), 100.0);
    // A small load, for which the incompressible law agrees with the linear one; C10 = mu / 2.
    let mu_pa = 250.0 / (2.0 * 1.4999);
    let neo = Region {
        material: Material::MooneyRivlin(MooneyRivlin { c10_pa: 0.5 * mu_pa, c01_pa: 0.0 }),
        bulk_modulus_pa: Some(mu_pa * 2.0 * 0.4999 / (1.0 - 2.0 * 0.4999)),
    };
    let small = 1e-3;
    let mixed = row("mixed P2/P1, times 1e5", &few, Order::Quadratic, neo.clone(), 100.0 * small) / small;
    println!("mixed P2/P1, small load scaled up  {mixed:8.4}");
    let finite = row("mixed P2/P1, finite strain", &few, Order::Quadratic, neo, 100.0);
    assert!((tet10 / 32.25 - 1.0).abs() < 0.01 && tet4 < tet10 && tet4 > 0.93 * tet10);
    assert!((mixed / 7.769 - 1.0).abs() < 0.015);
    assert!(locked < 0.4 * mixed && (0.9..1.0).contains(&(nearly / mixed)));
    // The panel stiffens at finite strain.
    assert!((0.8..0.95).contains(&(finite / mixed)));
}
