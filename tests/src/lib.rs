//! Fixtures shared by the tests: small bodies with known solutions.
#![forbid(unsafe_code)]

pub mod circles;
pub mod coarse_blob;
pub mod documents;
pub mod figures;
pub mod platform_math;
pub mod sizes;
pub mod space_bench;
pub mod strata;

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use palpate_precompute::fem::material::{LAWS, Lame, Material, MooneyRivlin, StVenantKirchhoff, Value};
use palpate_precompute::fem::{Body, Model};
use palpate_precompute::mesh::TetMesh;

/// Files below a folder, except build output and those of git, sorted in each folder.
///
/// # Panics
///
/// If a folder cannot be read.
#[must_use]
pub fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.expect("readable").path()).collect();
    paths.sort();
    let name = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    paths.retain(|path| name(path).is_some_and(|name| name != "target" && name != ".git"));
    paths.into_iter().flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

/// The Rust files among [`files`].
#[must_use]
pub fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let is_rust = |path: &PathBuf| path.extension().is_some_and(|kind| kind == "rs");
    files(folder).into_iter().filter(is_rust).collect()
}

/// A Rust file as syntax.
///
/// # Panics
///
/// If it cannot be read or parsed.
#[must_use]
pub fn parsed(file: &Path) -> syn::File {
    let text = std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    syn::parse_file(&text).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

/// The paper's Mooney-Rivlin liver.
pub fn mooney_rivlin() -> Material {
    Material::MooneyRivlin(MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 })
}

/// The paper's St. Venant-Kirchhoff liver.
pub fn st_venant_kirchhoff() -> Material {
    Material::StVenantKirchhoff(StVenantKirchhoff { lame: Lame::from_young_poisson(15480.0, 0.49) })
}

/// Every built-in law, with constants similar to those of a liver.
pub fn livers() -> Vec<Material> {
    let given = |law: &str| -> Vec<(&str, Value)> {
        match law {
            "mooney-rivlin" | "mooney-rivlin-reduced" => {
                vec![("c10_pa", Value::Number(1300.0)), ("c01_pa", Value::Number(1280.0))]
            }
            "holzapfel-gasser-ogden" => vec![
                ("c10_pa", Value::Number(2500.0)),
                ("k1_pa", Value::Number(3000.0)),
                ("k2", Value::Number(2.0)),
                ("dispersion", Value::Number(0.1)),
                ("fibre", Value::Vector([0.8, 0.0, 0.6])),
            ],
            "st-venant-kirchhoff" => {
                vec![("young_pa", Value::Number(15480.0)), ("poisson", Value::Number(0.49))]
            }
            _ => vec![("young_pa", Value::Number(15480.0)), ("poisson", Value::Number(0.45))],
        }
    };
    let liver = |law: &&str| Material::from_parameters(law, &given(law)).expect("constants of the law");
    LAWS.iter().map(liver).collect()
}

/// A box of `cells` cubes of edge `edge_m`, each split into six tetrahedra around its main diagonal (Kuhn).
/// Nodes are moved off the lattice slightly, those of a face within the face, so that no symmetry hides an
/// error.
pub fn box_mesh(cells: [usize; 3], edge_m: f64) -> TetMesh {
    let mut mesh = TetMesh::cuboid(cells, edge_m);
    for x in &mut mesh.nodes_m {
        let at = x.map(|x| (x / edge_m).round() as usize);
        let [i, j, k] = at;
        for axis in 0..3 {
            let wobble = ((7 * i + 11 * j + 13 * k + 4 * axis + 1) % 17) as f64 / 17.0 - 0.5;
            if at[axis] != 0 && at[axis] != cells[axis] {
                x[axis] += 0.3 * wobble * edge_m;
            }
        }
    }
    mesh.check().expect("the box is a valid mesh");
    mesh
}

/// Nodes of a mesh that `keep` accepts.
pub fn nodes_where(mesh: &TetMesh, keep: impl Fn([f64; 3]) -> bool) -> Vec<u32> {
    (0..mesh.nodes_m.len() as u32).filter(|&n| keep(mesh.nodes_m[n as usize])).collect()
}

/// Node nearest to a point.
pub fn nearest_node(mesh: &TetMesh, point_m: [f64; 3]) -> u32 {
    let distance = |n: u32| -> f64 {
        mesh.nodes_m[n as usize].iter().zip(point_m).map(|(x, p)| (x - p) * (x - p)).sum()
    };
    (0..mesh.nodes_m.len() as u32)
        .min_by(|&a, &b| distance(a).total_cmp(&distance(b)))
        .expect("the mesh has nodes")
}

/// A beam of 80 x 40 x 40 mm.
pub fn beam() -> TetMesh {
    box_mesh([4, 2, 2], 0.02)
}

/// The soft beam, fixed at its left end, with the middle of its top face as active node.
pub fn soft_beam(material: Material) -> (TetMesh, Vec<u32>, u32, Arc<Body>) {
    let mesh = beam();
    let fixed = nodes_where(&mesh, |x| x[0] == 0.0);
    let active = nearest_node(&mesh, [0.06, 0.02, 0.04]);
    let model = Model::uniform(material, &fixed);
    let body = Arc::new(Body::new(&mesh, &model).expect("every element has volume"));
    (mesh, fixed, active, body)
}

/// Writes a mesh as Gmsh 2.2 ASCII.
pub fn write_gmsh22(mesh: &TetMesh, path: &Path) {
    let mut text = String::from("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n");
    writeln!(text, "{}", mesh.nodes_m.len()).expect("writing to a string cannot fail");
    for (i, [x, y, z]) in mesh.nodes_m.iter().enumerate() {
        writeln!(text, "{} {x:?} {y:?} {z:?}", i + 1).expect("writing to a string cannot fail");
    }
    writeln!(text, "$EndNodes\n$Elements\n{}", mesh.tets.len()).expect("writing to a string cannot fail");
    for (i, [a, b, c, d]) in mesh.tets.iter().enumerate() {
        writeln!(text, "{} 4 2 1 1 {} {} {} {}", i + 1, a + 1, b + 1, c + 1, d + 1)
            .expect("writing to a string cannot fail");
    }
    text.push_str("$EndElements\n");
    std::fs::write(path, text).expect("the folder is writable");
}

/// Writes the soft beam as a scene with this law, grid and force limit. Returns the path of the scene.
pub fn write_beam_scene(folder: &Path, law: &str, grid: &str, max_force_n: f64) -> PathBuf {
    let (mesh, fixed, active, _) = soft_beam(mooney_rivlin());
    write_gmsh22(&mesh, &folder.join("beam.msh"));
    let scene = format!(
        "name = \"beam\"\n[mesh]\nfile = \"beam.msh\"\n[material]\n{law}\n[fixed]\nnodes = {fixed:?}\n[[active]]\nname \
         = \"A\"\nnode = {active}\n[grid]\n{grid}\n[device]\nmax_force_n = {max_force_n:?}\n"
    );
    let path = folder.join("beam.toml");
    std::fs::write(&path, scene).expect("the folder is writable");
    path
}
