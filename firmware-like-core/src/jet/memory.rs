//! The jets of a session, and the force from them.
//!
//! h = sum w_i h_i(d) over the engaged contact points, each with its own table. A point without jets, or beyond the
//! trust of its jets while others are within theirs, takes the weighted mean of the others: they are its neighbours.
//! Meanwhile the touch does not slip. If none has jets, the force is zero.

use super::frame::Jet;
use super::ladder::{Ladder, Solver};
use super::stiffest::Stiffest;
use super::table::{Decay, Table};
use super::trusted::limited;
use super::turning::Turning;
use crate::field::{Field, Touch};
use crate::method::{Coverage, ForceSample};
use crate::num::exponential::exp_of_minus;
use crate::num::lanes::{Baseline, Machine};
use crate::num::vec3::{self, Vec3};
use crate::touch::NodeWeight;

/// Time constant of the fade between two jets, us.
const FAST_US: f64 = 10_000.0;
/// The same where jets take the place of a substitute, us.
const SLOW_US: f64 = 30_000.0;
/// The same after a change of the body's model, us.
const CHANGE_US: f64 = 100_000.0;
/// Share of the weights within trust with which the force is covered: the neighbours' forces differ by less than half,
/// so that a tenth of them is not felt.
const COVERED: f32 = 0.9;
/// Longest time for which a touch does not slip, us: that of the solves of three points of a body of 100,000 equations.
const STICK_US: u64 = 10_000_000;
/// Longest time between two ticks for a fade, us: the range of the exponential.
const MAX_ELAPSED_US: u64 = 1_000_000;

/// A table and its use.
#[derive(Debug, Clone, PartialEq)]
struct Place<const JETS: usize> {
    table: Table<JETS>,
    /// Tick in which the table last gave a force.
    tick: u64,
    /// Number of the last use, by a force or an insertion.
    used: u64,
}

/// The force of the present touch that no single table owns.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Whole {
    now_us: u64,
    displacement_m: Vec3,
    weights: [NodeWeight; 3],
    /// Which of the engaged points give a force of their own.
    counts: [bool; 3],
    /// Since when others stand in for a point.
    partial_since_us: Option<u64>,
    /// Sum before the ladder.
    force_n: Vec3,
    /// Decays with the slow time constant.
    offset_n: Vec3,
}

/// Jets of at most `CONTACTS` contact points, `JETS` of each, a multiple of 8; its size is fixed.
///
/// A point takes a table with its first jet. When all tables are taken, the one that was used longest ago is
/// cleared for it, but never one of the present touch.
#[derive(Debug, Clone, PartialEq)]
pub struct JetMemory<const CONTACTS: usize, const JETS: usize = 256> {
    /// The contact point of each table, apart from the tables because it is searched in every tick.
    owners: [Option<u16>; CONTACTS],
    places: [Place<JETS>; CONTACTS],
    solver: Solver,
    ladder: Ladder,
    /// Number of the present tick.
    tick: u64,
    /// Number of the last use of a table.
    uses: u64,
    /// Number of the last insertion.
    stamp: u32,
    /// Number of the newest model of the body.
    model: u32,
    /// Largest |S| of its jets, N/m.
    stiffest: Stiffest,
    /// The same of the fixed part in the present touch.
    stiffest_fixed: Stiffest,
    hand_overs: u32,
    /// What the fades took from the force in the last tick, N.
    faded_n: Vec3,
    /// The present touch.
    whole: Option<Whole>,
    /// Displacement of the partner, if it touches the body.
    partner_m: Option<Vec3>,
    /// The second control of the present touch: the half axis of the tool, or the place of the partner.
    second_m: Option<Vec3>,
    /// What turns a capsule.
    turning: Turning,
}

