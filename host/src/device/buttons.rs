//! Debouncer for the buttons in replies without a checksum: a damaged reply must not count as a press.
//!
//! The buttons arm, grasp and release, so a wrong value here would move a hand.

/// Number of consecutive equal replies after which a new value is accepted, as for positions.
const STABLE_REPLIES: u32 = super::position_check::MAX_REJECTIONS;

/// Silence after which the buttons count as held until equal replies say otherwise, us: one that went down
/// meanwhile is not a press.
const MAX_GAP_US: u64 = 10_000;

/// Debounced state of the buttons. The first reply is accepted: a button held from the start is not a press.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ButtonDebouncer {
    stable: Option<u32>,
    /// Value of the last reply and the number of consecutive replies with it, if it differs from the stable
    /// value.
    candidate: u32,
    count: u32,
    /// Time of the last reply.
    last_us: u64,
}

impl ButtonDebouncer {
    /// Takes the buttons of a reply and returns the stable value.
    pub(super) fn update(&mut self, now_us: u64, buttons: u32) -> u32 {
        let gap_us = now_us.saturating_sub(core::mem::replace(&mut self.last_us, now_us));
        if gap_us > MAX_GAP_US && self.stable.is_some() {
            (self.stable, self.count) = (Some(u32::MAX), 0);
        }
        let stable = *self.stable.get_or_insert(buttons);
        self.count = match buttons {
            value if value == stable => 0,
            value if value == self.candidate => self.count + 1,
            _ => 1,
        };
        self.candidate = buttons;
        if self.count >= STABLE_REPLIES {
            (self.stable, self.count) = (Some(buttons), 0);
            return buttons;
        }
        stable
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filtered(samples: &[u32]) -> Vec<u32> {
        let mut buttons = ButtonDebouncer::default();
        (0..).zip(samples).map(|(ms, sample)| buttons.update(1_000 * ms, *sample)).collect()
    }

    /// A button that went down in a gap is held, and not pressed, when the replies are back.
    #[test]
    fn after_a_gap_a_button_must_first_be_seen_released() {
        let mut buttons = ButtonDebouncer::default();
        assert!((0..5).all(|ms| buttons.update(1_000 * ms, 0) == 0));
        let back: Vec<u32> = (100..104).map(|ms| buttons.update(1_000 * ms, 1)).collect();
        assert_eq!(back, [u32::MAX, u32::MAX, 1, 1]);
    }

    #[test]
    fn a_press_needs_three_equal_replies() {
        assert_eq!(filtered(&[0, 1, 1, 1, 1, 0, 0, 0]), [0, 0, 0, 1, 1, 1, 1, 0]);
        assert_eq!(filtered(&[0, 1, 1, 0, 1, 2, 1, 4, 1]), [0; 9]);
        assert_eq!(filtered(&[1, 1, 0, 1]), [1; 4], "held from the start");
    }
}
