//! Reads a blob: verifies everything once and copies only names.
//!
//! After [`Organ::read`] has returned, every plane is in bounds, every float finite, every index in range and
//! every flag consistent, so that no query needs a check. The checksum detects damage before any content is
//! used; the other checks are for a blob that was written incorrectly.

use bytemuck::Pod;
use heapless::{String, Vec};

use super::error::BlobError;
use super::format::{
    ALIGNMENT, BUFFER_ALIGNMENT, CHECKSUM, CHECKSUM_LEN, DisplacementHeader, HermiteHeader, KernelHeader,
    LAW_NAME_LEN, MAGIC, PREFIX_LEN, PlaneRef, Preamble, RbfHeader, SCENE_NAME_LEN, SpaceHeader,
    SurfaceHeader, Tool, VERSION, plane_area_start,
};
use super::profile::Limits;
use crate::displacement::DisplacementPlanes;
use crate::grid::BallLattice;
use crate::method::baseline::rbf::RbfPlanes;
use crate::method::hermite::HermitePlanes;
use crate::method::kernel::{KernelPlanes, LANES, MAX_CENTRES};
use crate::num::vec3;
use crate::plane::{PlaneError, PlaneProblem, check_finite, check_len, check_range};
use crate::space::{ActiveNode, Space, SpacePlanes};

/// Largest deviation of the length of a normal from 1.
const UNIT_TOLERANCE: f32 = 1e-3;

/// One organ: its surface and the configuration spaces of its active nodes, as views into the blob.
#[derive(Debug, Clone, PartialEq)]
pub struct Organ<'a, const MAX_SPACES: usize = { Limits::PC.spaces }> {
    /// Name of the scene that it was made from.
    pub scene: String<SCENE_NAME_LEN>,
    /// Name of the material law (the first, where regions differ).
    pub law: String<LAW_NAME_LEN>,
    /// The largest force of the device that the scene was made for, newtons; infinite without a device.
    pub max_force_n: f32,
    /// Hash of the mesh, to match a blob with its scene.
    pub mesh_hash: [u8; 32],
    /// The active nodes.
    pub spaces: Vec<Space<'a>, MAX_SPACES>,
    /// The surface at rest.
    pub surface: Surface<'a>,
    /// Triangles between contact points; `node` is the index of the space of each vertex. Empty if the tool
    /// touches nodes, or contact points one by one.
    pub contact: Surface<'a>,
    /// What touches.
    pub tool: Tool,
    /// The measured accuracy of these tables as JSON, if it was measured.
    pub certificate: Option<&'a [u8]>,
}

/// Surface of the body at rest.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Surface<'a> {
    /// Mesh node of each surface vertex, 0-based.
    pub node: &'a [u32],
    /// x, y, z of each surface vertex, model frame, metres.
    pub position_m: [&'a [f32]; 3],
    /// Surface vertices of each triangle, counter-clockwise seen from outside.
    pub triangles: &'a [[u32; 3]],
    /// 1 where the vertex is fixed, else 0.
    pub fixed: &'a [u8],
}

