//! One configuration space: an active node, the grid of its displacements, and the tables of the packed
//! methods.
//!
//! Tables are checked views of planes: lengths, indices and values are verified when the space is built, so a
//! query can neither fail nor return a number that is not finite.

use heapless::String;

use crate::displacement::{DisplacementPlanes, DisplacementTable};
use crate::grid::BallLattice;
use crate::grid::flags::{self, SOLVED};
use crate::method::baseline::rbf::{RbfCubic, RbfLinear, RbfPlanes, RbfTable};
use crate::method::baseline::{Forces, Hybrid, Tricubic, Trilinear};
use crate::method::energy::Energy;
use crate::method::hermite::{Hermite, HermitePlanes, HermiteTable};
use crate::method::kernel::{Kernel, KernelPlanes, KernelTable};
use crate::method::{self, Ball, Estimate, ForceSample, Interpolant, Method};
use crate::num::lanes::{Baseline, Machine};
use crate::num::vec3::{self, Vec3};
use crate::plane::{PlaneError, PlaneProblem, check_finite, check_len};

/// Longest name of an active node, bytes.
pub const SPACE_NAME_LEN: usize = 32;

/// The node of the mesh that the tool holds.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ActiveNode {
    /// Name in the scene.
    pub name: String<SPACE_NAME_LEN>,
    /// Mesh node, 0-based in the order of the file.
    pub node: u32,
    /// Position at rest, model frame, metres.
    pub rest_position_m: Vec3,
    /// Unit normal of the surface at the node, pointing out of the body.
    pub outward_normal: Vec3,
}

/// Planes of one space. All planes except the flags are optional: each belongs to a method or to the
/// pictures.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SpacePlanes<'a> {
    /// One byte per slot of the box, see [`crate::flags`].
    pub flags: &'a [u8],
    /// For `trilinear`, `tricubic` and `hybrid`: h at each slot of the box, newtons; zero at rest.
    pub force_n: Option<&'a [Vec3]>,
    /// For `rbf-linear`.
    pub rbf_linear: Option<RbfPlanes<'a, f32>>,
    /// For `rbf-cubic`.
    pub rbf_cubic: Option<RbfPlanes<'a, f64>>,
    /// For `hermite` and `energy`.
    pub hermite: Option<HermitePlanes<'a>>,
    /// For `kernel`.
    pub kernel: Option<KernelPlanes<'a>>,
    /// For the pictures.
    pub displacement: Option<DisplacementPlanes<'a>>,
}

/// An active node with its configuration space.
#[derive(Debug, Clone, PartialEq)]
pub struct Space<'a> {
    active: ActiveNode,
    lattice: BallLattice,
    flags: &'a [u8],
    force_n: Option<&'a [Vec3]>,
    rbf_linear: Option<RbfTable<'a, f32>>,
    rbf_cubic: Option<RbfTable<'a, f64>>,
    hermite: Option<HermiteTable<'a>>,
    kernel: Option<KernelTable<'a>>,
    displacement: Option<DisplacementTable<'a>>,
}

impl<'a> Space<'a> {
    /// Checks the planes. `vertices` is the number of surface vertices that the displacements refer to.
    ///
    /// Errors: [`PlaneError`] with the name of the first plane that does not fit the lattice or the other
    /// planes, or has values that are not finite. The active node is not checked.
    pub fn new(
        active: ActiveNode,
        lattice: BallLattice,
        planes: SpacePlanes<'a>,
        vertices: usize,
    ) -> Result<Self, PlaneError> {
        let SpacePlanes { flags, force_n, rbf_linear, rbf_cubic, hermite, kernel, displacement } = planes;
        let rest = lattice.rest_slot();
        check_len("flags", flags, lattice.slots())?;
        if let Some(slot) = flags::first_inconsistent(&lattice, flags) {
            return Err(PlaneProblem::Flags { slot }.of("flags"));
        }
        if flags.get(rest).is_none_or(|bits| bits & SOLVED == 0) {
            return Err(PlaneProblem::RestPoint.of("flags"));
        }
        if let Some(force_n) = force_n {
            check_len("force", force_n, lattice.slots())?;
            check_finite("force", force_n.as_flattened())?;
            if force_n.get(rest).is_none_or(|force_n| *force_n != vec3::ZERO) {
                return Err(PlaneProblem::RestPoint.of("force"));
            }
        }
        Ok(Self {
            active,
            lattice,
            flags,
            force_n,
            rbf_linear: rbf_linear.map(|planes| RbfTable::new("rbf-linear", planes)).transpose()?,
            rbf_cubic: rbf_cubic.map(|planes| RbfTable::new("rbf-cubic", planes)).transpose()?,
            hermite: hermite.map(|planes| HermiteTable::new(&lattice, planes)).transpose()?,
            kernel: kernel.map(|planes| KernelTable::new(lattice.radius_m(), planes)).transpose()?,
            displacement: displacement
                .map(|planes| DisplacementTable::new(&lattice, planes, vertices))
                .transpose()?,
        })
    }

    /// The active node.
    pub const fn active(&self) -> &ActiveNode {
        &self.active
    }

    /// The active node, to be moved or renamed.
    pub const fn active_mut(&mut self) -> &mut ActiveNode {
        &mut self.active
    }

    /// The grid of displacements.
    pub const fn lattice(&self) -> &BallLattice {
        &self.lattice
    }

