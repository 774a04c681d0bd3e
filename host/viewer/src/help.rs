//! The help on the picture of a window: its keys.

use super::font::{Align, TextStyle, Typeface};
use super::image::Image;
use super::palette::{BRIGHT, MUTED};

/// Extent of the help.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Help {
    /// No help, for files.
    #[default]
    Absent,
    /// The key that shows the help.
    Hint,
    /// All keys.
    Keys,
    /// All keys, and the mouse actions that move the tool.
    KeysAndHand,
}

/// Keys of every window and their actions.
const KEYS: &[[&str; 2]] = &[
    ["right drag", "pan (or shift + left)"],
    ["wheel", "zoom"],
    ["Home or 0", "initial view"],
    ["shift + A", "hold 1 s: arm"],
    ["D", "disarm"],
    ["R", "reset a fault"],
    ["N", "next model, if any"],
    ["1 .. 9", "next value, if live"],
    ["T", "shape at rest"],
    ["G", "reachable region"],
    ["V", "side view"],
    ["Space", "screenshot (PNG)"],
    ["H", "this help"],
    ["Esc", "end"],
];

/// Action of the left button if the mouse is not the device.
const TURN: &[[&str; 2]] = &[["left drag", "turn"]];

/// Actions if it is.
const HAND: &[[&str; 2]] = &[
    ["left on organ", "push, drag"],
    ["ctrl or E", "grasp, then pull"],
    ["wheel or W, S", "deeper, back"],
    ["left beside", "turn"],
];

/// Draws the help; sizes are for a picture 720 pixels high.
pub(super) fn draw(image: &mut Image, face: &mut Typeface, help: Help) {
    let scale = image.height() as f32 / 720.0;
    let style = TextStyle::new(8.5 * scale, MUTED);
    let left_button = match help {
        Help::Absent => return,
        Help::Hint => {
            let (x, y) = (image.width() as f32 - 40.0 * scale, image.height() as f32 - 16.0 * scale);
            face.draw(image, "H: keys", x, y, Align::Right, style);
            return;
        }
        Help::Keys => TURN,
        Help::KeysAndHand => HAND,
    };
    let rows = || left_button.iter().chain(KEYS);
    let line = 18.5 * scale;
    let (left, top) = (40.0 * scale, 118.0 * scale);
    let height = line * rows().count() as f32 + 12.0 * scale;
    let edge = 12.0 * scale;
    image.fill_rect(
        (left - edge) as i32,
        (top - edge) as i32,
        (226.0 * scale) as i32,
        height as i32,
        0x0d_1116,
        0.55,
    );
    for (row, [key, action]) in rows().enumerate() {
        let y = top + 8.0 * scale + line * row as f32;
        face.draw(image, key, left, y, Align::Left, TextStyle { colour: BRIGHT, ..style });
        face.draw(image, action, left + 88.0 * scale, y, Align::Left, style);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The help and the manual name the same keys.
    #[test]
    fn the_manual_has_the_same_keys() {
        let manual = include_str!("../../../docs/guide.md");
        let section =
            manual.split("### Keys").nth(1).and_then(|rest| rest.split("\n## ").next()).expect("keys");
        let separate = |text: &str| -> Vec<String> {
            text.replace(" or ", ", ").split(", ").map(|key| key.trim().to_owned()).collect()
        };
        let rows = section.lines().filter_map(|line| line.strip_prefix("| ")?.split(" |").next());
        let sorted = |keys: &mut dyn Iterator<Item = &str>| -> Vec<String> {
            let mut keys: Vec<String> = keys.filter(|key| !key.contains("drag")).flat_map(separate).collect();
            keys.sort();
            keys
        };
        let in_manual = sorted(&mut rows.skip(1));
        assert_eq!(in_manual, sorted(&mut KEYS.iter().map(|[key, _]| *key)));
    }

    #[test]
    fn the_help_is_drawn_on_request_and_fits() {
        let face = Typeface::new();
        for [_, action] in KEYS.iter().chain(HAND).chain(TURN) {
            assert!(face.width_px(action, 8.5) < 126.0, "{action}: {}", face.width_px(action, 8.5));
        }
        for [key, _] in KEYS.iter().chain(HAND).chain(TURN) {
            assert!(face.width_px(key, 8.5) < 84.0, "{key}: {}", face.width_px(key, 8.5));
        }
        let drawn = |help| {
            let mut image = Image::new(1280, 720);
            draw(&mut image, &mut Typeface::new(), help);
            image.pixels().iter().filter(|pixel| **pixel != 0).count()
        };
        let [absent, hint, keys, hand] = [Help::Absent, Help::Hint, Help::Keys, Help::KeysAndHand].map(drawn);
        assert!(absent == 0 && hint > 20 && keys > 20 * hint && hand > keys, "{hint} {keys} {hand}");
    }
}
