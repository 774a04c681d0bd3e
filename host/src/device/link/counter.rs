//! Encoder counts of the device link, beyond the range of its 32-bit readings.

/// Encoder counts without wrap-around. Two readings must be less than 2^31 counts apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Counter {
    last: Option<([i32; 3], [i64; 3])>,
}

impl Counter {
    /// Adds a reading. The first one is taken as it is: counts from home, with sign.
    pub(super) fn update(&mut self, encoders: [i32; 3]) -> [i64; 3] {
        let counts = match self.last {
            None => encoders.map(i64::from),
            Some((before, counts)) => core::array::from_fn(|axis| {
                counts[axis] + i64::from(encoders[axis].wrapping_sub(before[axis]))
            }),
        };
        self.last = Some((encoders, counts));
        counts
    }

    /// Restarts after homing has reset the counts.
    pub(super) const fn restart(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_continue_across_the_wrap_round() {
        let mut counter = Counter::default();
        assert_eq!(counter.update([i32::MAX - 1, i32::MIN + 1, -5])[0], i64::from(i32::MAX) - 1);
        let counts = counter.update([i32::MIN + 1, i32::MAX - 1, 5]);
        assert_eq!(counts, [i64::from(i32::MAX) + 2, i64::from(i32::MIN) - 2, 5]);
        counter.restart();
        assert_eq!(counter.update([7, 8, -9]), [7, 8, -9]);
    }
}
