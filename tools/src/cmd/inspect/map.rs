//! A `.space` file as a picture: the organ coloured by its stiffness at rest, and by the number of
//! configurations.

use palpate_precompute::mesh::Surface;
use palpate_precompute::num::{distance, norm};
use palpate_precompute::space::{Record, Store};
use palpate_viewer::frames::still;
use palpate_viewer::map::{ScalarField, Side, SurfaceMap, draw};

use crate::failure::Failure;
use crate::files::Output;

const SIZE: [usize; 2] = [1280, 720];

/// An active node or contact point, and the values shown for it.
#[derive(Debug, Clone, Copy)]
struct Touched {
    node: u32,
    place_m: [f64; 3],
    stiffness_n_m: f32,
    configurations: f32,
}

/// The sides that are shown if none is given.
pub(super) const SIDES: [Side; 2] = [Side::Front, Side::Back];

/// A side by its name.
pub(crate) fn side(text: &str) -> Result<Side, String> {
    let found = Side::ALL.into_iter().find(|side| side.name() == text);
    found.ok_or_else(|| format!("one of {}", Side::ALL.map(Side::name).join(", ")))
}

/// Draws the picture from these sides.
pub(super) fn write(store: &Store, sides: &[Side], file: &Output) -> Result<(), Failure> {
    let (mesh, fixed) = store.body()?;
    let surface = Surface::of(&mesh);
    let identity = store.identity()?;
    let mut touched = Vec::new();
    for (active, (_, node)) in store.active()?.into_iter().enumerate() {
        let records = store.records(active)?;
        let solved = records.iter().filter(|record| record.tag().is_solved());
        let Some(rest) = records.iter().find(|r| r.index == [0; 3]).and_then(Record::equilibrium) else {
            continue;
        };
        let at_node = |node| surface.normal(node).unwrap_or_default();
        let Some(normal) = normalized(identity.at_active(active, node, at_node)) else { continue };
        let of = |i: usize, j: usize| normal[i] * rest.stiffness_n_m[(i, j)] * normal[j];
        touched.push(Touched {
            node,
            place_m: identity.at_active(active, node, |node| mesh.nodes_m[node as usize]),
            stiffness_n_m: (0..9).map(|n| of(n / 3, n % 3)).sum::<f64>() as f32,
            configurations: solved.count() as f32,
        });
    }
    let vertex =
        |node: u32| surface.nodes.binary_search(&node).expect("a triangle's nodes are surface nodes");
    let is_fixed = |node: &u32| fixed.binary_search(node).is_ok();
    // A pad that touches anywhere has contact points between the vertices.
    let pad_m = identity.contacts.as_ref().filter(|contacts| !contacts.triangles.is_empty());
    let pad_m = pad_m.map(|contacts| contacts.fingertip.radius_m);
    let at_vertex = |node: &u32| match pad_m {
        Some(_) if is_fixed(node) => None,
        Some(pad_m) => nearest(&touched, mesh.nodes_m[*node as usize], pad_m),
        None => touched.iter().find(|touched| touched.node == *node),
    };
    let shown: Vec<Option<&Touched>> = surface.nodes.iter().map(at_vertex).collect();
    let figure = |name: &str, of: fn(&Touched) -> f32| ScalarField {
        name: name.into(),
        values: shown.iter().map(|touched| touched.map(of)).collect(),
        is_logarithmic: true,
        from: None,
    };
    let place = if identity.contacts.is_some() { "contact point" } else { "active node" };
    let solved: f32 = touched.iter().map(|t| t.configurations).sum();
    let map = SurfaceMap {
        title: identity.scene_name,
        subtitle: format!(
            "{} {place}{}, {solved:.0} configurations; {} vertices, {} of them fixed (blue)",
            touched.len(),
            if touched.len() == 1 { "" } else { "s" },
            surface.nodes.len(),
            surface.nodes.iter().filter(|node| is_fixed(node)).count()
        ),
        triangles: surface.triangles.iter().map(|t| t.map(|node| vertex(node) as u32)).collect(),
        position_m: surface.nodes.iter().map(|&n| mesh.nodes_m[n as usize].map(|x| x as f32)).collect(),
        fixed: surface.nodes.iter().map(is_fixed).collect(),
        fields: vec![
            figure("stiffness at rest, pushed, N/m", |t| t.stiffness_n_m),
            figure("configurations needed", |t| t.configurations),
        ],
        sides: sides.to_vec(),
    };
    let [width, height] = SIZE;
    file.put(&still(&draw(&map, width, height)).map_err(|error| file.failure(&error))?)
}

/// The nearest place to a point, within a distance.
fn nearest(touched: &[Touched], point_m: [f64; 3], within_m: f64) -> Option<&Touched> {
    let away_m = |touched: &Touched| distance(touched.place_m, point_m);
    let nearest = touched.iter().min_by(|one, other| away_m(one).total_cmp(&away_m(other)))?;
    (away_m(nearest) <= within_m).then_some(nearest)
}

/// A vector of unit length, if it has a direction.
fn normalized(vector: [f64; 3]) -> Option<[f64; 3]> {
    let length = norm(vector);
    (length > 0.0).then(|| vector.map(|x| x / length))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_side_has_its_name() {
        assert!(Side::ALL.iter().all(|one| side(one.name()) == Ok(*one)));
        assert_eq!(side("top"), Err("one of front, back, left, right, above, below".into()));
    }

    #[test]
    fn a_vertex_takes_the_value_of_the_nearest_place_within_reach() {
        let place =
            |x| Touched { node: 0, place_m: [x, 0.0, 0.0], stiffness_n_m: x as f32, configurations: 1.0 };
        let places = [place(0.0), place(1.0), place(3.0)];
        let at = |x| nearest(&places, [x, 0.0, 0.0], 0.6).map(|touched| touched.stiffness_n_m);
        assert_eq!([at(0.4), at(0.6), at(2.0), at(2.5)], [Some(0.0), Some(1.0), None, Some(3.0)]);
        assert_eq!(normalized([0.0; 3]), None);
        assert_eq!(normalized([0.0, -4.0, 3.0]), Some([0.0, -0.8, 0.6]));
    }
}
