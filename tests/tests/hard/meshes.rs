//! Bad meshes, generated in code.

use std::collections::HashMap;

use palpate_precompute::mesh::TetMesh;

/// A box of `cells` cubes of edge `edge_m`, each of five tetrahedra. The diagonals of all faces join nodes of
/// one parity of i + j + k, so the cubes fit. With a `gap` the parity changes at half the length. Each face
/// there has different diagonals on its two sides, whose nodes are `gap` edges apart, and a sliver between
/// them fills the face: four nodes almost on a circle, the worst element of mesh generators.
pub(crate) fn box_of_five(cells: [usize; 3], edge_m: f64, gap: Option<f64>) -> TetMesh {
    let [nx, ny, nz] = cells;
    let middle = nx / 2;
    let at = |[i, j, k]: [usize; 3]| ((i * (ny + 1) + j) * (nz + 1) + k) as u32;
    let mut nodes_m = Vec::new();
    for i in 0..=nx {
        for j in 0..=ny {
            for k in 0..=nz {
                let shift = match gap {
                    Some(gap) if i == middle && (i + j + k) % 2 == 0 => -0.5 * gap,
                    Some(gap) if i == middle => 0.5 * gap,
                    _ => 0.0,
                };
                nodes_m.push([(i as f64 + shift) * edge_m, j as f64 * edge_m, k as f64 * edge_m]);
            }
        }
    }
    let mut tets = Vec::new();
    for i in 0..nx {
        for j in 0..ny {
            for k in 0..nz {
                let parity = if gap.is_some() && i >= middle { 1 } else { 0 };
                let corner = |c: usize| [i + (c >> 2), j + (c >> 1 & 1), k + (c & 1)];
                let is_central = |c: usize| corner(c).iter().sum::<usize>() % 2 == parity;
                let central: Vec<usize> = (0..8).filter(|&c| is_central(c)).collect();
                tets.push([0, 1, 2, 3].map(|n| at(corner(central[n]))));
                for c in (0..8).filter(|&c| !is_central(c)) {
                    tets.push([c, c ^ 1, c ^ 2, c ^ 4].map(|n| at(corner(n))));
                }
                if gap.is_some() && i + 1 == middle {
                    let face = [[0, 0], [0, 1], [1, 0], [1, 1]].map(|[a, b]| at([middle, j + a, k + b]));
                    tets.push(face);
                }
            }
        }
    }
    oriented(nodes_m, tets)
}

/// A cube of `edge_m` with nested cubes, each `ratio` times smaller than the one around it; the outermost one
/// is cut into `cells`^3. Each shell is filled with pyramids on triangles, from the centres of the six
/// frusta.
pub(crate) fn nested_cubes(edge_m: f64, ratio: f64, levels: i32) -> TetMesh {
    // Faces of a cube by corner numbers x + 2 y + 4 z, in order around each face.
    const FACES: [[u32; 4]; 6] =
        [[0, 2, 6, 4], [1, 3, 7, 5], [0, 1, 5, 4], [2, 3, 7, 6], [0, 1, 3, 2], [4, 5, 7, 6]];
    let mut nodes_m = Vec::new();
    for level in 0..=levels {
        let half = 0.5 * edge_m / ratio.powi(level);
        for corner in 0..8_u32 {
            let side = |bit: u32| if corner >> bit & 1 == 1 { half } else { -half };
            nodes_m.push([0, 1, 2].map(|bit| 0.5 * edge_m + side(bit)));
        }
    }
    let mut tets = Vec::new();
    // A quadrilateral is cut along the diagonal at its lowest node, which is the same from both sides.
    let mut cone = |quads: &[[u32; 4]], nodes_m: &mut Vec<[f64; 3]>| {
        let mut seen: Vec<u32> = quads.concat();
        seen.sort_unstable();
        seen.dedup();
        let apex = nodes_m.len() as u32;
        let mean =
            |axis: usize| seen.iter().map(|&n| nodes_m[n as usize][axis]).sum::<f64>() / seen.len() as f64;
        let middle = [mean(0), mean(1), mean(2)];
        nodes_m.push(middle);
        for quad in quads {
            let lowest = (0..4).min_by_key(|&c| quad[c]).expect("a quadrilateral has corners");
            let [a, b, c, d] = [0, 1, 2, 3].map(|n| quad[(lowest + n) % 4]);
            tets.push([a, b, c, apex]);
            tets.push([a, c, d, apex]);
        }
    };
    for level in 0..levels as u32 {
        let (outer, inner) = (8 * level, 8 * level + 8);
        for face in FACES {
            let mut quads = vec![face.map(|c| outer + c), face.map(|c| inner + c)];
            for side in 0..4 {
                let (p, q) = (face[side], face[(side + 1) % 4]);
                quads.push([outer + p, outer + q, inner + q, inner + p]);
            }
            cone(&quads, &mut nodes_m);
        }
    }
    cone(&FACES.map(|face| face.map(|c| 8 * levels as u32 + c)), &mut nodes_m);
    oriented(nodes_m, tets)
}

