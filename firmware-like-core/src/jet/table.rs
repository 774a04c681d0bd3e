//! The jets of one contact point, which of them is active, and the fade from one to the next.
//!
//! The active jet has the least |d - d_k| / rho_k; another one must be nearer by a tenth to take over. At every
//! change of it, whether it was replaced, removed or left, the difference of the forces becomes an offset that
//! decays:
//!
//! o += h_old(d) - h_new(d),   o *= exp(-dt / tau)
//!
//! with tau = 10 ms, and 100 ms after a change of the body's model. A jump of the body has no time of its own: its true
//! force jumps at once. The difference of the energies, by which the tool slips, decays alike.

use super::frame::Jet;
use super::trusted::limited;
use crate::method::ForceSample;
use crate::num::vec3::{self, Vec3};

/// Jets that the search compares side by side.
const LANES: usize = 8;
/// Share of the active jet's distance, in trust radii, within which another one takes over, squared.
const NEARER: f32 = 0.9 * 0.9;
/// Controls closer than this are the same, metres.
const SAME_M: f32 = 1e-6;
/// Coordinate of an unused place: with its factor of 1e12 it is further than any displacement from any jet.
const UNUSED: (f32, f32) = (1e9, 1e12);
/// An offset below this is set to zero, newtons.
const NOTHING_N: f32 = 1e-5;
/// The same, joules.
const NOTHING_J: f32 = 1e-8;
/// A jet contradicts another one at its control beyond this force, newtons.
const CONTRADICTION_N: f32 = 0.1;
/// The same, as a share of the force.
const CONTRADICTION_SHARE: f32 = 0.1;

/// Factors by which offsets decay in one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Decay {
    /// 10 ms.
    pub(super) fast: f32,
    /// 30 ms, for what no table owns.
    pub(super) slow: f32,
    /// 100 ms.
    pub(super) change: f32,
}

/// A hand-over with a larger difference fades as slowly as a change of the model: where a hand overcomes the device and the
/// tool goes through a wall, N.
const LARGE_N: f32 = 4.0;

/// How fast an offset decays, the faster first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Fade {
    Fast,
    Change,
}

impl Decay {
    fn of(self, fade: Fade) -> f32 {
        match fade {
            Fade::Fast => self.fast,
            Fade::Change => self.change,
        }
    }
}

/// The jet that gave the force in the last tick. It is a copy, so that its force is known after it was
/// replaced or removed.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Active {
    slot: usize,
    stamp: u32,
    jet: Jet,
}

/// What the search reads, apart from the jets: 16 bytes a jet.
#[derive(Debug, Clone, PartialEq)]
struct Search<const JETS: usize> {
    x: [f32; JETS],
    y: [f32; JETS],
    z: [f32; JETS],
    /// 1 / rho^2
    per_trust2: [f32; JETS],
}

/// The second control for the search: far from all others without one.
fn place_of(second_m: Option<Vec3>) -> Vec3 {
    second_m.unwrap_or([Jet::PARTED_M, 0.0, 0.0])
}

/// The jets of one contact point.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Table<const JETS: usize> {
    jets: [Jet; JETS],
    /// Number of the insertion of each jet.
    stamps: [u32; JETS],
    len: usize,
    search: Search<JETS>,
    active: Option<Active>,
    offset_n: Vec3,
    /// The same of the energy.
    offset_j: f32,
    /// How fast the offsets decay.
    fade: Fade,
    /// How the next hand-over fades: the model of the body may have changed since the last tick.
    next: Fade,
    /// Model of the jets.
    model: u32,
    /// Whether a jet had a second control.
    is_coupled: bool,
}

/// The force of a table in one tick.
pub(super) struct Answer {
    pub(super) sample: ForceSample,
    /// The active jet has changed while the tool touched.
    pub(super) is_handed_over: bool,
    /// What the fades of earlier changes took from the force since the last tick, N.
    pub(super) faded_n: Vec3,
    /// |h| and |S| of another jet of the fixed part, which takes over.
    pub(super) of_fixed: Option<(f32, f32)>,
}

