//! Statistics over the records of a session or a recording.

use crate::rt::TickRecord;
use palpate_core::{Coverage, Phase, vec3};

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
    /// Time of the first tick with a force of the model, us since the loop began.
    pub first_force_us: Option<u64>,
    /// Changes of the active jet of a touched contact; 0 where tables give the force.
    pub hand_overs: u32,
    /// Largest step of h in a tick by the fades of these changes, N.
    pub largest_hand_over_n: f32,
    before: Option<TickRecord>,
}

impl TouchStatistics {
    /// Adds one record. Records come in order.
    pub fn add(&mut self, record: &TickRecord) {
        self.peak_reaction_n = self.peak_reaction_n.max(vec3::norm(record.reaction_n));
        self.peak_hand_force_n = self.peak_hand_force_n.max(vec3::norm(record.hand_force_n));
        self.peak_displacement_m = self.peak_displacement_m.max(vec3::norm(record.displacement_m));
        let (engaged, before) = (record.engaged.is_some(), self.before.unwrap_or(TickRecord::EMPTY));
        self.contacts += u64::from(engaged && before.engaged.is_none());
        if record.phase == Phase::Active && record.tick == before.tick + 1 {
            let step_n = vec3::distance(before.hand_force_n, record.hand_force_n);
            self.largest_step_n = self.largest_step_n.max(step_n);
        }
        if engaged && record.reaction_n != vec3::ZERO {
            self.first_force_us.get_or_insert(record.t_us);
        }
        if let Some(live) = &record.live {
            self.hand_overs = live.hand_overs;
            self.largest_hand_over_n = self.largest_hand_over_n.max(live.fade_step_n);
        }
        self.before = Some(*record);
        self.largest_work_j = self.largest_work_j.max(record.hand_work_j);
        self.damped_ticks += u64::from(record.damped);
        self.engaged_ticks += u64::from(engaged);
        self.clamped_ticks += u64::from(record.clamped);
        let kinds = Coverage::ALL.iter().zip(&mut self.coverage_ticks);
        for (_, ticks) in kinds.filter(|(kind, _)| record.coverage == Some(**kind)) {
            *ticks += 1;
        }
    }

    /// Share of the ticks in contact whose force was extrapolated; 0 without contact.
    #[must_use]
    pub fn extrapolated_share(&self) -> f64 {
        let kinds = Coverage::ALL.iter().zip(self.coverage_ticks);
        let extrapolated: u64 =
            kinds.filter(|(kind, _)| **kind == Coverage::Extrapolated).map(|(_, ticks)| ticks).sum();
        extrapolated as f64 / self.engaged_ticks.max(1) as f64
    }
}
