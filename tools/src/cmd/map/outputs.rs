//! The files of a map: a table, the skin for ParaView, and a picture.

use std::io;

use palpate_precompute::map::{Found, Places};
use palpate_precompute::mesh::write::{Cell, Field, Grid};
use palpate_viewer::frames::still;
use palpate_viewer::map::{ScalarField, Side, SurfaceMap, draw, side_facing};

use super::Map;
use super::summary::{Summary, detectability};
use crate::failure::Failure;
use crate::output::Csv;
use crate::words::{figure, milli, percent};

/// Size of a picture with one row of panels, and the height of each further row.
const SIZE: [usize; 2] = [1280, 640];
const ROW: usize = 420;

/// Columns of the table.
const COLUMNS: &str =
    "node,x_m,y_m,z_m,inward_x,inward_y,inward_z,area_m2,stiffness_n_m,depth_m,end_m,end_force_n,status";
/// Additional columns with an inclusion.
const COMPARED: &str = "stiffness_without_n_m,compared_m,force_n,force_without_n,detectability";

/// How a push ended.
fn status(found: &Found) -> &'static str {
    match (found.depth_m, &found.press.failure) {
        (Some(_), _) => "reached",
        (None, None) => "below",
        (None, Some(_)) => "failed",
    }
}

/// A row per place.
pub(super) fn csv(map: &Map) -> Result<Vec<u8>, Failure> {
    let more = COMPARED.split(',').filter(|_| map.inclusion.is_some());
    let mut table = Csv::new(COLUMNS.split(',').chain(more))?;
    for (place, found) in map.places.places.iter().zip(&map.found) {
        let end_m = found.press.end_m();
        let place = (place.active.node, place.position_m, place.inward, place.area_m2);
        let ends = (end_m, found.press.force_n(end_m));
        let row = (place, found.press.stiffness_n_m(), found.depth_m, ends, status(found));
        if map.inclusion.is_none() {
            table.row(row)?;
            continue;
        }
        let c = found.compared;
        let compared = (c.map(|c| c.stiffness_without_n_m), c.map(|c| c.depth_m), c.map(|c| c.force_n));
        let d = c.map(|c| c.detectability(&map.jnd));
        table.row((row, compared, c.map(|c| c.without_n), d))?;
    }
    table.finish()
}

/// The fields of a map: name in files, name in pictures, value of each place, factor of the picture, whether
/// its scale is logarithmic.
struct Shown {
    file: &'static str,
    picture: String,
    values: Vec<Option<f64>>,
    factor: f64,
    is_logarithmic: bool,
    /// Lower end of the colour scale of a picture.
    from: Option<f32>,
}

fn fields(map: &Map) -> Vec<Shown> {
    let stiffness = Shown {
        file: "stiffness_n_m",
        picture: "stiffness at rest, N/m".into(),
        values: map.found.iter().map(|found| Some(found.press.stiffness_n_m())).collect(),
        factor: 1.0,
        is_logarithmic: true,
        from: None,
    };
    let depth = Shown {
        file: "depth_m",
        picture: format!("depth at {} N, mm", figure(map.goal.force_n)),
        values: map.found.iter().map(|found| found.depth_m).collect(),
        factor: 1e3,
        is_logarithmic: false,
        from: None,
    };
    let felt = map.inclusion.as_ref().map(|_| Shown {
        file: "detectability",
        picture: "change of force, in just noticeable differences; grey: not felt".into(),
        values: detectability(map),
        factor: 1.0,
        is_logarithmic: false,
        from: Some(1.0),
    });
    [stiffness, depth].into_iter().chain(felt).collect()
}

/// The triangles of the skin as indices into its nodes.
fn triangles(places: &Places) -> Vec<[u32; 3]> {
    let skin = &places.skin;
    let vertex = |node: u32| skin.nodes.binary_search(&node).expect("a corner is a node of the skin") as u32;
    skin.triangles.iter().map(|corners| corners.map(vertex)).collect()
}

