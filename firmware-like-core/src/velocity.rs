//! Velocity from positions in steps: the longest straight line that the last few positions allow.
//!
//! A difference over one sample at 1 kHz steps by 45 mm/s with each count of a 45 um encoder; over a fixed longer window it is late when the
//! hand turns. The first-order adaptive window takes, per axis, the largest n for which every position between lies within one step of
//! the line from x_(k-n) to x_k, and that line's slope (end-fit FOAW; Janabi-Sharifi, Hayward, Chen 2000).

use crate::vec3::{self, Vec3};

/// Longest window, in samples.
const LONGEST: usize = 15;

/// The last positions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdaptiveWindow {
    /// A ring; `newest` is the place of the newest. Microseconds, cut to 32 bits: only differences count.
    positions: [(u32, Vec3); LONGEST + 1],
    newest: usize,
    known: usize,
}

impl Default for AdaptiveWindow {
    fn default() -> Self {
        Self::new()
    }
}

impl AdaptiveWindow {
    /// Nothing known.
    pub const fn new() -> Self {
        Self { positions: [(0, vec3::ZERO); LONGEST + 1], newest: 0, known: 0 }
    }

    /// Takes the next position, metres.
    pub fn push(&mut self, t_us: u64, position_m: Vec3) {
        self.newest = (self.newest + 1) % (LONGEST + 1);
        if let Some(slot) = self.positions.get_mut(self.newest) {
            *slot = (t_us as u32, position_m);
        }
        self.known = (self.known + 1).min(LONGEST + 1);
    }

    /// Velocity now, metres a second, of positions that are known to within `step_m`; zero before there are two.
    ///
    /// A line from x_(k-n) passes x_(k-j) within a step if its slope is within step / (t_k - t_(k-j)) of the slope from x_(k-j): one pass
    /// that narrows the slopes that are left, and no second look at what lies between.
    pub fn velocity_m_s(&self, step_m: f32) -> Vec3 {
        let Some(&(now_us, now_m)) = self.positions.get(self.newest) else { return vec3::ZERO };
        let (mut velocity, mut low, mut high) = (vec3::ZERO, [f32::NEG_INFINITY; 3], [f32::INFINITY; 3]);
        for samples in 1..self.known {
            let place = (self.newest + LONGEST + 1 - samples) % (LONGEST + 1);
            let Some(&(then_us, then_m)) = self.positions.get(place) else { break };
            let per_s = (now_us.wrapping_sub(then_us) as f32 * 1e-6).recip();
            // Two samples of one time, or a time that ran backwards: nothing is known beyond.
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
                    // This axis has its line.
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

    /// Largest error of the velocity along a motion, and that of the difference of two samples, m/s.
    fn errors(motion: impl Fn(f32) -> (f32, f32)) -> (f32, f32) {
        let (mut window, mut most, mut most_plain, mut before) =
            (AdaptiveWindow::new(), 0.0_f32, 0.0_f32, 0.0);
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
    fn a_steady_motion_is_known_many_times_better_than_by_a_difference() {
        for speed in [0.0, 0.007, 0.031, 0.1, 0.5] {
            let (most, plain) = errors(|t| (0.01 + speed * t, speed));
            println!("{speed} m/s: {most} beside {plain}");
            // Two steps over fifteen samples.
            assert!(most <= 2.0 * STEP_M / 15e-3, "{speed} m/s: {most}");
            assert!(speed == 0.0 || plain > 3.0 * most, "{speed} m/s: {plain}: this test could not fail");
        }
    }

    #[test]
    fn a_turn_shortens_the_window() {
        // 20 mm at 2 Hz: up to .25 m/s, and as much again by the difference's steps.
        let omega = 4.0 * core::f32::consts::PI;
        let (most, plain) = errors(|t| (0.02 * (omega * t).sin(), 0.02 * omega * (omega * t).cos()));
        println!("{most} beside {plain}");
        assert!(most < 0.03 && plain > 0.04, "{most}, {plain}");
    }

    #[test]
    fn odd_times_and_few_positions_give_no_nonsense() {
        let mut window = AdaptiveWindow::new();
        assert_eq!(window.velocity_m_s(STEP_M), vec3::ZERO);
        window.push(5, [1.0, 2.0, 3.0]);
        assert_eq!(window.velocity_m_s(STEP_M), vec3::ZERO, "one is none");
        window.push(5, [2.0, 2.0, 3.0]);
        assert_eq!(window.velocity_m_s(STEP_M), vec3::ZERO, "no time has passed");
        let mut window = AdaptiveWindow::new();
        window.push(0, vec3::ZERO);
        window.push(2_000, [0.002, 0.0, -0.004]);
        let [x, y, z] = window.velocity_m_s(0.0);
        assert!((x - 1.0).abs() < 1e-5 && y == 0.0 && (z + 2.0).abs() < 1e-5);
    }
}
