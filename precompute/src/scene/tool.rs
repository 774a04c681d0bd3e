//! The tool of a scene: a point, a fingertip with an elastic pad, a rigid sphere or a rigid capsule.

use std::ops::Range;

use toml::Spanned;

use super::ElementOrder;
use super::file::{ActiveTable, ToolTable};
use super::lookup::Lookup;
use super::place::{Place, finite, positive};
use super::three::Three;
use crate::error::{InputError, count};
use crate::fem::pad::under;
use crate::fem::{Capsule, Fingertip, Layer, PadProfile, Sphere};
use crate::mesh::{SkinPoint, Surface, TetMesh};
use crate::num::vector::{distance, norm, unit};
use crate::spec::{ActiveNode, Tool};

/// A fingertip of the size of a human one: k pi a^2 / 3 = 524 N/m, where a pulp has some 300 to 1,000 N/m.
pub const PULP: Fingertip = Fingertip { radius_m: 0.01, stiffness_pa_m: 5e6, profile: PadProfile::Quartic };

/// A pad whose radius is smaller than this share of the mean edge of the triangles under it cannot be
/// integrated over them.
const LEAST_RADIUS: f64 = 0.5;
/// Smallest radius of a sphere, m.
const LEAST_SPHERE_M: f64 = 1e-3;
/// Largest distance of a given point from the skin, as a share of the body's diagonal.
const LARGEST_DISTANCE: f64 = 0.25;

/// The tool of a scene with this mesh.
pub(super) fn tool(
    place: &Place,
    mesh: &TetMesh,
    table: Option<&Spanned<ToolTable>>,
) -> Result<Tool, InputError> {
    let Some(table) = table else { return Ok(Tool::Point) };
    let ToolTable { shape, radius_m, stiffness_pa_m, profile, layer_m, layer_pa, length_m, axis } =
        table.get_ref();
    let is_sphere = match shape.get_ref().as_str() {
        "fingertip" => false,
        "sphere" => true,
        "capsule" => return capsule(place, mesh, table).map(Tool::Capsule),
        other => {
            let what = format!("unknown shape \"{other}\"");
            let fix = "use \"fingertip\", \"sphere\" or \"capsule\", or leave [tool] out for a point";
            return Err(place.error(shape.span(), what, fix));
        }
    };
    if let Some(span) = length_m.as_ref().map(Spanned::span).or(axis.as_ref().map(Spanned::span)) {
        let what = "`length_m` and `axis` are keys of a capsule";
        return Err(place.error(span, what, "remove them, or use shape = \"capsule\""));
    }
    if is_sphere {
        return sphere(place, mesh, table).map(Tool::Sphere);
    }
    if layer_m.is_some() || layer_pa.is_some() {
        let what = "a fingertip has no layer: `layer_m` and `layer_pa` are keys of a sphere";
        return Err(place.error(table.span(), what, "remove them, or use shape = \"sphere\""));
    }
    let number = |key, given, default| number(place, key, given, default);
    let tip = Fingertip {
        radius_m: number("radius_m", radius_m, PULP.radius_m)?,
        stiffness_pa_m: number("stiffness_pa_m", stiffness_pa_m, PULP.stiffness_pa_m)?,
        profile: profile.unwrap_or(PULP.profile),
    };
    let size_m = mesh.diagonal_m();
    if 2.0 * tip.radius_m > size_m {
        let what = format!(
            "a pad of {} m radius is larger than the body, which is {size_m:.3} m across",
            tip.radius_m
        );
        let span = radius_m.as_ref().map_or(table.span(), Spanned::span);
        return Err(place.error(span, what, "give `radius_m` in metres, or correct the unit of the mesh"));
    }
    Ok(Tool::Fingertip(tip))
}

fn number(place: &Place, key: &str, given: &Option<Spanned<f64>>, default: f64) -> Result<f64, InputError> {
    given.as_ref().map_or(Ok(default), |given| positive(place, key, given))
}

