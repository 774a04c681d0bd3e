//! One attempt at one point: its solution or the reason of its failure.

use nalgebra::Matrix3;
use palpate_core::ConfigTag;
use serde::{Deserialize, Serialize};

use super::task::Task;
use crate::fem::solve::{Configuration, FailureReason, SolveFailure};
use crate::num::jet::{EnergyJet, SymmetricThird};
use crate::spec::GridIndex;

/// The outcome of one [`Task`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// The grid point.
    pub index: GridIndex,
    /// Number of the attempt at this point, from 0.
    pub attempt: u32,
    /// Expandable, terminating or failed.
    pub tag: ConfigTag,
    /// Level of the expansion, or round of retries.
    pub round: u32,
    /// Start of the transition: the point and the attempt whose solution is used.
    pub parent: Option<(GridIndex, u32)>,
    /// Reason of a failure.
    pub failure: Option<String>,
    /// W, J.
    pub energy_j: f64,
    /// h, N.
    pub force_n: [f64; 3],
    /// S, N/m.
    pub stiffness_n_m: Matrix3<f64>,
    /// W_ijk in the order of [`crate::num::jet::THIRD_INDICES`], N/m^2.
    pub third_n_m2: SymmetricThird,
    /// Residual, N.
    pub residual_n: f64,
    /// Smallest J.
    pub min_jacobian: f64,
    /// Number of inverted elements.
    pub inverted: u32,
    /// Number of unstable modes, if the factorisation gives it.
    pub unstable_modes: Option<u32>,
    /// Whether the transition switched to another branch.
    pub switched: bool,
    /// Deformed volume, m^3.
    pub volume_m3: f64,
    /// Newton iterations.
    pub iterations: u32,
    /// Number of factorisations.
    pub factorisations: u32,
    /// Load increments.
    pub increments: u32,
    /// Wall time of the solve, s.
    pub seconds: f64,
}

impl Record {
    /// Record of a task without an outcome.
    pub(crate) fn blank(task: &Task) -> Self {
        Self {
            index: task.target,
            attempt: task.attempt,
            tag: ConfigTag::Unknown,
            round: task.round,
            parent: task.parent,
            failure: None,
            energy_j: f64::NAN,
            force_n: [f64::NAN; 3],
            stiffness_n_m: Matrix3::from_element(f64::NAN),
            third_n_m2: [f64::NAN; 10],
            residual_n: f64::NAN,
            min_jacobian: f64::NAN,
            inverted: 0,
            unstable_modes: None,
            switched: false,
            volume_m3: f64::NAN,
            iterations: 0,
            factorisations: 0,
            increments: 0,
            seconds: 0.0,
        }
    }

    /// Record of a solved configuration. It is terminating beyond `max_force_n`, and failed if a number is
    /// not finite.
    pub(super) fn solved(task: &Task, c: &Configuration, max_force_n: f64, seconds: f64) -> Self {
        let mut record = Self {
            energy_j: c.jet().energy_j,
            force_n: c.jet().force_n,
            stiffness_n_m: c.jet().stiffness_n_m,
            third_n_m2: c.jet().third_n_m2,
            residual_n: c.residual_n,
            min_jacobian: c.min_jacobian,
            inverted: c.inverted as u32,
            unstable_modes: c.unstable_modes,
            switched: c.switched,
            volume_m3: c.volume_m3,
            iterations: c.iterations,
            factorisations: c.factorisations,
            increments: c.increments,
            seconds,
            ..Self::blank(task)
        };
        if !record.is_finite() {
            let (iterations, residual_n) = (c.iterations, c.residual_n);
            let failure = SolveFailure { reason: FailureReason::NotFinite, iterations, residual_n };
            return Self::failed(task, &failure, seconds);
        }
        let reachable = task.parent.is_none() || record.force_norm_n() < max_force_n;
        record.tag = if reachable { ConfigTag::Expandable } else { ConfigTag::Terminating };
        record
    }

    /// Record of a failed transition.
    pub(super) fn failed(task: &Task, failure: &SolveFailure, seconds: f64) -> Self {
        Self {
            tag: ConfigTag::Failed,
            failure: Some(failure.reason.name().into()),
            residual_n: failure.residual_n,
            iterations: failure.iterations,
            seconds,
            ..Self::blank(task)
        }
    }

    /// Whether all numbers of the solution that fits and later solves use are finite.
    pub(super) fn is_finite(&self) -> bool {
        let numbers = self.force_n.iter().chain(self.stiffness_n_m.iter()).chain(&self.third_n_m2);
        numbers.chain([&self.energy_j]).all(|x| x.is_finite())
    }

    /// W, h, S and W_ijk of the solution at this displacement, m.
    pub fn jet(&self, displacement_m: [f64; 3]) -> EnergyJet {
        let Self { energy_j, force_n, stiffness_n_m, third_n_m2, .. } = *self;
        EnergyJet { control_m: displacement_m, energy_j, force_n, stiffness_n_m, third_n_m2 }
    }

    /// [`Self::jet`] for fits. At rest W and h are zero by definition, S is exactly symmetric, and no zero
    /// has a sign. So a new record and the same record from a store give identical fits.
    pub fn jet_for_fit(&self, displacement_m: [f64; 3]) -> EnergyJet {
        let jet = self.jet(displacement_m);
        let jet = EnergyJet::from_numbers(displacement_m, &jet.numbers().map(|x| x + 0.0));
        if self.index == [0; 3] { jet.as_rest() } else { jet }
    }

    /// |h|, N.
    pub fn force_norm_n(&self) -> f64 {
        self.force_n.iter().map(|f| f * f).sum::<f64>().sqrt()
    }
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
        }
    }

    /// The seed at `displacement_m`; `None` if the bytes are invalid.
    pub fn unpack(&self, displacement_m: [f64; 3]) -> Option<crate::fem::solve::Seed> {
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
        Some(crate::fem::solve::Seed { pose, state: numbers(&self.state), sensitivity, jet })
    }
}
