//! What a device checks a command and its own motion with: three small judges, put in order by [`super::device`].

/// Whether a number follows another one: it is ahead by less than half of all numbers, so that they may wrap round.
pub const fn is_newer(seq: u32, than: u32) -> bool {
    matches!(seq.wrapping_sub(than), 1..=0x7fff_ffff)
}

/// Shortens a torque to the limits of the axes; true if it had to.
///
/// All axes by the same share, so that the direction stays; rounded towards zero, so that no axis is beyond its limit. An axis
/// whose limit is zero gets none and does not shorten the others.
pub fn clamp_torque(torque_unm: [i32; 3], limit_unm: [u32; 3]) -> ([i32; 3], bool) {
    // The share is limit / asked of the axis where that is smallest, kept as a fraction: no rounding, and no float in a firmware
    // without a floating-point unit.
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
            // Never divides by zero: `asked` is 1 or above a limit.
            let size = u64::from(torque.unsigned_abs()).saturating_mul(limit).checked_div(asked).unwrap_or(0);
            let size = i32::try_from(size).unwrap_or(i32::MAX);
            *clamped = if torque < 0 { size.wrapping_neg() } else { size };
        }
    }
    (clamped_unm, clamped_unm != torque_unm)
}

/// How late a command is, though the two clocks have nothing in common.
///
/// The difference between the clocks, as a command shows it, is the true one plus the time on the way. The least
/// that was seen stands for a prompt command; what is above it is lateness: time in a buffer on the way. Lateness of the first
/// command itself cannot be seen.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Lateness {
    /// Least difference seen, and when.
    prompt: Option<(u32, u64)>,
}

impl Lateness {
    /// The clocks may drift apart by one part in so many, 244 us a second: the worst pair of quartzes.
    pub const DRIFT: u64 = 4096;

    /// Nothing seen yet.
    pub const fn new() -> Self {
        Self { prompt: None }
    }

    /// Lateness of a command, microseconds. Both clocks may wrap round at 2^32.
    pub fn judge(&mut self, now_us: u64, t_host_us: u32) -> u32 {
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

/// Whether an axis moves faster than it may, or its encoder jumps.
///
/// Moved counts are held against what the largest speed allows in the time since the start of a window of at least a
/// millisecond. Against a shorter time, one count between two readings would be a speed.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SpeedWatch {
    start: Option<(u64, [i32; 3])>,
}

impl SpeedWatch {
    /// Shortest window, microseconds.
    pub const WINDOW_US: u64 = 1_000;

    /// No reading yet.
    pub const fn new() -> Self {
        Self { start: None }
    }

    /// Starts a window, whatever was before.
    pub fn restart(&mut self, now_us: u64, encoders: [i32; 3]) {
        self.start = Some((now_us, encoders));
    }

    /// Takes one reading; true if one of the first `dof` axes is too fast. A jump is seen at once.
    pub fn is_too_fast(&mut self, now_us: u64, encoders: [i32; 3], dof: u8, max_counts_per_s: u32) -> bool {
        let Some((start_us, start)) = self.start else {
            self.restart(now_us, encoders);
            return false;
        };
        let elapsed_us = now_us.saturating_sub(start_us);
        let allowed = u64::from(max_counts_per_s).saturating_mul(elapsed_us.max(Self::WINDOW_US));
        let too_fast = |(now, before): (i32, i32)| {
            // Counts wrap round.
            u64::from(now.wrapping_sub(before).unsigned_abs()).saturating_mul(1_000_000) > allowed
        };
        let found = encoders.into_iter().zip(start).take(usize::from(dof)).any(too_fast);
        if elapsed_us >= Self::WINDOW_US {
            self.restart(now_us, encoders);
        }
        found
    }
}
