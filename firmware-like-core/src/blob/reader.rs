//! Reads a blob: checks everything once, copies nothing but names.
//!
//! After [`Organ::read`] has returned, every plane is in bounds, every float finite, every index in range and every flag
//! consistent, so that no query needs a check. Damage is found by the checksum before anything is believed; the
//! checks behind it are for a blob that was written wrong.

use bytemuck::Pod;
use heapless::{String, Vec};

use super::error::{BlobError, PlaneProblem};
use super::format::{
    ALIGNMENT, BUFFER_ALIGNMENT, CHECKSUM, CHECKSUM_LEN, KernelHeader, LAW_NAME_LEN, MAGIC, PREFIX_LEN,
    PlaneRef, Preamble, RbfHeader, SCENE_NAME_LEN, SpaceHeader, SurfaceHeader, VERSION,
    VERSION_WITHOUT_KERNELS, plane_area_start,
};
use crate::displacement::{DisplacementPlanes, DisplacementTable};
use crate::flags;
use crate::grid::BallLattice;
use crate::hermite::{HermiteTable, Node};
use crate::kernel::{Block, KernelTable, LANES, MOST_CENTRES};
use crate::profile::{Limits, PC_SPACES};
use crate::rbf::RbfTable;
use crate::table::{LatticeTable, Space, TableError, check_finite, check_len};
use crate::vec3::{self, Vec3};

/// Largest deviation of a normal's length from 1.
const UNIT_TOLERANCE: f32 = 1e-3;

/// One organ: its surface and the configuration spaces of its active nodes, as views into the blob.
#[derive(Debug, Clone, PartialEq)]
pub struct Organ<'a, const MAX_SPACES: usize = PC_SPACES> {
    /// Name of the scene it was made from.
    pub scene: String<SCENE_NAME_LEN>,
    /// Name of the material law.
    pub law: String<LAW_NAME_LEN>,
    /// Device force the scene was made for, newtons.
    pub max_force_n: f32,
    /// Hash of the mesh, to match a blob with its scene.
    pub mesh_hash: [u8; 32],
    /// The active nodes.
    pub spaces: Vec<Space<'a>, MAX_SPACES>,
    /// For the eye.
    pub surface: Surface<'a>,
    /// What was measured of these very tables, as JSON; `None` if nothing was.
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
    /// 1 where the vertex is fixed.
    pub fixed: &'a [u8],
}

impl<'a, const MAX_SPACES: usize> Organ<'a, MAX_SPACES> {
    /// [`Organ::read_within`] the limits of a PC.
    pub fn read(bytes: &'a [u8]) -> Result<Self, BlobError> {
        Self::read_within(bytes, &Limits::PC)
    }

    /// Checks a blob and opens it in place. `bytes` starts at an address divisible by 8 and holds exactly one blob.
    pub fn read_within(bytes: &'a [u8], limits: &Limits) -> Result<Self, BlobError> {
        let mut organ = Self::empty();
        organ.load(bytes, limits)?;
        Ok(organ)
    }

    /// Nothing: no space, no surface, no force. A function and not a constant: that would be as large in flash as the organ is.
    #[inline(always)]
    pub fn empty() -> Self {
        Self {
            scene: String::new(),
            law: String::new(),
            max_force_n: 0.0,
            mesh_hash: [0; 32],
            spaces: Vec::new(),
            surface: Surface::default(),
            certificate: None,
        }
    }