fn sphere(place: &Place, mesh: &TetMesh, table: &Spanned<ToolTable>) -> Result<Sphere, InputError> {
    let ToolTable { shape, radius_m, stiffness_pa_m, profile, layer_m, layer_pa, .. } = table.get_ref();
    let shape = shape.get_ref();
    if stiffness_pa_m.is_some() || profile.is_some() {
        let what = format!("a {shape} is rigid: `stiffness_pa_m` and `profile` are keys of a fingertip");
        return Err(place.error(table.span(), what, "remove them, or use shape = \"fingertip\""));
    }
    let Some(given) = radius_m else {
        let what = format!("a {shape} needs a `radius_m`");
        return Err(place.error(table.span(), what, "add radius_m = 0.01 (metres)"));
    };
    let radius_m = positive(place, "radius_m", given)?;
    let size_m = mesh.diagonal_m();
    if radius_m < LEAST_SPHERE_M || 2.0 * radius_m > size_m {
        let what =
            format!("a {shape} of {radius_m} m radius does not fit a body that is {size_m:.3} m across");
        let fix = format!(
            "give a radius from {LEAST_SPHERE_M} to {:.3} m, or correct the unit of the mesh",
            0.5 * size_m
        );
        return Err(place.error(given.span(), what, fix));
    }
    let default = Layer::of(radius_m);
    let layer = Layer {
        thickness_m: number(place, "layer_m", layer_m, default.thickness_m)?,
        pressure_pa: number(place, "layer_pa", layer_pa, default.pressure_pa)?,
    };
    if let Some(given) = layer_m.as_ref().filter(|_| layer.thickness_m > 0.5 * radius_m) {
        let what = format!("a layer of {} m is thicker than half the radius", layer.thickness_m);
        return Err(place.error(given.span(), what, "give a thinner `layer_m`, or leave it out"));
    }
    Ok(Sphere { radius_m, layer })
}

/// A capsule with its axis along z of the grip, unless another one is given.
fn capsule(place: &Place, mesh: &TetMesh, table: &Spanned<ToolTable>) -> Result<Capsule, InputError> {
    let sphere = sphere(place, mesh, table)?;
    let ToolTable { length_m, axis, .. } = table.get_ref();
    let Some(given) = length_m else {
        let what = "a capsule needs a `length_m`: the distance between the centres of its ends";
        return Err(place.error(table.span(), what, "add length_m = 0.02 (metres)"));
    };
    let (length_m, size_m) = (positive(place, "length_m", given)?, mesh.diagonal_m());
    if length_m > size_m {
        let what = format!("a capsule of {length_m} m does not fit a body that is {size_m:.3} m across");
        return Err(place.error(
            given.span(),
            what,
            "give a shorter `length_m`, or correct the unit of the mesh",
        ));
    }
    let direction = match axis {
        None => [0.0, 0.0, 1.0],
        Some(axis) => {
            let direction = finite(place, "axis", axis)?;
            if norm(direction) == 0.0 {
                return Err(place.error(
                    axis.span(),
                    "`axis` has no direction",
                    "give one, as [0.0, 0.0, 1.0]",
                ));
            }
            unit(direction)
        }
    };
    Ok(Capsule { sphere, half_axis_m: direction.map(|x| 0.5 * length_m * x) })
}