/// The skin with its fields. A node without a value has NaN, which viewers leave blank.
pub(super) fn vtu(map: &Map) -> io::Result<String> {
    let skin = &map.places.skin;
    let nodes_m: Vec<[f64; 3]> =
        skin.nodes.iter().map(|&node| map.scene.mesh.nodes_m[node as usize]).collect();
    let pushed: Vec<f64> = skin
        .nodes
        .iter()
        .map(|&node| f64::from(u8::from(map.places.places.iter().any(|place| place.active.node == node))))
        .collect();
    let fields: Vec<(&str, Vec<f64>)> = fields(map)
        .iter()
        .map(|field| {
            let on_skin = map.places.on_skin(&field.values);
            (field.file, on_skin.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect())
        })
        .chain([("pushed", pushed)])
        .collect();
    let point_data: Vec<Field<'_>> =
        fields.iter().map(|(name, values)| Field { name, components: 1, values }).collect();
    let jnd = [map.jnd.relative, map.jnd.absolute_n];
    let triangles = triangles(&map.places);
    let grid = Grid {
        nodes_m: &nodes_m,
        cell: Cell::Triangle,
        connectivity: triangles.as_flattened(),
        point_data: &point_data,
        cell_data: &[],
        field_data: &[
            Field { name: "force_n", components: 1, values: &[map.goal.force_n] },
            Field { name: "max_depth_m", components: 1, values: &[map.goal.max_depth_m] },
            Field { name: "jnd", components: 2, values: &jnd },
        ],
    };
    grid.encode()
}

/// The picture: with an inclusion its detectability and the depth, otherwise stiffness and depth.
pub(super) fn picture(map: &Map, summary: &Summary, sides: &[Side]) -> io::Result<Vec<u8>> {
    let skin = &map.places.skin;
    let position_m: Vec<[f32; 3]> =
        skin.nodes.iter().map(|&node| map.scene.mesh.nodes_m[node as usize].map(|x| x as f32)).collect();
    let outward = map.places.places[summary.shown].inward.map(|x| -x as f32);
    let sides = if sides.is_empty() { vec![side_facing(&position_m, outward)] } else { sides.to_vec() };
    let mut fields = fields(map);
    // The last two: depth and detectability, or stiffness and depth; what matters most is first.
    let mut fields = fields.split_off(fields.len() - 2);
    if map.inclusion.is_some() {
        fields.reverse();
    }
    let scalar = |field: &Shown| ScalarField {
        name: field.picture.clone(),
        values: map
            .places
            .on_skin(&field.values)
            .into_iter()
            .map(|value| value.map(|value| (field.factor * value) as f32))
            .collect(),
        is_logarithmic: field.is_logarithmic,
        from: field.from,
    };
    let [width, height] = [SIZE[0], SIZE[1] + ROW * (sides.len() - 1)];
    let picture = SurfaceMap {
        title: map.scene.name.clone(),
        subtitle: subtitle(map, summary),
        triangles: triangles(&map.places),
        position_m,
        fixed: skin.nodes.iter().map(|node| map.scene.fixed.binary_search(node).is_ok()).collect(),
        fields: fields.iter().map(scalar).collect(),
        sides,
    };
    still(&draw(&picture, width, height))
}

fn subtitle(map: &Map, summary: &Summary) -> String {
    let mut parts = vec![format!("{}, {} places", summary.tool(), map.found.len())];
    if map.inclusion.is_some() {
        let share = summary.inclusion.as_ref().map_or(0.0, |felt| felt.area_share);
        parts.push(format!(
            "inclusion felt on {} of the skin (just noticeable: {} of the force)",
            percent(share),
            percent(map.jnd.relative)
        ));
    }
    parts.push("blue: fixed".into());
    if map.found.iter().any(|found| found.depth_m.is_none()) {
        parts.push(format!(
            "grey on the map of depth: below {} N down to {} mm",
            figure(map.goal.force_n),
            milli(map.goal.max_depth_m)
        ));
    }
    parts.join("; ")
}