    /// [`Organ::read_within`] where the organ lies already: an organ of many spaces is large for a stack. After an error it is
    /// to be thrown away.
    pub fn load(&mut self, bytes: &'a [u8], limits: &Limits) -> Result<(), BlobError> {
        let (version, header, planes) = open(bytes)?;
        let (preamble, mut rest) = decode::<Preamble>(header)?;
        let need = preamble.space_count as usize;
        // A command names its space with a u16.
        let limit = MAX_SPACES.min(usize::from(u16::MAX));
        let capacity = BlobError::Capacity { what: "spaces", space: None, need, limit };
        if need > limit {
            return Err(capacity);
        }
        if !(preamble.max_force_n > 0.0 && preamble.max_force_n.is_finite()) {
            return Err(BlobError::Value { what: "max_force_n", space: None });
        }
        let surface = read_surface(&planes, &preamble.surface, limits)?;
        self.spaces.clear();
        for index in 0..need {
            let (space, after) = decode::<SpaceHeader>(rest)?;
            rest = after;
            let space = read_space(&planes, space, index as u16, surface.node.len(), limits)?;
            self.spaces.push(space).map_err(|_| capacity)?;
        }
        if version > VERSION_WITHOUT_KERNELS {
            for (index, space) in self.spaces.iter_mut().enumerate() {
                let (header, after) = decode::<Option<KernelHeader>>(rest)?;
                rest = after;
                let kernel = header.map(|header| read_kernel(&planes, header, space, index as u16, limits));
                space.kernel = kernel.transpose()?;
            }
        }
        if !rest.is_empty() {
            return Err(BlobError::Header);
        }
        let certificate = preamble.certificate.map(|plane| planes.get(plane)).transpose();
        self.certificate = certificate.map_err(named("certificate", None))?;
        self.surface = surface;
        (self.scene, self.law) = (preamble.scene, preamble.law);
        (self.max_force_n, self.mesh_hash) = (preamble.max_force_n, preamble.mesh_hash);
        Ok(())
    }
}

/// Checks the envelope; returns the version, the header and the plane area.
fn open(bytes: &[u8]) -> Result<(u32, &[u8], Planes<'_>), BlobError> {
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
    let version = u32::from_le_bytes(*version);
    match version {
        VERSION_WITHOUT_KERNELS..=VERSION => {}
        found if found > VERSION => return Err(BlobError::NewerVersion { found, supported: VERSION }),
        found => return Err(BlobError::UnknownVersion { found }),
    }
    if !bytes.as_ptr().addr().is_multiple_of(BUFFER_ALIGNMENT) {
        return Err(BlobError::Misaligned);
    }
    let header_len = u32::from_le_bytes(*header_len) as usize;
    let header = body.get(PREFIX_LEN..PREFIX_LEN.saturating_add(header_len)).ok_or(BlobError::Header)?;
    let area = plane_area_start(header_len).and_then(|start| body.get(start..)).unwrap_or_default();
    Ok((version, header, Planes { area }))
}

fn decode<'b, T: serde::Deserialize<'b>>(bytes: &'b [u8]) -> Result<(T, &'b [u8]), BlobError> {
    postcard::take_from_bytes(bytes).map_err(|_| BlobError::Header)
}

/// The plane area.
struct Planes<'a> {
    area: &'a [u8],
}

impl<'a> Planes<'a> {
    fn get<T: Pod>(&self, plane: PlaneRef) -> Result<&'a [T], PlaneProblem> {
        let PlaneRef { offset, len } = plane;
        let out_of_bounds = PlaneProblem::OutOfBounds { offset, len };
        let start = offset as usize;
        if !start.is_multiple_of(ALIGNMENT) {
            return Err(PlaneProblem::Misaligned { offset });
        }
        let end = (len as usize).checked_mul(size_of::<T>()).and_then(|size| size.checked_add(start));
        let bytes = end.and_then(|end| self.area.get(start..end)).ok_or(out_of_bounds)?;
        bytemuck::try_cast_slice(bytes).map_err(|_| PlaneProblem::Misaligned { offset })
    }

    fn get_three<T: Pod>(&self, [x, y, z]: [PlaneRef; 3]) -> Result<[&'a [T]; 3], PlaneProblem> {
        Ok([self.get(x)?, self.get(y)?, self.get(z)?])
    }

    fn rbf<T: Pod + Into<f64>>(&self, header: &RbfHeader) -> Result<RbfTable<'a, T>, PlaneProblem> {
        Ok(RbfTable::new(self.get_three(header.centres)?, self.get_three(header.weights)?)?)
    }
}

