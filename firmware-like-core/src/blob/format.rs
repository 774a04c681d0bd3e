//! Layout of a blob, version 6. Little-endian throughout.
//!
//! ```text
//! offset          size         content
//! 0               8            magic "PALPATE\0"
//! 8               4            u32 version = 6
//! 12              4            u32 header_len
//! 16              8            u64 total_len: the whole file, checksum included
//! 24              header_len   header: one Preamble, then Preamble::space_count SpaceHeaders (postcard)
//! ..              ..           zero padding to the next multiple of 64: here the plane area starts
//! plane area      ..           planes, each at a multiple of 64 bytes, zero padding between them
//! total_len - 4   4            u32 CRC-32 (ISO-HDLC) of all bytes before it
//! ```
//!
//! A [`PlaneRef`] counts its offset from the start of the plane area, not of the file. The integers of
//! postcard have a length that depends on their value, so offsets from the start of the file would depend on
//! themselves. The bulk data is not in postcard, which decodes element by element; planes are used where they
//! lie.
//!
//! The writer in `palpate-precompute` serialises the types that the reader here decodes.

use crc::{CRC_32_ISO_HDLC, Crc};
use heapless::String;
use serde::{Deserialize, Serialize};

use crate::num::vec3::{self, Vec3};
use crate::space::SPACE_NAME_LEN;

#[cfg(target_endian = "big")]
compile_error!(
    "blob planes are used in place and are little-endian: a big-endian target needs a converting reader"
);

/// The first eight bytes of a blob.
pub const MAGIC: [u8; 8] = *b"PALPATE\0";
/// The layout that is written and read.
pub const VERSION: u32 = 6;
/// Length of magic, version, header length and total length.
pub(crate) const PREFIX_LEN: usize = 24;
/// Length of the checksum at the end.
pub(crate) const CHECKSUM_LEN: usize = 4;
/// Planes start at multiples of this, a cache line: no vector load at the start of a row crosses a line.
pub const ALIGNMENT: usize = 64;
/// Alignment that a reader needs of the address of a blob, because of planes of f64.
pub(crate) const BUFFER_ALIGNMENT: usize = 8;
/// Longest scene name, bytes.
pub const SCENE_NAME_LEN: usize = 64;
/// Longest name of a material law, bytes.
pub(crate) const LAW_NAME_LEN: usize = 48;

/// The checksum of a blob.
pub const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Offset of the plane area in the file for a header of this length; `None` beyond the end of the address
/// space.
pub(crate) const fn plane_area_start(header_len: usize) -> Option<usize> {
    match PREFIX_LEN.checked_add(header_len) {
        Some(end) => end.checked_next_multiple_of(ALIGNMENT),
        None => None,
    }
}

/// Emits a blob in pieces: prefix, serialised header, padding, plane area and checksum.
///
/// Returns `None` if the header is longer than its length field can state; then nothing is emitted.
pub fn write(header: &[u8], planes: &[u8], mut emit: impl FnMut(&[u8])) -> Option<()> {
    let header_len = u32::try_from(header.len()).ok()?;
    let start = plane_area_start(header.len())?;
    let total_len = start.checked_add(planes.len())?.checked_add(CHECKSUM_LEN)? as u64;
    let padding = start.saturating_sub(PREFIX_LEN).saturating_sub(header.len());
    let padding = [0; ALIGNMENT].get(..padding)?;
    let mut digest = CHECKSUM.digest();
    let (version, header_len) = (VERSION.to_le_bytes(), header_len.to_le_bytes());
    for piece in [&MAGIC[..], &version, &header_len, &total_len.to_le_bytes(), header, padding, planes] {
        digest.update(piece);
        emit(piece);
    }
    emit(&digest.finalize().to_le_bytes());
    Some(())
}

/// Location of a plane, an array of equal elements. Their type follows from the field that contains the
/// reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct PlaneRef {
    /// Bytes from the start of the plane area; a multiple of [`ALIGNMENT`].
    pub offset: u32,
    /// Elements (not bytes).
    pub len: u32,
}