impl<const JETS: usize> Table<JETS> {
    pub(super) fn new() -> Self {
        const { assert!(JETS > 0 && JETS.is_multiple_of(LANES), "a multiple of 8 jets") };
        let (far, factor) = UNUSED;
        let search = Search { x: [far; JETS], y: [0.0; JETS], z: [0.0; JETS], per_trust2: [factor; JETS] };
        Self {
            jets: [Jet::default(); JETS],
            stamps: [0; JETS],
            len: 0,
            search,
            active: None,
            offset_n: vec3::ZERO,
            offset_j: 0.0,
            fade: Fade::Fast,
            next: Fade::Fast,
            model: 0,
            is_coupled: false,
        }
    }

    /// Forgets all jets, for those of another contact point.
    pub(super) fn clear(&mut self) {
        self.change(self.model);
        self.active = None;
    }

    /// Forgets all jets, for those of another model. The force goes on from that of the last tick.
    fn change(&mut self, model: u32) {
        while let Some(last) = self.len.checked_sub(1) {
            self.remove(last);
        }
        (self.model, self.next, self.is_coupled) = (model, Fade::Change, false);
    }

    /// Model of the jets.
    pub(super) const fn model(&self) -> u32 {
        self.model
    }

    pub(super) const fn len(&self) -> usize {
        self.len
    }

    /// The jets.
    fn known(&self) -> &[Jet] {
        self.jets.get(..self.len).unwrap_or_default()
    }

    /// Adds a checked jet. `stamp` is different for each insertion.
    ///
    /// A jet with the same controls is replaced. In a full table the one farthest from the new jet is: the solver, which
    /// does the same, knows what is left.
    pub(super) fn insert(&mut self, jet: &Jet, stamp: u32) {
        self.is_coupled |= jet.coupling.is_some();
        if jet.model != self.model {
            self.change(jet.model);
        }
        if jet.flags.flush_before {
            self.flush(jet);
        }
        let is_same = |known: &Jet| {
            vec3::distance(known.control_m, jet.control_m) <= SAME_M
                && vec3::distance(second_of(known), second_of(jet)) <= SAME_M
        };
        let slot = match self.known().iter().position(is_same) {
            Some(slot) => slot,
            None if self.len < JETS => {
                self.len += 1;
                self.len - 1
            }
            None => self.farthest(jet),
        };
        self.put(slot, Some((jet, stamp)));
    }

    /// Writes a place, or marks it as unused.
    fn put(&mut self, slot: usize, content: Option<(&Jet, u32)>) {
        let (far, factor) = UNUSED;
        let ([x, y, z], per_trust2) = match content {
            Some((jet, _)) => (jet.control_m, jet.per_trust2()),
            None => ([far, 0.0, 0.0], factor),
        };
        let Search { x: xs, y: ys, z: zs, per_trust2: factors } = &mut self.search;
        for (row, value) in [(xs, x), (ys, y), (zs, z), (factors, per_trust2)] {
            if let Some(place) = row.get_mut(slot) {
                *place = value;
            }
        }
        if let Some((jet, stamp)) = content
            && let (Some(place), Some(number)) = (self.jets.get_mut(slot), self.stamps.get_mut(slot))
        {
            (*place, *number) = (*jet, stamp);
        }
    }

    /// Removes a jet; the last one takes its place.
    fn remove(&mut self, slot: usize) {
        let Some(last) = self.len.checked_sub(1) else { return };
        move_within(&mut self.jets, last, slot);
        move_within(&mut self.stamps, last, slot);
        let Search { x, y, z, per_trust2 } = &mut self.search;
        for row in [x, y, z, per_trust2] {
            move_within(row, last, slot);
        }
        self.put(last, None);
        self.len = last;
    }