/// Names the plane a problem is in.
fn named(what: &'static str, space: Option<u16>) -> impl Fn(PlaneProblem) -> BlobError {
    move |problem| BlobError::Plane { what, space, problem }
}

/// Refuses what is more than this build holds.
fn check_capacity(
    what: &'static str,
    space: Option<u16>,
    need: usize,
    limit: usize,
) -> Result<(), BlobError> {
    if need <= limit { Ok(()) } else { Err(BlobError::Capacity { what, space, need, limit }) }
}

fn read_surface<'a>(
    planes: &Planes<'a>,
    header: &SurfaceHeader,
    limits: &Limits,
) -> Result<Surface<'a>, BlobError> {
    let of = |what| named(what, None);
    check_capacity("surface vertices", None, header.node.len as usize, limits.vertices)?;
    let out_of_range = |index| PlaneProblem::Table(TableError::OutOfRange { index });

    let node: &[u32] = planes.get(header.node).map_err(of("surface node"))?;
    let position_m = planes.get_three(header.position_m).map_err(of("surface position"))?;
    for plane in position_m {
        let checked = check_len(plane, node.len()).and_then(|()| check_finite(plane));
        checked.map_err(|error| of("surface position")(error.into()))?;
    }
    let triangles: &[[u32; 3]] = planes.get(header.triangles).map_err(of("triangles"))?;
    let bad = |triangle: &[u32; 3]| triangle.iter().any(|&vertex| vertex as usize >= node.len());
    if let Some(index) = triangles.iter().position(bad) {
        return Err(of("triangles")(out_of_range(index)));
    }
    let fixed: &[u8] = planes.get(header.fixed).map_err(of("fixed"))?;
    check_len(fixed, node.len()).map_err(|error| of("fixed")(error.into()))?;
    if let Some(index) = fixed.iter().position(|&fixed| fixed > 1) {
        return Err(of("fixed")(out_of_range(index)));
    }
    Ok(Surface { node, position_m, triangles, fixed })
}

