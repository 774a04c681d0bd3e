//! The regions of a scene inside the body, for the side view of a session.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use palpate_core::Organ;
use palpate_precompute::mesh::TetMesh;
use palpate_precompute::num::distance;
use palpate_precompute::scene::{MaterialRegion, Scene};
use palpate_viewer::Regions;

use crate::failure::Failure;

/// The corners of each face of a tet.
const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];
/// Weights of the skin below this are left out of the mean.
const MIN_WEIGHT: f64 = 1e-4;
/// Relative residual at which the weights are known well enough for a picture.
const TOLERANCE: f64 = 1e-6;

/// The boundaries of all materials but the most common in the scene at `path`. The organs are of its mesh.
pub(crate) fn of_scene(path: &Path, organs: &[&Organ<'_>]) -> Result<Regions, Failure> {
    let scene = Scene::load(path)?.resolve()?;
    let refused = |what: &str| Failure::input(format!("--scene {}: {what}", path.display()));
    let hash = scene.mesh.content_hash();
    if organs.iter().any(|organ| organ.mesh_hash != hash) {
        return Err(refused("the blob was made from another mesh: give the scene of the blob"));
    }
    let triangles = boundaries(&scene.mesh, &scene.materials);
    if triangles.is_empty() {
        return Err(refused("it has one material, so there is no region to show: leave it out"));
    }
    Ok(following(&scene.mesh, &triangles, organs.first().map_or(&[], |organ| organ.surface.node)))
}

/// The boundary of every region but the largest, by mesh nodes.
fn boundaries(mesh: &TetMesh, materials: &[MaterialRegion]) -> Vec<[u32; 3]> {
    let parts: Vec<&Vec<u32>> = materials.iter().filter_map(|material| material.tets.as_ref()).collect();
    let largest = parts.iter().enumerate().max_by_key(|(_, tets)| tets.len()).map(|(part, _)| part);
    let mut triangles = Vec::new();
    for (_, tets) in parts.iter().enumerate().filter(|(part, _)| Some(*part) != largest) {
        let mut faces: BTreeMap<[u32; 3], Option<[u32; 3]>> = BTreeMap::new();
        for tet in tets.iter().map(|tet| mesh.tets[*tet as usize]) {
            for face in FACES.map(|face| face.map(|corner| tet[corner])) {
                let mut key = face;
                key.sort_unstable();
                // A face of two tets of the region is inside it.
                faces.entry(key).and_modify(|face| *face = None).or_insert(Some(face));
            }
        }
        triangles.extend(faces.into_values().flatten());
    }
    triangles
}

/// The boundary as it follows the nodes of the skin: each vertex by the harmonic mean of their displacements.
///
/// The true displacement inside is not in the blob. A harmonic one decays from the skin inwards, is exact for
/// a translation, and is that of the skin on the skin.
fn following(mesh: &TetMesh, triangles: &[[u32; 3]], skin: &[u32]) -> Regions {
    let conduction = Conduction::new(mesh, skin);
    let mut vertices: Vec<u32> = triangles.as_flattened().to_vec();
    vertices.sort_unstable();
    vertices.dedup();
    let index: HashMap<u32, u32> = vertices.iter().zip(0..).map(|(node, index)| (*node, index)).collect();
    let mut regions = Regions::default();
    for node in &vertices {
        let weights = conduction.weights(*node as usize);
        let mut offset_m = mesh.nodes_m[*node as usize];
        for (vertex, weight) in &weights {
            let place_m = mesh.nodes_m[skin[*vertex as usize] as usize];
            (0..3).for_each(|axis| offset_m[axis] -= weight * place_m[axis]);
        }
        regions.offset_m.push(offset_m.map(|x| x as f32));
        regions.weights.push(weights.into_iter().map(|(vertex, weight)| (vertex, weight as f32)).collect());
    }
    regions.triangles = triangles.iter().map(|corners| corners.map(|node| index[&node])).collect();
    regions
}

/// The edges of a mesh as conductors of 1 / length between its nodes; those of the skin are held.
struct Conduction {
    /// (neighbour, conductance) of each node.
    edges: Vec<Vec<(usize, f64)>>,
    /// Index in the skin of each node that is on it.
    skin: Vec<Option<u32>>,
}

impl Conduction {
    fn new(mesh: &TetMesh, skin: &[u32]) -> Self {
        let mut edges = vec![BTreeMap::new(); mesh.nodes_m.len()];
        for tet in &mesh.tets {
            for (i, j) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
                let [one, other] = [tet[i] as usize, tet[j] as usize];
                let conductance = distance(mesh.nodes_m[one], mesh.nodes_m[other]).recip();
                edges[one].insert(other, conductance);
                edges[other].insert(one, conductance);
            }
        }
        let mut index = vec![None; mesh.nodes_m.len()];
        for (vertex, node) in (0..).zip(skin) {
            if let Some(place) = index.get_mut(*node as usize) {
                *place = Some(vertex);
            }
        }
        Self { edges: edges.into_iter().map(|round| round.into_iter().collect()).collect(), skin: index }
    }

    /// L x on the nodes inside: sum over the edges of conductance times difference, the skin at zero.
    fn apply(&self, x: &[f64]) -> Vec<f64> {
        let row = |node: usize| match self.skin[node] {
            Some(_) => 0.0,
            None => {
                self.edges[node].iter().map(|(other, conductance)| conductance * (x[node] - x[*other])).sum()
            }
        };
        (0..x.len()).map(row).collect()
    }

    /// What a node inside takes from each vertex of the skin: non-negative, of sum 1.
    ///
    /// With L g = e_node it is the current that a source at the node sends to the vertex. Conjugate gradients.
    fn weights(&self, node: usize) -> Vec<(u32, f64)> {
        if let Some(vertex) = self.skin[node] {
            return vec![(vertex, 1.0)];
        }
        let count = self.edges.len();
        let (mut g, mut residual) = (vec![0.0; count], vec![0.0; count]);
        residual[node] = 1.0;
        let (mut direction, mut left) = (residual.clone(), 1.0);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        for _ in 0..count {
            if left <= TOLERANCE * TOLERANCE {
                break;
            }
            let image = self.apply(&direction);
            let step = left / dot(&direction, &image);
            for i in 0..count {
                g[i] += step * direction[i];
                residual[i] -= step * image[i];
            }
            let next = dot(&residual, &residual);
            let ratio = next / left;
            direction.iter_mut().zip(&residual).for_each(|(d, r)| *d = r + ratio * *d);
            left = next;
        }
        let current = |node: usize| -> f64 {
            self.edges[node].iter().map(|(other, conductance)| conductance * g[*other]).sum()
        };
        let skin =
            self.skin.iter().enumerate().filter_map(|(node, vertex)| Some(((*vertex)?, current(node))));
        let kept: Vec<(u32, f64)> = skin.filter(|(_, weight)| *weight >= MIN_WEIGHT).collect();
        let sum: f64 = kept.iter().map(|(_, weight)| weight).sum();
        kept.into_iter().map(|(vertex, weight)| (vertex, weight / sum)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_host::BlobFile;
    use palpate_precompute::mesh::Surface;

    const BLOB: &[u8] = include_bytes!("../../firmware-like-core/golden/organ-514.blob");

    fn scene(name: &str) -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets").join(name)
    }

    fn mesh(name: &str) -> TetMesh {
        Scene::load(&scene(name)).and_then(|scene| scene.resolve()).expect("a bundled scene").mesh
    }

    /// The boundary of the bundled tumour is a closed surface on its nodes, and lies where it does.
    #[test]
    fn the_tumour_has_a_closed_boundary() {
        let (path, mesh) = (scene("scenes/tumour.toml"), mesh("scenes/tumour.toml"));
        let skin = Surface::of(&mesh).nodes;
        let file = BlobFile::of(BLOB);
        let mut organ: Organ<'_> = Organ::read(file.bytes()).expect("a sound blob");
        let other = of_scene(&path, &[&organ]).expect_err("another mesh");
        assert!(other.line().contains("another mesh"), "{}", other.line());
        organ.mesh_hash = mesh.content_hash();
        organ.surface.node = &skin;
        let regions = of_scene(&path, &[&organ]).expect("two materials");
        let mut edges: HashMap<[u32; 2], usize> = HashMap::new();
        for [a, b, c] in &regions.triangles {
            for [i, j] in [[a, b], [b, c], [c, a]] {
                *edges.entry([*i.min(j), *i.max(j)]).or_default() += 1;
            }
        }
        assert!(regions.triangles.len() > 20 && edges.values().all(|count| *count % 2 == 0));
        let tumour: Vec<[f64; 3]> = mesh.tet_groups["tumour"]
            .iter()
            .flat_map(|tet| mesh.tets[*tet as usize])
            .map(|node| mesh.nodes_m[node as usize])
            .collect();
        for (offset_m, weights) in regions.offset_m.iter().zip(&regions.weights) {
            assert!(weights.iter().all(|(_, weight)| *weight > 0.0));
            let sum: f32 = weights.iter().map(|(_, weight)| weight).sum();
            assert!((sum - 1.0).abs() < 1e-5, "{sum}");
            let mut place_m = offset_m.map(f64::from);
            for (vertex, weight) in weights {
                let skin_m = mesh.nodes_m[skin[*vertex as usize] as usize];
                (0..3).for_each(|axis| place_m[axis] += f64::from(*weight) * skin_m[axis]);
            }
            let away = tumour.iter().map(|node_m| distance(*node_m, place_m)).fold(f64::INFINITY, f64::min);
            assert!(away < 1e-6, "{away}");
        }
    }

    /// A node on the skin follows its own vertex, and one inside the mean of its neighbours by conductance.
    #[test]
    fn a_node_inside_follows_the_skin_round_it() {
        let mesh = mesh("liver-small.toml");
        let skin = Surface::of(&mesh).nodes;
        let conduction = Conduction::new(&mesh, &skin);
        let mean_m: Vec<f64> = (0..mesh.nodes_m.len())
            .map(|node| {
                let weights = conduction.weights(node);
                let sum: f64 = weights.iter().map(|(_, weight)| weight).sum();
                assert!((sum - 1.0).abs() < 1e-9, "{node}: {sum}");
                weights.iter().map(|(v, w)| w * mesh.nodes_m[skin[*v as usize] as usize][2]).sum()
            })
            .collect();
        let mut inside = 0;
        for (node, found_m) in mean_m.iter().enumerate() {
            if conduction.skin[node].is_some() {
                assert_eq!(*found_m, mesh.nodes_m[node][2]);
                continue;
            }
            inside += 1;
            let round = &conduction.edges[node];
            let total: f64 = round.iter().map(|(_, conductance)| conductance).sum();
            let expected_m = round.iter().map(|(other, c)| c * mean_m[*other]).sum::<f64>() / total;
            // The body is 0.1 m high; small weights are left out.
            assert!((found_m - expected_m).abs() < 4e-4, "{node}: {found_m} {expected_m}");
        }
        assert!(inside > 50, "{inside}");
    }

    #[test]
    fn a_scene_of_one_material_is_refused() {
        let file = BlobFile::of(BLOB);
        let mut organ: Organ<'_> = Organ::read(file.bytes()).expect("a sound blob");
        organ.mesh_hash = mesh("liver-small.toml").content_hash();
        let refused = of_scene(&scene("liver-small.toml"), &[&organ]).expect_err("nothing to show");
        assert!(refused.line().contains("one material"), "{}", refused.line());
    }
}
