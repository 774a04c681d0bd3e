//! A `.space` file as a picture: the organ coloured by its stiffness at rest, and by the number of
//! configurations.

use std::collections::HashMap;

use palpate_precompute::mesh::Surface;
use palpate_precompute::space::{Record, Store};
use palpate_viewer::frames::still;
use palpate_viewer::map::{ScalarField, SurfaceMap, draw};

use crate::failure::Failure;
use crate::files::Output;

const SIZE: [usize; 2] = [1280, 720];

/// The values shown for an active node.
#[derive(Debug, Clone, Copy)]
struct Touched {
    stiffness_n_m: f32,
    configurations: f32,
}

/// Draws the picture.
pub(super) fn write(store: &Store, file: &Output) -> Result<(), Failure> {
    let (mesh, fixed) = store.body()?;
    let surface = Surface::of(&mesh);
    let mut touched = HashMap::new();
    for (active, (_, node)) in store.active()?.into_iter().enumerate() {
        let records = store.records(active)?;
        let solved = records.iter().filter(|record| record.tag().is_solved());
        let (Some(rest), Some(normal)) =
            (records.iter().find(|r| r.index == [0; 3]).and_then(Record::equilibrium), surface.normal(node))
        else {
            continue;
        };
        let of = |i: usize, j: usize| normal[i] * rest.stiffness_n_m[(i, j)] * normal[j];
        let stiffness_n_m = (0..9).map(|n| of(n / 3, n % 3)).sum::<f64>() as f32;
        touched.insert(node, Touched { stiffness_n_m, configurations: solved.count() as f32 });
    }
    let vertex =
        |node: u32| surface.nodes.binary_search(&node).expect("a triangle's nodes are surface nodes");
    let figure = |name: &str, of: fn(&Touched) -> f32| ScalarField {
        name: name.into(),
        values: surface.nodes.iter().map(|node| touched.get(node).map(of)).collect(),
        is_logarithmic: true,
    };
    let identity = store.identity()?;
    let solved: f32 = touched.values().map(|t| t.configurations).sum();
    let map = SurfaceMap {
        title: identity.scene_name,
        subtitle: format!(
            "{} active node{}, {solved:.0} configurations; {} vertices, {} of them fixed (blue)",
            touched.len(),
            if touched.len() == 1 { "" } else { "s" },
            surface.nodes.len(),
            surface.nodes.iter().filter(|n| fixed.binary_search(n).is_ok()).count()
        ),
        triangles: surface.triangles.iter().map(|t| t.map(|node| vertex(node) as u32)).collect(),
        position_m: surface.nodes.iter().map(|&n| mesh.nodes_m[n as usize].map(|x| x as f32)).collect(),
        fixed: surface.nodes.iter().map(|n| fixed.binary_search(n).is_ok()).collect(),
        fields: vec![
            figure("stiffness at rest, pushed, N/m", |t| t.stiffness_n_m),
            figure("configurations needed", |t| t.configurations),
        ],
    };
    let [width, height] = SIZE;
    file.put(&still(&draw(&map, width, height)).map_err(|error| file.failure(&error))?)
}
