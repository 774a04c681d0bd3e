//! Speed of the HIP over a short window, for the overspeed fault.
//!
//! The difference of two samples at 1 kHz changes by 45 mm/s with each encoder count. Over four milliseconds
//! one count is 14 mm/s, while the jump of a lost encoder by centimetres is still detected at once.

use crate::num::vec3::{self, Vec3};

/// Number of positions kept.
const SLOTS: usize = 5;
/// Smallest time between two kept positions. Faster samples are thinned, otherwise the window would shrink.
const SPACING_US: u64 = 900;
/// Smallest time that a speed is computed over, so that a single count is not taken for a speed.
const MIN_SPAN_US: u64 = 4_000;
/// Largest age of a position.
const MAX_AGE_US: u64 = 20_000;

/// Recent positions; before the first one the speed is zero.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct SpeedWindow {
    /// Newest first.
    kept: [Option<(u64, Vec3)>; SLOTS],
}

impl SpeedWindow {
    /// Processes one position; returns the mean speed since the oldest one kept, metres per second.
    pub(crate) fn speed_m_s(&mut self, t_us: u64, position_m: Vec3) -> f32 {
        let recent = |&(then_us, _): &(u64, Vec3)| t_us.saturating_sub(then_us) <= MAX_AGE_US;
        let oldest = self.kept.iter().rev().flatten().find(|entry| recent(entry)).copied();
        let [newest, ..] = self.kept;
        if newest.is_none_or(|(then_us, _)| t_us.saturating_sub(then_us) >= SPACING_US) {
            let mut next = Some((t_us, position_m));
            for slot in &mut self.kept {
                core::mem::swap(slot, &mut next);
            }
        }
        oldest.map_or(0.0, |(then_us, then_m)| {
            let span_us = t_us.saturating_sub(then_us).max(MIN_SPAN_US);
            vec3::distance(position_m, then_m) / (span_us as f32 * 1e-6)
        })
    }
}
