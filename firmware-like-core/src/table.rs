//! One configuration space as the tick sees it: lattice, flags and the tables that were packed.
//!
//! Every table is a checked view of planes in the blob: lengths, indices and values are proven when it is built, so a
//! query cannot fail. A constructor that refuses returns the reason; the tick then never asks again.

use heapless::String;

use crate::blend;
use crate::continuation;
use crate::displacement::DisplacementTable;
use crate::flags::{CELL, SUPERCELL};
use crate::grid::{BallLattice, Location};
use crate::hermite::HermiteTable;
use crate::kernel::KernelTable;
use crate::lanes::{Baseline, Machine};
use crate::method::{Coverage, Estimate, ForceSample, Method};
use crate::rbf::RbfTable;
use crate::tricubic;
use crate::trilinear;
use crate::vec3::{self, Vec3};

/// Longest name of an active node, bytes.
pub const SPACE_NAME_LEN: usize = 32;

/// Why a set of planes is no table on this lattice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TableError {
    /// A plane has another length than the lattice or the vertex count asks for.
    Length {
        /// Elements found.
        have: usize,
        /// Elements needed.
        need: usize,
    },
    /// A value is NaN, infinite or beyond [`LARGEST_VALUE`].
    NotFinite {
        /// Element in its plane.
        index: usize,
    },
    /// An index points beyond what it indexes.
    OutOfRange {
        /// Element in its plane.
        index: usize,
    },
    /// An index is not larger than the one before it.
    Order {
        /// Element in its plane.
        index: usize,
    },
}

impl core::fmt::Display for TableError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Length { have, need } => write!(f, "a plane holds {have} elements where {need} are needed"),
            Self::NotFinite { index } => write!(f, "element {index} is NaN, infinite or absurdly large"),
            Self::OutOfRange { index } => write!(f, "element {index} points out of range"),
            Self::Order { index } => write!(f, "element {index} is not larger than the one before it"),
        }
    }
}

impl core::error::Error for TableError {}

pub(crate) fn check_len<T>(plane: &[T], need: usize) -> Result<(), TableError> {
    if plane.len() == need { Ok(()) } else { Err(TableError::Length { have: plane.len(), need }) }
}

/// Largest value a table may hold, newtons or metres: absurd, but its interpolation cannot overflow.
pub const LARGEST_VALUE: f32 = 1e9;

pub(crate) fn check_finite(plane: &[f32]) -> Result<(), TableError> {
    match plane.iter().position(|value| value.is_nan() || value.abs() > LARGEST_VALUE) {
        None => Ok(()),
        Some(index) => Err(TableError::NotFinite { index }),
    }
}

/// Reaction force on every slot of the box: solved configurations, and ghosts where there is none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LatticeTable<'a> {
    force: &'a [Vec3],
}

impl<'a> LatticeTable<'a> {
    /// Checks that the planes (x, y, z in newtons) cover the box and are finite.
    pub fn new(lattice: &BallLattice, force: &'a [Vec3]) -> Result<Self, TableError> {
        check_len(force, lattice.slots())?;
        check_finite(force.as_flattened())?;
        Ok(Self { force })
    }

    /// The planes x, y, z, one value per slot, newtons.
    pub const fn force_n(&self) -> &'a [Vec3] {
        self.force
    }
}

/// One active node with its configuration space.
#[derive(Debug, Clone, PartialEq)]
pub struct Space<'a> {
    /// Name of the active node in the scene.
    pub name: String<SPACE_NAME_LEN>,
    /// Mesh node, 0-based file order.
    pub node: u32,
    /// Position of the node at rest, model frame, metres.
    pub rest_position_m: Vec3,
    /// Unit normal of the surface at the node, out of the body.
    pub outward_normal: Vec3,
    /// The grid of displacements.
    pub lattice: BallLattice,
    /// One byte per slot of the box, see [`crate::flags`].
    pub flags: &'a [u8],
    /// For trilinear, tricubic and hybrid.
    pub lattice_table: Option<LatticeTable<'a>>,
    /// For rbf-linear.
    pub rbf_linear: Option<RbfTable<'a, f32>>,
    /// For rbf-cubic.
    pub rbf_cubic: Option<RbfTable<'a, f64>>,
    /// For hermite and energy.
    pub hermite: Option<HermiteTable<'a>>,
    /// For kernel.
    pub kernel: Option<KernelTable<'a>>,
    /// For the eye.
    pub displacement: Option<DisplacementTable<'a>>,
}

