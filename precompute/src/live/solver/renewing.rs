//! Factors that are made beside the steps.

use super::super::renewals::Ended;
use super::super::task::Task;
use super::super::workers::Made;
use super::LiveSolver;

impl LiveSolver {
    /// Whether the steps go on with the factors at hand, because a new one takes too long to wait for it.
    pub(super) fn waits_for_factors(&self) -> bool {
        self.renewals.is_some() && self.times.factor_is_long() && !self.needs_no_factor()
    }

    /// Whether presses are solved before the hand is there.
    pub(super) fn prepares(&self) -> bool {
        self.waits_for_factors() || self.needs_no_factor()
    }

    /// Whether the body is so large that its states are solved without a factor of their tangent.
    pub(super) fn needs_no_factor(&self) -> bool {
        self.skin.sphere().is_none() && self.free.needs_no_factor()
    }

    /// Begins to make the factor of a kept state beside the steps; whether that is possible.
    pub(super) fn begin_renewal(&mut self, task: &Task) -> bool {
        let &Task { contact, control_m, .. } = task;
        if !self.waits_for_factors() {
            return false;
        }
        if self.doubted == Some(contact) {
            self.doubted = None;
            return false;
        }
        let branch = self.branches.of(contact);
        let problem = self.problem(contact);
        let Some(renewals) = &mut self.renewals else { return false };
        let Some(start) = self.states.take_nearest(contact, branch, control_m) else { return false };
        let room = if start.is_guess { None } else { renewals.room() };
        let begins = room.is_some();
        if let Some(mut order) = room {
            self.workers.go_to(contact, problem);
            self.workers.present().solver.lend(&start.seed, &mut order.renewal);
            (order.contact, order.control_m, order.branch) = (contact, start.seed.jet.control_m, branch);
            renewals.begin(order);
        }
        self.states.keep(contact, branch, start);
        begins
    }

    /// Takes the factor that has been made beside the steps, if its contact still has a solver. An unstable state is
    /// solved once more.
    pub(super) fn take_renewal(&mut self) {
        let Some(renewals) = &mut self.renewals else { return };
        let mut order = match renewals.ready() {
            Ok(Some(order)) => order,
            Ok(None) => return,
            Err(Ended) => {
                // The steps make all factors from now on.
                self.renewals = None;
                return;
            }
        };
        if order.branch == self.branches.of(order.contact)
            && let Some(worker) = self.workers.of(order.contact)
        {
            if order.renewal.serves() {
                worker.solver.renew_by(&mut order.renewal);
                worker.factor = Made::At(order.contact, order.control_m);
                self.totals.factorisations += 1;
            } else {
                worker.factor = Made::Unknown;
                self.doubted = Some(order.contact);
            }
        }
        renewals.give_back(order);
    }
}
