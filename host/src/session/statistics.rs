//! Statistics over the records of a session or a recording.

use crate::rt::TickRecord;
use palpate_core::{Coverage, Phase, Vec3, vec3};

/// Displacement of the tool in a touch.
///
/// Tables count it from the anchor. The displacement of a live sphere has one origin for the whole body, far from most
/// touches, so in a live session it counts from where the tool was in the first tick of the touch.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TouchDisplacement {
    origin_m: Option<Vec3>,
}

impl TouchDisplacement {
    /// That of the next record, m; `None` without contact. Records come in order.
    pub fn next_m(&mut self, record: &TickRecord) -> Option<Vec3> {
        if record.engaged.is_none() {
            self.origin_m = None;
            return None;
        }
        let first_m = if record.live.is_some() { record.displacement_m } else { vec3::ZERO };
        Some(vec3::sub(record.displacement_m, *self.origin_m.get_or_insert(first_m)))
    }
}

/// Largest values and counts over the records that reached the caller.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TouchStatistics {
    /// Largest |h| of the model, N.
    pub peak_reaction_n: f32,
    /// Largest moment of h about the HIP, N m.
    pub peak_reaction_n_m: f32,
    /// Largest force for the hand, N.
    pub peak_hand_force_n: f32,
    /// Largest displacement of the tool in a touch, m.
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
    /// Ticks with a number that is not finite. The other largest values ignore it.
    pub not_finite_ticks: u64,
    /// Time of the first tick with a force of the model, us since the loop began.
    pub first_force_us: Option<u64>,
    /// Changes of the active jet of a touched contact; 0 where tables give the force.
    pub hand_overs: u32,
    /// Largest step of h in a tick by the fades of these changes, N.
    pub largest_hand_over_n: f32,
    displacement: TouchDisplacement,
    before: Option<TickRecord>,
}

impl TouchStatistics {
    /// Adds one record. Records come in order.
    pub fn add(&mut self, record: &TickRecord) {
        self.peak_reaction_n = self.peak_reaction_n.max(vec3::norm(record.reaction_n));
        self.peak_reaction_n_m = self.peak_reaction_n_m.max(vec3::norm(record.reaction_n_m));
        self.peak_hand_force_n = self.peak_hand_force_n.max(vec3::norm(record.hand_force_n));
        let displacement_m = self.displacement.next_m(record).map_or(0.0, vec3::norm);
        self.peak_displacement_m = self.peak_displacement_m.max(displacement_m);
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
        let vectors = [record.hip_m, record.displacement_m, record.reaction_n, record.hand_force_n];
        self.not_finite_ticks += u64::from(!vectors.into_iter().all(vec3::is_finite));
        self.engaged_ticks += u64::from(engaged);
        self.clamped_ticks += u64::from(record.clamped);
        let kinds = Coverage::ALL.iter().zip(&mut self.coverage_ticks);
        for (_, ticks) in kinds.filter(|(kind, _)| record.coverage == Some(**kind)) {
            *ticks += 1;
        }
    }

    /// Contacts, peak forces and the largest displacement in words, of a session of this many ticks. A live tool slides
    /// over the skin, so its displacement is not that of the skin.
    #[must_use]
    pub fn in_words(&self, ticks: u64) -> String {
        let is_live = self.before.is_some_and(|record| record.live.is_some());
        let mm = self.peak_displacement_m * 1e3;
        let moved = if is_live {
            format!("tool at most {mm:.1} mm from where it touched")
        } else {
            format!("peak displacement {mm:.1} mm")
        };
        let moment = match 1e3 * self.peak_reaction_n_m {
            0.0 => String::new(),
            mn_m => format!("; moment up to {mn_m:.1} mN m"),
        };
        format!(
            "{} contacts, {:.1} % of the ticks; peak force {:.2} N on the body, {:.2} N for the hand; {moved}{moment}",
            self.contacts,
            100.0 * self.engaged_ticks as f64 / ticks.max(1) as f64,
            self.peak_reaction_n,
            self.peak_hand_force_n,
        )
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::LiveTick;

    /// A sphere touches 150 mm from the origin of its displacement, moves by 5 mm, leaves and touches elsewhere.
    #[test]
    fn the_displacement_of_a_live_tool_counts_from_its_touch() {
        let places = [None, Some(0.150), Some(0.153), Some(0.155), None, Some(-0.080), Some(-0.081)];
        let of = |live: Option<LiveTick>| {
            let mut touch = TouchStatistics::default();
            for (tick, place) in (0..).zip(places) {
                let (engaged, x_m) = (place.map(|_| 0), place.unwrap_or_default());
                let displacement_m = [x_m, 0.0, 0.0];
                touch.add(&TickRecord { tick, engaged, displacement_m, live, ..TickRecord::EMPTY });
            }
            (touch.peak_displacement_m, touch.in_words(7))
        };
        let ((live_m, live), (table_m, table)) = (of(Some(LiveTick::default())), of(None));
        assert!(
            (live_m - 0.005).abs() < 1e-6 && live.ends_with("tool at most 5.0 mm from where it touched"),
            "{live}"
        );
        assert!((table_m - 0.155).abs() < 1e-6 && table.ends_with("peak displacement 155.0 mm"), "{table}");
        assert!(live.starts_with("2 contacts, 71.4 % of the ticks; peak force"), "{live}");
    }

    #[test]
    fn numbers_that_are_not_finite_are_counted() {
        let mut touch = TouchStatistics::default();
        let forces_n = [0.0, f32::NAN, 1.0, f32::INFINITY, 2.0];
        for (tick, force_n) in (0..).zip(forces_n) {
            touch.add(&TickRecord { tick, hand_force_n: [0.0, force_n, 0.0], ..TickRecord::EMPTY });
        }
        assert_eq!(touch.not_finite_ticks, 2);
    }
}
