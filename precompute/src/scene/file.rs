//! The scene file as written: its tables and keys, each value with its place in the text.

use std::fmt;
use std::marker::PhantomData;
use std::ops::Range;

use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use toml::Spanned;

use super::material::MaterialTable;
use super::place::{Located, Place};
use super::three::Three;
use crate::error::InputError;
use crate::fem::PadProfile;
use crate::fem::boundary::Constraints;
use crate::fem::pressure::PressurePair;

/// The whole file.
#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneFile {
    pub(super) name: Option<Spanned<String>>,
    pub(super) mesh: Spanned<MeshTable>,
    pub(super) material: Spanned<OneOrMany<MaterialTable>>,
    pub(super) fixed: Spanned<FixedTable>,
    /// Where a point or a fingertip touches; a sphere touches anywhere.
    pub(super) active: Option<Spanned<OneOrMany<ActiveTable>>>,
    pub(super) grid: Option<Spanned<GridTable>>,
    pub(super) device: Option<Spanned<DeviceTable>>,
    pub(super) body_force: Option<Spanned<BodyForceTable>>,
    pub(super) solver: Option<Spanned<SolverOptions>>,
    pub(super) tool: Option<Spanned<ToolTable>>,
    #[serde(default)]
    pub(super) needs: NeedsTable,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MeshTable {
    pub(super) file: Spanned<String>,
    pub(super) unit: Option<Spanned<String>>,
    pub(super) order: Option<Spanned<toml::Value>>,
    /// Name of the cell array that numbers the regions.
    pub(super) regions: Option<Spanned<String>>,
    pub(super) refine: Option<Spanned<Refine>>,
    /// Largest mean edge of a refined tet.
    pub(super) refine_edge_m: Option<Spanned<f64>>,
}

