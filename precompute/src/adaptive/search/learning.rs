//! What a search knows: configurations enter its fits, of which the best one makes the predictions.

use super::{CandidateFit, Search};
use crate::adaptive::{Shared, on_one_branch};
use crate::num::jet::EnergyJet;
use crate::num::vector::norm;

impl Search {
    /// The search with configurations that neighbouring charts have solved, without those on another branch than the
    /// origin.
    #[must_use]
    pub(crate) fn knowing(mut self, mut shared: Vec<Shared>) -> Self {
        let origin = self.fitted.jets[..1].iter().copied();
        let jets: Vec<EnergyJet> = origin.chain(shared.iter().map(|shared| shared.jet)).collect();
        let mut agrees = on_one_branch(&jets, &self.fitted.wanted.tolerance).into_iter().skip(1);
        shared.retain(|_| agrees.next().unwrap_or(false));
        self.learn(shared.iter().map(|shared| shared.jet).collect(), &vec![false; shared.len()]);
        if self.fitted.jets.len() > 1 {
            self.fitted.shared = shared;
        }
        self
    }

    /// Adds configurations to the fits and chooses the best one.
    pub(super) fn learn(&mut self, learned: Vec<EnergyJet>, is_given: &[bool]) {
        let grown: Vec<bool> =
            self.fits.iter_mut().map(|candidate| candidate.system.add(&learned).is_ok()).collect();
        if grown.contains(&true) {
            let mut grown = grown.into_iter();
            self.fits.retain(|_| grown.next().unwrap_or(false));
            self.fitted.jets.extend(learned);
            self.is_given.extend(is_given);
        } else {
            // No kernel length makes the matrix regular, so the fits do not change.
            self.excluded.extend(learned.iter().map(|jet| jet.control_m));
        }
        let tolerance = self.fitted.wanted.tolerance;
        for candidate in &mut self.fits {
            let missed = candidate.system.leave_one_out_n().zip(&self.fitted.jets).zip(&self.is_given);
            let missed = missed.filter(|(_, is_given)| !**is_given);
            candidate.leave_one_out =
                missed.map(|((missed, jet), _)| norm(missed) / tolerance.at(jet.force_n)).collect();
        }
        // Given positions have no errors that compare the lengths.
        let are_all_given = self.is_given.len() > 1 && self.is_given.iter().all(|is_given| *is_given);
        if !are_all_given || self.chosen >= self.fits.len() {
            let best = (0..self.fits.len())
                .min_by(|&a, &b| self.fits[a].mean_left_out().total_cmp(&self.fits[b].mean_left_out()));
            self.chosen = best.unwrap_or(0);
        }
        let CandidateFit { system, leave_one_out } = &self.fits[self.chosen];
        self.fitted.fit = system.fit.clone();
        self.fitted.leave_one_out.clone_from(leave_one_out);
        self.fitted.condition = system.condition();
        self.fitted.linear = self.linear.errors;
        self.fitted.deviation = self.largest_deviation();
    }
}
