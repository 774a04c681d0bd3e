//! The plan compared with rounds with a barrier, and with itself for outcomes in any order.

use std::collections::{HashMap, HashSet};

use super::super::supersedes;
use super::*;
use crate::num::jet::EnergyJet;
use crate::num::sequence::{split_mix, unit_interval};
use crate::spec::{GridIndex, neighbours, plus, squared};

/// Synthetic outcomes, which depend on the task alone, as those of a solver do.
struct World {
    seed: u64,
    fails: f64,
    terminates: f64,
    /// Fraction of solutions on another branch, whose energy makes the pairs around them inconsistent.
    jumps: f64,
    /// A point is on the same branch from every parent: no branch jump can be removed.
    stubborn: bool,
}

impl Default for World {
    fn default() -> Self {
        Self { seed: 0, fails: 0.0, terminates: 0.0, jumps: 0.02, stubborn: false }
    }
}

impl World {
    fn draw(&self, task: &Task, what: u64) -> f64 {
        let mut z = split_mix(self.seed ^ what);
        let parent = task.parent.filter(|_| !self.stubborn).map_or([0; 3], |(index, _)| index);
        for n in task.target.into_iter().chain(parent) {
            z = split_mix(z ^ n as u64);
        }
        unit_interval(z)
    }

    fn solve(&self, task: &Task) -> Record {
        let is_rest = task.target == [0; 3];
        let (end, branch) = (self.draw(task, 1), self.draw(task, 2));
        if !is_rest && end < self.fails {
            return with(task, ConfigTag::Failed, 0.0);
        }
        let terminates = !is_rest && end < self.fails + self.terminates;
        let energy_j = if !is_rest && branch < self.jumps { 1.0 } else { 0.0 };
        with(task, if terminates { ConfigTag::Terminating } else { ConfigTag::Expandable }, energy_j)
    }
}

/// A record of this energy without force and stiffness.
fn with(task: &Task, tag: ConfigTag, energy_j: f64) -> Record {
    let mut numbers = [0.0; 20];
    numbers[0] = energy_j;
    if !tag.is_solved() {
        return Record::new(task, Err("line-search".into()));
    }
    let jet = EnergyJet::from_numbers([0.0; 3], &numbers);
    Record::of_jet(task, &jet, tag == ConfigTag::Terminating)
}

fn grid() -> SpaceGrid {
    SpaceGrid::new(0.01, 0.045).unwrap()
}

/// All tasks, by (target, attempt).
type Log = HashMap<(GridIndex, u32), Task>;

/// Runs a plan with up to `hands` tasks in flight. Their outcomes arrive in an order drawn from `order`.
fn run(world: &World, hands: usize, order: u64) -> (Log, TagCounts) {
    let mut plan = Plan::new(Arc::new(Domain::new(&grid(), true)), grid());
    let (mut out, mut log, mut draw) = (Vec::new(), Log::new(), order);
    loop {
        while out.len() < hands {
            let Some(task) = plan.next_task() else { break };
            assert!(log.insert((task.target, task.attempt), task).is_none(), "{task:?} twice");
            out.push(task);
        }
        if out.is_empty() {
            assert!(plan.is_done());
            return (log, plan.counts);
        }
        draw = split_mix(draw);
        let task = out.swap_remove(draw as usize % out.len());
        plan.decide(&world.solve(&task));
    }
}

#[test]
fn nothing_depends_on_who_is_done_first() {
    for seed in 0..6 {
        let world = World { seed, fails: 0.08, terminates: 0.15, ..World::default() };
        let (expected, counts) = run(&world, 1, 0);
        assert!(expected.len() > 300, "seed {seed}: the space is too small for the test");
        for (hands, order) in [(2, 1), (7, 2), (64, 3), (1000, 4)] {
            let (log, others) = run(&world, hands, order);
            assert_eq!((log == expected, others), (true, counts), "seed {seed}, {hands} hands");
        }
    }
}

/// Rounds with a barrier as in the paper's expansion, first attempts only.
#[test]
fn handing_out_ahead_is_the_same_as_rounds() {
    for seed in 10..16 {
        let world = World { seed, fails: 0.2, terminates: 0.3, ..World::default() };
        let lattice = grid().lattice;
        let mut tags: HashMap<GridIndex, ConfigTag> = HashMap::from([([0; 3], ConfigTag::Expandable)]);
        let mut expected = Vec::new();
        for round in 1.. {
            let mut tasks = Vec::new();
            for target in lattice.points().filter(|p| !tags.contains_key(p)) {
                let parent = neighbours()
                    .map(|offset| (squared(offset), plus(target, offset)))
                    .filter(|(_, index)| tags.get(index) == Some(&ConfigTag::Expandable))
                    .min_by_key(|&(distance, index)| (distance, squared(index), index));
                if let Some((_, parent)) = parent {
                    tasks.push(Task { target, attempt: 0, round, parent: Some((parent, 0)), chart: None });
                }
            }
            if tasks.is_empty() {
                break;
            }
            tags.extend(tasks.iter().map(|t| (t.target, world.solve(t).tag())));
            expected.extend(tasks);
        }
        assert!(expected.len() > 50, "seed {seed}");
        let (log, _) = run(&world, 5, seed);
        for task in expected {
            assert_eq!(log.get(&(task.target, 0)), Some(&task), "seed {seed}");
        }
    }
}

