//! Buttons of a reply without a checksum: a press that one damaged reply tells of is none.
//!
//! The first button arms, grasps and lets go, so what is believed here moves a hand.

/// Replies in a row that say the same before it is believed, as for positions.
const SAME: u32 = super::motion::REFUSALS;

/// What the buttons are believed to be. The first reply is believed: what is held from the beginning is no press.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Buttons {
    believed: Option<u32>,
    /// What the last reply said, if it was something else, and how many have said so on end.
    said: u32,
    count: u32,
}

impl Buttons {
    /// A reply says what they are: what to believe.
    pub(super) fn hear(&mut self, buttons: u32) -> u32 {
        let believed = *self.believed.get_or_insert(buttons);
        self.count = match buttons {
            same if same == believed => 0,
            again if again == self.said => self.count + 1,
            _ => 1,
        };
        self.said = buttons;
        if self.count >= SAME {
            (self.believed, self.count) = (Some(buttons), 0);
            return buttons;
        }
        believed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heard(said: &[u32]) -> Vec<u32> {
        let mut buttons = Buttons::default();
        said.iter().map(|buttons_said| buttons.hear(*buttons_said)).collect()
    }

    #[test]
    fn a_press_is_told_by_three_replies_and_damage_by_none() {
        assert_eq!(heard(&[0, 1, 1, 1, 1, 0, 0, 0]), [0, 0, 0, 1, 1, 1, 1, 0]);
        assert_eq!(heard(&[0, 1, 1, 0, 1, 2, 1, 4, 1]), [0; 9]);
        assert_eq!(heard(&[1, 1, 0, 1]), [1; 4], "held from the beginning");
    }
}