impl Lookup<'_> {
    /// The point of the outer skin nearest to `point`, for a tool with a size.
    pub(super) fn contact_point(&self, name: &str, point: &Spanned<Three>) -> Result<SkinPoint, InputError> {
        let target = finite(self.place, "point", point)?;
        let on = |surface: &Surface| {
            let found = surface.nearest(self.mesh, target).expect("a mesh with a tet has a surface");
            (distance(found.interpolate(|n| self.mesh.nodes_m[n as usize]), target), found)
        };
        let ((away_m, found), (least_m, _)) = (on(self.seen), on(self.skin));
        if least_m < away_m {
            let what =
                format!("`point` of \"{name}\" is on the wall of a cavity, where the tool cannot reach it");
            return Err(self.place.error(point.span(), what, "choose a point on the outside"));
        }
        let size_m = self.mesh.diagonal_m();
        if away_m > LARGEST_DISTANCE * size_m {
            let what = format!(
                "`point` of \"{name}\" lies {away_m:.3} m from the body's skin; the body is {size_m:.3} m across"
            );
            let fix = "give a place on the skin, in metres, in the mesh's frame";
            return Err(self.place.error(point.span(), what, fix));
        }
        Ok(found)
    }

    /// A contact point at a node of the skin.
    pub(super) fn contact_at(&self, node: u32) -> SkinPoint {
        let around = self.skin.triangles.iter().find(|triangle| triangle.contains(&node));
        let triangle = *around.expect("the node is on the surface");
        SkinPoint { triangle, weights: triangle.map(|corner| f64::from(u8::from(corner == node))) }
    }

    /// Refuses keys of a point tool for a fingertip, and those of a tool with a size for a point.
    pub(super) fn check_keys(&self, table: &ActiveTable, name: &str, tool: &Tool) -> Result<(), InputError> {
        match (tool, &table.point, table.patch.as_ref().map(Spanned::span), &table.patch_radius_m) {
            (Tool::Point, Some(point), ..) => {
                let what = format!(
                    "`point` of \"{name}\" is for a tool with a size: the force of a point on \
                                    a face depends on the mesh"
                );
                let fix = "add [tool] with shape = \"fingertip\", or give `node` or `nearest`";
                Err(self.place.error(point.span(), what, fix))
            }
            (Tool::Fingertip(_), _, Some(span), _) => Err(self.no_patch(span)),
            (Tool::Fingertip(_), _, None, Some(radius)) => Err(self.no_patch(radius.span())),
            _ => Ok(()),
        }
    }

    fn no_patch(&self, span: Range<usize>) -> InputError {
        self.place.error(span, "a fingertip has no rigid patch", "remove the patch, or the [tool]")
    }

    /// Refuses a pad that does not fit the mesh at a contact point; returns the mean edge of the triangles under
    /// it, m. `pieces` has the piece of the body of each node.
    pub(super) fn check_pad(
        &self,
        span: Range<usize>,
        tip: &Fingertip,
        active: &ActiveNode,
        fixed: &[u32],
        pieces: &[u32],
    ) -> Result<f64, InputError> {
        let (name, radius_mm) = (&active.name, 1e3 * tip.radius_m);
        let is_free = |face: &&[u32]| face.iter().any(|node| fixed.binary_search(node).is_err());
        if active.contact.is_some_and(|at| !is_free(&&at.triangle[..])) {
            let what = format!("the contact point \"{name}\" is in the fixed set");
            let fix = "choose a point on the free skin, or take it out of [fixed]";
            return Err(self.place.error(span, what, fix));
        }
        let faces = self.skin.triangles.iter().map(|triangle| &triangle[..]).filter(is_free);
        let (under, apart) = under(&self.mesh.nodes_m, faces, active.place_m(self.mesh), tip.radius_m);
        let edges = under.iter().flat_map(|face| [[0, 1], [1, 2], [2, 0]].map(|ends| ends.map(|k| face[k])));
        let lengths = edges.map(|ends| {
            let [a, b] = ends.map(|node| self.mesh.nodes_m[node as usize]);
            distance(a, b)
        });
        let edge_m = lengths.sum::<f64>() / (3 * under.len().max(1)) as f64;
        if tip.radius_m < LEAST_RADIUS * edge_m {
            let what = format!(
                "the pad of {radius_mm:.1} mm radius at \"{name}\" is smaller than the elements under it, whose edges \
                 are {:.1} mm long",
                1e3 * edge_m
            );
            let fix = format!(
                "refine the mesh there, or give [tool] a `radius_m` of {:.4} or more",
                LEAST_RADIUS * edge_m
            );
            return Err(self.place.error(span, what, fix));
        }
        let own = pieces[active.node as usize];
        if let Some(other) = apart.iter().find(|face| pieces[face[0] as usize] != own) {
            let what = format!(
                "the pad at \"{name}\" lies over two bodies: node {} of another piece is within its {radius_mm:.1} mm",
                other[0]
            );
            return Err(self.place.error(
                span,
                what,
                "give a smaller `radius_m`, or mesh the two as one body",
            ));
        }
        Ok(edge_m)
    }

    /// Warns once of a pad of linear elements that is smaller than they are. `edges_m` has the mean edge under each
    /// pad.
    pub(super) fn warn_of_coarse_skin(&mut self, order: ElementOrder, tip: &Fingertip, edges_m: &[f64]) {
        let coarse = edges_m.iter().filter(|edge_m| tip.radius_m < **edge_m).count();
        if coarse > 0 {
            let remedy = match order {
                ElementOrder::Linear => "refine the mesh, or use quadratic elements (`order`)",
                ElementOrder::Quadratic | ElementOrder::NearTool => "refine the mesh",
            };
            let longest_m = edges_m.iter().copied().fold(0.0, f64::max);
            let places = match edges_m.len() {
                1 => String::new(),
                all => format!(" at {coarse} of {}", count(all, "contact point")),
            };
            self.warnings.push(format!(
                "the tool is smaller than its elements: the pad has a radius of {:.1} mm, and the edges under it are up to \
                 {:.1} mm long{places}; {remedy}",
                1e3 * tip.radius_m,
                1e3 * longest_m,
            ));
        }
    }
}
