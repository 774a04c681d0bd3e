//! The fits that the points of a table take their values from.
//!
//! The fit of a space is one for all of it, but the time that a fit takes grows with the third power of its data. A deep chart
//! of a sphere's field has too many. There every block of the space has a fit of its own, to the configurations nearest to
//! it.

use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;

use nalgebra::Vector3;

use super::AdaptiveFit;
use crate::fit::{Base, KernelFit, KernelSystem, LEAST_ROOT_J};
use crate::num::jet::EnergyJet;
use crate::num::vector::distance;
use crate::spec::Quantity;

/// Number of configurations of the fit of a block.
const DATA: usize = 64;
/// Edge of a block, as a share of the kernel's length.
const BLOCK: f64 = 1.5;

/// Distance beside the body beyond which the tangent replaces the fit, as a share of the kernel's length.
const BESIDE: f64 = 0.05;

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
        if self.search.is_fit_whole() {
            return self.whole.clone();
        }
        let edge_m = BLOCK * self.search.fit.length_m;
        let block = displacement_m.map(|x| (x / edge_m).floor() as i32);
        let middle_m = block.map(|n| (f64::from(n) + 0.5) * edge_m);
        self.blocks.borrow_mut().entry(block).or_insert_with(|| Rc::new(self.local(middle_m))).clone()
    }

    /// Whether a displacement is so near to a configuration that its fit is one.
    pub(super) fn reach(&self, displacement_m: [f64; 3]) -> bool {
        let length_m = self.search.fit.length_m;
        self.search.jets.iter().any(|jet| distance(jet.control_m, displacement_m) <= length_m)
    }

    /// Value and slope of a root beside the body, where only its sign counts: the tangent at the nearest configuration,
    /// where that is clearly below zero. A fit would follow the curvature of the first touch and rise again.
    pub(super) fn beside(&self, displacement_m: [f64; 3]) -> Option<(f64, Vector3<f64>)> {
        if self.search.wanted.quantity == Quantity::Energy {
            return None;
        }
        let root = self.search.jets[self.search.nearest(displacement_m)].root(LEAST_ROOT_J)?;
        let away_m = Vector3::from(displacement_m) - Vector3::from(root.control_m);
        let slope = Vector3::from(root.force_n);
        let value = root.energy_j + slope.dot(&away_m);
        (value < -BESIDE * self.search.fit.length_m * slope.norm()).then_some((value, slope))
    }

    /// The fit to the configurations nearest to a displacement.
    fn local(&self, middle_m: [f64; 3]) -> KernelFit {
        let mut nearest: Vec<&EnergyJet> = self.search.jets.iter().collect();
        nearest.sort_by(|a, b| distance(a.control_m, middle_m).total_cmp(&distance(b.control_m, middle_m)));
        let first = nearest[0].root(LEAST_ROOT_J).expect("a datum of a root has one");
        let mut system =
            KernelSystem::without_errors(self.search.fit.length_m, Quantity::Root, Base::about(&first));
        let nearest: Vec<EnergyJet> = nearest.into_iter().take(DATA).copied().collect();
        if system.add(&nearest).is_err() {
            // One by one; those that are too close to the others add nothing.
            for jet in nearest {
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