    /// Removes the jets that contradict a new one at its control.
    fn flush(&mut self, new: &Jet) {
        let second_m = new.coupling.map(|coupling| coupling.control_m);
        let new_n = new.force(new.control_m).force_n;
        let most_n = CONTRADICTION_N.max(CONTRADICTION_SHARE * vec3::norm(new_n));
        let mut slot = self.len;
        // From the end: the jet that takes the place of a removed one was examined already.
        while let Some(before) = slot.checked_sub(1) {
            slot = before;
            let differs = |jet: &Jet| {
                let known = if self.is_coupled {
                    jet.force_beside(new.control_m, second_m)
                } else {
                    jet.force(new.control_m)
                };
                vec3::distance(known.force_n, new_n) > most_n
            };
            if self.known().get(slot).is_some_and(differs) {
                self.remove(slot);
            }
        }
    }

    fn farthest(&self, new: &Jet) -> usize {
        let (mut slot, mut most) = (0, -1.0);
        for (at, jet) in self.known().iter().enumerate() {
            let parted_m =
                if self.is_coupled { vec3::sub(second_of(jet), second_of(new)) } else { vec3::ZERO };
            let squared =
                vec3::norm_squared(vec3::sub(jet.control_m, new.control_m)) + vec3::norm_squared(parted_m);
            if squared > most {
                (slot, most) = (at, squared);
            }
        }
        slot
    }

    /// h at a limited displacement; `None` without jets.
    ///
    /// `is_continued`: the tool has touched the point in the last tick too. Otherwise there is no offset.
    pub(super) fn force(
        &mut self,
        d: Vec3,
        second_m: Option<Vec3>,
        decay: Decay,
        is_continued: bool,
    ) -> Option<Answer> {
        let before = self.active.take().filter(|_| is_continued);
        let next = core::mem::replace(&mut self.next, Fade::Fast);
        let (slot, squared) = self.nearest(d, second_m)?;
        if before.is_none() {
            (self.offset_n, self.offset_j, self.fade) = (vec3::ZERO, 0.0, Fade::Fast);
        }
        let begins = before.is_none() && !is_continued;
        let is_kept = |active: &Active| {
            let is_known = active.slot < self.len && self.stamps.get(active.slot) == Some(&active.stamp);
            is_known && squared >= NEARER * self.squared(active.slot, d, second_m)
        };
        let kept = before.filter(is_kept);
        let active = match kept {
            Some(active) => active,
            None => Active { slot, stamp: *self.stamps.get(slot)?, jet: *self.jets.get(slot)? },
        };
        let sample = active.jet.force_beside(d, second_m);
        let faded_n = vec3::scale(self.offset_n, 1.0 - decay.of(self.fade));
        self.offset_n = vec3::scale(self.offset_n, decay.of(self.fade));
        self.offset_j *= decay.of(self.fade);
        if vec3::max_abs(self.offset_n) < NOTHING_N && self.offset_j.abs() < NOTHING_J {
            (self.offset_n, self.offset_j, self.fade) = (vec3::ZERO, 0.0, Fade::Fast);
        }
        let left = if kept.is_none() { before } else { None };
        if let Some(left) = &left {
            let left_n = left.jet.force_beside(d, second_m).force_n;
            let difference_n = vec3::sub(left_n, sample.force_n);
            self.offset_n = vec3::add(self.offset_n, difference_n);
            let of = |jet: &Jet| jet.energy_beside_j(d, second_m);
            self.offset_j += of(&left.jet) - of(&active.jet);
            let is_large = vec3::norm(difference_n) > LARGE_N;
            self.fade = self.fade.max(if is_large { Fade::Change } else { next });
        }
        if begins && active.jet.flags.root {
            // A sphere comes to a body without force, whatever a jet far away says.
            self.offset_n = vec3::scale(sample.force_n, -1.0);
        }
        self.active = Some(active);
        let force_n = vec3::add(sample.force_n, self.offset_n);
        let is_handed_over = left.is_some();
        let of_fixed = (kept.is_none() && active.jet.flags.fixed)
            .then(|| (active.jet.force_size_n(), active.jet.stiffness_size_n_m()));
        Some(Answer { sample: ForceSample { force_n, ..sample }, is_handed_over, faded_n, of_fixed })
    }

    /// dW/dq of the active jet.
    pub(super) fn slope_n(&self, d: Vec3, second_m: Vec3) -> Vec3 {
        self.active.as_ref().map_or(vec3::ZERO, |active| active.jet.slope_beside(d, second_m))
    }

