//! An adaptive search as tasks of a configuration space.

use std::collections::{HashMap, VecDeque};

use super::switched::Switched;
use super::{Phase, PlanStatus, SolvesLeft, SpacePlan};
use crate::adaptive::{AdaptiveFit, STREAK, Search, Shared, SolveResult, Step, Target, Verdict};
use crate::fit::LEAST_ROOT_J;
use crate::num::jet::EnergyJet;
use crate::space::record::Record;
use crate::space::task::{TagCounts, Task};
use crate::spec::{GridIndex, Quantity, Requirements, displacement_m, nearest_index};

/// The rest point.
const REST: GridIndex = [0; 3];

/// The plan of one adaptive space.
#[derive(Debug)]
pub(crate) struct ScatteredPlan {
    wanted: Requirements,
    /// Displacements to solve first, m.
    visited_m: Vec<[f64; 3]>,
    /// Configurations of neighbouring charts.
    shared: Vec<Shared>,
    /// `None` before rest is solved.
    search: Option<Search>,
    /// The configurations of the search in its order, each with the chart that solved it if it is another one. Parents
    /// are indices into this list.
    learned: Vec<(Option<u32>, GridIndex)>,
    /// The batch in progress.
    batch: Vec<Target>,
    found: HashMap<GridIndex, SolveResult>,
    ready: VecDeque<Task>,
    counts: TagCounts,
    round: u32,
    verdict: Option<Verdict>,
    /// The rest record, with which the fallback lattice starts.
    rest: Option<Record>,
    /// The fallback lattice, after stagnation.
    switched: Option<Switched>,
}

impl ScatteredPlan {
    /// Plan with nothing solved.
    pub(crate) fn new(wanted: Requirements, visited_m: Vec<[f64; 3]>) -> Self {
        Self {
            wanted,
            visited_m,
            shared: Vec::new(),
            search: None,
            learned: Vec::new(),
            batch: Vec::new(),
            found: HashMap::new(),
            ready: VecDeque::from([Task { target: REST, attempt: 0, round: 0, parent: None, chart: None }]),
            counts: TagCounts::default(),
            round: 0,
            verdict: None,
            rest: None,
            switched: None,
        }
    }

    /// The plan with configurations that neighbouring charts have solved.
    pub(crate) fn knowing(self, shared: Vec<Shared>) -> Self {
        Self { shared, ..self }
    }

    /// Notes the configurations of the fit.
    fn learn(&mut self) {
        let Some(search) = &self.search else { return };
        let fitted = &search.fitted;
        let own = |jet: &EnergyJet| (None, nearest_index(jet.control_m));
        let shared = fitted.shared.iter().map(|shared| (Some(shared.chart), shared.index));
        let (first, rest) = fitted.jets.split_at(1);
        let rest = rest.iter().skip(fitted.shared.len());
        self.learned = first.iter().map(own).chain(shared).chain(rest.map(own)).collect();
    }

    fn begin_batch(&mut self) {
        let Some(search) = &mut self.search else { return };
        match search.step() {
            Step::Done(verdict) => {
                self.verdict = Some(verdict);
                if verdict == Verdict::Stagnated {
                    let rest = self.rest.as_ref();
                    self.switched = rest.and_then(|rest| Switched::new(self.wanted, rest));
                }
            }
            Step::Solve(targets) => {
                self.round += 1;
                let round = self.round;
                let task = |target: &Target| {
                    let (chart, parent) = self.learned[target.parent];
                    Task { target: target.index, attempt: 0, round, parent: Some((parent, 0)), chart }
                };
                self.ready = targets.iter().map(task).collect();
                self.batch = targets;
            }
        }
    }
}

impl SpacePlan for ScatteredPlan {
    /// `None` also while results of the batch are outstanding.
    fn next_task(&mut self) -> Option<Task> {
        if self.ready.is_empty() && self.batch.is_empty() && self.verdict.is_none() {
            self.begin_batch();
        }
        match &mut self.switched {
            Some(lattice) => lattice.next_task(),
            None => self.ready.pop_front(),
        }
    }

