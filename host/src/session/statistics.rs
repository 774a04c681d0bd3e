//! Statistics over the records of a session or a recording.

use crate::rt::TickRecord;
use palpate_core::{Coverage, Phase, Vec3, vec3};

/// Largest values and counts over the records that reached the caller.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TouchStatistics {
    /// Largest |h| of the model, N.
    pub peak_reaction_n: f32,
    /// Largest force for the hand, N.
    pub peak_hand_force_n: f32,
    /// Largest displacement of an active node, m.
    pub peak_displacement_m: f32,
    /// Number of contacts.
    pub contacts: u64,
    /// Ticks in contact.
    pub engaged_ticks: u64,
    /// Ticks in contact by coverage, in the order of `Coverage::ALL`.
    pub coverage_ticks: [u64; Coverage::ALL.len()],
    /// Ticks in which the force limit reduced the force.
    pub clamped_ticks: u64,
    /// Largest change of the force for the hand between consecutive ticks while rendering, N. The step to
    /// zero at a fault or at the end is excluded.
    pub largest_step_n: f32,
    /// Largest work on the hand since the start of a contact, J. A passive body cannot give more than 0.
    pub largest_work_j: f32,
    /// Ticks in which the energy guard added damping.
    pub damped_ticks: u64,
    before: Option<(u64, bool, Vec3)>,
}

impl TouchStatistics {
    /// Adds one record. Records come in order.
    pub fn add(&mut self, record: &TickRecord) {
        self.peak_reaction_n = self.peak_reaction_n.max(vec3::norm(record.reaction_n));
        self.peak_hand_force_n = self.peak_hand_force_n.max(vec3::norm(record.hand_force_n));
        self.peak_displacement_m = self.peak_displacement_m.max(vec3::norm(record.displacement_m));
        let engaged = record.engaged.is_some();
        let (before, was_engaged, force_n) = self.before.unwrap_or((0, false, vec3::ZERO));
        self.contacts += u64::from(engaged && !was_engaged);
        if record.phase == Phase::Active && record.tick == before + 1 {
            self.largest_step_n = self.largest_step_n.max(vec3::distance(force_n, record.hand_force_n));
        }
        self.before = Some((record.tick, engaged, record.hand_force_n));
        self.largest_work_j = self.largest_work_j.max(record.hand_work_j);
        self.damped_ticks += u64::from(record.damped);
        self.engaged_ticks += u64::from(engaged);
        self.clamped_ticks += u64::from(record.clamped);
        let kinds = Coverage::ALL.iter().zip(&mut self.coverage_ticks);
        for (_, ticks) in kinds.filter(|(kind, _)| record.coverage == Some(**kind)) {
            *ticks += 1;
        }
    }
}
