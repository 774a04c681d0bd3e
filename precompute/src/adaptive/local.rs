//! The fits that the points of a table take their values from.
//!
//! The fit of a space is one for all of it. A chart of a sphere's field has a fit for each small block of it instead, to a
//! few configurations round it. The energy of a contact bends sharply where the sphere comes to other edges of the skin, and an
//! organ has several equilibria: a fit through configurations that do not belong together oscillates between them. So the
//! nearest ones are taken of which each agrees with the one nearest to it among those already taken: the Taylor series of
//! either predicts the other.

use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;

use nalgebra::Vector3;

use super::AdaptiveFit;
use super::branch::agree;
use crate::fit::{Base, KernelFit, KernelSystem, LEAST_ROOT_J};
use crate::num::jet::EnergyJet;
use crate::num::vector::distance;
use crate::spec::Quantity;

/// Edge of a block, as a share of the kernel's length.
const BLOCK: f64 = 0.5;
/// Number of configurations of its fit, and number of the nearest ones that they are chosen from.
const DATA: usize = 12;
const NEAREST: usize = 36;

/// Distance beside the body beyond which the tangent replaces the fit, as a share of the kernel's length. Nearer, where the
/// cells of the table reach into the body, it does if the slope of the fit is below the other share of the tangent's.
const BESIDE: f64 = 0.3;
const LEAST_SLOPE: f64 = 0.6;

/// The fits of a search.
pub(super) struct Fits<'s> {
    search: &'s AdaptiveFit,
    whole: Rc<KernelFit>,
    blocks: RefCell<HashMap<[i32; 3], Rc<KernelFit>>>,
}

impl<'s> Fits<'s> {
    pub(super) fn of(search: &'s AdaptiveFit) -> Self {
        Self { search, whole: Rc::new(search.fit.clone()), blocks: RefCell::default() }
    }

    /// The fit for a displacement, m.
    pub(super) fn at(&self, displacement_m: [f64; 3]) -> Rc<KernelFit> {
        if self.search.wanted.quantity == Quantity::Energy {
            return self.whole.clone();
        }
        let edge_m = BLOCK * self.search.fit.length_m;
        let block = displacement_m.map(|x| (x / edge_m).floor() as i32);
        let middle_m = block.map(|n| (f64::from(n) + 0.5) * edge_m);
        let mut blocks = self.blocks.borrow_mut();
        blocks.entry(block).or_insert_with(|| Rc::new(self.fit(&self.chosen(middle_m)))).clone()
    }

    /// Whether a displacement is so near to a configuration that its fit is one.
    pub(super) fn reach(&self, displacement_m: [f64; 3]) -> bool {
        let length_m = self.search.fit.length_m;
        self.search.jets.iter().any(|jet| distance(jet.control_m, displacement_m) <= length_m)
    }

    /// Value and slope of a root beside the body, where only its sign counts: the tangent at the nearest configuration. A fit
    /// would follow the curvature of the first touch and rise again. `None` where the fit holds.
    pub(super) fn beside(&self, displacement_m: [f64; 3]) -> Option<(f64, Vector3<f64>)> {
        if self.search.wanted.quantity == Quantity::Energy {
            return None;
        }
        let root = self.search.jets[self.search.nearest(displacement_m)].root(LEAST_ROOT_J)?;
        let away_m = Vector3::from(displacement_m) - Vector3::from(root.control_m);
        let slope = Vector3::from(root.force_n);
        let value = root.energy_j + slope.dot(&away_m);
        let far = -BESIDE * self.search.fit.length_m * slope.norm();
        let rises = || {
            let of_fit = self.at(displacement_m).value_and_slope(displacement_m).1;
            of_fit.dot(&slope) < LEAST_SLOPE * slope.norm_squared()
        };
        (value < far || value < 0.0 && rises()).then_some((value, slope))
    }

    /// The configurations for a fit round a displacement, the nearest first.
    fn chosen(&self, displacement_m: [f64; 3]) -> Vec<usize> {
        let jets = &self.search.jets;
        let away_m = |n: usize| distance(jets[n].control_m, displacement_m);
        let mut nearest: Vec<usize> = (0..jets.len()).collect();
        nearest.sort_by(|&a, &b| away_m(a).total_cmp(&away_m(b)));
        let mut chosen: Vec<usize> = Vec::new();
        for next in nearest.into_iter().take(NEAREST) {
            let between_m = |n: usize| distance(jets[n].control_m, jets[next].control_m);
            let neighbour = chosen.iter().copied().min_by(|&a, &b| between_m(a).total_cmp(&between_m(b)));
            if neighbour.is_none_or(|n| agree(&jets[n], &jets[next], &self.search.wanted.tolerance)) {
                chosen.push(next);
            }
            if chosen.len() == DATA {
                break;
            }
        }
        chosen
    }

    fn fit(&self, chosen: &[usize]) -> KernelFit {
        let jets: Vec<EnergyJet> = chosen.iter().map(|&n| self.search.jets[n]).collect();
        let first = jets[0].root(LEAST_ROOT_J).expect("a datum of a root has one");
        let mut system =
            KernelSystem::without_errors(self.search.fit.length_m, Quantity::Root, Base::about(&first));
        if system.add(&jets).is_err() {
            // One by one; those that are too close to the others add nothing.
            for jet in jets {
                let _ = system.add(&[jet]);
            }
        }
        system.fit
    }
}

impl Base {
    /// The second-order Taylor polynomial of a root about its own displacement.
    fn about(root: &EnergyJet) -> Self {
        let (at, slope) = (Vector3::from(root.control_m), Vector3::from(root.force_n));
        let bent = root.stiffness_n_m * at;
        let value = root.energy_j - slope.dot(&at) + 0.5 * at.dot(&bent);
        Self { value, slope: slope - bent, curvature: root.stiffness_n_m }
    }
}
