//! dW/dq of a touch, which turns a capsule, with the fades of the force.

use crate::num::vec3::{self, Vec3};

/// The slope of the present touch.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Turning {
    slope_n: Vec3,
    /// Part of it that decays: the slope goes on from that of the jet before.
    offset_n: Vec3,
    /// Number of hand-overs of the last tick, if the tool touched.
    hand_overs: Option<u32>,
}

impl Turning {
    /// The slope of the jets in this tick. A touch begins with none, as it begins without force.
    pub(super) fn follow(&mut self, of_jets_n: Vec3, hand_overs: u32, decay: f32) {
        let before = self.hand_overs.replace(hand_overs);
        self.offset_n = if before == Some(hand_overs) {
            vec3::scale(self.offset_n, decay)
        } else {
            vec3::sub(self.slope_n, of_jets_n)
        };
        self.slope_n = vec3::add(of_jets_n, self.offset_n);
    }

    /// dW/dq, newtons.
    pub(super) const fn slope_n(&self) -> Vec3 {
        self.slope_n
    }
}