/// Where the mesh is refined.
#[derive(Debug, Clone, Copy, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Refine {
    Tool,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FixedTable {
    pub(super) nodes: Option<Spanned<Vec<Spanned<i64>>>>,
    pub(super) group: Option<Spanned<String>>,
    /// Corners in metres, inclusive.
    #[serde(rename = "box")]
    pub(super) in_box: Option<Spanned<BoxTable>>,
    pub(super) file: Option<Spanned<String>>,
    pub(super) key: Option<Spanned<String>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BoxTable {
    pub(super) min: Three,
    pub(super) max: Three,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ActiveTable {
    /// Default: the name of the group.
    pub(super) name: Option<Spanned<String>>,
    pub(super) node: Option<Spanned<i64>>,
    /// In metres, for any unit of the mesh file.
    pub(super) nearest: Option<Spanned<Three>>,
    /// In metres; projected onto the skin, for a tool with a size.
    pub(super) point: Option<Spanned<Three>>,
    pub(super) group: Option<Spanned<String>>,
    /// Nodes that move with the node as a rigid body.
    pub(super) patch: Option<Spanned<Vec<Spanned<i64>>>>,
    /// Distance within which all surface nodes belong to the patch.
    pub(super) patch_radius_m: Option<Spanned<f64>>,
    /// Displacements that adaptive sampling solves first.
    pub(super) visited_m: Option<Spanned<Vec<Three>>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ToolTable {
    pub(super) shape: Spanned<String>,
    pub(super) radius_m: Option<Spanned<f64>>,
    pub(super) stiffness_pa_m: Option<Spanned<f64>>,
    pub(super) profile: Option<PadProfile>,
    pub(super) layer_m: Option<Spanned<f64>>,
    pub(super) layer_pa: Option<Spanned<f64>>,
    /// Distance between the centres of the two ends of a capsule, m.
    pub(super) length_m: Option<Spanned<f64>>,
    /// Direction of its axis in the frame of the grip.
    pub(super) axis: Option<Spanned<Three>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GridTable {
    pub(super) radius_m: Spanned<f64>,
    pub(super) spacing_m: Option<Spanned<f64>>,
    pub(super) points: Option<Spanned<i64>>,
    pub(super) complete_cells: Option<bool>,
    /// Number of equal parts of every transition, whose intermediate states are stored.
    pub(super) increments: Option<Spanned<i64>>,
    pub(super) tolerance_n: Option<Spanned<f64>>,
    pub(super) tolerance_relative: Option<Spanned<f64>>,
    pub(super) cannot_be_felt: Option<Spanned<bool>>,
    /// Corners of the box that bounds the tool's positions, in the model's frame.
    pub(super) workspace_min_m: Option<Spanned<Three>>,
    pub(super) workspace_max_m: Option<Spanned<Three>>,
}

/// A key with its place, if it is given.
type GivenKey = Option<(Range<usize>, &'static str)>;

fn given<T>(key: &'static str, value: &Option<Spanned<T>>) -> GivenKey {
    value.as_ref().map(|value| (value.span(), key))
}

impl GridTable {
    /// The first key that requests adaptive sampling.
    pub(super) fn adaptive_key(&self) -> GivenKey {
        given("tolerance_n", &self.tolerance_n)
            .or_else(|| given("tolerance_relative", &self.tolerance_relative))
            .or_else(|| given("cannot_be_felt", &self.cannot_be_felt))
    }

    /// The first key that requests a lattice.
    pub(super) fn lattice_key(&self) -> GivenKey {
        given("spacing_m", &self.spacing_m)
            .or_else(|| given("points", &self.points))
            .or_else(|| given("increments", &self.increments))
    }
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DeviceTable {
    pub(super) max_force_n: Option<Spanned<f64>>,
    /// Name of a bundled device profile, or path of a profile file.
    pub(super) profile: Option<Spanned<String>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BodyForceTable {
    /// Per undeformed volume.
    pub(super) force_n_per_m3: Option<Spanned<Three>>,
    /// Alternatively as weight: density times gravity.
    pub(super) density_kg_m3: Option<Spanned<f64>>,
    pub(super) gravity_m_s2: Option<Spanned<Three>>,
}

/// The table `[solver]`. A new key is one field here; its default is the behaviour of scenes without it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SolverOptions {
    /// Pressure field of incompressible regions.
    pub pressure: PressurePair,
    /// Method that imposes prescribed displacements.
    pub constraints: Constraints,
    /// Whether a solution with inverted elements counts as failed.
    pub reject_inverted: bool,
}

/// Forces that the tool can exert.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Contact {
    #[default]
    Any,
    Push,
}

#[derive(Debug, Default, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct NeedsTable {
    /// Default: true.
    pub(super) visual: Option<bool>,
    pub(super) contact: Contact,
    /// Error bounds of packed displacements: RMS over the surface, and maximum over its nodes.
    pub(super) displacement_rms_mm: Option<Spanned<f64>>,
    pub(super) displacement_max_mm: Option<Spanned<f64>>,
    /// Tolerated share of the force that more accurate elements change.
    pub(super) discretisation: Option<Spanned<f64>>,
}

/// `[material]` or `[[material]]`: one table or several.
///
/// Implemented by hand because serde's untagged enums buffer the value, which loses the places of the keys.
#[derive(Debug)]
pub(super) enum OneOrMany<T> {
    One(T),
    Many(Vec<Spanned<T>>),
}

/// The tables of a [`OneOrMany`], each with its place.
pub(super) fn tables<T>(given: &Spanned<OneOrMany<T>>) -> Vec<Located<'_, T>> {
    match given.get_ref() {
        OneOrMany::One(table) => vec![Located { span: given.span(), table }],
        OneOrMany::Many(many) => {
            many.iter().map(|t| Located { span: t.span(), table: t.get_ref() }).collect()
        }
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for OneOrMany<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct TableOrArray<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for TableOrArray<T> {
            type Value = OneOrMany<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a table or an array of tables")
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map)).map(OneOrMany::One)
            }

            fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<Self::Value, A::Error> {
                Vec::deserialize(SeqAccessDeserializer::new(seq)).map(OneOrMany::Many)
            }
        }
        deserializer.deserialize_any(TableOrArray(PhantomData))
    }
}

impl SceneFile {
    /// The active tables.
    pub(super) fn active(&self) -> Vec<Located<'_, ActiveTable>> {
        self.active.as_ref().map(tables).unwrap_or_default()
    }

    /// Parses the tables of the file.
    pub(super) fn parse(place: &Place) -> Result<Self, InputError> {
        // The whole text, also what no key reads.
        toml::from_str::<toml::Table>(&place.text).map_err(|error| place.explain(&error))?;
        toml::from_str(&place.text).map_err(|error| place.explain(&error))
    }
}
