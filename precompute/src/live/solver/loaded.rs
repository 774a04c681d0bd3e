//! Which contacts the loop has the jets of.
//!
//! The loop has room for fewer contacts than a skin has places, and does not say which it gives up. So the solver keeps
//! the order of their last use, and sends the jets of a contact again when the tool comes back to it. For its own memory
//! it gives up the jets of those used longest ago, too, and keeps what it knows of them at rest.

use std::collections::VecDeque;

use super::super::choice::HEADING_M;
use super::super::hand::{Hand, Touch};
use super::super::memory::{Known, MAX_JETS};
use super::super::published::Published;
use super::super::tabled;
use super::LiveSolver;
use super::publishing::as_new;

/// Contacts whose jets the loop has for certain. It has room for 64, and gives the room of the one that it used longest
/// ago to another; it also uses contacts between two looks of the solver at the hand, and never gives away those in touch.
const LOADED: usize = 32;
/// Most jets that the solver keeps, besides those at rest and those of tables: all that these contacts can have.
const MAX_KEPT: usize = LOADED * MAX_JETS;

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
        if let Some(lost) = lost
            && !self.lost_by_loop.contains(&lost)
        {
            self.lost_by_loop.push(lost);
        }
    }

    /// Gives up the jets of the contacts used longest ago while there are too many.
    pub(super) fn give_up_old(&mut self) {
        let mut kept: usize = self.known.iter().map(Known::away_from_rest).sum();
        for contact in &self.recent {
            if kept <= MAX_KEPT {
                return;
            }
            let known = &mut self.known[usize::from(*contact)];
            kept -= known.away_from_rest();
            known.keep_rest();
        }
    }

    /// Publishes again the jets of contacts in touch that the loop may have given up.
    fn send_lost(&mut self, touch: &Touch) {
        for (contact, _) in touch.contacts.into_iter().filter(|(_, weight)| *weight > 0.0) {
            if let Some(at) = self.lost_by_loop.iter().position(|of| *of == contact) {
                self.lost_by_loop.swap_remove(at);
                let first = self.tabled.len();
                self.tabled.extend(as_new(&self.known[usize::from(contact)], contact, self.model));
                nearest_first(&mut self.tabled, first, touch.control_m);
            }
            self.uses(contact);
        }
    }

    /// Publishes the jets that the loop has not got of contacts that the tool touches or comes near.
    pub(super) fn send_known(&mut self, hand: &Hand) {
        if let Some(touch) = &hand.touch {
            self.send_lost(touch);
        }
        if self.unsent.is_empty() {
            return;
        }
        let Self { skin, known, near, unsent, begun, tabled, model, .. } = self;
        let mut send = |contact: u16, is_deep: bool, from_m: [f64; 3]| {
            let first = tabled.len();
            let is_wanted = |jet: &Published| (jet.distance_m([0.0; 3]) > tabled::NEAR_REST_M) == is_deep;
            tabled.extend(as_new(&known[usize::from(contact)], contact, *model).filter(is_wanted));
            nearest_first(tabled, first, from_m);
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

/// Sorts the jets from number `first` on by their distance from a control.
fn nearest_first(jets: &mut VecDeque<Published>, first: usize, from_m: [f64; 3]) {
    let jets = &mut jets.make_contiguous()[first..];
    jets.sort_unstable_by(|a, b| a.distance_m(from_m).total_cmp(&b.distance_m(from_m)));
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::super::branches::REST;
    use super::*;
    use crate::num::jet::EnergyJet;
    use crate::scene::Scene;

    #[test]
    fn contacts_used_long_ago_keep_their_jet_at_rest_and_the_last_ones_all() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/liver-small.toml");
        let scene = Scene::load(&path).and_then(|scene| scene.resolve()).expect("a bundled scene");
        let mut solver = LiveSolver::new(&scene).expect("it can be touched");
        let (contacts, each) = (100, 200_u16);
        for contact in 0..contacts {
            for number in 0..=each {
                let jet = EnergyJet::from_numbers([0.0, 0.0, -1e-4 * f64::from(number)], &[1.0; 20]);
                solver.publish(contact, REST, (jet, None), true, Some(0));
            }
        }
        let kept: Vec<usize> = (0..contacts).map(|contact| solver.jets(contact).count()).collect();
        let all = usize::from(each) + 1;
        let whole = kept.iter().rev().take_while(|count| **count == all).count();
        assert_eq!(whole, MAX_KEPT / (all - 1), "{kept:?}");
        assert!(kept[..usize::from(contacts) - whole].iter().all(|count| *count == 1), "{kept:?}");
    }
}
