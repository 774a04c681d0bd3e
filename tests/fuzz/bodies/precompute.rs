//! The bodies of the fuzz targets of the readers of scenes and meshes, also run by the tests of
//! `palpate-precompute`: arbitrary files and the invariants that must hold for what is read.

use std::path::Path;
use std::sync::LazyLock;

use palpate_precompute::InputError;
use palpate_precompute::mesh::write::{Cell, Grid};
use palpate_precompute::mesh::{LengthUnit, MeshBytes, TetMesh};
use palpate_precompute::scene::{ResolvedScene, Scene};

/// A file of each mesh format. The first byte selects format, unit, and whether the regions are read; the rest
/// is the file. TetGen's two files are separated by a zero byte.
///
/// A file is refused with one line, or its mesh is valid and unchanged by a round trip through VTU. Returns
/// whether it was read.
pub(crate) fn mesh(data: &[u8]) -> bool {
    let Some((&choice, file)) = data.split_first() else { return false };
    let content = match choice & 3 {
        0 => MeshBytes::Gmsh(file),
        1 => MeshBytes::Vtk(file),
        2 => MeshBytes::Vtu(file),
        _ => {
            let mut files = file.splitn(2, |&byte| byte == 0);
            let mut next = || files.next().unwrap_or_default();
            MeshBytes::TetGen { node: next(), ele: next() }
        }
    };
    let unit = if choice & 4 == 0 { LengthUnit::Metre } else { LengthUnit::Millimetre };
    let path = Path::new("mesh");
    let read = if choice & 8 == 0 { content.read(path, unit) } else { content.read_with_regions(path, unit) };
    read.as_ref().map(assert_valid_mesh).map_err(assert_one_line).is_ok()
}

fn assert_valid_mesh(mesh: &TetMesh) {
    assert_eq!(mesh.check(), Ok(()));
    let is_ascending = |members: &Vec<u32>| members.is_sorted_by(|a, b| a < b);
    let (nodes, tets) = (mesh.nodes_m.len() as u32, mesh.tets.len() as u32);
    for (groups, count) in [(&mesh.node_groups, nodes), (&mesh.tet_groups, tets)] {
        for members in groups.values() {
            assert!(is_ascending(members) && members.last().is_none_or(|last| *last < count), "{members:?}");
        }
    }
    let grid = Grid {
        nodes_m: &mesh.nodes_m,
        cell: Cell::Tet4,
        connectivity: mesh.tets.as_flattened(),
        point_data: &[],
        cell_data: &[],
        field_data: &[],
    };
    let file = grid.encode().expect("a valid mesh");
    let again = MeshBytes::Vtu(file.as_bytes()).read(Path::new("again.vtu"), LengthUnit::Metre);
    let again = again.unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(again.content_hash(), mesh.content_hash());
}

/// A box of 60 tets with the groups of the bundled bodies.
static BODY: LazyLock<TetMesh> = LazyLock::new(|| {
    let mut mesh = TetMesh::cuboid([5, 2, 1], 0.02);
    let nodes = mesh.nodes_m.len() as u32;
    mesh.node_groups.insert("F1".into(), (0..6).collect());
    mesh.node_groups.insert("top".into(), (0..nodes).filter(|node| node % 2 == 1).collect());
    mesh.tet_groups.insert("tissue".into(), (0..48).collect());
    mesh.tet_groups.insert("tumour".into(), (48..60).collect());
    mesh
});

/// A scene file. It is refused with one line, or its indices are valid, and its text, which a `.space` stores,
/// reads as the same scene. Returns whether it was resolved.
pub(crate) fn scene(data: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(data) else { return false };
    let scene = match Scene::parse(Path::new("scene.toml"), text.to_owned()) {
        Ok(scene) => scene,
        Err(error) => {
            assert_one_line(&error);
            return false;
        }
    };
    for constant in scene.constants() {
        let Ok(again) = scene.with_constants(&[(&constant, constant.value)]) else { continue };
        let values = |scene: &Scene| -> Vec<u64> {
            scene.constants().iter().map(|constant| constant.value.to_bits()).collect()
        };
        assert_eq!(values(&again), values(&scene));
    }
    // A resolution opens the files that a scene names beside its mesh. A refinement and the charts of a sphere's field
    // can take seconds.
    let is_slow = text.contains("refine") || text.contains("sphere") && text.contains("grid");
    if scene.files().len() > 2 || is_slow {
        return false;
    }
    scene.resolve_on(BODY.clone()).as_ref().map(assert_valid_scene).map_err(assert_one_line).is_ok()
}

fn assert_valid_scene(scene: &ResolvedScene) {
    let nodes = scene.mesh.nodes_m.len() as u32;
    assert!(scene.fixed.is_sorted_by(|a, b| a < b) && scene.fixed.last().is_some_and(|last| *last < nodes));
    for active in &scene.active {
        let is_free = scene.fixed.binary_search(&active.node).is_err();
        // A contact may be nearest to a fixed node.
        assert!(active.node < nodes && (is_free || active.contact.is_some()), "{active:?}");
        assert!(active.patch.iter().all(|node| *node < nodes), "{active:?}");
    }
    assert!(scene.max_force_n > 0.0 && scene.body_force.is_none_or(|f| f.iter().all(|x| x.is_finite())));
    assert!(scene.warnings.iter().all(|line| !line.contains('\n')), "{:?}", scene.warnings);
    let again = Scene::parse(Path::new("scene.toml"), scene.text.clone())
        .and_then(|again| again.resolve_in(scene.mesh.clone(), scene.fixed.clone()))
        .unwrap_or_else(|error| panic!("{error}\n{}", scene.text));
    assert_eq!(again.content_hash(), scene.content_hash(), "{}", scene.text);
    assert_eq!(again.text, scene.text);
}

fn assert_one_line(error: &InputError) {
    let line = error.to_string();
    assert!(!line.contains(['\n', '\r']) && !error.what.is_empty() && !error.fix.is_empty(), "{line:?}");
}