impl<const CONTACTS: usize, const JETS: usize> Default for JetMemory<CONTACTS, JETS> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const CONTACTS: usize, const JETS: usize> JetMemory<CONTACTS, JETS> {
    /// Without jets.
    ///
    /// 64 contacts of 256 jets take 2 MB, as much as the whole stack of a thread: box it in a thread that has
    /// more.
    pub fn new() -> Self {
        Self {
            owners: [None; CONTACTS],
            places: core::array::from_fn(|_| Place { table: Table::new(), tick: 0, used: 0 }),
            solver: Solver::Alive,
            ladder: Ladder::default(),
            tick: 1,
            uses: 0,
            stamp: 0,
            model: 0,
            stiffest: Stiffest::default(),
            stiffest_fixed: Stiffest::default(),
            hand_overs: 0,
            faded_n: vec3::ZERO,
            whole: None,
            partner_m: None,
            second_m: None,
            turning: Turning::default(),
        }
    }

    /// Adds a jet, before a tick; one of an earlier model has no effect. Returns false if it was refused: a number is out of range, or all tables
    /// are in use by the present touch.
    pub fn insert(&mut self, jet: &Jet) -> bool {
        if jet.check().is_err() {
            return false;
        }
        if jet.model < self.model {
            return true;
        }
        if jet.model > self.model {
            (self.model, self.stiffest) = (jet.model, Stiffest::default());
        }
        if !jet.flags.fixed {
            self.stiffest.add(jet.force_size_n(), jet.stiffness_size_n_m());
        }
        let Some(index) = self.index(jet.contact).or_else(|| self.make_room(jet.contact)) else {
            return false;
        };
        self.uses += 1;
        self.stamp = self.stamp.wrapping_add(1);
        let (used, stamp) = (self.uses, self.stamp);
        let Some(place) = self.places.get_mut(index) else { return false };
        place.used = used;
        place.table.insert(jet, stamp);
        true
    }

    /// States whether the solver is alive, from the next tick on.
    pub fn solver(&mut self, solver: Solver) {
        self.solver = solver;
    }

    /// States where the partner is from the next tick on, relative to where the displacement of the tool is zero; `None` if
    /// it does not touch the body. A place that is not finite is none.
    pub fn partner(&mut self, displacement_m: Option<Vec3>) {
        self.partner_m = displacement_m.and_then(limited);
    }

    /// Number of jets of a contact point that count: of the newest model, or of the present touch.
    pub fn jets(&self, contact: u16) -> usize {
        let counts = |place: &&Place<JETS>| place.table.model() == self.model || place.tick == self.tick;
        self.place(contact).filter(counts).map_or(0, |place| place.table.len())
    }

    /// Number of times that another jet has taken over while the tool touched.
    pub const fn hand_overs(&self) -> u32 {
        self.hand_overs
    }

    /// Size of the step that the fades made in the force of the last tick, N: what a hand-over adds to the motion.
    pub fn fade_step_n(&self) -> f32 {
        vec3::norm(self.faded_n)
    }

    fn index(&self, contact: u16) -> Option<usize> {
        self.owners.iter().position(|owner| *owner == Some(contact))
    }

    fn place(&self, contact: u16) -> Option<&Place<JETS>> {
        self.places.get(self.index(contact)?)
    }

    /// Clears the table that was used longest ago, or takes one that is free, for a contact.
    fn make_room(&mut self, contact: u16) -> Option<usize> {
        let touched = self.whole.map(|_| self.tick);
        let idle = self.places.iter().enumerate().filter(|(_, place)| Some(place.tick) != touched);
        let (index, _) = idle.min_by_key(|(_, place)| place.used)?;
        *self.owners.get_mut(index)? = Some(contact);
        self.places.get_mut(index)?.table.clear();
        Some(index)
    }

    /// The sum over the points that give a force of their own, the weight of these, and whether enough of it lies in their
    /// trust.
    fn sum(&mut self, touch: &Touch, d: Vec3, decay: Decay, counts: &mut [bool; 3]) -> (Vec3, f32, bool) {
        let (mut all, mut trusted) = (0.0, 0.0);
        let answers = touch.weights.map(|node| {
            if node.weight <= 0.0 {
                return None;
            }
            all += node.weight;
            let (sample, faded_n) = self.one(node, d, decay)?;
            let is_trusted = sample.coverage != Coverage::Extrapolated;
            trusted += if is_trusted { node.weight } else { 0.0 };
            Some((sample.force_n, faded_n, is_trusted))
        });
        let (mut sum_n, mut weight) = (vec3::ZERO, 0.0);
        for ((node, answer), counts) in touch.weights.iter().zip(answers).zip(counts) {
            let counting = answer.filter(|(_, _, is_trusted)| *is_trusted || trusted <= 0.0);
            if let Some((force_n, faded_n, _)) = counting {
                *counts = true;
                sum_n = vec3::add(sum_n, vec3::scale(force_n, node.weight));
                self.faded_n = vec3::add(self.faded_n, vec3::scale(faded_n, node.weight));
                weight += node.weight;
            }
        }
        (sum_n, weight, trusted >= COVERED * all)
    }

