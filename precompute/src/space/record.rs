//! One attempt at one point: its solution or the reason of its failure.

use nalgebra::Matrix3;
use palpate_core::ConfigTag;
use serde::{Deserialize, Serialize};

use super::task::Task;
use crate::fem::solve::{Configuration, NewtonOptions, SolveFailure};
use crate::num::jet::{EnergyJet, SECOND_INDICES, SymmetricThird};
use crate::num::vector::norm;
use crate::spec::{GridIndex, Quantity, Tolerance};

/// The outcome of one [`Task`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// The grid point.
    pub index: GridIndex,
    /// Number of the attempt at this point, from 0.
    pub attempt: u32,
    /// Level of the expansion, or round of retries.
    pub round: u32,
    /// Start of the transition: the point and the attempt whose solution is used.
    pub parent: Option<(GridIndex, u32)>,
    /// The solution, or the reason of the failure.
    pub result: Result<Solution, String>,
    /// Residual, N; `None` for a failed solve whose residual is not a number.
    pub residual_n: Option<f64>,
    /// Newton iterations.
    pub iterations: u32,
    /// Number of factorisations.
    pub factorisations: u32,
    /// Load increments.
    pub increments: u32,
    /// Wall time of the solve, s.
    pub seconds: f64,
}

/// A solved configuration without third derivatives, as grid points and held-out references store it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Equilibrium {
    /// Whether |h| is at or above the force limit.
    pub terminating: bool,
    /// W, J.
    pub energy_j: f64,
    /// h, N.
    pub force_n: [f64; 3],
    /// S, N/m.
    pub stiffness_n_m: Matrix3<f64>,
    /// Smallest J.
    pub min_jacobian: f64,
    /// Number of inverted elements.
    pub inverted: u32,
    /// Number of unstable modes; `None` without a factor that gives it, as for most configurations of a large body.
    pub unstable_modes: Option<u32>,
    /// Whether the transition switched to another branch.
    pub switched: bool,
}

impl Equilibrium {
    /// The stored numbers of a configuration.
    pub(super) fn of(c: &Configuration, terminating: bool) -> Self {
        let EnergyJet { energy_j, force_n, stiffness_n_m, .. } = *c.jet();
        let &Configuration { min_jacobian, inverted, unstable_modes, switched, .. } = c;
        let inverted = inverted as u32;
        Self {
            terminating,
            energy_j,
            force_n,
            stiffness_n_m,
            min_jacobian,
            inverted,
            unstable_modes,
            switched,
        }
    }

    /// Expandable or terminating.
    pub fn tag(&self) -> ConfigTag {
        if self.terminating { ConfigTag::Terminating } else { ConfigTag::Expandable }
    }

    /// W, h and S (order of [`crate::num::jet::SECOND_INDICES`]), as in the columns of files.
    pub fn numbers(&self) -> [f64; 10] {
        let [x, y, z] = self.force_n;
        let [xx, xy, xz, yy, yz, zz] = SECOND_INDICES.map(|[i, j]| self.stiffness_n_m[(i, j)]);
        [self.energy_j, x, y, z, xx, xy, xz, yy, yz, zz]
    }
}

/// The solution of a grid point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Solution {
    /// W, h, S and the condition of the mesh.
    pub equilibrium: Equilibrium,
    /// W_ijk in the order of [`crate::num::jet::THIRD_INDICES`], N/m^2.
    pub third_n_m2: SymmetricThird,
    /// Deformed volume, m^3.
    pub volume_m3: f64,
}

impl Solution {
    /// A stable solution with the values of `jet` on a mesh of the volume 1 m^3 without distorted elements: of a
    /// model without a mesh.
    pub(super) fn of_jet(jet: &EnergyJet, terminating: bool) -> Self {
        let EnergyJet { energy_j, force_n, stiffness_n_m, third_n_m2, .. } = *jet;
        let equilibrium = Equilibrium {
            terminating,
            energy_j,
            force_n,
            stiffness_n_m,
            min_jacobian: 1.0,
            inverted: 0,
            unstable_modes: Some(0),
            switched: false,
        };
        Self { equilibrium, third_n_m2, volume_m3: 1.0 }
    }

    /// W, h, S and W_ijk at this displacement, m.
    pub(super) fn jet(&self, displacement_m: [f64; 3]) -> EnergyJet {
        let Equilibrium { energy_j, force_n, stiffness_n_m, .. } = self.equilibrium;
        let third_n_m2 = self.third_n_m2;
        EnergyJet { control_m: displacement_m, energy_j, force_n, stiffness_n_m, third_n_m2 }
    }
}

impl Record {
    /// Record of a task that took no time.
    pub(super) fn new(task: &Task, result: Result<Solution, String>) -> Self {
        let Task { target, attempt, round, parent, chart: _ } = *task;
        Self {
            index: target,
            attempt,
            round,
            parent,
            result,
            residual_n: Some(0.0),
            iterations: 0,
            factorisations: 0,
            increments: 0,
            seconds: 0.0,
        }
    }

    /// Record of a task that a model without a mesh solved with this jet.
    pub fn of_jet(task: &Task, jet: &EnergyJet, terminating: bool) -> Self {
        Self::new(task, Ok(Solution::of_jet(jet, terminating)))
    }