fn read_space<'a>(
    planes: &Planes<'a>,
    header: SpaceHeader,
    space: u16,
    vertices: usize,
    limits: &Limits,
) -> Result<Space<'a>, BlobError> {
    let of = |what| named(what, Some(space));
    let value = |what| BlobError::Value { what, space: Some(space) };

    check_vector(header.rest_position_m).ok_or(value("rest_position_m"))?;
    check_vector(header.outward_normal).ok_or(value("outward_normal"))?;
    // The norm of finite components may be infinite, but is not NaN.
    if (vec3::norm(header.outward_normal) - 1.0).abs() > UNIT_TOLERANCE {
        return Err(value("outward_normal"));
    }
    let lattice = BallLattice::new(header.spacing_m, header.radius_m)
        .map_err(|error| BlobError::Lattice { space, error })?;
    let capacity = |what, need, limit| check_capacity(what, Some(space), need, limit);
    capacity("grid slots", lattice.slots(), limits.slots)?;
    for rbf in [&header.rbf_linear, &header.rbf_cubic].into_iter().flatten() {
        let [centres, ..] = rbf.centres;
        capacity("RBF centres", centres.len as usize, limits.centres)?;
    }
    if let Some(displacement) = &header.displacement {
        capacity("displacement modes", displacement.scale.len as usize, limits.modes)?;
    }

    let flags: &[u8] = planes.get(header.flags).map_err(of("flags"))?;
    check_len(flags, lattice.slots()).map_err(|error| of("flags")(error.into()))?;
    if let Some(slot) = flags::first_inconsistent(&lattice, flags) {
        return Err(of("flags")(PlaneProblem::Flags { slot }));
    }
    let rest = lattice.rest_slot();
    if flags.get(rest).is_none_or(|bits| bits & flags::SOLVED == 0) {
        return Err(BlobError::RestPoint { space });
    }

    let lattice_table = match header.force_n {
        None => None,
        Some(force) => {
            let force: &[Vec3] = planes.get(force).map_err(of("force"))?;
            let table = LatticeTable::new(&lattice, force).map_err(|error| of("force")(error.into()))?;
            if force.get(rest).is_none_or(|&force| force != vec3::ZERO) {
                return Err(BlobError::RestPoint { space });
            }
            Some(table)
        }
    };
    let rbf_linear = match &header.rbf_linear {
        None => None,
        Some(rbf) => Some(planes.rbf(rbf).map_err(of("rbf-linear"))?),
    };
    let rbf_cubic = match &header.rbf_cubic {
        None => None,
        Some(rbf) => Some(planes.rbf(rbf).map_err(of("rbf-cubic"))?),
    };
    let hermite = match header.hermite {
        None => None,
        Some(refs) => {
            let row = planes.get(refs.row).map_err(of("hermite row"))?;
            let nodes: &[Node] = planes.get(refs.nodes).map_err(of("hermite nodes"))?;
            let table = HermiteTable::new(lattice.slots(), row, nodes);
            let table = table.map_err(|error| of("hermite nodes")(error.into()))?;
            if !table.node(rest).is_some_and(is_at_rest) {
                return Err(BlobError::RestPoint { space });
            }
            Some(table)
        }
    };
    let displacement = match header.displacement {
        None => None,
        Some(refs) => {
            let refs = DisplacementPlanes {
                slopes: refs.slopes as usize,
                row: planes.get(refs.row).map_err(of("displacement row"))?,
                modes: planes.get(refs.modes).map_err(of("displacement modes"))?,
                scale: planes.get(refs.scale).map_err(of("displacement scale"))?,
                coefficients: planes.get(refs.coefficients).map_err(of("displacement coefficients"))?,
                outlier_row: planes.get(refs.outlier_row).map_err(of("displacement outlier row"))?,
                outlier_scale: planes.get(refs.outlier_scale).map_err(of("displacement outlier scale"))?,
                outliers: planes.get(refs.outliers).map_err(of("displacement outliers"))?,
            };
            let table = DisplacementTable::new(&lattice, refs, vertices);
            Some(table.map_err(|found| of(found.plane)(found.error.into()))?)
        }
    };
    let SpaceHeader { name, node, rest_position_m, outward_normal, .. } = header;
    Ok(Space {
        name,
        node,
        rest_position_m,
        outward_normal,
        lattice,
        flags,
        lattice_table,
        rbf_linear,
        rbf_cubic,
        hermite,
        // In a part of the header of its own.
        kernel: None,
        displacement,
    })
}

fn read_kernel<'a>(
    planes: &Planes<'a>,
    header: KernelHeader,
    of_space: &Space<'a>,
    space: u16,
    limits: &Limits,
) -> Result<KernelTable<'a>, BlobError> {
    let of = |what| named(what, Some(space));
    let centres = (header.blocks.len as usize).saturating_mul(LANES);
    check_capacity("kernel centres", Some(space), centres, limits.centres.min(MOST_CENTRES))?;
    let scalars: &[f64] = planes.get(header.scalars).map_err(of("kernel scalars"))?;
    let blocks: &[Block] = planes.get(header.blocks).map_err(of("kernel blocks"))?;
    let reach: &[u8] = planes.get(header.reach).map_err(of("kernel reach"))?;
    KernelTable::new(of_space.lattice.radius_m(), scalars, blocks, reach)
        .map_err(|error| of("kernel")(error.into()))
}

/// Whether a node has neither energy nor force.
fn is_at_rest([[[w, wz, ..], [wy, ..], _], [[wx, ..], ..], _]: &Node) -> bool {
    [w, wx, wy, wz].iter().all(|value| **value == 0.0)
}

fn check_vector(vector: Vec3) -> Option<()> {
    vec3::is_finite(vector).then_some(())
}
