//! Workers in simulated time, with which the bench `scheduler` runs the real planner.

#[path = "../benches/scheduler/simulated.rs"]
#[allow(dead_code, reason = "a module of the bench, which uses all of it")]
mod simulated;

use std::time::Duration;

use palpate_precompute::space::{Executor, Job, Task, Work};
use palpate_precompute::spec::{GridIndex, SpaceGrid};
use simulated::{Costs, Durations, Simulated, Solves};

fn job(target: GridIndex, parent: Option<GridIndex>) -> Work {
    let task = Task { target, attempt: 0, round: 1, parent: parent.map(|index| (index, 0)), chart: None };
    Work::Point(Job { active: 0, task, seed: None })
}

#[test]
fn time_passes_as_on_a_machine() {
    let grid = SpaceGrid::new(0.01, 0.02).expect("a grid");
    let durations = Durations { at_rest: Vec::new(), others: vec![1000] };
    let solves = Solves::Spring(grid, &durations);
    let mut executor = Simulated::new(2, Costs { give: 10, take: 20, message: 5 }, &solves);
    // The jobs arrive at 10 and 20. The third waits for the first, which ends at 10 + 5 + 1000.
    for (worker, target) in [(0, [0, 0, 1]), (1, [0, 0, 2]), (0, [0, 1, 0])] {
        let parent = (target == [0, 0, 2]).then_some([0, 0, 1]);
        executor.give(worker, job(target, parent)).expect("it is taken");
    }
    let mut take = || executor.take(Duration::ZERO).map(|done| done.expect("it never waits").0);
    let order: Vec<usize> = (0..3).map(|_| take().expect("three are out")).collect();
    assert_eq!(order, [0, 1, 0]);
    assert!(take().is_err());
    let ran = executor.ran();
    // The last job ends at 2015, arrives at 2020 and is stored at 2040.
    assert_eq!((ran.makespan, ran.work, ran.chain, ran.rank0_busy), (2040, 3000, 2000, 90));
}

#[test]
fn a_solve_at_rest_takes_the_time_of_one() {
    let grid = SpaceGrid::new(0.01, 0.02).expect("a grid");
    let durations = Durations { at_rest: vec![7000], others: vec![1000] };
    let solves = Solves::Spring(grid, &durations);
    let mut executor = Simulated::new(1, Costs { give: 0, take: 0, message: 0 }, &solves);
    for (target, parent) in [([0, 0, 0], None), ([0, 0, 1], Some([0, 0, 0]))] {
        executor.give(0, job(target, parent)).expect("it is taken");
        executor.take(Duration::ZERO).expect("it is out");
    }
    let ran = executor.ran();
    assert_eq!((ran.work, ran.tries, ran.points), (8000, 2, 1));
}
