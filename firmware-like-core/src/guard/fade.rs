//! The transition over a jump of the force: it starts from the old force, and the difference decays linearly.
//!
//! F(t) = F_new(t) + (F_old - F_new(t_0)) (1 - (t - t_0) / T)
//!
//! A release, a lost grasp or a change of the model is thus smooth for the hand. A fault has no transition:
//! its force is zero at once.

use crate::num::vec3::{self, Vec3};

/// A difference of forces that decays to zero.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Fade {
    difference_n: Vec3,
    since_us: u64,
}

impl Fade {
    /// Starts with the difference between the old force and the new one.
    pub(crate) fn begin(&mut self, now_us: u64, difference_n: Vec3) {
        *self = Self { difference_n, since_us: now_us };
    }

    /// The remaining difference; zero after the time `fade_s`, and always if that is 0.
    pub(crate) fn remaining_n(&self, now_us: u64, fade_s: f32) -> Vec3 {
        let elapsed_s = now_us.saturating_sub(self.since_us) as f32 * 1e-6;
        if elapsed_s >= fade_s {
            return vec3::ZERO;
        }
        let left = 1.0 - elapsed_s / fade_s;
        if left > 0.0 { vec3::scale(self.difference_n, left) } else { vec3::ZERO }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_starts_at_the_old_force_and_ends_at_zero() {
        let mut fade = Fade::default();
        assert_eq!(fade.remaining_n(5_000_000, 0.03), vec3::ZERO);
        fade.begin(1_000, [3.0, 0.0, -6.0]);
        assert_eq!(fade.remaining_n(1_000, 0.03), [3.0, 0.0, -6.0]);
        let [x, y, z] = fade.remaining_n(16_000, 0.03);
        assert!((x - 1.5).abs() < 1e-5 && y == 0.0 && (z + 3.0).abs() < 1e-5);
        assert_eq!(
            (fade.remaining_n(31_000, 0.03), fade.remaining_n(u64::MAX, 0.03)),
            (vec3::ZERO, vec3::ZERO)
        );
        assert_eq!(fade.remaining_n(1_000, 0.0), vec3::ZERO, "no time, no transition");
    }
}