/// The first record of the header.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Preamble {
    /// Name of the scene.
    pub scene: String<SCENE_NAME_LEN>,
    /// Name of the material law (the first, where regions differ).
    pub law: String<LAW_NAME_LEN>,
    /// The largest force of the device that the scene was made for, newtons; infinite without a device.
    pub max_force_n: f32,
    /// Hash of the mesh.
    pub mesh_hash: [u8; 32],
    /// Surface of the body.
    pub surface: SurfaceHeader,
    /// Contact points of a tool with a size: vertices with the index of their space instead of a mesh node, and
    /// triangles between them. Empty if the tool touches nodes, or contact points one by one.
    pub contact: SurfaceHeader,
    /// The tool that the spaces were solved for.
    pub tool: Tool,
    /// u8: the certificate as JSON (UTF-8), for people and tools; the core does not read it. Always the last
    /// plane.
    pub certificate: Option<PlaneRef>,
    /// Number of [`SpaceHeader`]s that follow.
    pub space_count: u32,
}

/// What touches the body.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub enum Tool {
    /// A point, which holds nodes.
    #[default]
    Point,
    /// A fingertip, which touches contact points.
    Fingertip(Fingertip),
    /// A sphere, which touches the surface anywhere. The displacement of a space is that of its centre from the space's
    /// position. A live field has one space, a packed one a chart for each part of the surface.
    Sphere(Sphere),
    /// A capsule, which touches the surface anywhere: a sphere that is drawn along an axis, which the grip turns.
    Capsule(Capsule),
}

impl Tool {
    /// The fingertip, if it is one.
    pub const fn fingertip(&self) -> Option<Fingertip> {
        match *self {
            Self::Fingertip(tip) => Some(tip),
            Self::Point | Self::Sphere(_) | Self::Capsule(_) => None,
        }
    }

    /// The sphere, or that of which a capsule is made.
    pub const fn sphere(&self) -> Option<Sphere> {
        match *self {
            Self::Sphere(sphere) | Self::Capsule(Capsule { sphere, .. }) => Some(sphere),
            Self::Point | Self::Fingertip(_) => None,
        }
    }

    /// The way from the centre of a capsule to one of its ends in the frame of the grip, metres.
    pub const fn half_axis_m(&self) -> Option<Vec3> {
        match *self {
            Self::Capsule(Capsule { half_axis_m, .. }) => Some(half_axis_m),
            Self::Point | Self::Fingertip(_) | Self::Sphere(_) => None,
        }
    }

    /// Whether it can take hold of the skin and pull.
    pub const fn grasps(&self) -> bool {
        matches!(self, Self::Point)
    }

    /// The field that is not a positive number.
    pub(crate) fn fault(&self) -> Option<&'static str> {
        let (what, numbers) = match *self {
            Self::Point => return None,
            Self::Fingertip(Fingertip { radius_m, stiffness_n_m }) => {
                ("fingertip", [radius_m, stiffness_n_m])
            }
            Self::Sphere(Sphere { radius_m, layer_m }) => ("sphere", [radius_m, layer_m]),
            Self::Capsule(Capsule { sphere: Sphere { radius_m, layer_m }, half_axis_m }) => {
                ("capsule", [radius_m * vec3::norm(half_axis_m), layer_m])
            }
        };
        let is_sound = numbers.iter().all(|x| x.is_finite() && *x > 0.0);
        (!is_sound).then_some(what)
    }
}

/// A sphere without friction, with an elastic layer.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sphere {
    /// Its radius, metres.
    pub radius_m: f32,
    /// Thickness of its layer beyond the radius, metres.
    pub layer_m: f32,
}

impl Sphere {
    /// Distance from the centre within which it touches, metres.
    pub const fn reach_m(&self) -> f32 {
        self.radius_m + self.layer_m
    }

    /// Thickness of the whole layer, metres: a third of it lies within the radius.
    pub const fn thickness_m(&self) -> f32 {
        1.5 * self.layer_m
    }
}

/// A capsule: what a sphere covers whose centre moves along a line.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Capsule {
    /// The sphere.
    pub sphere: Sphere,
    /// The way from the middle of the line to one end in the frame of the grip, metres.
    pub half_axis_m: Vec3,
}

