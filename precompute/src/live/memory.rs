//! What is known: the jets of every contact, how far each is trusted, and how fast their error grows.

use nalgebra::{Matrix3, Vector3};

use super::beyond::{MIN_LEVELLING_M, continued, nearness, parted_m, straight_on};
use crate::fem::{Coupling, Second};
use crate::num::jet::{EnergyJet, SymmetricThird, THIRD_INDICES};
use crate::num::vector::{distance, norm};
use crate::spec::Tolerance;

/// Largest distance to which a jet is trusted, m.
const MAX_TRUST_M: f64 = 0.025;
/// Smallest one, m: near a fold W_ijk has any size.
const MIN_TRUST_M: f64 = 1e-4;
/// Jets of a contact that the loop keeps.
pub(super) const MAX_JETS: usize = 256;
/// Jets that a contact that is touched has room for at first.
const FEW_JETS: usize = 32;
/// Largest stiffness of a jet, in those of the contact at rest. Near a fold S has any size too.
const MAX_STIFFNESS: f64 = 3.0;
/// Estimated error c r^3 of a Taylor series before one was measured, N/m^3.
const FIRST_ERROR: f64 = 1e4;
/// The same of a sphere, and the least that is left of it. On the small organ the median of the error is 20 mN at 3 mm,
/// which is 7e5, and one position in five is off by more than the tolerance.
const SPHERE_ERROR: f64 = 4e6;
const LEAST_SPHERE_ERROR: f64 = 2e6;
/// A touch with less energy has that of a contact of Hertz, J.
const LEAST_ROOT_J: f64 = 3e-6;
/// W (n.S n) / |h|^2 of a contact of Hertz.
const HERTZ: f64 = 0.6;
/// A touch below this force has no root, N.
const LEAST_FORCE_N: f64 = 1e-4;
/// The jet of a light touch is trusted to this multiple of the distance to the first touch,
const BEYOND_FIRST: f64 = 1.3;
/// and a touch is light if that is below this, m.
const LIGHT_M: f64 = 3e-3;
/// Share of the last estimate that a better measurement leaves.
const FORGETTING: f64 = 0.7;
/// Shortest distance at which the error of a series is measured, m.
const MIN_MEASURED_M: f64 = 5e-4;
/// A position is known within this share of the trust radius.
const KNOWN_TRUST: f64 = 0.5;
/// Jets whose force is off by more than both at a state on another branch are removed.
const FLUSH_N: f64 = 0.1;
const FLUSH_SHARE: f64 = 0.1;
/// A jet replaces one that is nearer than this, m.
const SAME_M: f64 = 1e-6;

/// A jet as the loop gets it: limited in stiffness, with the radius to which its Taylor series is trusted.
///
/// rho = |S_rest| / |W_ijk|, at most 25 mm: there the third-order term has doubled or cancelled a stiffness like
/// that at rest. Stiffness and third derivatives are reduced alike to |S| <= 3 |S_rest|.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trust {
    /// The limited jet.
    pub jet: EnergyJet,
    /// That of s = sqrt(2 W), where the loop gets it instead.
    pub root: Option<EnergyJet>,
    /// rho, m.
    pub radius_m: f64,
    /// How its force depends on a second control, if there is one.
    pub coupling: Option<Coupling>,
    /// Whether most of the force is that of the fixed part.
    pub is_of_fixed_part: bool,
}

impl Trust {
    /// The jet of a contact with this |S| at rest, N/m.
    pub(super) fn of(mut jet: EnergyJet, rest_n_m: f64) -> Self {
        let size = jet.stiffness_n_m.norm();
        let limit = MAX_STIFFNESS * rest_n_m;
        if size > limit {
            jet.stiffness_n_m *= limit / size;
            jet.third_n_m2 = jet.third_n_m2.map(|third| third * (limit / size));
        }
        let third = third_norm(&jet.third_n_m2);
        let radius_m = (rest_n_m / third).clamp(MIN_TRUST_M, MAX_TRUST_M);
        // At the smallest radius the third derivatives would still change the stiffness by any amount.
        let most = rest_n_m / radius_m;
        if third > most {
            jet.third_n_m2 = jet.third_n_m2.map(|one| one * (most / third));
        }
        Self { jet, root: None, radius_m, coupling: None, is_of_fixed_part: false }
    }

