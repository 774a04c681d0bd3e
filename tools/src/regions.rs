//! The boundaries between the materials of a scene, for the side view of a session.

use std::collections::HashMap;
use std::path::Path;

use palpate_core::Organ;
use palpate_precompute::mesh::TetMesh;
use palpate_precompute::scene::Scene;
use palpate_viewer::Regions;

use crate::failure::Failure;

/// The corners of each face of a tet.
const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// The boundaries between materials in the scene at `path`, at rest. Every organ must be of its mesh.
pub(crate) fn of_scene(path: &Path, organs: &[&Organ<'_>]) -> Result<Regions, Failure> {
    let scene = Scene::load(path)?.resolve()?;
    let refused = |what: &str| Failure::input(format!("--scene {}: {what}", path.display()));
    let hash = scene.mesh.content_hash();
    if organs.iter().any(|organ| organ.mesh_hash != hash) {
        return Err(refused("the blob was made from another mesh: give the scene of the blob"));
    }
    if scene.body_force.is_some() {
        return Err(refused(
            "a body force moves its regions, and the blob does not state where: leave it out",
        ));
    }
    let mut region_of_tet = vec![0; scene.mesh.tets.len()];
    for (region, material) in scene.materials.iter().enumerate() {
        for tet in material.tets.iter().flatten() {
            region_of_tet[*tet as usize] = region;
        }
    }
    let regions = boundaries(&scene.mesh, &region_of_tet);
    if regions.triangles.is_empty() {
        return Err(refused("it has one material, so there is no region to show: leave it out"));
    }
    Ok(regions)
}

/// The faces between tets of different regions.
fn boundaries(mesh: &TetMesh, region_of_tet: &[usize]) -> Regions {
    let mut open: HashMap<[u32; 3], usize> = HashMap::new();
    let mut regions = Regions::default();
    let mut vertex_of_node: HashMap<u32, u32> = HashMap::new();
    for (tet, region) in mesh.tets.iter().zip(region_of_tet) {
        for face in FACES.map(|face| face.map(|corner| tet[corner])) {
            let mut key = face;
            key.sort_unstable();
            let Some(other) = open.remove(&key) else {
                open.insert(key, *region);
                continue;
            };
            if other == *region {
                continue;
            }
            regions.triangles.push(face.map(|node| {
                *vertex_of_node.entry(node).or_insert_with(|| {
                    regions.position_m.push(mesh.nodes_m[node as usize].map(|x| x as f32));
                    regions.position_m.len() as u32 - 1
                })
            }));
        }
    }
    regions
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_host::BlobFile;

    const BLOB: &[u8] = include_bytes!("../../firmware-like-core/golden/organ-514.blob");

    fn scene(name: &str) -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets").join(name)
    }

    /// The boundary of the bundled tumour is one closed surface round it, inside the body.
    #[test]
    fn the_tumour_has_a_closed_boundary() {
        let file = BlobFile::of(BLOB);
        let mut organ: Organ<'_> = Organ::read(file.bytes()).expect("a sound blob");
        let path = scene("scenes/tumour.toml");
        let mesh = Scene::load(&path).and_then(|scene| scene.resolve()).expect("a bundled scene").mesh;
        let other = of_scene(&path, &[&organ]).expect_err("another mesh");
        assert!(other.line().contains("another mesh"), "{}", other.line());
        organ.mesh_hash = mesh.content_hash();
        let regions = of_scene(&path, &[&organ]).expect("two materials");
        let mut edges: HashMap<[u32; 2], usize> = HashMap::new();
        for [a, b, c] in &regions.triangles {
            for [i, j] in [[a, b], [b, c], [c, a]] {
                *edges.entry([*i.min(j), *i.max(j)]).or_default() += 1;
            }
        }
        assert!(regions.triangles.len() > 20 && edges.values().all(|count| *count == 2));
        // A closed surface without handles: V - E + F = 2.
        let [vertices, edges, faces] = [regions.position_m.len(), edges.len(), regions.triangles.len()];
        assert_eq!(vertices + faces, edges + 2);
        let tumour = &mesh.tet_groups["tumour"];
        let of_tumour = |position_m: &[f32; 3]| {
            let nodes = tumour.iter().flat_map(|tet| mesh.tets[*tet as usize]);
            nodes
                .map(|node| mesh.nodes_m[node as usize].map(|x| x as f32))
                .any(|place_m| place_m == *position_m)
        };
        assert!(regions.position_m.iter().all(of_tumour));
    }

    #[test]
    fn a_scene_of_one_material_is_refused() {
        let file = BlobFile::of(BLOB);
        let mut organ: Organ<'_> = Organ::read(file.bytes()).expect("a sound blob");
        let path = scene("liver-small.toml");
        organ.mesh_hash = Scene::load(&path)
            .and_then(|scene| scene.resolve())
            .expect("a bundled scene")
            .mesh
            .content_hash();
        let refused = of_scene(&path, &[&organ]).expect_err("nothing to show");
        assert!(refused.line().contains("one material"), "{}", refused.line());
    }
}
