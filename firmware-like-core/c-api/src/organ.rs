//! Organs: opening a blob, and queries of the force, stiffness and surface of a space.

use core::ffi::c_char;
use core::mem::MaybeUninit;

use palpate_core::{Coverage, Limits, Method, Organ, Space, Vec3};

use crate::memory;
use crate::status::{PalpateProblem, PalpateStatus};

const IS_SMALL: bool = cfg!(feature = "microcontroller");

/// The largest number of spaces: that of a PC, or with the feature `microcontroller` that of a
/// microcontroller.
pub(crate) const SPACES: usize = LIMITS.spaces;

/// The largest tables that are accepted.
const LIMITS: Limits = if IS_SMALL { Limits::MICROCONTROLLER } else { Limits::PC };

/// Required alignment of the memory for organs and controllers, bytes.
pub const PALPATE_ALIGNMENT: usize = 16;

/// Longest name with its final zero, bytes.
pub const PALPATE_NAME_LEN: usize = 72;

/// An opened blob, in memory of the caller. Opaque: only this library accesses its contents.
#[derive(Debug)]
pub struct PalpateOrgan {
    pub(crate) organ: Organ<'static, SPACES>,
}

const _: () = assert!(align_of::<PalpateOrgan>() <= PALPATE_ALIGNMENT);

/// Interpolation method for the reaction force.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PalpateMethod {
    /// Eight corners of the cell.
    Trilinear = 0,
    /// Catmull-Rom on the 64 points round the cell; C1.
    Tricubic = 1,
    /// Tri-cubic where all 64 points are solved, tri-linear elsewhere.
    Hybrid = 2,
    /// Radial basis functions, phi = r.
    RbfLinear = 3,
    /// Radial basis functions, phi = r^3.
    RbfCubic = 4,
    /// Cubic Hermite on each force component; C1.
    Hermite = 5,
    /// Gradient of the quintic Hermite interpolant of the energy; C1, conservative. The most accurate and
    /// recommended method.
    Energy = 6,
    /// Gradient of the sum of Gaussians fitted to the energy; smooth, conservative. The smallest table, from
    /// few scattered configurations; evaluated in f64.
    Kernel = 7,
}

/// The method with a number of [`PalpateMethod`].
pub(crate) fn method(number: u32) -> Option<Method> {
    Method::ALL.get(usize::try_from(number).ok()?).copied()
}

/// The data behind a force.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PalpateCoverage {
    /// No contact and no force.
    None = 0,
    /// All eight corners of the cell are solved configurations.
    Cell = 1,
    /// All 64 points round the cell are solved configurations.
    SuperCell = 2,
    /// A scattered-data method inside its domain.
    Scattered = 3,
    /// Data is missing: an unsolved corner, or a position outside the domain. The force is continued without
    /// a jump.
    Extrapolated = 4,
}

impl From<Option<Coverage>> for PalpateCoverage {
    fn from(coverage: Option<Coverage>) -> Self {
        match coverage {
            None => Self::None,
            Some(Coverage::Cell) => Self::Cell,
            Some(Coverage::SuperCell) => Self::SuperCell,
            Some(Coverage::Scattered) => Self::Scattered,
            Some(Coverage::Extrapolated) => Self::Extrapolated,
        }
    }
}

/// Properties of an organ.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct PalpateOrganInfo {
    /// Name of the scene, a C string.
    pub scene: [c_char; PALPATE_NAME_LEN],
    /// Name of the material law, a C string.
    pub law: [c_char; PALPATE_NAME_LEN],
    /// Largest force of the device that the scene was made for, N; infinite without a device.
    pub max_force_n: f32,
    /// Number of spaces (active nodes).
    pub spaces: u32,
    /// Vertices of the surface.
    pub vertices: u32,
    /// Triangles of the surface.
    pub triangles: u32,
    /// Whether the blob has a certificate of its measured accuracy. Do not render a blob without one on a
    /// real device.
    pub certified: bool,
}