    /// Record of a solved configuration. It is terminating beyond `max_force_n`.
    pub(super) fn solved(task: &Task, c: &Configuration, max_force_n: f64, seconds: f64) -> Self {
        let reachable = task.parent.is_none() || norm(c.jet().force_n) < max_force_n;
        let solution = Solution {
            equilibrium: Equilibrium::of(c, !reachable),
            third_n_m2: c.jet().third_n_m2,
            volume_m3: c.volume_m3,
        };
        Self {
            residual_n: Some(c.residual_n),
            iterations: c.iterations,
            factorisations: c.factorisations,
            increments: c.increments,
            seconds,
            ..Self::new(task, Ok(solution))
        }
    }

    /// Record of a failed transition.
    pub(super) fn failed(task: &Task, failure: &SolveFailure, seconds: f64) -> Self {
        Self {
            residual_n: unless_nan(failure.residual_n),
            iterations: failure.iterations,
            seconds,
            ..Self::new(task, Err(failure.reason.to_string()))
        }
    }

    /// Expandable, terminating or failed.
    pub fn tag(&self) -> ConfigTag {
        self.equilibrium().map_or(ConfigTag::Failed, Equilibrium::tag)
    }

    /// The solution without its third derivatives; `None` for a failed attempt.
    pub fn equilibrium(&self) -> Option<&Equilibrium> {
        self.result.as_ref().ok().map(|solution| &solution.equilibrium)
    }

    /// Whether Newton's method accepted the solution at the rounding floor of the residual, above its
    /// tolerance.
    ///
    /// The tolerance is relative to the force. The solver adds the weight and a force of the material, which
    /// no record contains; the imperceptible force replaces them here.
    pub(crate) fn is_at_rounding_floor(&self) -> bool {
        let least_n = Tolerance::IMPERCEPTIBLE.absolute_n;
        self.equilibrium().zip(self.residual_n).is_some_and(|(at, residual_n)| {
            residual_n > NewtonOptions::default().tolerance * norm(at.force_n).max(least_n)
        })
    }

    /// W, h, S and W_ijk of the solution at this displacement, m.
    pub(crate) fn jet(&self, displacement_m: [f64; 3]) -> Option<EnergyJet> {
        self.result.as_ref().ok().map(|solution| solution.jet(displacement_m))
    }

    /// [`Self::jet`] for fits. At rest W and h are zero by definition unless the tool touches the body there, S is
    /// exactly symmetric, and no zero has a sign. So a new record and the same record from a store give identical
    /// fits.
    pub(crate) fn jet_for_fit(&self, displacement_m: [f64; 3], quantity: Quantity) -> Option<EnergyJet> {
        let jet = self.jet(displacement_m)?;
        let jet = EnergyJet::from_numbers(displacement_m, &jet.numbers().map(|x| x + 0.0));
        let is_rest = self.index == [0; 3] && quantity == Quantity::Energy;
        Some(if is_rest { jet.as_rest() } else { jet })
    }
}

/// The residual of a failed solve as stored.
pub(super) fn unless_nan(residual_n: f64) -> Option<f64> {
    (!residual_n.is_nan()).then_some(residual_n)
}

/// Start state of later solves as stored: little-endian f32, and the condensed energy. Every child starts
/// from the stored state. So an interrupted run gives the same bits as an uninterrupted one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StoredSeed {
    /// State vector.
    #[serde(with = "serde_bytes")]
    pub(super) state: Vec<u8>,
    /// d(state)/dd along x, then y, then z.
    #[serde(with = "serde_bytes")]
    pub(super) sensitivity: Vec<u8>,
    /// W, h, S and W_ijk, [`EnergyJet::numbers`]. The store keeps them in the record.
    pub(super) numbers: [f64; 20],
    /// The zero of the displacement of the chart that solved it, from that of the chart that uses it, m.
    pub(super) from_m: [f64; 3],
}

impl StoredSeed {
    /// Rounds `seed` to the stored precision.
    pub fn pack(seed: &crate::fem::solve::Seed) -> Self {
        let bytes =
            |values: &[f64]| values.iter().flat_map(|&x| (x as f32).to_le_bytes()).collect::<Vec<u8>>();
        Self {
            state: bytes(&seed.state),
            sensitivity: seed.sensitivity.iter().flat_map(|c| bytes(c)).collect(),
            numbers: seed.jet.numbers(),
            from_m: [0.0; 3],
        }
    }

    /// The same for a chart whose displacements begin so far before those of the chart that solved it, m.
    pub(crate) fn moved_by(self, from_m: [f64; 3]) -> Self {
        Self { from_m, ..self }
    }

    /// The seed at `displacement_m`; `None` if the bytes are invalid.
    pub(crate) fn unpack(&self, displacement_m: [f64; 3]) -> Option<crate::fem::solve::Seed> {
        let displacement_m = std::array::from_fn(|axis| displacement_m[axis] + self.from_m[axis]);
        let numbers = |bytes: &[u8]| -> Vec<f64> {
            bytes.as_chunks().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect()
        };
        if self.state.is_empty() || self.sensitivity.len() != 3 * self.state.len() {
            return None;
        }
        let mut columns = self.sensitivity.chunks_exact(self.state.len()).map(numbers);
        let sensitivity = [columns.next()?, columns.next()?, columns.next()?];
        let pose = crate::fem::boundary::Pose::translation(displacement_m);
        let jet = EnergyJet::from_numbers(displacement_m, &self.numbers);
        Some(crate::fem::solve::Seed { pose, state: numbers(&self.state), sensitivity, jet, coupling: None })
    }
}