    /// The jet of a tool that touches nothing at rest: by its root, where the third derivatives change the slope of s
    /// by half within the radius. A light touch is trusted beyond the place where s is zero, which is that of the first
    /// touch. The lightest ones keep their jet, because the root of zero has no derivatives.
    ///
    /// Beside a partner the energy that the tool adds is a small difference of large ones, and takes a solve of the partner
    /// alone: the root is that of a contact of Hertz.
    fn of_root(jet: EnergyJet, coupling: Option<Coupling>) -> Option<Self> {
        let is_beside = coupling.is_some_and(|coupling| coupling.of == Second::Partner);
        let exact = if is_beside { None } else { jet.root(LEAST_ROOT_J) };
        let root = exact.or_else(|| hertz_root(&jet))?;
        let slope = norm(root.force_n);
        let first_m = BEYOND_FIRST * root.energy_j / slope;
        let least_m = if first_m <= LIGHT_M { first_m } else { 0.0 };
        let radius_m = (slope / third_norm(&root.third_n_m2)).sqrt().max(least_m);
        Some(Self {
            jet,
            root: Some(root),
            radius_m: radius_m.clamp(MIN_TRUST_M, MAX_TRUST_M),
            is_of_fixed_part: false,
            coupling: coupling.map(|of| match exact {
                Some(_) => of.of_exact_root(&root),
                None => of.of_root(&root),
            }),
        })
    }

    /// It is trusted no farther than this, m.
    pub(super) fn shrink_to(&mut self, radius_m: f64) {
        self.radius_m = self.radius_m.min(radius_m).max(MIN_TRUST_M);
    }

    /// h at a control, with a second one, as the loop has it, N.
    fn force_n(&self, control_m: [f64; 3], second_m: Option<[f64; 3]>) -> [f64; 3] {
        let (value, slope) = match &self.root {
            Some(root) => straight_on(root, self.radius_m, control_m),
            None => continued(&self.jet, self.radius_m, control_m),
        };
        let change = self.coupling.zip(second_m).map(|(of, at_m)| {
            let away_m = distance(self.jet.control_m, control_m);
            let most_m = self.radius_m + 3.0 * self.radius_m.max(MIN_LEVELLING_M);
            let share = (most_m / away_m.max(f64::MIN_POSITIVE)).min(1.0);
            let from_m = std::array::from_fn(|k| share * (control_m[k] - self.jet.control_m[k]));
            of.change(at_m, self.radius_m, from_m)
        });
        let (more, steeper) = change.unwrap_or_default();
        let nearness = nearness(self.radius_m, distance(self.jet.control_m, control_m));
        let root = if self.root.is_some() { nearness * (value + more).max(0.0) } else { 1.0 };
        std::array::from_fn(|k| root * (slope[k] + steeper[k]))
    }

    fn second_m(&self) -> Option<[f64; 3]> {
        self.coupling.map(|coupling| coupling.second_m)
    }

    /// Distance from a control, with a second one, m: that of both together.
    fn away_m(&self, control_m: [f64; 3], second_m: Option<[f64; 3]>) -> f64 {
        let gap_m = parted_m(self.second_m(), second_m);
        libm::hypot(distance(self.jet.control_m, control_m), gap_m)
    }

    /// Whether another jet has nearly the force of this one at its control, by the rule of the loop.
    pub(super) fn agrees(&self, other: &Self) -> bool {
        let limit_n = FLUSH_N.max(FLUSH_SHARE * norm(self.jet.force_n));
        distance(other.force_n(self.jet.control_m, self.second_m()), self.jet.force_n) <= limit_n
    }
}

/// The root with the energy of a contact of Hertz, W = 0.6 |h|^2 / (n.S n), where |h| ~ depth^(3/2) along n = h / |h|. Its force
/// and its first and second derivatives are those of the jet, as with any positive energy. `None` without a stiffness.
fn hertz_root(jet: &EnergyJet) -> Option<EnergyJet> {
    let force_n = Vector3::from(jet.force_n);
    let stiffness_n_m = (jet.stiffness_n_m * force_n).dot(&force_n) / force_n.norm_squared();
    let is_stiff = force_n.norm() > LEAST_FORCE_N && stiffness_n_m > 0.0;
    let energy_j = HERTZ * force_n.norm_squared() / stiffness_n_m;
    is_stiff.then(|| EnergyJet { energy_j, ..*jet }.root(0.0)).flatten()
}