    fn decide(&mut self, record: &Record) {
        if let Some(lattice) = &mut self.switched {
            return lattice.decide(record);
        }
        let jet = record.jet_for_fit(displacement_m(record.index), self.wanted.quantity);
        let Some(search) = &mut self.search else {
            let has_root = |jet: &EnergyJet| jet.energy_j > LEAST_ROOT_J;
            if let Some(jet) = jet.filter(|jet| self.wanted.quantity == Quantity::Energy || has_root(jet)) {
                let search = Search::new(self.wanted, &jet).after(&self.visited_m);
                self.search = Some(search.knowing(std::mem::take(&mut self.shared)));
                self.learn();
                self.rest = Some(record.clone());
            } else {
                self.verdict = Some(Verdict::NotReached);
            }
            return;
        };
        *self.counts.of(record.tag()) += 1;
        let found = match (jet, record.equilibrium()) {
            (Some(jet), Some(at)) if at.switched => SolveResult::OtherBranch(jet),
            (Some(jet), _) => SolveResult::Solved(jet),
            (None, _) => SolveResult::Failed,
        };
        self.found.insert(record.index, found);
        if self.batch.iter().all(|target| self.found.contains_key(&target.index)) {
            let batch = std::mem::take(&mut self.batch);
            let found: Vec<SolveResult> = batch
                .iter()
                .map(|target| self.found.remove(&target.index).unwrap_or(SolveResult::Failed))
                .collect();
            search.take(&found);
            self.learn();
        }
    }

    fn is_done(&self) -> bool {
        self.verdict.is_some() && self.switched.as_ref().is_none_or(|lattice| lattice.plan.is_done())
    }

    fn status(&self) -> PlanStatus {
        let passes = self.search.as_ref().map_or(0, |search| search.fitted.passes()).min(STREAK);
        if let Some(lattice) = &self.switched {
            let mut status = PlanStatus { phase: Phase::FallbackLattice, passes, ..lattice.plan.status() };
            status.counts += self.counts;
            return status;
        }
        let left = match &self.search {
            _ if self.verdict.is_some() => SolvesLeft::About(0),
            Some(search) => SolvesLeft::AtLeast(search.predictions_missing().max(1)),
            None => SolvesLeft::AtLeast(1 + STREAK),
        };
        let (phase, is_solving_again) = (Phase::Search, false);
        PlanStatus { counts: self.counts, phase, is_solving_again, left, passes }
    }