/// An active node and the grid of its displacements.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct PalpateSpaceInfo {
    /// Name in the scene, a C string.
    pub name: [c_char; PALPATE_NAME_LEN],
    /// Node of the mesh, 0-based.
    pub node: u32,
    /// Bit m is set if the space has a table for the method of number m.
    pub methods: u32,
    /// Position of the node at rest, model frame, m.
    pub rest_position_m: [f32; 3],
    /// Unit outward normal of the surface at the node.
    pub outward_normal: [f32; 3],
    /// Distance of neighbouring grid points, m.
    pub spacing_m: f32,
    /// Radius of the ball of displacements, m.
    pub radius_m: f32,
    /// Whether the space has surface displacements for pictures.
    pub displacements: bool,
}

/// Reaction force at a displacement of the active node.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct PalpateForce {
    /// h, the force by the tool on the body, N.
    pub reaction_n: [f32; 3],
    /// The data behind the force.
    pub coverage: PalpateCoverage,
}

/// Force with stiffness and energy.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct PalpateEstimate {
    /// h, the force by the tool on the body, N.
    pub reaction_n: [f32; 3],
    /// dh_i/dd_j as rows i, N/m.
    pub stiffness_n_m: [[f32; 3]; 3],
    /// W, J; valid if `has_energy` is set.
    pub energy_j: f32,
    /// Whether the force is the gradient of an energy at this displacement.
    pub has_energy: bool,
    /// The data behind the force.
    pub coverage: PalpateCoverage,
}

/// The surface at rest, as pointers into the blob.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct PalpateSurface {
    /// x of each vertex, model frame, m.
    pub x_m: *const f32,
    /// y of each vertex.
    pub y_m: *const f32,
    /// z of each vertex.
    pub z_m: *const f32,
    /// Three vertices per triangle, counter-clockwise seen from outside.
    pub triangles: *const [u32; 3],
    /// 1 where the vertex is fixed, else 0.
    pub fixed: *const u8,
    /// Number of vertices.
    pub vertices: u32,
    /// Number of triangles.
    pub triangle_count: u32,
}

/// Number of bytes of memory that an organ needs.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_organ_size() -> usize {
    size_of::<PalpateOrgan>()
}

/// Verifies a blob and opens it in place.
///
/// `memory` has at least palpate_organ_size() bytes, aligned to PALPATE_ALIGNMENT; the blob starts at an
/// address divisible by 8. Both must exist, and the blob must not change, as long as the organ is used.
/// `problem` may be null. For start-up, not for the haptic loop: every byte of the blob is read.
///
/// # Safety
///
/// Each pointer that is not null is valid for the number of bytes given with it, and only this library
/// changes `memory` afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn palpate_organ_open(
    memory: *mut u8,
    memory_len: usize,
    blob: *const u8,
    blob_len: usize,
    organ: Option<&mut MaybeUninit<*const PalpateOrgan>>,
    problem: Option<&mut MaybeUninit<PalpateProblem>>,
) -> PalpateStatus {
    // SAFETY: the caller has the same obligation.
    let opened = unsafe { open(memory, memory_len, blob, blob_len) };
    let handle = opened.as_ref().map_or(core::ptr::null(), |opened| core::ptr::from_ref(*opened));
    match organ {
        Some(organ) => {
            organ.write(handle);
            told(opened, problem)
        }
        None => told(Err::<(), _>(PalpateProblem::of(PalpateStatus::NullArgument)), problem),
    }
}

unsafe fn open(
    memory: *mut u8,
    memory_len: usize,
    blob: *const u8,
    blob_len: usize,
) -> Result<&'static PalpateOrgan, PalpateProblem> {
    let too_small = PalpateProblem::of(PalpateStatus::Memory);
    // SAFETY: the caller's obligation.
    let blob =
        unsafe { memory::bytes(blob, blob_len) }.ok_or(PalpateProblem::of(PalpateStatus::NullArgument))?;
    // In place, because an organ is large for the stack.
    // SAFETY: the caller's obligation.
    let opened = unsafe { memory::place(memory, memory_len, PalpateOrgan { organ: Organ::empty() }) }
        .ok_or(too_small)?;
    opened.organ.load(blob, &LIMITS)?;
    Ok(opened)
}

