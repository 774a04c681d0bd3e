//! One configuration space: an active node, the grid of its displacements, and the tables of the packed
//! methods.
//!
//! Tables are checked views of planes: lengths, indices and values are verified when the space is built, so a
//! query can neither fail nor return a number that is not finite.

use heapless::String;

use crate::displacement::{DisplacementPlanes, DisplacementTable};
use crate::grid::BallLattice;
use crate::grid::flags::{Ball, SOLVED, first_inconsistent};
use crate::method::baseline::rbf::{Rbf, RbfPlanes};
use crate::method::baseline::{Hybrid, Tricubic, Trilinear};
use crate::method::energy::Energy;
use crate::method::hermite::{Hermite, HermitePlanes};
use crate::method::interpolant;
use crate::method::kernel::{Kernel, KernelPlanes, KernelTable};
use crate::method::root::{Known, Root};
use crate::method::{Estimate, ForceSample, Method};
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
    /// Whether that table holds s = sqrt(2 W) of a sphere, for `energy` alone.
    pub is_root: bool,
    /// For `kernel`.
    pub kernel: Option<KernelPlanes<'a>>,
    /// For the pictures.
    pub displacement: Option<DisplacementPlanes<'a>>,
}

/// An active node with its configuration space.
#[derive(Debug, Clone, PartialEq)]
pub struct Space<'a> {
    /// The active node.
    pub active: ActiveNode,
    lattice: BallLattice,
    flags: &'a [u8],
    force_n: Option<&'a [Vec3]>,
    rbf_linear: Option<RbfPlanes<'a, f32>>,
    rbf_cubic: Option<RbfPlanes<'a, f64>>,
    hermite: Option<HermitePlanes<'a>>,
    is_root: bool,
    kernel: Option<KernelTable<'a>>,
    displacement: Option<DisplacementTable<'a>>,
}

/// Evaluates an expression with the interpolant of a method and its domain; returns `None` from the function
/// if the planes of the method are absent.
macro_rules! with_interpolant {
    ($space:expr, $method:expr, |$interpolant:ident, $domain:ident| $answer:expr) => {{
        let Space { lattice, flags, force_n, rbf_linear, rbf_cubic, hermite, is_root, kernel, .. } = $space;
        let $domain = Ball { lattice, flags };
        match $method {
            Method::Trilinear => {
                let $interpolant = Trilinear((*force_n)?);
                $answer
            }
            Method::Tricubic => {
                let $interpolant = Tricubic((*force_n)?);
                $answer
            }
            Method::Hybrid => {
                let $interpolant = Hybrid((*force_n)?);
                $answer
            }
            Method::RbfLinear => {
                let $interpolant = Rbf(rbf_linear.as_ref()?);
                $answer
            }
            Method::RbfCubic => {
                let $interpolant = Rbf(rbf_cubic.as_ref()?);
                $answer
            }
            Method::Hermite if *is_root => return None,
            Method::Energy if *is_root => {
                let ($interpolant, $domain) = (Root(Hermite(hermite.as_ref()?)), Known($domain));
                $answer
            }
            Method::Hermite => {
                let $interpolant = Hermite(hermite.as_ref()?);
                $answer
            }
            Method::Energy => {
                let $interpolant = Energy(Hermite(hermite.as_ref()?));
                $answer
            }
            Method::Kernel => {
                let $interpolant = Kernel { table: kernel.as_ref()?, spacing_m: lattice.spacing_m() };
                let $domain = $interpolant;
                $answer
            }
        }
    }};
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
        let SpacePlanes { flags, force_n, rbf_linear, rbf_cubic, hermite, is_root, .. } = planes;
        let rest = lattice.rest_slot();
        check_len("flags", flags, lattice.slots())?;
        if let Some(slot) = first_inconsistent(&lattice, flags) {
            return Err(PlaneProblem::Flags { slot }.of("flags"));
        }
        if !is_root && flags.get(rest).is_none_or(|bits| bits & SOLVED == 0) {
            return Err(PlaneProblem::RestPoint.of("flags"));
        }
        if let Some(force_n) = force_n {
            check_len("force", force_n, lattice.slots())?;
            check_finite("force", force_n.as_flattened())?;
            if force_n.get(rest).is_none_or(|force_n| *force_n != vec3::ZERO) {
                return Err(PlaneProblem::RestPoint.of("force"));
            }
        }
        if let Some(rbf) = &rbf_linear {
            rbf.check("rbf-linear")?;
        }
        if let Some(rbf) = &rbf_cubic {
            rbf.check("rbf-cubic")?;
        }
        if let Some(hermite) = &hermite {
            hermite.check(&lattice)?;
            if !is_root {
                hermite.check_rest(&lattice)?;
            }
        }
        let kernel = planes.kernel.map(|kernel| KernelTable::new(lattice.radius_m(), kernel)).transpose()?;
        let displacement =
            planes.displacement.map(|of| DisplacementTable::new(&lattice, of, vertices)).transpose()?;
        Ok(Self {
            active,
            lattice,
            flags,
            force_n,
            rbf_linear,
            rbf_cubic,
            hermite,
            is_root,
            kernel,
            displacement,
        })
    }

    /// The grid of displacements.
    pub const fn lattice(&self) -> &BallLattice {
        &self.lattice
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
        let Self { flags, force_n, rbf_linear, rbf_cubic, hermite, is_root, .. } = *self;
        let kernel = self.kernel.as_ref().map(KernelTable::planes);
        let displacement = self.displacement.as_ref().map(|table| *table.planes());
        SpacePlanes { flags, force_n, rbf_linear, rbf_cubic, hermite, is_root, kernel, displacement }
    }

    /// Whether the planes of a method are present.
    pub fn has(&self, method: Method) -> bool {
        (|| Some(with_interpolant!(self, method, |_interpolant, _domain| true)))().is_some()
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
        let d = &displacement_m;
        let inside = with_interpolant!(self, method, |h, of| interpolant::force_inside(h, of, machine, d));
        match inside {
            Ok(sample) => Some(sample),
            // Passed as components, because an array would have to be in memory.
            Err([x, y, z]) => self.force_outside(method, x, y, z),
        }
    }

    /// Not inlined, so that the common path of the tick is short.
    #[cold]
    #[inline(never)]
    fn force_outside(&self, method: Method, x: f32, y: f32, z: f32) -> Option<ForceSample> {
        Some(with_interpolant!(self, method, |h, of| interpolant::force_outside(h, of, [x, y, z])))
    }

    /// W at a displacement of the active node, joules, where the force is its gradient: `energy` away from
    /// folds, and `kernel`. Outside the domain it is continued along the ray from rest. Costs about as much as
    /// the force.
    pub fn energy_j(&self, method: Method, displacement_m: Vec3) -> Option<f32> {
        with_interpolant!(self, method, |h, of| interpolant::energy_j(h, of, &displacement_m))
    }

    /// Force with stiffness, and with energy where the force is its gradient. `None` as for [`Space::force`].
    ///
    /// Costs a few times as much as the force alone; not for the tick.
    pub fn estimate(&self, method: Method, displacement_m: Vec3) -> Option<Estimate> {
        Some(with_interpolant!(self, method, |h, of| interpolant::estimate(h, of, displacement_m)))
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
}
