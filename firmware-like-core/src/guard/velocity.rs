//! Velocity from quantised positions: the slope of the longest straight line that fits the last positions.
//!
//! The difference of two samples at 1 kHz changes by 45 mm/s with each count of a 45 um encoder; over a fixed
//! longer window it lags when the hand turns. The first-order adaptive window uses, per axis, the largest n
//! for which all positions in between lie within one step of the line from x_(k-n) to x_k.
//!
//! Source: Janabi-Sharifi, Hayward, Chen 2000, end-fit FOAW. Deviation: none.

use super::recent::Recent;
use crate::num::vec3::{self, Vec3};

/// Longest window, in samples.
const LONGEST: usize = 15;

/// The last positions.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct AdaptiveWindow {
    positions: Recent<{ LONGEST + 1 }>,
    known: usize,
}

impl AdaptiveWindow {
    /// Adds the next position, metres.
    pub(crate) fn push(&mut self, t_us: u64, position_m: Vec3) {
        self.positions.push(t_us, position_m);
        self.known = (self.known + 1).min(LONGEST + 1);
    }

    /// Velocity at the newest position, metres per second; zero before there are two positions. `step_m` is
    /// the error of the positions, metres.
    ///
    /// A line from x_(k-n) passes x_(k-j) within a step if its slope differs from the slope from x_(k-j) by
    /// at most step / (t_k - t_(k-j)). Therefore one pass suffices; it narrows the interval of admissible
    /// slopes.
    pub(crate) fn velocity_m_s(&self, step_m: f32) -> Vec3 {
        let mut positions = self.positions.iter().take(self.known);
        let Some((now_us, now_m)) = positions.next() else { return vec3::ZERO };
        let (mut velocity, mut low, mut high) = (vec3::ZERO, [f32::NEG_INFINITY; 3], [f32::INFINITY; 3]);
        for (then_us, then_m) in positions {
            let per_s = (now_us.wrapping_sub(then_us) as f32 * 1e-6).recip();
            // Two samples at one time, or a time that ran backwards: older positions cannot be used.
            if !(0.0..f32::INFINITY).contains(&per_s) {
                break;
            }
            let slopes = vec3::scale(vec3::sub(now_m, then_m), per_s);
            let mut is_open = false;
            for (((velocity, low), high), slope) in
                velocity.iter_mut().zip(&mut low).zip(&mut high).zip(slopes)
            {
                if slope >= *low && slope <= *high {
                    *velocity = slope;
                    *low = low.max(slope - step_m * per_s);
                    *high = high.min(slope + step_m * per_s);
                    is_open = true;
                } else {
                    // The line of this axis ends here: the interval is empty from now on.
                    (*low, *high) = (f32::INFINITY, f32::NEG_INFINITY);
                }
            }
            if !is_open {
                break;
            }
        }
        velocity
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_M: f32 = 54e-6;

    fn counted(metres: f32) -> f32 {
        (metres / STEP_M).floor() * STEP_M
    }

    /// Largest error of the velocity along a motion, and of the difference of two samples, m/s.
    fn errors(motion: impl Fn(f32) -> (f32, f32)) -> (f32, f32) {
        let (mut window, mut most, mut most_plain, mut before) =
            (AdaptiveWindow::default(), 0.0_f32, 0.0_f32, 0.0);
        for tick in 0..2_000_u64 {
            let (at_m, true_m_s) = motion(tick as f32 * 1e-3);
            let seen_m = counted(at_m);
            window.push(u64::from(u32::MAX) - 1_000_000 + tick * 1_000, [0.0, seen_m, 0.0]);
            let [_, y, _] = window.velocity_m_s(STEP_M);
            if tick > 20 {
                most = most.max((y - true_m_s).abs());
                most_plain = most_plain.max(((seen_m - before) / 1e-3 - true_m_s).abs());
            }
            before = seen_m;
        }
        (most, most_plain)
    }

    #[test]
    fn a_steady_motion_has_a_much_smaller_error_than_a_difference() {
        for speed in [0.0, 0.007, 0.031, 0.1, 0.5] {
            let (most, plain) = errors(|t| (0.01 + speed * t, speed));
            println!("{speed} m/s: {most}, difference {plain}");
            // Two steps over fifteen samples.
            assert!(most <= 2.0 * STEP_M / 15e-3, "{speed} m/s: {most}");
            assert!(
                speed == 0.0 || plain > 3.0 * most,
                "{speed} m/s: {plain}: the test must be able to fail"
            );
        }
    }

    #[test]
    fn a_turn_shortens_the_window() {
        // 20 mm at 2 Hz: up to 0.25 m/s. The error of the plain difference is of the same size.
        let omega = 4.0 * core::f32::consts::PI;
        let (most, plain) = errors(|t| (0.02 * (omega * t).sin(), 0.02 * omega * (omega * t).cos()));
        println!("{most}, difference {plain}");
        assert!(most < 0.03 && plain > 0.04, "{most}, {plain}");
    }

    #[test]
    fn few_positions_and_equal_times_give_zero() {
        let mut window = AdaptiveWindow::default();
        assert_eq!(window.velocity_m_s(STEP_M), vec3::ZERO);
        window.push(5, [1.0, 2.0, 3.0]);
        assert_eq!(window.velocity_m_s(STEP_M), vec3::ZERO, "one position");
        window.push(5, [2.0, 2.0, 3.0]);
        assert_eq!(window.velocity_m_s(STEP_M), vec3::ZERO, "equal times");
        let mut window = AdaptiveWindow::default();
        window.push(0, vec3::ZERO);
        window.push(2_000, [0.002, 0.0, -0.004]);
        let [x, y, z] = window.velocity_m_s(0.0);
        assert!((x - 1.0).abs() < 1e-5 && y == 0.0 && (z + 2.0).abs() < 1e-5);
    }
}