#[test]
fn a_failed_point_is_tried_from_every_solved_neighbour_before_it_is_given_up() {
    let world = World { seed: 3, fails: 0.4, terminates: 0.1, ..World::default() };
    let domain = Domain::new(&grid(), true);
    let (log, counts) = run(&world, 4, 9);
    let solved =
        |index: &GridIndex| log.values().any(|t| t.target == *index && world.solve(t).tag().is_solved());
    let mut given_up = 0;
    for point in 1..domain.count() as u32 {
        let index = domain.index(point);
        let tries: Vec<&Task> = log.values().filter(|t| t.target == index).collect();
        if tries.is_empty() || solved(&index) {
            continue;
        }
        given_up += 1;
        for &parent in domain.parents(point) {
            let from = domain.index(parent);
            let tried = tries.iter().any(|t| t.parent.is_some_and(|(index, _)| index == from));
            assert!(tried || !solved(&from), "{index:?} was never tried from {from:?}");
        }
    }
    assert_eq!(counts.failed, given_up);
    assert!(log.keys().any(|(_, attempt)| *attempt > 0), "there were retries");
}

#[test]
fn points_of_flagged_pairs_are_solved_again_and_the_lower_energy_is_kept() {
    let world = World { seed: 5, fails: 0.0, terminates: 0.0, ..World::default() };
    let (log, counts) = run(&world, 3, 1);
    assert_eq!((counts.failed, counts.terminating, counts.unknown), (0, 0, 0));
    let is_upper = |r: &Record| r.equilibrium().is_some_and(|at| at.energy_j > 0.5);
    let jumped: Vec<GridIndex> =
        log.values().filter(|t| t.attempt == 0 && is_upper(&world.solve(t))).map(|t| t.target).collect();
    assert!(jumped.len() > 3, "the synthetic body has solutions on another branch");
    let domain = Domain::new(&grid(), true);
    for index in jumped {
        let tries = log.values().filter(|t| t.target == index).count();
        // A corner of the shell may have only one parent. A point that its second attempt solved is not tried
        // again.
        let parents = domain.parents(domain.position(index).unwrap()).len();
        let most = parents.min(1 + MAX_JUMP_ATTEMPTS);
        assert!((most.min(2)..=most).contains(&tries), "{index:?}: {tries} tries, {parents} parents");
    }
    let untouched = log.keys().filter(|(_, attempt)| *attempt == 0).count();
    assert!(log.len() < 3 * untouched, "not everything is solved again");
}

/// Another solve of a point at a persistent branch jump, from a parent already used, would cost a solve and
/// give nothing new.
#[test]
fn a_fold_is_looked_at_a_second_time_only_where_the_other_side_found_something() {
    let stubborn = World { seed: 5, stubborn: true, ..World::default() };
    let (log, _) = run(&stubborn, 3, 1);
    let tries = |log: &Log, attempt: u32| log.keys().filter(|(_, a)| *a == attempt).count();
    assert!(tries(&log, 1) > 100, "{} second tries", tries(&log, 1));
    assert_eq!(tries(&log, 2), 0, "a persistent branch jump was solved again");
    // A better solution on one side causes one repetition on the other.
    let (log, _) = run(&World { seed: 5, jumps: 0.3, ..World::default() }, 3, 1);
    assert!(tries(&log, 2) > 0, "no branch jump was solved a second time");
    assert_eq!(tries(&log, 3), 0);
}

/// The store holds the start state of a retry. A failed attempt has no state, and a superseded one is on a
/// branch that the space no longer uses.
#[test]
fn later_tries_start_from_the_solution_that_counted_when_their_round_began() {
    let (mut of_failed, mut of_superseded) = (0, 0);
    for seed in 0..12 {
        let world = World { seed, fails: 0.3, terminates: 0.2, jumps: 0.3, ..World::default() };
        let mut plan = Plan::new(Arc::new(Domain::new(&grid(), true)), grid());
        let mut kept: HashMap<GridIndex, Record> = HashMap::new();
        let mut failed_first = HashSet::new();
        let (mut round, mut at_its_beginning) = (0, kept.clone());
        while let Some(task) = plan.next_task() {
            if task.attempt > 0 && task.round != round {
                (round, at_its_beginning) = (task.round, kept.clone());
            }
            if let Some((parent, solution)) = task.parent {
                // The expansion never supersedes a solution; its start state may be of the same round.
                let known = if task.attempt == 0 { &kept } else { &at_its_beginning };
                let counts = known.get(&parent).filter(|r| r.tag().is_solved()).expect("a solved parent");
                assert_eq!(solution, counts.attempt, "seed {seed}: {task:?}");
                let was_failed = kept.get(&task.target).is_some_and(|r| !r.tag().is_solved());
                if was_failed && solution > 0 {
                    *(if failed_first.contains(&parent) { &mut of_failed } else { &mut of_superseded }) += 1;
                }
            }
            let record = world.solve(&task);
            plan.decide(&record);
            if task.attempt == 0 && !record.tag().is_solved() {
                failed_first.insert(task.target);
            }
            if supersedes(&record, kept.get(&task.target)) {
                kept.insert(task.target, record);
            }
        }
        assert!(plan.is_done());
    }
    assert!(of_failed > 0 && of_superseded > 0, "{of_failed} and {of_superseded}: some cases are missing");
}

#[test]
fn the_first_solution_is_kept_unless_a_later_one_is_clearly_lower() {
    let task = Task { target: [1, 0, 0], attempt: 0, round: 1, parent: None, chart: None };
    let with = |tag, energy_j| with(&task, tag, energy_j);
    let first = with(ConfigTag::Expandable, 1.0);
    assert!(
        !supersedes(&with(ConfigTag::Expandable, 1.0 - 1e-9), Some(&first)),
        "a difference by rounding does not supersede"
    );
    assert!(supersedes(&with(ConfigTag::Terminating, 0.9), Some(&first)));
    assert!(!supersedes(&with(ConfigTag::Failed, 0.0), Some(&first)));
    assert!(supersedes(&first, Some(&with(ConfigTag::Failed, 0.0))));
    assert!(!supersedes(&with(ConfigTag::Expandable, 1.1), Some(&first)));
}