/// The mesh with all tetrahedra oriented to positive volume.
fn oriented(nodes_m: Vec<[f64; 3]>, tets: Vec<[u32; 4]>) -> TetMesh {
    let mut mesh = TetMesh { nodes_m, tets, ..TetMesh::default() };
    for tet in 0..mesh.tets.len() {
        if mesh.signed_volume_m3(tet) < 0.0 {
            mesh.tets[tet].swap(2, 3);
        }
    }
    TetMesh::new(mesh.nodes_m, mesh.tets).expect("the generated mesh is valid")
}

/// `a` and a copy of it at `offset_m`, in one mesh without common nodes.
pub(crate) fn two_pieces(a: &TetMesh, offset_m: [f64; 3]) -> TetMesh {
    let n = a.nodes_m.len() as u32;
    let moved = a.nodes_m.iter().map(|x| std::array::from_fn(|axis| x[axis] + offset_m[axis]));
    let nodes = a.nodes_m.iter().copied().chain(moved).collect();
    let tets = a.tets.iter().copied().chain(a.tets.iter().map(|t| t.map(|v| v + n))).collect();
    TetMesh::new(nodes, tets).expect("both pieces are valid")
}

/// The mesh scaled by `factor`.
pub(crate) fn scaled(mesh: &TetMesh, factor: f64) -> TetMesh {
    let nodes = mesh.nodes_m.iter().map(|x| x.map(|c| c * factor)).collect();
    TetMesh::new(nodes, mesh.tets.clone()).expect("the scaled mesh is valid")
}

/// The meshes fill their boxes and are connected, which the cases on them require.
#[test]
fn generated_meshes_are_valid() {
    let faces_fit = |mesh: &TetMesh| {
        let mut uses: HashMap<[u32; 3], u32> = HashMap::new();
        for t in &mesh.tets {
            for skip in 0..4 {
                let mut face: Vec<u32> = (0..4).filter(|&v| v != skip).map(|v| t[v]).collect();
                face.sort_unstable();
                *uses.entry([face[0], face[1], face[2]]).or_default() += 1;
            }
        }
        let outer: Vec<_> = uses.iter().filter(|(_, n)| **n == 1).map(|(face, _)| *face).collect();
        assert!(uses.values().all(|&n| n <= 2));
        let (low, high) = mesh.bounding_box_m();
        outer.iter().all(|face| {
            (0..3).any(|axis| {
                [low, high]
                    .iter()
                    .any(|side| face.iter().all(|&n| mesh.nodes_m[n as usize][axis] == side[axis]))
            })
        })
    };
    for (mesh, volume) in [
        (box_of_five([4, 2, 2], 0.02, None), 1.28e-4),
        (box_of_five([4, 2, 2], 0.02, Some(0.002)), 1.28e-4),
        (nested_cubes(0.1, 2.0, 10), 1e-3),
        (nested_cubes(0.1, 1000.0, 1), 1e-3),
    ] {
        assert!((mesh.volume_m3() / volume - 1.0).abs() < 1e-12, "{}", mesh.volume_m3());
        assert!(faces_fit(&mesh), "an inner face has only one tet");
    }
}
