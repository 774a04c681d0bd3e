//! Debouncer for the buttons in replies without a checksum: a damaged reply must not count as a press.
//!
//! The first button arms, grasps and releases, so a wrong value here would move a hand.

/// Number of consecutive equal replies after which a new value is accepted, as for positions.
const STABLE_REPLIES: u32 = super::position_check::MAX_REJECTIONS;

/// Debounced state of the buttons. The first reply is accepted: a button held from the start is not a press.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ButtonDebouncer {
    stable: Option<u32>,
    /// Value of the last reply and the number of consecutive replies with it, if it differs from the stable
    /// value.
    candidate: u32,
    count: u32,
}

impl ButtonDebouncer {
    /// Takes the buttons of a reply and returns the stable value.
    pub(super) fn update(&mut self, buttons: u32) -> u32 {
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
        samples.iter().map(|sample| buttons.update(*sample)).collect()
    }

    #[test]
    fn a_press_needs_three_equal_replies() {
        assert_eq!(filtered(&[0, 1, 1, 1, 1, 0, 0, 0]), [0, 0, 0, 1, 1, 1, 1, 0]);
        assert_eq!(filtered(&[0, 1, 1, 0, 1, 2, 1, 4, 1]), [0; 9]);
        assert_eq!(filtered(&[1, 1, 0, 1]), [1; 4], "held from the start");
    }
}