    fn fit(&self) -> Option<AdaptiveFit> {
        self.search.as_ref().map(|search| search.fitted.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::synthetic;
    use crate::space::branch_jumps;
    use crate::space::fallback::FallbackLattice;
    use crate::spec::{Tolerance, UNIT_M};

    const RADIUS_M: f64 = 0.03;

    /// A body whose force jumps by `jump_n` to another branch, at a plane oblique to every axis.
    fn record(task: &Task, jump_n: f64) -> Record {
        let jet = synthetic::jet(displacement_m(task.target));
        let [x, y, z] = jet.control_m;
        let beyond = x + 0.4 * y - 0.3 * z - 0.011;
        let jump_n = if beyond > 0.0 { jump_n } else { 0.0 };
        let normal = [1.0, 0.4, -0.3];
        let jet = EnergyJet {
            energy_j: jet.energy_j + jump_n * beyond,
            force_n: std::array::from_fn(|i| jet.force_n[i] + jump_n * normal[i]),
            ..jet
        };
        Record::of_jet(task, &jet, false)
    }

    const ANYWHERE: Requirements = Requirements {
        tolerance: Tolerance::IMPERCEPTIBLE,
        radius_m: RADIUS_M,
        max_force_n: 8.0,
        push: None,
        workspace_m: None,
        column: None,
        quantity: Quantity::Energy,
        max_configurations: 160,
    };

    /// Solves to the end with `width` tasks in flight. Returns the solved records in the order of the points.
    fn solved(wanted: Requirements, jump_n: f64, width: usize) -> (ScatteredPlan, Vec<Record>) {
        let (mut plan, mut records) = (ScatteredPlan::new(wanted, Vec::new()), Vec::new());
        while !plan.is_done() {
            let tasks: Vec<Task> = std::iter::from_fn(|| plan.next_task()).take(width).collect();
            for task in tasks.iter().rev() {
                let record = record(task, jump_n);
                plan.decide(&record);
                records.push(record);
            }
        }
        records.sort_by_key(|r| (r.index, r.attempt));
        (plan, records)
    }

    #[test]
    fn a_lattice_takes_over_where_predictions_do_not_fall_and_it_finds_the_fold() {
        let (smooth, few) = solved(ANYWHERE, 0.0, 1);
        assert_eq!((smooth.verdict, smooth.switched.is_none()), (Some(Verdict::Passed), true));
        assert!(few.len() < 60, "{}", few.len());

        let (plan, records) = solved(ANYWHERE, 2.0, 1);
        assert_eq!(plan.verdict, Some(Verdict::Stagnated));
        let jets = plan.fit().expect("a fit").jets.len();
        let lattice = FallbackLattice::within(RADIUS_M).expect("a lattice");
        assert!((40..160).contains(&jets), "{jets}");
        assert_eq!(f64::from(lattice.spacing) * UNIT_M, lattice.grid.spacing_m);
        // All points of the ball and the corners that complete its cells. Of the search only rest is among
        // them.
        let own = lattice.records(&records);
        let points: std::collections::BTreeSet<GridIndex> = own.iter().map(|r| r.index).collect();
        assert_eq!(points.len(), 613);
        let all: std::collections::BTreeSet<GridIndex> = records.iter().map(|r| r.index).collect();
        assert_eq!(plan.status().counts.solved(), all.len() - 1);
        // Its branch jumps are at the plane and nowhere else.
        let kept: Vec<Record> = own.into_iter().filter(|r| r.attempt == 0).collect();
        let branch_jumps = branch_jumps(&lattice.grid, &kept);
        assert!(branch_jumps.len() > 50, "{}", branch_jumps.len());
        for fold in branch_jumps {
            let beyond = [fold.from, fold.to].map(|index| {
                let [x, y, z] = lattice.grid.displacement_m(index);
                x + 0.4 * y - 0.3 * z > 0.011
            });
            assert_ne!(beyond[0], beyond[1], "{fold:?}");
        }
        // The number of tasks in flight does not matter.
        let (_, again) = solved(ANYWHERE, 2.0, 7);
        assert_eq!(again, records);
    }

    #[test]
    fn the_lattice_goes_no_further_than_a_step_beyond_the_tool_s_reach() {
        let [low, high] = [[-0.004, -0.012, -0.02], [0.02, 0.03, 0.03]];
        let push = Some([0.0, 0.0, -1.0]);
        let (plan, records) =
            solved(Requirements { workspace_m: Some([low, high]), push, ..ANYWHERE }, 2.0, 1);
        assert!(plan.switched.is_some());
        let lattice = FallbackLattice::within(RADIUS_M).expect("a lattice");
        let own: HashMap<GridIndex, Record> =
            lattice.records(&records).into_iter().map(|r| (r.index, r)).collect();
        let points = own.len();
        assert!((60..400).contains(&points), "{points} of 613");
        let step_m = 1.001 * lattice.grid.spacing_m;
        let (mut inside, mut pressing) = (0, 0);
        for (index, record) in &own {
            let at = lattice.grid.displacement_m(*index);
            assert!((0..3).all(|i| at[i] >= low[i] - step_m && at[i] <= high[i] + step_m), "{at:?}");
            let is_inside = (0..3).all(|i| at[i] >= low[i] && at[i] <= high[i]);
            inside += usize::from(is_inside);
            let force_n = record.equilibrium().expect("solved").force_n;
            if is_inside && -force_n[2] <= 0.0 && lattice.grid.lattice.contains(*index) {
                // All corners of its cells exist.
                pressing += 1;
                let beside = |code: i32| {
                    std::array::from_fn(|axis| index[axis] + code / 3i32.pow(axis as u32) % 3 - 1)
                };
                let missing = (0..27).map(beside).find(|corner: &GridIndex| {
                    lattice.grid.lattice.contains(*corner) && !own.contains_key(corner)
                });
                assert_eq!(missing, None, "beside {index:?}");
            }
        }
        assert!(pressing > 10 && inside > pressing, "{inside} {pressing}");
    }
}
