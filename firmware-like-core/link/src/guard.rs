//! Checks of commands and of the motion of a device, applied in order by [`super::device`].

/// Whether a sequence number is newer than another one. Numbers may wrap: newer means ahead by less than half
/// of all numbers.
pub const fn is_newer(seq: u32, than: u32) -> bool {
    matches!(seq.wrapping_sub(than), 1..=0x7fff_ffff)
}

/// Limits a torque to the limits of the axes, micro-newton-metres. The second value is true if the torque was
/// changed.
///
/// All axes are scaled by the same factor, which keeps the direction, and rounded towards zero, so that no
/// axis exceeds its limit. An axis whose limit is zero gets no torque and does not reduce the others.
pub fn clamp_torque(torque_unm: [i32; 3], limit_unm: [u32; 3]) -> ([i32; 3], bool) {
    // The factor is the smallest quotient limit / asked of all axes, kept as a fraction. It has no rounding
    // and needs no floating-point unit.
    let (mut limit, mut asked) = (1_u64, 1_u64);
    for (torque, axis_limit) in torque_unm.into_iter().zip(limit_unm) {
        let (torque, axis_limit) = (u64::from(torque.unsigned_abs()), u64::from(axis_limit));
        // Both products are below 2^64.
        if axis_limit > 0 && axis_limit.saturating_mul(asked) < torque.saturating_mul(limit) {
            (limit, asked) = (axis_limit, torque);
        }
    }
    let mut clamped_unm = [0; 3];
    for ((clamped, torque), axis_limit) in clamped_unm.iter_mut().zip(torque_unm).zip(limit_unm) {
        if axis_limit > 0 {
            // No division by zero: `asked` is 1 or exceeds a limit.
            let size = u64::from(torque.unsigned_abs()).saturating_mul(limit).checked_div(asked).unwrap_or(0);
            let size = i32::try_from(size).unwrap_or(i32::MAX);
            *clamped = if torque < 0 { size.wrapping_neg() } else { size };
        }
    }
    (clamped_unm, clamped_unm != torque_unm)
}

/// The lateness of commands, without a common clock.
///
/// For each command the difference of the two clocks is the true difference plus the transport time. The
/// minimum of these values stands for a command without delay; the excess over it is the lateness, the time
/// spent in a buffer. The lateness of the first command cannot be detected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Delay {
    /// Smallest difference, and when it was observed.
    prompt: Option<(u32, u64)>,
}

impl Delay {
    /// The clocks may drift by one part in this many, 244 us per second: a bound for any pair of quartz
    /// clocks.
    const DRIFT: u64 = 4096;

    /// Before the first command.
    pub(super) const fn new() -> Self {
        Self { prompt: None }
    }

    /// Lateness of a command, microseconds. Both clocks may wrap at 2^32.
    pub(super) fn judge(&mut self, now_us: u64, t_host_us: u32) -> u32 {
        let difference_us = (now_us as u32).wrapping_sub(t_host_us);
        if let Some((least_us, since_us)) = self.prompt {
            let drift_us = now_us.saturating_sub(since_us) / Self::DRIFT;
            let late_us = difference_us.wrapping_sub(least_us.wrapping_add(drift_us as u32));
            if is_newer(late_us, 0) {
                return late_us;
            }
        }
        self.prompt = Some((difference_us, now_us));
        0
    }
}

/// Detection of axes that exceed their speed, and of encoders that jump.
///
/// The counts moved are compared with the largest speed times the time since the start of a window. A window
/// lasts at least one millisecond, because in a shorter one a single count would exceed the speed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct SpeedWatch {
    start: Option<(u64, [i32; 3])>,
}

impl SpeedWatch {
    /// Shortest window, microseconds.
    const WINDOW_US: u64 = 1_000;

    /// Before the first reading.
    pub(super) const fn new() -> Self {
        Self { start: None }
    }

    /// Starts a window.
    pub(super) fn restart(&mut self, now_us: u64, encoders: [i32; 3]) {
        self.start = Some((now_us, encoders));
    }

    /// Processes one reading; true if one of the first `dof` axes is too fast. A jump is detected at once.
    pub(super) fn is_too_fast(
        &mut self,
        now_us: u64,
        encoders: [i32; 3],
        dof: u8,
        max_counts_per_s: u32,
    ) -> bool {
        let Some((start_us, start)) = self.start else {
            self.restart(now_us, encoders);
            return false;
        };
        let elapsed_us = now_us.saturating_sub(start_us);
        let allowed = u64::from(max_counts_per_s).saturating_mul(elapsed_us.max(Self::WINDOW_US));
        let too_fast = |(now, before): (i32, i32)| {
            // Counts may wrap.
            u64::from(now.wrapping_sub(before).unsigned_abs()).saturating_mul(1_000_000) > allowed
        };
        let found = encoders.into_iter().zip(start).take(usize::from(dof)).any(too_fast);
        if elapsed_us >= Self::WINDOW_US {
            self.restart(now_us, encoders);
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::{Delay, SpeedWatch};

    #[test]
    fn the_speed_window_is_at_least_a_millisecond() {
        let watch = |steps: &[(u64, i32)]| {
            let mut watch = SpeedWatch::new();
            steps.iter().any(|&(now_us, count)| {
                watch.is_too_fast(now_us, [0, count, i32::MAX.wrapping_sub(count)], 2, 20_000)
            })
        };
        assert!(!watch(&[(0, 5)]), "the first reading has no predecessor");
        assert!(
            !watch(&[(0, 0), (10, 1), (11, 2), (11, 3)]),
            "single counts in a short time are not too fast"
        );
        assert!(!watch(&[(0, 0), (100, 20)]) && watch(&[(0, 0), (100, 21)]) && watch(&[(0, 0), (100, -21)]));
        assert!(!watch(&[(0, 0), (2000, 40)]) && watch(&[(0, 0), (2000, 41)]));
        assert!(watch(&[(0, 0), (500, 15), (900, 21)]), "too fast over several readings");
        assert!(!watch(&[(0, 0), (1000, 20), (1100, 40)]) && watch(&[(0, 0), (999, 20), (1099, 40)]));
        assert!(!watch(&[(0, i32::MAX), (100, i32::MIN)]), "counts may wrap");
        assert!(watch(&[(0, 0), (100, i32::MIN)]));
        assert!(!watch(&[(0, 0), (u64::MAX, i32::MAX)]));
    }

    #[test]
    fn lateness_is_measured_despite_the_drift_of_the_clocks() {
        let mut lateness = Delay::new();
        let (first_us, ticks) = (1_u64 << 40, 600_000_u64);
        for tick in 0..ticks {
            // Ten minutes with a host clock that is slow by 200 ppm.
            let now_us = first_us + tick * 1000;
            let late_us = lateness.judge(now_us, (tick * 1000 - tick / 5) as u32);
            assert!(late_us <= 1, "{late_us} us at {tick} ms");
        }
        let now_us = first_us + ticks * 1000;
        let late_us = lateness.judge(now_us, (ticks * 1000 - ticks / 5 - 7000) as u32);
        assert!((6990..=7001).contains(&late_us), "{late_us}");
    }
}