/// |W_ijk| over all 27 components.
fn third_norm(third: &SymmetricThird) -> f64 {
    let square = |(&[i, j, k], value): (&[usize; 3], &f64)| {
        let orders = match (i == j, j == k) {
            (true, true) => 1.0,
            (false, false) => 6.0,
            _ => 3.0,
        };
        orders * value * value
    };
    THIRD_INDICES.iter().zip(third).map(square).sum::<f64>().sqrt()
}

/// The jets of one contact.
#[derive(Debug, Clone, Default)]
pub(super) struct Known {
    /// Jets and their branches.
    jets: Vec<(Trust, u32)>,
    /// |S| at rest, or another stiffness to compare with, N/m; 0 before the first jet.
    rest_n_m: f64,
    /// Whether the jets are those of s = sqrt(2 W).
    is_of_roots: bool,
    /// Distance from a jet up to which its branch is known by tables, m.
    tabled_m: f64,
    /// The second control now, if there is one.
    second_m: Option<[f64; 3]>,
}

impl Known {
    /// Without jets. Of a tool that touches nothing at rest jets are compared with this stiffness, N/m.
    pub(super) fn of_stiffness(rest_n_m: Option<f64>) -> Self {
        Self { rest_n_m: rest_n_m.unwrap_or(0.0), is_of_roots: rest_n_m.is_some(), ..Self::default() }
    }

    /// The second control is this one now.
    pub(super) fn face(&mut self, second_m: Option<[f64; 3]>) {
        self.second_m = second_m;
    }

    pub(super) fn is_empty(&self) -> bool {
        self.jets.is_empty()
    }

    pub(super) fn jets(&self) -> impl ExactSizeIterator<Item = &Trust> {
        self.jets.iter().map(|(trust, _)| trust)
    }

    /// The jet with the smallest distance in trust radii, as the loop chooses it, and this distance in metres;
    /// `None` if it lies on another branch.
    pub(super) fn nearest(&self, control_m: [f64; 3], branch: u32) -> Option<(&Trust, f64)> {
        let away_m = |trust: &Trust| trust.away_m(control_m, self.second_m);
        let by = |(trust, _): &(Trust, u32)| away_m(trust) / trust.radius_m;
        let (nearest, of) = self.jets.iter().min_by(|a, b| by(a).total_cmp(&by(b)))?;
        (*of == branch).then(|| (nearest, away_m(nearest)))
    }

    /// Largest error c r^3 of a series near a control, in c, that the others show there, N/m^3: two series, r_1 and r_2 away, whose
    /// errors are c r^3 differ by at most c (r_1^3 + r_2^3).
    fn contradiction_n_m3(&self, control_m: [f64; 3], branch: u32, (nearest, r_m): (&Trust, f64)) -> f64 {
        let force_n = nearest.force_n(control_m, self.second_m);
        let others = self.jets.iter().filter_map(|(trust, of)| {
            let away_m = trust.away_m(control_m, self.second_m);
            let is_near = *of == branch && away_m <= trust.radius_m && away_m > MIN_MEASURED_M;
            let cubes_m3 = away_m.powi(3) + r_m.powi(3);
            is_near.then(|| distance(trust.force_n(control_m, self.second_m), force_n) / cubes_m3)
        });
        others.fold(0.0, f64::max)
    }

    /// The jets are those of tables, which lie no farther apart than twice this distance, m.
    pub(super) fn are_tabled(&mut self, within_m: f64) {
        self.tabled_m = within_m;
    }

    /// Whether a jet of a branch lies within a distance, and within the share of its trust where it is known.
    pub(super) fn has_near(&self, control_m: [f64; 3], branch: u32, within_m: f64) -> bool {
        let is_near = |(trust, of): &(Trust, u32)| {
            let within_m = within_m.min(KNOWN_TRUST * trust.radius_m).max(self.tabled_m);
            *of == branch && trust.away_m(control_m, self.second_m) < within_m
        };
        self.jets.iter().any(is_near)
    }

    /// Number of jets that [`Self::keep_rest`] gives up.
    pub(super) fn away_from_rest(&self) -> usize {
        if self.tabled_m > 0.0 { 0 } else { self.jets.len().saturating_sub(1) }
    }

    /// Gives up all jets but that at rest. Those of tables are kept, because they would not be solved again.
    pub(super) fn keep_rest(&mut self) {
        if self.away_from_rest() > 0 {
            // In a room of its own: the whole old one is free for another contact.
            let rest = self.jets.iter().filter(|(trust, _)| norm(trust.jet.control_m) < SAME_M);
            self.jets = rest.copied().collect();
        }
    }