impl<'a, const MAX_SPACES: usize> Organ<'a, MAX_SPACES> {
    /// The surface that the tool meets: that between contact points, or else the skin at rest.
    pub fn met(&self) -> Surface<'a> {
        if self.contact.triangles.is_empty() { self.surface } else { self.contact }
    }

    /// Opens a blob in place, within the limits of a PC, see [`Organ::read_within`].
    pub fn read(bytes: &'a [u8]) -> Result<Self, BlobError> {
        Self::read_within(bytes, &Limits::PC)
    }

    /// Verifies a blob and opens it in place.
    ///
    /// `bytes` is exactly one blob and starts at an address divisible by 8, see [`super::Aligned`].
    ///
    /// Errors: [`BlobError`] if any check fails or a limit is exceeded.
    pub fn read_within(bytes: &'a [u8], limits: &Limits) -> Result<Self, BlobError> {
        let mut organ = Self::empty();
        organ.load(bytes, limits)?;
        Ok(organ)
    }

    /// [`Organ::read`] on the heap, with as many spaces as the type holds: an organ of many spaces takes a large
    /// part of a thread's stack. Needs the feature `alloc`.
    #[cfg(feature = "alloc")]
    pub fn read_boxed(bytes: &'a [u8]) -> Result<alloc::boxed::Box<Self>, BlobError> {
        let mut organ = alloc::boxed::Box::new(Self::empty());
        organ.load(bytes, &Limits { spaces: MAX_SPACES, ..Limits::PC })?;
        Ok(organ)
    }

    /// An organ without spaces, surface and force, for [`Organ::load`].
    // A function and not a constant, which would occupy the size of an organ in flash.
    #[inline(always)]
    pub fn empty() -> Self {
        Self {
            scene: String::new(),
            law: String::new(),
            max_force_n: 0.0,
            mesh_hash: [0; 32],
            spaces: Vec::new(),
            surface: Surface::default(),
            contact: Surface::default(),
            tool: Tool::Point,
            certificate: None,
        }
    }

    /// [`Organ::read_within`] into existing memory, because an organ of many spaces is large for a stack.
    ///
    /// Errors: as [`Organ::read_within`]. The organ must not be used after an error.
    pub fn load(&mut self, bytes: &'a [u8], limits: &Limits) -> Result<(), BlobError> {
        let (header, area) = open(bytes)?;
        let (preamble, mut rest) = decode::<Preamble>(header)?;
        let need = preamble.space_count as usize;
        // A command refers to its space by a u16.
        let limit = MAX_SPACES.min(limits.spaces).min(usize::from(u16::MAX));
        let capacity = BlobError::Capacity { what: "spaces", space: None, need, limit };
        if need > limit {
            return Err(capacity);
        }
        if preamble.max_force_n.is_nan() || preamble.max_force_n <= 0.0 {
            return Err(BlobError::Value { what: "max_force_n", space: None });
        }
        let is_root = preamble.tool.sphere().is_some();
        let planes = Planes { area, limits: *limits, space: None, is_root };
        let (surface, contact) = (planes.surface(&preamble.surface)?, planes.surface(&preamble.contact)?);
        check_range("contact space", contact.node, |space| *space < preamble.space_count)
            .map_err(|error| planes.refuse(error))?;
        if let Some(what) = preamble.tool.fault() {
            return Err(BlobError::Value { what, space: None });
        }
        self.spaces.clear();
        for index in 0..need as u16 {
            let (header, after) = decode::<SpaceHeader>(rest)?;
            rest = after;
            let space = Planes { space: Some(index), ..planes }.space(index, header, surface.node.len())?;
            self.spaces.push(space).map_err(|_| capacity)?;
        }
        if !rest.is_empty() {
            return Err(BlobError::Header);
        }
        self.certificate = preamble.certificate.map(|plane| planes.get("certificate", plane)).transpose()?;
        (self.surface, self.contact, self.tool) = (surface, contact, preamble.tool);
        (self.scene, self.law) = (preamble.scene, preamble.law);
        (self.max_force_n, self.mesh_hash) = (preamble.max_force_n, preamble.mesh_hash);
        Ok(())
    }
}

