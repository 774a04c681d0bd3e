//! Layout of a blob, versions 3 and 4. Little-endian throughout.
//!
//! ```text
//! offset          size         what
//! 0               8            magic "PALPATE\0"
//! 8               4            u32 version = 3, or 4 where a space has a kernel
//! 12              4            u32 header_len
//! 16              8            u64 total_len: the whole file, checksum included
//! 24              header_len   header: one Preamble, then Preamble::space_count SpaceHeaders (postcard); in version 4 as many
//!                              Option<KernelHeader> after them
//! ..              ..           zero padding to the next multiple of 64: here the plane area starts
//! plane area      ..           planes, each at a multiple of 64 bytes, zero padding between them
//! total_len - 4   4            u32 CRC-32 (ISO-HDLC) of every byte before it
//! ```
//!
//! A [`PlaneRef`] counts its offset from the start of the plane area, not of the file: the header's postcard integers have a
//! length that depends on their value, so offsets from the start of the file would depend on themselves.
//! Bulk data is not in postcard because that decodes element by element; planes are used where they lie.
//!
//! The writer in `palpate-precompute` serialises the very types that the reader here decodes.

use crc::{CRC_32_ISO_HDLC, Crc};
use heapless::String;
use serde::{Deserialize, Serialize};

use crate::table::SPACE_NAME_LEN;

#[cfg(target_endian = "big")]
compile_error!(
    "blob planes are used in place and are little-endian: a big-endian target needs a converting reader"
);

/// First eight bytes of a blob.
pub const MAGIC: [u8; 8] = *b"PALPATE\0";
/// Newest layout that this version reads: it differs from [`VERSION_WITHOUT_KERNELS`] in what the header ends with.
pub const VERSION: u32 = 4;
/// The layout of a blob without kernels, which older readers know.
pub const VERSION_WITHOUT_KERNELS: u32 = 3;
/// Magic, version, header length and total length.
pub const PREFIX_LEN: usize = 24;
/// Length of the checksum at the end.
pub const CHECKSUM_LEN: usize = 4;
/// Planes start at multiples of this, a cache line: no vector load of a row's start crosses one.
pub const ALIGNMENT: usize = 64;
/// What a reader asks of the buffer's own address; f64 planes need it.
pub const BUFFER_ALIGNMENT: usize = 8;
/// Longest scene name, bytes.
pub const SCENE_NAME_LEN: usize = 64;
/// Longest material law name, bytes.
pub const LAW_NAME_LEN: usize = 48;

/// The checksum of a blob.
pub const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Next multiple of [`ALIGNMENT`], or `None` past the end of the address space.
pub const fn align_up(len: usize) -> Option<usize> {
    len.checked_next_multiple_of(ALIGNMENT)
}

/// Offset of the plane area in the file for a header of this length.
pub const fn plane_area_start(header_len: usize) -> Option<usize> {
    match PREFIX_LEN.checked_add(header_len) {
        Some(end) => align_up(end),
        None => None,
    }
}

/// Where a plane lies: a run of equal elements. What kind they are follows from the field that holds the reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct PlaneRef {
    /// Bytes from the start of the plane area; a multiple of [`ALIGNMENT`].
    pub offset: u32,
    /// Elements (not bytes).
    pub len: u32,
}

/// First record of the header.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Preamble {
    /// Name of the scene.
    pub scene: String<SCENE_NAME_LEN>,
    /// Name of the material law (the first, where regions differ).
    pub law: String<LAW_NAME_LEN>,
    /// The device force the scene was made for, newtons.
    pub max_force_n: f32,
    /// Hash of the mesh.
    pub mesh_hash: [u8; 32],
    /// Surface of the body.
    pub surface: SurfaceHeader,
    /// u8: the certificate as JSON (UTF-8), for people and tools; the core does not read it. It is always the last plane.
    pub certificate: Option<PlaneRef>,
    /// Number of [`SpaceHeader`]s that follow.
    pub space_count: u32,
}

/// Surface of the body: vertices, triangles and which vertices are fixed.
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
    /// u8 per slot of the box, see [`crate::flags`]; derived bits by [`crate::flags::derive()`].
    pub flags: PlaneRef,
    /// `[f32; 3]` per slot: h in newtons, every slot finite (ghosts filled in), 0 at the rest point.
    pub force_n: Option<PlaneRef>,
    /// phi = r, planes of f32.
    pub rbf_linear: Option<RbfHeader>,
    /// phi = r^3, planes of f64.
    pub rbf_cubic: Option<RbfHeader>,
    /// The energy and its derivatives.
    pub hermite: Option<HermiteHeader>,
    /// Surface displacements.
    pub displacement: Option<DisplacementHeader>,
}

/// Planes of the energy and its derivatives at the grid points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct HermiteHeader {
    /// u32 per slot of the box: its node.
    pub row: PlaneRef,
    /// [`crate::hermite::Node`]: 36 f32 each, newtons; zero energy and force at the rest point.
    pub nodes: PlaneRef,
}

/// Planes of one kernel, see [`crate::kernel`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct KernelHeader {
    /// f64: [`crate::kernel::SCALARS`] of them, l in metres and B in newtons.
    pub scalars: PlaneRef,
    /// [`crate::kernel::Block`]: 23 x 4 f64 each.
    pub blocks: PlaneRef,
    /// u8: [`crate::kernel::REACH_POINTS`] shares of the grid's radius.
    pub reach: PlaneRef,
}

/// Planes of one set of radial basis functions, padded to a multiple of [`crate::rbf::LANES`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RbfHeader {
    /// x, y, z of the centres in cell units.
    pub centres: [PlaneRef; 3],
    /// x, y, z of the weights; zero in the padding.
    pub weights: [PlaneRef; 3],
}

/// Planes of the surface displacements, see [`crate::displacement`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct DisplacementHeader {
    /// How many of the modes, from the first, have slopes; 0: all are interpolated tri-linearly.
    pub slopes: u32,
    /// u32 per slot of the box: its row. May be the plane that `hermite` has.
    pub row: PlaneRef,
    /// i16, `[mode][surface vertex][xyz]`.
    pub modes: PlaneRef,
    /// f32 per mode: metres per unit of the mode times unit of its coefficient.
    pub scale: PlaneRef,
    /// i16, rows of the values of all modes, then of the slopes along x, along y and along z, per cell.
    pub coefficients: PlaneRef,
    /// u32: the rows that are outliers, ascending.
    pub outlier_row: PlaneRef,
    /// f32 per outlier: metres per unit.
    pub outlier_scale: PlaneRef,
    /// i16, `[outlier][surface vertex][xyz]`: what the modes miss.
    pub outliers: PlaneRef,
}