    /// W of the active jet with its fade if the point is touched, otherwise of the nearest one; `None` without jets.
    pub(super) fn energy_j(
        &self,
        displacement_m: Vec3,
        second_m: Option<Vec3>,
        is_touched: bool,
    ) -> Option<f32> {
        let active = self.active.as_ref().map(|active| &active.jet).filter(|_| is_touched);
        let nearest =
            || self.jets.get(self.nearest(limited(displacement_m).unwrap_or_default(), second_m)?.0);
        let faded_j = if active.is_some() { self.offset_j } else { 0.0 };
        Some(active.or_else(nearest)?.energy_beside_j(displacement_m, second_m) + faded_j)
    }

    /// The same with second controls.
    // On its own, so that it costs a tool without one nothing.
    #[inline(never)]
    fn nearest_of_both(&self, d: Vec3, second_m: Option<Vec3>) -> Option<(usize, f32)> {
        let mut best: Option<(usize, f32)> = None;
        for slot in 0..self.len {
            let squared = self.squared(slot, d, second_m);
            if best.is_none_or(|(_, least)| squared < least) {
                best = Some((slot, squared));
            }
        }
        best
    }

    /// (|d - d_k| / rho_k)^2; with second controls the distance is that of both together.
    fn squared(&self, slot: usize, d: Vec3, second_m: Option<Vec3>) -> f32 {
        self.jets.get(slot).map_or(f32::MAX, |jet| {
            let parted2 = if self.is_coupled {
                vec3::norm_squared(vec3::sub(second_of(jet), place_of(second_m)))
            } else {
                0.0
            };
            (vec3::norm_squared(vec3::sub(jet.control_m, d)) + parted2) * jet.per_trust2()
        })
    }

    /// The nearest jet in trust radii and the square of that distance; the earliest place of equal ones.
    ///
    /// Cost: eight jets side by side, without a branch.
    fn nearest(&self, [dx, dy, dz]: Vec3, second_m: Option<Vec3>) -> Option<(usize, f32)> {
        if self.is_coupled {
            return self.nearest_of_both([dx, dy, dz], second_m);
        }
        let Search { x, y, z, per_trust2 } = &self.search;
        let blocks = x.chunks_exact(LANES).zip(y.chunks_exact(LANES));
        let blocks = blocks.zip(z.chunks_exact(LANES).zip(per_trust2.chunks_exact(LANES)));
        let (mut least, mut places) = ([f32::MAX; LANES], [0_u32; LANES]);
        for (block, ((x, y), (z, factor))) in (0_u32..).zip(blocks).take(self.len.div_ceil(LANES)) {
            let row = |of: &[f32]| of.first_chunk::<LANES>().copied().unwrap_or_default();
            let (x, y, z, factor) = (row(x), row(y), row(z), row(factor));
            for lane in 0..LANES {
                let (rx, ry, rz) = (x[lane] - dx, y[lane] - dy, z[lane] - dz);
                let squared = (rx * rx + ry * ry + rz * rz) * factor[lane];
                let is_nearer = squared < least[lane];
                least[lane] = if is_nearer { squared } else { least[lane] };
                places[lane] = if is_nearer { block } else { places[lane] };
            }
        }
        let mut best = None;
        for (lane, (squared, block)) in least.into_iter().zip(places).enumerate() {
            let slot = block as usize * LANES + lane;
            let is_better = |(other, most): (usize, f32)| squared < most || (squared == most && slot < other);
            if slot < self.len && best.is_none_or(is_better) {
                best = Some((slot, squared));
            }
        }
        best
    }
}

/// Copies an element to an earlier place.
fn move_within<T: Copy>(all: &mut [T], from: usize, to: usize) {
    if let Some((before, after)) = all.split_at_mut_checked(from)
        && let (Some(place), Some(moved)) = (before.get_mut(to), after.first())
    {
        *place = *moved;
    }
}

/// The second control of a jet for the search.
fn second_of(jet: &Jet) -> Vec3 {
    place_of(jet.coupling.as_ref().map(|coupling| coupling.control_m))
}