/// The status of a result; writes the problem if the caller asks for it.
pub(crate) fn told<T>(
    result: Result<T, PalpateProblem>,
    problem: Option<&mut MaybeUninit<PalpateProblem>>,
) -> PalpateStatus {
    let told = result.err().unwrap_or(PalpateProblem::of(PalpateStatus::Ok));
    if let Some(problem) = problem {
        problem.write(told);
    }
    told.status
}

/// Writes the properties of an organ.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_organ_info(
    organ: Option<&PalpateOrgan>,
    info: Option<&mut MaybeUninit<PalpateOrganInfo>>,
) -> PalpateStatus {
    let (Some(PalpateOrgan { organ }), Some(info)) = (organ, info) else {
        return PalpateStatus::NullArgument;
    };
    info.write(PalpateOrganInfo {
        scene: c_string(&organ.scene),
        law: c_string(&organ.law),
        max_force_n: organ.max_force_n,
        spaces: organ.spaces.len() as u32,
        vertices: organ.surface.node.len() as u32,
        triangles: organ.surface.triangles.len() as u32,
        certified: organ.certificate.is_some(),
    });
    PalpateStatus::Ok
}

fn c_string(text: &str) -> [c_char; PALPATE_NAME_LEN] {
    let mut name = [0; PALPATE_NAME_LEN];
    // One byte less than the length: the last byte stays zero.
    for (to, byte) in name.iter_mut().zip(text.bytes().take(PALPATE_NAME_LEN.saturating_sub(1))) {
        *to = byte as c_char;
    }
    name
}

/// Writes the properties of a space.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_space_info(
    organ: Option<&PalpateOrgan>,
    space: u32,
    info: Option<&mut MaybeUninit<PalpateSpaceInfo>>,
) -> PalpateStatus {
    let (Some(organ), Some(info)) = (organ, info) else { return PalpateStatus::NullArgument };
    let Some(space) = organ.space(space) else { return PalpateStatus::NoSuchSpace };
    let mut methods = 0;
    for (number, method) in (0_u32..).zip(Method::ALL) {
        methods |= u32::from(space.has(method)).wrapping_shl(number);
    }
    let active = &space.active;
    info.write(PalpateSpaceInfo {
        name: c_string(&active.name),
        node: active.node,
        methods,
        rest_position_m: active.rest_position_m,
        outward_normal: active.outward_normal,
        spacing_m: space.lattice().spacing_m(),
        radius_m: space.lattice().radius_m(),
        displacements: space.displacement().is_some(),
    });
    PalpateStatus::Ok
}

impl PalpateOrgan {
    fn space(&self, number: u32) -> Option<&Space<'static>> {
        self.organ.spaces.get(usize::try_from(number).ok()?)
    }
}

/// Reaction force of a space at a displacement of its node, m. Every displacement has an answer; a call that
/// fails writes zero.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_force(
    organ: Option<&PalpateOrgan>,
    space: u32,
    method_number: u32,
    displacement_m: Option<&[f32; 3]>,
    force: Option<&mut MaybeUninit<PalpateForce>>,
) -> PalpateStatus {
    let answer = asked(organ, space, method_number, displacement_m)
        .and_then(|(space, method, at_m)| space.force(method, at_m).ok_or(PalpateStatus::MissingMethod));
    let (status, reaction_n, coverage) = match answer {
        Ok(answer) => (PalpateStatus::Ok, answer.force_n, Some(answer.coverage)),
        Err(status) => (status, [0.0; 3], None),
    };
    let Some(force) = force else { return PalpateStatus::NullArgument };
    force.write(PalpateForce { reaction_n, coverage: coverage.into() });
    status
}