/// A fingertip with an elastic pad.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Fingertip {
    /// Radius of the pad on the undeformed skin, metres.
    pub radius_m: f32,
    /// Stiffness of the whole pad, newtons per metre.
    pub stiffness_n_m: f32,
}

/// A surface: vertices, triangles and which vertices are fixed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct SurfaceHeader {
    /// u32: 0-based mesh node of each surface vertex.
    pub node: PlaneRef,
    /// f32: x, y, z of each surface vertex at rest, metres.
    pub position_m: [PlaneRef; 3],
    /// `[u32; 3]`: surface vertices (not mesh nodes) of each triangle, counter-clockwise seen from outside.
    pub triangles: PlaneRef,
    /// u8: 1 where the vertex is fixed, else 0.
    pub fixed: PlaneRef,
}

/// One active node and the planes of its configuration space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpaceHeader {
    /// Name of the active node.
    pub name: String<SPACE_NAME_LEN>,
    /// Mesh node, 0-based.
    pub node: u32,
    /// Its position at rest, metres.
    pub rest_position_m: [f32; 3],
    /// Unit outward normal of the surface there.
    pub outward_normal: [f32; 3],
    /// Grid spacing, metres.
    pub spacing_m: f32,
    /// Grid radius, metres.
    pub radius_m: f32,
    /// u8 per slot of the box, see [`crate::flags`]; the derived bits are those of
    /// [`crate::flags::derive()`].
    pub flags: PlaneRef,
    /// `[f32; 3]` per slot: h in newtons, finite in every slot (extrapolated where unsolved), 0 at rest.
    pub force_n: Option<PlaneRef>,
    /// phi = r; planes of f32.
    pub rbf_linear: Option<RbfHeader>,
    /// phi = r^3; planes of f64.
    pub rbf_cubic: Option<RbfHeader>,
    /// Energy and its derivatives.
    pub hermite: Option<HermiteHeader>,
    /// Surface displacements.
    pub displacement: Option<DisplacementHeader>,
    /// Kernel through scattered configurations.
    pub kernel: Option<KernelHeader>,
}

/// Planes of the energy and its derivatives at the grid points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct HermiteHeader {
    /// u32 per slot of the box: the index of its node.
    pub row: PlaneRef,
    /// [`crate::HermiteNode`]: 36 f32 each, newtons; without energy and force at rest.
    pub nodes: PlaneRef,
}

/// Planes of one kernel, see [`crate::kernel`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct KernelHeader {
    /// f64: [`crate::kernel::SCALARS`] of them, l in metres and B in newtons.
    pub scalars: PlaneRef,
    /// [`crate::kernel::Block`]: 23 x 4 f64 each.
    pub blocks: PlaneRef,
    /// u8: [`crate::kernel::REACH_POINTS`] fractions of the radius of the grid.
    pub reach: PlaneRef,
}

/// Planes of one set of radial basis functions, padded to a multiple of
/// [`crate::RBF_LANES`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RbfHeader {
    /// x, y, z of the centres, in cells.
    pub centres: [PlaneRef; 3],
    /// x, y, z of the weights; zero in the padding.
    pub weights: [PlaneRef; 3],
}

/// Planes of the surface displacements, see [`crate::DisplacementPlanes`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct DisplacementHeader {
    /// Number of modes, from the first, that have slopes; the others are interpolated tri-linearly.
    pub slopes: u32,
    /// u32 per slot of the box: its row. It may be the plane that `hermite` refers to.
    pub row: PlaneRef,
    /// i16, `[mode][surface vertex][xyz]`.
    pub modes: PlaneRef,
    /// f32 per mode: metres per unit of the mode times unit of its coefficient.
    pub scale: PlaneRef,
    /// i16, rows of the values of all modes, then of the slopes along x, along y and along z, per cell.
    pub coefficients: PlaneRef,
    /// u32: the rows of the outliers, ascending.
    pub outlier_row: PlaneRef,
    /// f32 per outlier: metres per unit.
    pub outlier_scale: PlaneRef,
    /// i16, `[outlier][surface vertex][xyz]`: the residual of the modes.
    pub outliers: PlaneRef,
}
