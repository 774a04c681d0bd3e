//! The grip at the handle: orientation and buttons, by wire or radio.

use super::protocol::{Grip, Message};
use palpate_core::Orientation;

/// What the grip has last measured; without one upright and not pressed.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Gripped {
    pub(super) orientation: Orientation,
    /// Bit 0 is the only button of a grip with a wire, or `a`.
    pub(super) buttons: u32,
}

impl Gripped {
    /// Takes over the first grip of a message; one with a wire before one without. A message without grips changes nothing.
    pub(super) fn update(&mut self, message: &Message) {
        let lanes = [&message.verse_grip, &message.wireless_verse_grip];
        let first = lanes.into_iter().flatten().find_map(|lane| lane.first());
        let Some(Grip { state: Some(state) }) = first else { return };
        if let Some(orientation) = state.orientation.and_then(|turned| turned.orientation()) {
            self.orientation = orientation;
        }
        if state.button.is_some() || state.buttons.is_some() {
            let many = state.buttons.as_ref().map_or(0, |buttons| buttons.bits());
            self.buttons = u32::from(state.button == Some(true)) | many;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_grip_gives_orientation_and_buttons() {
        let mut grip = Gripped::default();
        let mut after = |text: &str| {
            grip.update(&serde_json::from_str(text).expect("a message"));
            grip
        };
        assert_eq!(after(r#"{"inverse3":[],"verse_grip":[],"session_id":7}"#), Gripped::default());
        let wireless = r#"{"verse_grip":[],"wireless_verse_grip":[{"device_id":"1","state":{
            "orientation":{"w":0.8,"x":0,"y":0.6,"z":0},"buttons":{"a":false,"b":true,"up":true},"hall":3}}]}"#;
        let turned = after(wireless);
        assert_eq!((turned.orientation.w, turned.orientation.xyz), (0.8, [0.0, 0.6, 0.0]));
        assert_eq!(turned.buttons, 0b100_0010);
        assert_eq!(after(r#"{"inverse3":[]}"#), turned, "an absent lane");
        let wired = r#"{"verse_grip":[{"state":{"button":true,"orientation":{"w":0,"x":0,"y":0,"z":0}}}]}"#;
        assert_eq!(after(wired), Gripped { buttons: 1, ..turned }, "no rotation is not taken over");
    }
}