/// Checks the envelope; returns the header and the plane area.
fn open(bytes: &[u8]) -> Result<(&[u8], &[u8]), BlobError> {
    const NEED: usize = PREFIX_LEN + CHECKSUM_LEN;
    let too_short = BlobError::TooShort { have: bytes.len(), need: NEED };
    if bytes.len() < NEED {
        return Err(too_short);
    }
    let (magic, rest) = bytes.split_first_chunk::<8>().ok_or(too_short)?;
    let (version, rest) = rest.split_first_chunk::<4>().ok_or(too_short)?;
    let (header_len, rest) = rest.split_first_chunk::<4>().ok_or(too_short)?;
    let (total_len, _) = rest.split_first_chunk::<8>().ok_or(too_short)?;
    if *magic != MAGIC {
        return Err(BlobError::BadMagic);
    }
    // The version is checked before lengths and checksum, because another version may have those elsewhere.
    let version = u32::from_le_bytes(*version);
    match version {
        VERSION => {}
        found if found > VERSION => return Err(BlobError::NewerVersion { found }),
        found => return Err(BlobError::UnknownVersion { found }),
    }
    let (have, need) = (bytes.len() as u64, u64::from_le_bytes(*total_len));
    if have < need {
        return Err(BlobError::Truncated { have, need });
    }
    if have > need {
        return Err(BlobError::TooLong { have, need });
    }
    let (body, stored) = bytes.split_last_chunk::<CHECKSUM_LEN>().ok_or(too_short)?;
    let (stored, computed) = (u32::from_le_bytes(*stored), CHECKSUM.checksum(body));
    if stored != computed {
        return Err(BlobError::Checksum { stored, computed });
    }
    if !bytes.as_ptr().addr().is_multiple_of(BUFFER_ALIGNMENT) {
        return Err(BlobError::Misaligned);
    }
    let header_len = u32::from_le_bytes(*header_len) as usize;
    let header = body.get(PREFIX_LEN..PREFIX_LEN.saturating_add(header_len)).ok_or(BlobError::Header)?;
    let area = plane_area_start(header_len).and_then(|start| body.get(start..)).unwrap_or_default();
    Ok((header, area))
}

fn decode<'b, T: serde::Deserialize<'b>>(bytes: &'b [u8]) -> Result<(T, &'b [u8]), BlobError> {
    postcard::take_from_bytes(bytes).map_err(|_| BlobError::Header)
}

/// The plane area, for the surface or a space.
struct Planes<'a> {
    area: &'a [u8],
    limits: Limits,
    /// Index of the space, or `None` for the surface.
    space: Option<u16>,
    /// Whether the tables hold s = sqrt(2 W).
    is_root: bool,
}

impl<'a> Planes<'a> {
    fn get<T: Pod>(&self, name: &'static str, plane: PlaneRef) -> Result<&'a [T], BlobError> {
        let PlaneRef { offset, len } = plane;
        let start = offset as usize;
        let misaligned = PlaneProblem::Misaligned { offset };
        if !start.is_multiple_of(ALIGNMENT) {
            return Err(self.refuse(misaligned.of(name)));
        }
        let end = (len as usize).checked_mul(size_of::<T>()).and_then(|size| size.checked_add(start));
        let bytes = end.and_then(|end| self.area.get(start..end));
        let bytes = bytes.ok_or(self.refuse(PlaneProblem::OutOfBounds { offset, len }.of(name)))?;
        bytemuck::try_cast_slice(bytes).map_err(|_| self.refuse(misaligned.of(name)))
    }

    fn get_three<T: Pod>(
        &self,
        name: &'static str,
        [x, y, z]: [PlaneRef; 3],
    ) -> Result<[&'a [T]; 3], BlobError> {
        Ok([self.get(name, x)?, self.get(name, y)?, self.get(name, z)?])
    }

    const fn refuse(&self, error: PlaneError) -> BlobError {
        BlobError::Plane { space: self.space, error }
    }

    /// Refuses more than a limit.
    fn check_capacity(&self, what: &'static str, need: usize, limit: usize) -> Result<(), BlobError> {
        if need <= limit { Ok(()) } else { Err(BlobError::Capacity { what, space: self.space, need, limit }) }
    }

    fn surface(&self, header: &SurfaceHeader) -> Result<Surface<'a>, BlobError> {
        self.check_capacity("surface vertices", header.node.len as usize, self.limits.vertices)?;
        self.check_capacity("surface triangles", header.triangles.len as usize, self.limits.triangles)?;
        let surface = Surface {
            node: self.get("surface node", header.node)?,
            position_m: self.get_three("surface position", header.position_m)?,
            triangles: self.get("triangles", header.triangles)?,
            fixed: self.get("fixed", header.fixed)?,
        };
        surface.check().map_err(|error| self.refuse(error))?;
        Ok(surface)
    }

