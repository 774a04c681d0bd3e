//! A poor mesh of a real liver that the project does not contain: edges of 1.8 to 45 mm, dihedral angles down
//! to 13 degrees.

use std::path::PathBuf;

use nalgebra::Vector3;
use palpate_precompute::fem::{Handle, Model, Order, Solver};
use palpate_precompute::mesh::{LengthUnit, MeshReport, Surface, read};
use palpate_tests::{mooney_rivlin, nodes_where, st_venant_kirchhoff};

use super::table::{Case, row};
use super::walk::{body, norm, problem, walk};

#[test]
fn a_poor_real_mesh_converges_or_gives_its_reason() {
    let Some(folder) = std::env::var_os("PALPATE_REFERENCE_DIR").map(PathBuf::from) else {
        println!("skipped: set PALPATE_REFERENCE_DIR to the folder of the reference meshes");
        return;
    };
    let path = folder.join("meshes/liver_sofa507.msh2.msh");
    let mesh = read(&path, LengthUnit::Metre).expect("the reference mesh is readable");
    let report = MeshReport::of(&mesh);
    assert_eq!((report.nodes, report.tets), (507, 1493));
    assert!(report.dihedral_deg.min < 15.0 && report.edge_m.max > 20.0 * report.edge_m.min, "{report}");
    // The fixed nodes follow the rule of the reference's other meshes: the left 22 mm of the surface.
    let skin = Surface::of(&mesh);
    let low = report.low_m[0];
    let fixed: Vec<u32> =
        nodes_where(&mesh, |x| x[0] < low + 0.022).into_iter().filter(|&n| skin.contains(n)).collect();
    let farthest = |from: f64| {
        let distance = |n: &u32| (mesh.nodes_m[*n as usize][0] - from).abs();
        skin.nodes
            .iter()
            .copied()
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .expect("a surface has nodes")
    };
    let (high, mid) = (report.high_m[0], 0.5 * (low + report.high_m[0]));
    for (node, place) in [(farthest(high), "right tip"), (farthest(mid), "middle")] {
        let normal = skin.normal(node).expect("on the surface");
        for (way, direction) in [("out", normal), ("in", normal.map(|c| -c))] {
            for (law, order) in [
                (st_venant_kirchhoff(), Order::Linear),
                (mooney_rivlin(), Order::Linear),
                (mooney_rivlin(), Order::Quadratic),
            ] {
                let model = Model { order, ..Model::uniform(law.clone(), &fixed) };
                let body = body(&mesh, &model);
                let handle = Handle::node(node);
                assert_eq!(body.check_pressures(Some(&handle)), Ok(()));
                let mut solver = Solver::new(problem(&body, handle));
                let path_result = walk(&mut solver, direction, 2e-3, 15).expect("the liver is fixed");
                let tried = format!("{}, {order:?}, {place} {way}, 15 x 2 mm", law.name());
                let work = path_result.work_j / path_result.last.jet().energy_j - 1.0;
                let verdict = format!("{}; work/energy - 1 = {work:.0e}", path_result.verdict());
                row(Case::RealMesh, &tried, path_result.cost, &path_result.result(), &verdict);
                assert!(path_result.reached_m > 0.003, "{tried}: {:?}", path_result.failure);
                // A snap dissipates work, and inverted elements may snap.
                assert!(work.abs() < 1e-3 || path_result.inverted_at_m.is_some(), "{tried}: {work:e}");
                if path_result.failure.is_none() {
                    let force =
                        |n: u32| Vector3::from_column_slice(&solver.nodal_force_n()[3 * n as usize..][..3]);
                    let held: Vector3<f64> = (0..body.nodes_m.len() as u32)
                        .filter(|&n| body.fixed[n as usize][0])
                        .map(force)
                        .sum();
                    let error = (held + Vector3::from(path_result.last.jet().force_n)).norm();
                    assert!(
                        error < 1e-7 * norm(path_result.last.jet().force_n),
                        "{tried}: reactions {error:e} N out of balance"
                    );
                }
            }
        }
    }
}