impl Space<'_> {
    /// Whether the tables of a method were packed.
    pub const fn has(&self, method: Method) -> bool {
        match method {
            Method::Trilinear | Method::Tricubic | Method::Hybrid => self.lattice_table.is_some(),
            Method::RbfLinear => self.rbf_linear.is_some(),
            Method::RbfCubic => self.rbf_cubic.is_some(),
            Method::Hermite | Method::Energy => self.hermite.is_some(),
            Method::Kernel => self.kernel.is_some(),
        }
    }

    /// Reaction force h at a displacement of the active node, and the data it stands on.
    ///
    /// `None` only if the method is not in the blob. Any displacement is answered, with a finite force: beyond the ball with
    /// a [`continuation`] of that at the rim, NaN and infinities with the force at rest, both as `Extrapolated`.
    pub fn force(&self, method: Method, displacement_m: Vec3) -> Option<ForceSample> {
        self.force_on(Baseline, method, displacement_m)
    }

    /// [`Space::force`] with the instructions of a machine, to be inlined where they may be used. The same bits.
    #[inline(always)]
    pub fn force_on<M: Machine>(
        &self,
        machine: M,
        method: Method,
        displacement_m: Vec3,
    ) -> Option<ForceSample> {
        if let Method::Kernel = method {
            return self.kernel_force(machine, displacement_m);
        }
        let at = match self.lattice.locate_inside(displacement_m) {
            Ok(at) => at,
            // Not as an array: it would have to be in memory.
            Err([x, y, z]) => return self.force_beyond(method, x, y, z),
        };
        let force_n = self.force_at(machine, method, &at)?;
        let flags = self.flags.get(at.slot).copied().unwrap_or(0);
        Some(ForceSample { force_n, coverage: coverage(method, flags) })
    }

    #[inline(always)]
    fn force_at<M: Machine>(&self, machine: M, method: Method, at: &Location) -> Option<Vec3> {
        let strides = self.lattice.strides();
        let table = || self.lattice_table.as_ref().map(LatticeTable::force_n);
        Some(match method {
            Method::Trilinear => trilinear::interpolate(table()?, strides, at.slot, at.t),
            Method::Tricubic => tricubic::interpolate(table()?, strides, at.slot, at.t),
            Method::Hybrid => blend::hybrid(table()?, self.flags, strides, at.slot, at.t),
            Method::Hermite => self.hermite.as_ref()?.force(machine, strides, at.slot, at.t),
            Method::Energy => {
                blend::energy(machine, self.hermite.as_ref()?, self.flags, strides, at.slot, at.t)
            }
            Method::RbfLinear => finite_or_zero(self.rbf_linear.as_ref()?.interpolate(machine, at.position)),
            Method::RbfCubic => finite_or_zero(self.rbf_cubic.as_ref()?.interpolate(machine, at.position)),
            // Asked by displacement and not by cell.
            Method::Kernel => return None,
        })
    }

    #[inline(always)]
    fn kernel_force<M: Machine>(&self, machine: M, displacement_m: Vec3) -> Option<ForceSample> {
        let table = self.kernel.as_ref()?;
        let least_m = table.reach().least_m();
        // False for NaN and for what overflows; a length would be that of the other components.
        let is_near = vec3::norm_squared(displacement_m) <= least_m * least_m;
        if is_near || self.is_within_reach(table, displacement_m) {
            let force_n = table.force(machine, displacement_m);
            return Some(ForceSample { force_n, coverage: Coverage::Scattered });
        }
        let [x, y, z] = displacement_m;
        Some(self.kernel_beyond(table, x, y, z))
    }

    #[inline(never)]
    fn is_within_reach(&self, table: &KernelTable<'_>, displacement_m: Vec3) -> bool {
        vec3::is_finite(displacement_m)
            && vec3::norm(displacement_m) <= table.reach().towards_m(displacement_m)
    }

    /// Beyond what the fit knows: the force goes on from where the ray leaves its reach, as every method's beyond the ball.
    #[cold]
    #[inline(never)]
    fn kernel_beyond(&self, table: &KernelTable<'_>, x: f32, y: f32, z: f32) -> ForceSample {
        let displacement_m = [x, y, z];
        let coverage = Coverage::Extrapolated;
        if !vec3::is_finite(displacement_m) {
            return ForceSample { force_n: vec3::ZERO, coverage };
        }
        let outward = vec3::normalize_or_zero(displacement_m);
        let reach_m = table.reach().towards_m(displacement_m);
        let pulled_m = (vec3::norm(displacement_m) - reach_m).max(0.0);
        let rim_m = vec3::scale(outward, reach_m);
        let at_rim_n = table.force(Baseline, rim_m);
        let slopes = table.jet(rim_m).stiffness_n_m.map(|row| row.map(|s| s as f32));
        let spacing_m = self.lattice.spacing_m();
        let force_n = continuation::force(at_rim_n, &slopes, outward, pulled_m, spacing_m);
        ForceSample { force_n: if vec3::is_finite(force_n) { force_n } else { at_rim_n }, coverage }
    }

    /// Apart from the rest, so that the tick's usual way is short.
    #[cold]
    #[inline(never)]
    fn force_beyond(&self, method: Method, x: f32, y: f32, z: f32) -> Option<ForceSample> {
        let at = self.lattice.locate_outside([x, y, z]);
        let force_n = self.continued(method, &at, self.force_at(Baseline, method, &at)?);
        Some(ForceSample { force_n, coverage: Coverage::Extrapolated })
    }

    /// The force beyond the rim, from that at the rim.
    fn continued(&self, method: Method, at: &Location, at_rim_n: Vec3) -> Vec3 {
        let Some(stiffness_n_m) = self.rim_slopes(method, at) else { return at_rim_n };
        let spacing_m = self.lattice.spacing_m();
        let force_n = continuation::force(at_rim_n, &stiffness_n_m, at.outward, at.pulled_m, spacing_m);
        if vec3::is_finite(force_n) { force_n } else { at_rim_n }
    }

    /// Force with stiffness, and energy where there is one. `None` only if the method is not in the blob.
    ///
    /// Costs a few times as much as [`Space::force`]; the tick does not ask for it.
    pub fn estimate(&self, method: Method, displacement_m: Vec3) -> Option<Estimate> {
        let ForceSample { force_n, coverage } = self.force(method, displacement_m)?;
        let at = self.lattice.locate(displacement_m);
        let (mut stiffness_n_m, energy_j) = match (method, &self.kernel) {
            (Method::Kernel, Some(table)) if self.is_within_reach(table, displacement_m) => {
                let jet = table.jet(displacement_m);
                (jet.stiffness_n_m.map(|row| row.map(|s| s as f32)), Some(jet.energy_j as f32))
            }
            (Method::Kernel, _) => (self.differences(method, displacement_m)?, None),
            _ if at.inside => self.slopes(method, &at)?,
            _ => (self.differences(method, displacement_m)?, None),
        };
        if !stiffness_n_m.iter().all(|row| vec3::is_finite(*row)) {
            stiffness_n_m = [vec3::ZERO; 3];
        }
        Some(Estimate { force_n, stiffness_n_m, energy_j, coverage })
    }

    /// dh_i/dd_j beyond the ball, N/m, by central differences: the continuation turns with the rim.
    fn differences(&self, method: Method, displacement_m: Vec3) -> Option<[Vec3; 3]> {
        // Rounding of 8 N costs a tenth of a newton a metre, curvature a thousandth of what it costs over a cell.
        let step_m = 2e-3 * self.lattice.spacing_m();
        let mut columns = [vec3::ZERO; 3];
        for (axis, column) in columns.iter_mut().enumerate() {
            let at = |sign: f32| -> Option<Vec3> {
                let mut at = displacement_m;
                if let Some(x) = at.get_mut(axis) {
                    *x += sign * step_m;
                }
                Some(self.force(method, at)?.force_n)
            };
            *column = vec3::scale(vec3::sub(at(1.0)?, at(-1.0)?), 0.5 / step_m);
        }
        let [x, y, z] = columns;
        let row = |axis: usize| [x, y, z].map(|column| column.get(axis).copied().unwrap_or(0.0));
        Some([row(0), row(1), row(2)])
    }

    /// What the force rises by beyond the rim, N/m: continuous along the rim.
    fn rim_slopes(&self, method: Method, at: &Location) -> Option<[Vec3; 3]> {
        let (strides, slot, t) = (self.lattice.strides(), at.slot, at.t);
        let per_cell = match method {
            Method::Trilinear | Method::Hybrid => {
                tricubic::slopes(self.lattice_table.as_ref()?.force_n(), strides, slot, t)
            }
            Method::Energy => {
                blend::energy_steady_slopes(self.hermite.as_ref()?, self.flags, strides, slot, t)
            }
            _ => return Some(self.slopes(method, at)?.0),
        };
        Some(per_cell.map(|row| vec3::scale(row, self.lattice.cells_per_m())))
    }

    /// dh_i/dd_j of a method inside the ball, N/m, and W, J, where the force is its gradient.
    fn slopes(&self, method: Method, at: &Location) -> Option<([Vec3; 3], Option<f32>)> {
        let (strides, slot, t) = (self.lattice.strides(), at.slot, at.t);
        let table = || self.lattice_table.as_ref().map(LatticeTable::force_n);
        let mut energy = None;
        let slopes = match method {
            Method::Trilinear => trilinear::slopes(table()?, strides, slot, t),
            Method::Tricubic => tricubic::slopes(table()?, strides, slot, t),
            Method::Hybrid => blend::hybrid_slopes(table()?, self.flags, strides, slot, t),
            Method::RbfLinear => self.rbf_linear.as_ref()?.linear_slopes(at.position),
            Method::RbfCubic => self.rbf_cubic.as_ref()?.cubic_slopes(at.position),
            Method::Hermite => self.hermite.as_ref()?.force_slope(strides, slot, t),
            Method::Energy => {
                let (slopes, value) =
                    blend::energy_slopes(self.hermite.as_ref()?, self.flags, strides, slot, t);
                energy = value.map(|value| value * self.lattice.spacing_m());
                slopes
            }
            Method::Kernel => return None,
        };
        Some((slopes.map(|row| vec3::scale(row, self.lattice.cells_per_m())), energy))
    }

    /// Surface displacement at a displacement of the active node. `false` where the blob holds none; `out` is then zero.
    pub fn displacement_into(&self, displacement_m: Vec3, out: &mut [Vec3]) -> bool {
        match &self.displacement {
            Some(table) => table.displacement_into(&self.lattice, self.flags, displacement_m, out),
            None => out.fill(vec3::ZERO),
        }
        self.displacement.is_some()
    }
}

/// Coverage of a cell with these flags, as the method sees it.
fn coverage(method: Method, flags: u8) -> Coverage {
    let (cell, supercell) = (flags & CELL != 0, flags & SUPERCELL != 0);
    match method {
        Method::Tricubic | Method::Hybrid if supercell => Coverage::SuperCell,
        Method::Trilinear | Method::Hybrid | Method::Hermite | Method::Energy if cell => Coverage::Cell,
        Method::RbfLinear | Method::RbfCubic if cell => Coverage::Scattered,
        _ => Coverage::Extrapolated,
    }
}

/// Finite weights of absurd size can overflow in the sum; such a force is no force. Lattice tables are bounded instead.
#[inline(always)]
fn finite_or_zero(force_n: Vec3) -> Vec3 {
    if vec3::is_finite(force_n) { force_n } else { vec3::ZERO }
}
