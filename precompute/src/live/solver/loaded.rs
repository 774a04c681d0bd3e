//! Which contacts the loop has the jets of.
//!
//! The loop has room for fewer contacts than a skin has places, and does not say which it gives up. So the solver keeps
//! the order of their last use, and sends the jets of a contact again when the tool comes back to it.

use super::super::choice::HEADING_M;
use super::super::hand::{Hand, Touch};
use super::super::published::Published;
use super::super::tabled;
use super::{LiveSolver, as_new};

/// Contacts whose jets the loop has for certain. It has room for 64, and gives the room of the one that it used longest
/// ago to another; it also uses contacts between two looks of the solver at the hand, and never gives away those in touch.
const LOADED: usize = 32;
/// Contacts whose jets are kept, at most 256 each of less than a kilobyte.
pub(super) const KEPT: usize = 128;

impl LiveSolver {
    /// States that the loop uses a contact. One that it has used before many others has to be sent again.
    pub(super) fn uses(&mut self, contact: u16) {
        let (count, place) = (self.recent.len(), self.recent.iter().position(|of| *of == contact));
        let is_loaded = place.is_some_and(|at| at + LOADED >= count);
        if let Some(at) = place {
            self.recent.remove(at);
        }
        self.recent.push_back(contact);
        let lost = self.recent.len().checked_sub(LOADED + 1).filter(|_| !is_loaded).map(|at| self.recent[at]);
        if let Some(lost) = lost {
            self.unsent.retain(|(of, _)| *of != lost);
            self.unsent.push((lost, false));
        }
        if self.recent.len() > KEPT
            && let Some(old) = self.recent.pop_front()
            && self.known[usize::from(old)].forget()
        {
            self.unsent.retain(|(of, _)| *of != old);
        }
    }

    /// Publishes the jets that the loop has not got of contacts that the tool touches or comes near.
    pub(super) fn send_known(&mut self, hand: &Hand) {
        let touched = hand.touch.iter().flat_map(|touch| touch.contacts);
        for (contact, _) in touched.filter(|(_, weight)| *weight > 0.0) {
            self.uses(contact);
        }
        if self.unsent.is_empty() {
            return;
        }
        let Self { skin, known, near, unsent, begun, tabled, model, .. } = self;
        let mut send = |contact: u16, is_deep: bool, from_m: [f64; 3]| {
            let first = tabled.len();
            let is_wanted = |jet: &Published| (jet.distance_m([0.0; 3]) > tabled::NEAR_REST_M) == is_deep;
            tabled.extend(as_new(&known[usize::from(contact)], contact, *model).filter(is_wanted));
            let jets = &mut tabled.make_contiguous()[first..];
            jets.sort_unstable_by(|a, b| a.distance_m(from_m).total_cmp(&b.distance_m(from_m)));
        };
        skin.near(hand.hip_m, HEADING_M, near);
        let touched = |contact: u16| {
            let of = |touch: &Touch| touch.contacts.iter().any(|&(of, weight)| of == contact && weight > 0.0);
            hand.touch.as_ref().filter(|touch| of(touch)).map(|touch| touch.control_m)
        };
        unsent.retain_mut(|(contact, is_begun)| {
            let control_m = touched(*contact);
            let comes = control_m.is_some() || near.iter().any(|(_, near)| near == contact);
            if comes && !std::mem::replace(is_begun, true) {
                send(*contact, false, control_m.unwrap_or_default());
                begun.push(*contact);
            }
            if let Some(control_m) = control_m {
                send(*contact, true, control_m);
            }
            control_m.is_none()
        });
        // They take room in the loop, too.
        while let Some(contact) = self.begun.pop() {
            self.uses(contact);
        }
    }
}
