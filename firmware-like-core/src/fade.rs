//! What bridges a jump: the force goes on from where it was, and the difference fades away.
//!
//! F(t) = F_new(t) + (F_old - F_new(t_0)) (1 - (t - t_0) / T)
//!
//! Whatever lets go of a force that is not zero (a button, a slip, another model) is smooth for the hand this way. A fault is not bridged:
//! that is zero at once.

use crate::vec3::{self, Vec3};

/// A difference on its way to zero.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Fade {
    apart_n: Vec3,
    since_us: u64,
}

impl Fade {
    /// Nothing to bridge.
    pub const fn new() -> Self {
        Self { apart_n: vec3::ZERO, since_us: 0 }
    }

    /// Begins at the difference between the force that was and the one that would be now.
    pub const fn begin(&mut self, now_us: u64, apart_n: Vec3) {
        *self = Self { apart_n, since_us: now_us };
    }

    /// What is left of it.
    pub fn rest_n(&self, now_us: u64, fade_s: f32) -> Vec3 {
        let share = 1.0 - now_us.saturating_sub(self.since_us) as f32 * 1e-6 / fade_s;
        // Also where there is no time to fade in: NaN is not above zero.
        if share > 0.0 { vec3::scale(self.apart_n, share) } else { vec3::ZERO }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_starts_where_the_force_was_and_ends_at_zero() {
        let mut fade = Fade::new();
        assert_eq!(fade.rest_n(5_000_000, 0.03), vec3::ZERO);
        fade.begin(1_000, [3.0, 0.0, -6.0]);
        assert_eq!(fade.rest_n(1_000, 0.03), [3.0, 0.0, -6.0]);
        let [x, y, z] = fade.rest_n(16_000, 0.03);
        assert!((x - 1.5).abs() < 1e-5 && y == 0.0 && (z + 3.0).abs() < 1e-5);
        assert_eq!((fade.rest_n(31_000, 0.03), fade.rest_n(u64::MAX, 0.03)), (vec3::ZERO, vec3::ZERO));
        assert_eq!(fade.rest_n(1_000, 0.0), vec3::ZERO, "no time: no bridge");
    }
}