    /// Follows what turns a capsule.
    // On its own, so that it costs a tool without an axis nothing.
    #[inline(never)]
    fn turn(&mut self, touch: &Touch, d: Vec3, decay: Decay) {
        let Some(second_m) = self.second_m else { return };
        let mut slope_n = vec3::ZERO;
        for node in touch.weights.iter().filter(|node| node.weight > 0.0) {
            let table = self.place(node.space).map(|place| &place.table);
            let one_n = table.map_or(vec3::ZERO, |table| table.slope_n(d, second_m));
            slope_n = vec3::add(slope_n, vec3::scale(one_n, node.weight));
        }
        self.turning.follow(slope_n, self.hand_overs, decay.fast);
    }

    /// The force of one point, which is then one of the present touch, and what its fades took from it.
    fn one(
        &mut self,
        NodeWeight { space, .. }: NodeWeight,
        d: Vec3,
        decay: Decay,
    ) -> Option<(ForceSample, Vec3)> {
        let index = self.index(space)?;
        self.uses += 1;
        let (tick, used) = (self.tick, self.uses);
        let place = self.places.get_mut(index)?;
        let is_continued = place.tick.wrapping_add(1) == tick;
        if place.table.model() != self.model && !is_continued {
            return None;
        }
        (place.tick, place.used) = (tick, used);
        let answer = place.table.force(d, self.second_m, decay, is_continued)?;
        self.hand_overs = self.hand_overs.wrapping_add(answer.is_handed_over.into());
        if let Some((force_n, stiffness_n_m)) = answer.of_fixed {
            self.stiffest_fixed.add(force_n, stiffness_n_m);
        }
        Some((answer.sample, answer.faded_n))
    }
}

impl<const CONTACTS: usize, const JETS: usize> Field for JetMemory<CONTACTS, JETS> {
    /// The coverage is `Scattered` if nine tenths of the engaged weights are within the trust of a jet.
    ///
    /// Cost: a pass over the controls of the engaged points, one jet for each of them, and another one where
    /// the active jet changes.
    fn force(&mut self, touch: &Touch) -> Option<ForceSample> {
        let finite = limited(touch.displacement_m);
        let d = finite.unwrap_or_default();
        let before = self.whole.take();
        let elapsed_us = before.map_or(0, |before| touch.now_us.saturating_sub(before.now_us));
        let decay = decay(elapsed_us.min(MAX_ELAPSED_US));
        self.tick += 1;
        self.faded_n = vec3::ZERO;
        self.second_m = touch.half_axis_m.and_then(limited).or(self.partner_m);
        let mut counts = [false; 3];
        let (sum_n, weight, is_covered) = self.sum(touch, d, decay, &mut counts);
        if touch.half_axis_m.is_some() {
            self.turn(touch, d, decay);
        }
        // The mean takes the place of the other points.
        let mean_n = if weight > 0.0 { vec3::scale(sum_n, 1.0 / weight) } else { vec3::ZERO };
        let all = touch.weights.iter().map(|node| node.weight).fold(0.0, |sum, weight| sum + weight.max(0.0));
        let is_partial = touch.weights.iter().zip(counts).any(|(node, counts)| !counts && node.weight > 0.0);
        let own_n = if is_partial { vec3::scale(mean_n, all) } else { sum_n };
        let since_us = before.and_then(|before| before.partial_since_us).unwrap_or(touch.now_us);
        let mut now = Whole {
            now_us: touch.now_us,
            displacement_m: d,
            weights: touch.weights,
            counts,
            partial_since_us: is_partial.then_some(since_us),
            force_n: own_n,
            offset_n: vec3::ZERO,
        };
        if let Some(before) = before {
            self.faded_n = vec3::add(self.faded_n, vec3::scale(before.offset_n, 1.0 - decay.slow));
            now.offset_n = vec3::scale(before.offset_n, decay.slow);
            if now.is_substituted_otherwise(&before) {
                now.offset_n = vec3::sub(before.force_n, own_n);
                self.hand_overs = self.hand_overs.wrapping_add(1);
            }
            now.force_n = vec3::add(own_n, now.offset_n);
        }
        self.whole = Some(now);
        let is_covered = is_covered && finite.is_some();
        let at = (touch.now_us, touch.hip_m);
        let force_n = self.ladder.apply(at, now.force_n, is_covered, self.solver);
        let coverage = if is_covered { Coverage::Scattered } else { Coverage::Extrapolated };
        Some(ForceSample { force_n, coverage })
    }