    /// One byte per slot of the box, see [`crate::flags`].
    pub const fn flags(&self) -> &'a [u8] {
        self.flags
    }

    /// The table of the method `kernel`.
    pub const fn kernel(&self) -> Option<&KernelTable<'a>> {
        self.kernel.as_ref()
    }

    /// The table of the surface displacements.
    pub const fn displacement(&self) -> Option<&DisplacementTable<'a>> {
        self.displacement.as_ref()
    }

    /// All planes, for example for a reference evaluation.
    pub fn planes(&self) -> SpacePlanes<'a> {
        SpacePlanes {
            flags: self.flags,
            force_n: self.force_n,
            rbf_linear: self.rbf_linear.as_ref().map(RbfTable::planes),
            rbf_cubic: self.rbf_cubic.as_ref().map(RbfTable::planes),
            hermite: self.hermite.as_ref().map(HermiteTable::planes),
            kernel: self.kernel.as_ref().map(KernelTable::planes),
            displacement: self.displacement.as_ref().map(|table| *table.planes()),
        }
    }

    /// Whether the planes of a method are present.
    pub fn has(&self, method: Method) -> bool {
        self.ask(method, IsPresent).is_some()
    }

    /// Reaction force h at a displacement of the active node, metres in and newtons out.
    ///
    /// `None` only if the planes of the method are absent. Outside the domain of the method the force is
    /// continued from the rim. A displacement that is not finite gives the force at rest. Both are
    /// `Extrapolated`.
    pub fn force(&self, method: Method, displacement_m: Vec3) -> Option<ForceSample> {
        self.force_on(Baseline, method, displacement_m)
    }

    /// [`Space::force`] with the instructions of a machine, inlined into the caller. The bits are the same.
    #[inline(always)]
    pub fn force_on<M: Machine>(
        &self,
        machine: M,
        method: Method,
        displacement_m: Vec3,
    ) -> Option<ForceSample> {
        match self.ask(method, Inside { machine, displacement_m: &displacement_m })? {
            Ok(sample) => Some(sample),
            // Passed as components, because an array would have to be in memory.
            Err([x, y, z]) => self.force_outside(method, x, y, z),
        }
    }

    /// Not inlined, so that the common path of the tick is short.
    #[cold]
    #[inline(never)]
    fn force_outside(&self, method: Method, x: f32, y: f32, z: f32) -> Option<ForceSample> {
        self.ask(method, Outside { displacement_m: [x, y, z] })
    }

    /// Force with stiffness, and with energy where the force is its gradient. `None` as for [`Space::force`].
    ///
    /// Costs a few times as much as the force alone; not for the tick.
    pub fn estimate(&self, method: Method, displacement_m: Vec3) -> Option<Estimate> {
        self.ask(method, Everything { displacement_m })
    }

    /// Surface displacement at a displacement of the active node, see
    /// [`DisplacementTable::displacement_into`].
    ///
    /// Returns false, and sets `out` to zero, where the space has no surface displacements.
    pub fn displacement_into(&self, displacement_m: Vec3, out: &mut [Vec3]) -> bool {
        match &self.displacement {
            Some(table) => table.displacement_into(&self.lattice, self.flags, displacement_m, out),
            None => out.fill(vec3::ZERO),
        }
        self.displacement.is_some()
    }

    /// Evaluates a query with the interpolant of a method; `None` if its planes are absent.
    #[inline(always)]
    fn ask<Q: Question>(&self, method: Method, question: Q) -> Option<Q::Answer> {
        let ball = Ball { lattice: &self.lattice, flags: self.flags };
        let forces = || self.force_n.map(|force_n| Forces { ball, force_n });
        Some(match method {
            Method::Trilinear => question.of(Trilinear(forces()?)),
            Method::Tricubic => question.of(Tricubic(forces()?)),
            Method::Hybrid => question.of(Hybrid(forces()?)),
            Method::RbfLinear => question.of(RbfLinear { ball, table: self.rbf_linear.as_ref()? }),
            Method::RbfCubic => question.of(RbfCubic { ball, table: self.rbf_cubic.as_ref()? }),
            Method::Hermite => question.of(Hermite { ball, table: self.hermite.as_ref()? }),
            Method::Energy => question.of(Energy { ball, table: self.hermite.as_ref()? }),
            Method::Kernel => {
                question.of(Kernel { table: self.kernel.as_ref()?, spacing_m: self.lattice.spacing_m() })
            }
        })
    }
}

/// A query to the interpolant of any method: a closure that is generic in the interpolant.
trait Question {
    type Answer;
    fn of<I: Interpolant>(self, method: I) -> Self::Answer;
}

struct IsPresent;

impl Question for IsPresent {
    type Answer = ();

    fn of<I: Interpolant>(self, _: I) {}
}

struct Inside<'d, M> {
    machine: M,
    displacement_m: &'d Vec3,
}

impl<M: Machine> Question for Inside<'_, M> {
    type Answer = Result<ForceSample, Vec3>;

    #[inline(always)]
    fn of<I: Interpolant>(self, method: I) -> Self::Answer {
        method::force_inside(method, self.machine, self.displacement_m)
    }
}

struct Outside {
    displacement_m: Vec3,
}

impl Question for Outside {
    type Answer = ForceSample;

    fn of<I: Interpolant>(self, method: I) -> ForceSample {
        method::force_outside(method, self.displacement_m)
    }
}

struct Everything {
    displacement_m: Vec3,
}

impl Question for Everything {
    type Answer = Estimate;

    fn of<I: Interpolant>(self, method: I) -> Estimate {
        method::estimate(method, self.displacement_m)
    }
}