    /// The first jet is that at rest: it defines the trust of all.
    pub(super) fn trust(&mut self, jet: EnergyJet, coupling: Option<Coupling>) -> Trust {
        if self.is_of_roots
            && let Some(trust) = Trust::of_root(jet, coupling)
        {
            return trust;
        }
        if self.rest_n_m == 0.0 {
            self.rest_n_m = stiffness(&jet.stiffness_n_m);
        }
        Trust { coupling, ..Trust::of(jet, self.rest_n_m) }
    }

    /// Adds a jet of a branch; with `flush` it removes those that contradict it. A jet at the same control is
    /// replaced.
    pub(super) fn add(&mut self, trust: Trust, branch: u32, flush: bool) {
        self.jets.retain(|(old, _)| {
            let same = old.away_m(trust.jet.control_m, trust.second_m()) < SAME_M;
            !same && (!flush || trust.agrees(old))
        });
        if self.jets.len() == MAX_JETS {
            let away = |(old, _): &(Trust, u32)| old.away_m(trust.jet.control_m, trust.second_m());
            let all = self.jets.iter().enumerate();
            let farthest = all.max_by(|(_, a), (_, b)| away(a).total_cmp(&away(b))).map(|(at, _)| at);
            self.jets.swap_remove(farthest.expect("it is full"));
        }
        // Most contacts have the jet at rest only, and most others a few.
        if self.jets.len() == 1 {
            self.jets.reserve_exact(FEW_JETS - 1);
        }
        self.jets.push((trust, branch));
    }
}

/// Never zero, because radii are divided by it.
fn stiffness(stiffness_n_m: &Matrix3<f64>) -> f64 {
    stiffness_n_m.norm().max(f64::MIN_POSITIVE)
}

/// From which estimated error on a position is solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Limit {
    /// It may soon be felt.
    Unknown,
    /// There is time to improve it.
    Rough,
}

impl Limit {
    /// As a share of the tolerance.
    fn share(self) -> f64 {
        match self {
            Self::Unknown => 0.15,
            Self::Rough => 0.02,
        }
    }
}

/// How fast the error of a Taylor series grows: c r^3, with c the largest that was measured lately.
#[derive(Debug, Clone, Copy)]
pub(super) struct Growth {
    error_n_m3: f64,
    least_n_m3: f64,
}

impl Growth {
    /// Before an error was measured: of a tool that stays at its place of the skin, or of a sphere, which comes to other
    /// edges of the skin within millimetres.
    pub(super) fn first(is_sphere: bool) -> Self {
        let (error_n_m3, least_n_m3) =
            if is_sphere { (SPHERE_ERROR, LEAST_SPHERE_ERROR) } else { (FIRST_ERROR, 0.0) };
        Self { error_n_m3, least_n_m3 }
    }

    /// Compares the series of the nearest jet with what was solved. Every solve is thus a check of the model.
    pub(super) fn measure(&mut self, known: &Known, solved: &EnergyJet, branch: u32) {
        // Where a tool touches nothing there is no error to learn from.
        if solved.is_free() {
            return;
        }
        self.error_n_m3 = (self.error_n_m3 * FORGETTING).max(self.least_n_m3);
        let Some((nearest, r_m)) = known.nearest(solved.control_m, branch) else { return };
        if r_m > MIN_MEASURED_M && r_m <= nearest.radius_m {
            let error_n = distance(nearest.force_n(solved.control_m, known.second_m), solved.force_n);
            self.error_n_m3 = self.error_n_m3.max(error_n / (r_m * r_m * r_m));
        }
    }

    /// Whether the force of a contact with this weight is known to a limit at a control on a branch.
    pub(super) fn knows(
        &self,
        known: &Known,
        (control_m, branch): ([f64; 3], u32),
        weight: f64,
        limit: Limit,
    ) -> bool {
        known.nearest(control_m, branch).is_some_and(|(nearest, r_m)| {
            let shown_n_m3 = known.contradiction_n_m3(control_m, branch, (nearest, r_m));
            let error_n = self.error_n_m3.max(shown_n_m3) * r_m * r_m * r_m;
            // Where no error can be measured nothing would be gained.
            let is_small =
                weight * error_n < limit.share() * Tolerance::IMPERCEPTIBLE.at(nearest.jet.force_n);
            (is_small || r_m <= MIN_MEASURED_M) && r_m < KNOWN_TRUST * nearest.radius_m
        })
    }
}

#[cfg(test)]
mod tests;
