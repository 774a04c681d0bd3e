//! The second control of the next solves: the place of the partner, or the half axis of a capsule.

use super::super::hand::{Axis, Hand};
use super::LiveSolver;
use crate::fem::Second;
use crate::num::vector::difference;

/// The second control is taken as it will be after this time, s: about when the loop has the jet, and half of the way to the
/// next one.
const SECOND_AHEAD_S: f64 = 0.01;

impl LiveSolver {
    /// Solves with the second control as it will be soon.
    pub(super) fn face(&mut self, hand: &Hand) {
        let soon_m = |from_m: [f64; 3], velocity_m_s: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|k| from_m[k] + SECOND_AHEAD_S * velocity_m_s[k])
        };
        self.second_m = match (self.skin.second(), &hand.axis) {
            (Second::Axis, Some(Axis { half_m, velocity_m_s })) => Some(soon_m(*half_m, *velocity_m_s)),
            (Second::Axis, None) => self.second_m.or_else(|| Some(self.skin.sphere()?.half_m)),
            (Second::Partner, _) => self.skin.sphere().zip(hand.partner.as_ref()).map(|(sphere, partner)| {
                soon_m(difference(partner.position_m, sphere.start_m), partner.velocity_m_s)
            }),
        };
        if let (Second::Axis, Some(half_m)) = (self.skin.second(), self.second_m) {
            self.skin.turn(half_m);
        }
        if let Some(known) = self.known.first_mut() {
            known.face(self.second_m);
        }
        self.states.face(self.second_m);
        self.lost.face(self.second_m);
    }
}
