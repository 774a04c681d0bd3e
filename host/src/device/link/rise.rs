//! How a force comes back that the device has let go of.
//!
//! The loop limits the steps of the force it asks for, and cannot know that the device holds zero meanwhile: a torque ends with its validity, and
//! a command that was too long on its way is refused. Answers tell. Without one in time the device is taken to hold zero, and the
//! force rises from there as fast as the loop's own would; the loop goes on, for nothing is broken that it would have to latch.

use palpate_core::{Vec3, limit};

/// The loop's limit, N/us.
const SLEW_N_PER_US: f32 = 1e-3;
/// Longest time that counts at once, us: a late command must not buy a large step.
const LONGEST_US: u64 = 1_000;

/// What the device is known to do.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Rise {
    /// When the newest command that acted was sent, us.
    acted_us: Option<u64>,
    limited_us: u64,
    /// How much the next force may be.
    allowed_n: f32,
}

impl Rise {
    /// A command sent at this time was obeyed.
    pub(super) fn acted(&mut self, sent_us: u64) {
        self.acted_us = self.acted_us.max(Some(sent_us));
    }

    /// What of a force may go now, if a command acts for so long.
    pub(super) fn limit(&mut self, now_us: u64, force_n: Vec3, valid_for_us: u16) -> Vec3 {
        let is_over = |us: u64| now_us.saturating_sub(us) >= u64::from(valid_for_us);
        if self.acted_us.is_none_or(is_over) {
            (self.allowed_n, self.limited_us) = (0.0, now_us.saturating_sub(LONGEST_US));
        }
        let since_us = now_us.saturating_sub(self.limited_us).min(LONGEST_US);
        (self.allowed_n, self.limited_us) = (self.allowed_n + SLEW_N_PER_US * since_us as f32, now_us);
        limit::clamp_force(force_n, self.allowed_n).0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_core::vec3;

    const FORCE_N: Vec3 = [0.0, 2.0, 1.5];

    #[test]
    fn a_force_that_was_let_go_rises_a_newton_a_millisecond() {
        let mut rise = Rise::default();
        let at = |rise: &mut Rise, ms: u64| {
            let force_n = vec3::norm(rise.limit(1_000 * ms, FORCE_N, 7_000));
            (10.0 * force_n).round() / 10.0
        };
        // Nothing has acted yet, and nobody says whether the first one has.
        assert_eq!([at(&mut rise, 10), at(&mut rise, 11)], [1.0, 1.0]);
        rise.acted(11_000);
        assert_eq!([at(&mut rise, 12), at(&mut rise, 13), at(&mut rise, 14)], [2.0, 2.5, 2.5]);
        // Unanswered for less than the validity: the device holds it. For as long: it does not.
        assert_eq!([at(&mut rise, 17), at(&mut rise, 18)], [2.5, 1.0]);
        rise.acted(18_000);
        // Time without a command is no time to rise in.
        assert_eq!(at(&mut rise, 24), 2.0);
    }
}