    /// With the factor of the ladder, as the force. A point without jets takes the mean of the others.
    fn energy_j(&self, space: u16, displacement_m: Vec3) -> Option<f32> {
        let of = |space: u16| {
            let place = self.place(space)?;
            if place.table.model() != self.model && place.tick != self.tick {
                return None;
            }
            place.table.energy_j(displacement_m, self.second_m, place.tick == self.tick)
        };
        let mean = || {
            let nodes = self.whole?.weights;
            let known = |node: &NodeWeight| Some((node.weight, of(node.space)?));
            let held = nodes.iter().filter(|node| node.weight > 0.0).filter_map(known);
            let add =
                |(sum, all): (f32, f32), (weight, energy): (f32, f32)| (sum + weight * energy, all + weight);
            let (sum, all) = held.fold((0.0, 0.0), add);
            Some(if all > 0.0 { sum / all } else { 0.0 })
        };
        Some(of(space).or_else(mean)? * self.ladder.gain())
    }

    /// Not while others stand in for a point, whose energy is then unknown: the difference of two energies would drive the
    /// slip, though a third one may balance it. A touch that sticks takes no energy from the body. After a while it slips all
    /// the same: the solver may have found nothing there.
    fn slips(&self) -> bool {
        let stuck_us = |whole: Whole| Some(whole.now_us.saturating_sub(whole.partial_since_us?));
        self.whole.and_then(stuck_us).is_none_or(|stuck_us| stuck_us > STICK_US)
    }

    /// With the factor of the ladder, as the force.
    fn turning_n(&self) -> Vec3 {
        vec3::scale(self.turning.slope_n(), self.ladder.gain())
    }

    fn released(&mut self, now_us: u64) {
        (self.whole, self.turning, self.stiffest_fixed) = (None, Turning::default(), Stiffest::default());
        self.tick += 1;
        self.faded_n = vec3::ZERO;
        self.ladder.free(now_us, self.solver);
    }

    fn stiffest_n_m(&self, force_n: f32) -> f32 {
        self.stiffest.below_n_m(force_n).max(self.stiffest_fixed.below_n_m(force_n))
    }

    fn is_lost(&self) -> bool {
        self.solver == Solver::Gone && self.ladder.is_faded()
    }
}

impl Whole {
    /// Whether points get the force of other points than in the last tick: then it jumps.
    fn is_substituted_otherwise(&self, before: &Self) -> bool {
        self.partial_since_us.or(before.partial_since_us).is_some()
            && !(self.is_within(before) && before.is_within(self))
    }

    /// Whether the points that give a force of their own also did in another tick.
    fn is_within(&self, other: &Self) -> bool {
        let has = |of: &Self, space: u16| {
            of.weights.iter().zip(of.counts).any(|(node, has)| has && node.space == space)
        };
        self.weights.iter().zip(self.counts).all(|(node, is)| !is || has(other, node.space))
    }
}

/// Factors of the fades for the time since the last tick.
fn decay(elapsed_us: u64) -> Decay {
    let elapsed_us = elapsed_us as f64;
    let q = [elapsed_us / FAST_US, elapsed_us / SLOW_US, elapsed_us / CHANGE_US, 0.0];
    let [fast, slow, change, _] = Baseline.to_array_f64(exp_of_minus(Baseline, Baseline.load_f64(&q)));
    Decay { fast: fast as f32, slow: slow as f32, change: change as f32 }
}