    fn rbf<T: Pod>(&self, name: &'static str, header: &RbfHeader) -> Result<RbfPlanes<'a, T>, BlobError> {
        let [centres, ..] = header.centres;
        self.check_capacity("RBF centres", centres.len as usize, self.limits.centres)?;
        Ok(RbfPlanes {
            centres: self.get_three(name, header.centres)?,
            weights: self.get_three(name, header.weights)?,
        })
    }

    fn hermite(&self, header: &HermiteHeader) -> Result<HermitePlanes<'a>, BlobError> {
        Ok(HermitePlanes {
            row: self.get("hermite row", header.row)?,
            nodes: self.get("hermite nodes", header.nodes)?,
        })
    }

    fn kernel(&self, header: &KernelHeader) -> Result<KernelPlanes<'a>, BlobError> {
        let centres = (header.blocks.len as usize).saturating_mul(LANES);
        self.check_capacity("kernel centres", centres, self.limits.centres.min(MAX_CENTRES))?;
        Ok(KernelPlanes {
            scalars: self.get("kernel scalars", header.scalars)?,
            blocks: self.get("kernel blocks", header.blocks)?,
            reach: self.get("kernel reach", header.reach)?,
        })
    }

    fn displacement(&self, header: &DisplacementHeader) -> Result<DisplacementPlanes<'a>, BlobError> {
        self.check_capacity("displacement modes", header.scale.len as usize, self.limits.modes)?;
        Ok(DisplacementPlanes {
            slopes: header.slopes as usize,
            row: self.get("displacement row", header.row)?,
            modes: self.get("displacement modes", header.modes)?,
            scale: self.get("displacement scale", header.scale)?,
            coefficients: self.get("displacement coefficients", header.coefficients)?,
            outlier_row: self.get("displacement outlier row", header.outlier_row)?,
            outlier_scale: self.get("displacement outlier scale", header.outlier_scale)?,
            outliers: self.get("displacement outliers", header.outliers)?,
        })
    }

    fn space(&self, index: u16, header: SpaceHeader, vertices: usize) -> Result<Space<'a>, BlobError> {
        let value = |what| BlobError::Value { what, space: self.space };
        if !vec3::is_finite(header.rest_position_m) {
            return Err(value("rest_position_m"));
        }
        let has_unit_length = (vec3::norm(header.outward_normal) - 1.0).abs() <= UNIT_TOLERANCE;
        if !(has_unit_length && vec3::is_finite(header.outward_normal)) {
            return Err(value("outward_normal"));
        }
        let lattice = BallLattice::new(header.spacing_m, header.radius_m)
            .map_err(|error| BlobError::Lattice { space: index, error })?;
        self.check_capacity("grid slots", lattice.slots(), self.limits.slots)?;
        let planes = SpacePlanes {
            flags: self.get("flags", header.flags)?,
            force_n: header.force_n.map(|plane| self.get("force", plane)).transpose()?,
            rbf_linear: header.rbf_linear.map(|header| self.rbf("rbf-linear", &header)).transpose()?,
            rbf_cubic: header.rbf_cubic.map(|header| self.rbf("rbf-cubic", &header)).transpose()?,
            hermite: header.hermite.map(|header| self.hermite(&header)).transpose()?,
            is_root: self.is_root,
            kernel: header.kernel.map(|header| self.kernel(&header)).transpose()?,
            displacement: header.displacement.map(|header| self.displacement(&header)).transpose()?,
        };
        let SpaceHeader { name, node, rest_position_m, outward_normal, .. } = header;
        let active = ActiveNode { name, node, rest_position_m, outward_normal };
        Space::new(active, lattice, planes, vertices).map_err(|error| self.refuse(error))
    }
}

impl Surface<'_> {
    /// Checks lengths, values and indices.
    fn check(&self) -> Result<(), PlaneError> {
        let vertices = self.node.len();
        for plane in self.position_m {
            check_len("surface position", plane, vertices)?;
            check_finite("surface position", plane)?;
        }
        let is_vertex = |vertex: &u32| (*vertex as usize) < vertices;
        check_range("triangles", self.triangles, |corners| corners.iter().all(is_vertex))?;
        check_len("fixed", self.fixed, vertices)?;
        check_range("fixed", self.fixed, |fixed| *fixed <= 1)
    }
}