/// Force, stiffness and energy of a space at a displacement of its node, m. Costs a few times as much as
/// palpate_force.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_estimate(
    organ: Option<&PalpateOrgan>,
    space: u32,
    method_number: u32,
    displacement_m: Option<&[f32; 3]>,
    estimate: Option<&mut MaybeUninit<PalpateEstimate>>,
) -> PalpateStatus {
    let answer = asked(organ, space, method_number, displacement_m)
        .and_then(|(space, method, at_m)| space.estimate(method, at_m).ok_or(PalpateStatus::MissingMethod));
    let (status, told) = match answer {
        Ok(answer) => (
            PalpateStatus::Ok,
            PalpateEstimate {
                reaction_n: answer.force_n,
                stiffness_n_m: answer.stiffness_n_m,
                energy_j: answer.energy_j.unwrap_or(0.0),
                has_energy: answer.energy_j.is_some(),
                coverage: Some(answer.coverage).into(),
            },
        ),
        Err(status) => (
            status,
            PalpateEstimate {
                reaction_n: [0.0; 3],
                stiffness_n_m: [[0.0; 3]; 3],
                energy_j: 0.0,
                has_energy: false,
                coverage: PalpateCoverage::None,
            },
        ),
    };
    let Some(estimate) = estimate else { return PalpateStatus::NullArgument };
    estimate.write(told);
    status
}

fn asked<'o>(
    organ: Option<&'o PalpateOrgan>,
    space: u32,
    number: u32,
    displacement_m: Option<&[f32; 3]>,
) -> Result<(&'o Space<'static>, Method, Vec3), PalpateStatus> {
    let (Some(organ), Some(displacement_m)) = (organ, displacement_m) else {
        return Err(PalpateStatus::NullArgument);
    };
    let space = organ.space(space).ok_or(PalpateStatus::NoSuchSpace)?;
    let method = method(number).ok_or(PalpateStatus::NoSuchMethod)?;
    Ok((space, method, *displacement_m))
}

/// Writes pointers to the surface at rest, which lies in the blob.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_surface(
    organ: Option<&PalpateOrgan>,
    surface: Option<&mut MaybeUninit<PalpateSurface>>,
) -> PalpateStatus {
    let (Some(PalpateOrgan { organ }), Some(surface)) = (organ, surface) else {
        return PalpateStatus::NullArgument;
    };
    let palpate_core::Surface { node, position_m: [x, y, z], triangles, fixed } = organ.surface;
    surface.write(PalpateSurface {
        x_m: x.as_ptr(),
        y_m: y.as_ptr(),
        z_m: z.as_ptr(),
        triangles: triangles.as_ptr(),
        fixed: fixed.as_ptr(),
        vertices: node.len() as u32,
        triangle_count: triangles.len() as u32,
    });
    PalpateStatus::Ok
}

/// Displacement of each vertex of the surface, m, at a displacement of the node of a space, m.
///
/// For pictures at 30 Hz. `out_m` has room for `vertices` points; a call that fails sets them to zero.
///
/// # Safety
///
/// If `out_m` is not null, `vertices` points may be written there.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn palpate_displacements(
    organ: Option<&PalpateOrgan>,
    space: u32,
    displacement_m: Option<&[f32; 3]>,
    out_m: *mut [f32; 3],
    vertices: usize,
) -> PalpateStatus {
    // SAFETY: the caller's obligation.
    let Some(out_m) = (unsafe { memory::points(out_m, vertices) }) else {
        return PalpateStatus::NullArgument;
    };
    let (Some(organ), Some(displacement_m)) = (organ, displacement_m) else {
        return PalpateStatus::NullArgument;
    };
    let Some(space) = organ.space(space) else { return PalpateStatus::NoSuchSpace };
    if space.displacement_into(*displacement_m, out_m) {
        PalpateStatus::Ok
    } else {
        PalpateStatus::NoDisplacements
    }
}
