//! Behaviour of the search on synthetic bodies.

use super::*;
use crate::fit::synthetic::{jet, spread};
use crate::spec::{Tolerance, is_within};

const WANTED: Requirements = Requirements {
    tolerance: Tolerance::IMPERCEPTIBLE,
    radius_m: 0.05,
    max_force_n: 8.0,
    push: None,
    workspace_m: None,
    column: None,
    quantity: Quantity::Energy,
    max_configurations: 100,
};

/// A number of configurations that suffices for a synthetic body.
const FINE: Requirements =
    Requirements { tolerance: Tolerance { relative: 1e-5, absolute_n: 1e-5 }, ..WANTED };

/// Runs a search to its end; `solve` returns the result at a position.
fn searched(wanted: Requirements, solve: impl Fn([f64; 3]) -> SolveResult) -> (Search, Verdict) {
    let mut search = Search::new(wanted, &jet([0.0; 3]));
    let verdict = search.run(|_, target| solve(target.displacement_m));
    (search, verdict)
}

fn solved(at: [f64; 3]) -> SolveResult {
    SolveResult::Solved(jet(at))
}

/// Reachable positions that the search did not choose, and the share of them with an error beyond the
/// tolerance.
fn felt(search: &Search, wanted: &Requirements) -> f64 {
    let truths: Vec<EnergyJet> = (5000..9000)
        .map(|n| jet(spread(n, wanted.radius_m)))
        .filter(|truth| norm(truth.force_n) <= wanted.max_force_n)
        .collect();
    assert!(truths.len() > 300);
    let felt = truths.iter().filter(|truth| {
        let error_n = distance(search.fitted.fit.force_n(truth.control_m), truth.force_n);
        error_n > wanted.tolerance.at(truth.force_n)
    });
    felt.count() as f64 / truths.len() as f64
}

#[test]
fn a_smooth_body_needs_a_few_dozen_and_the_verdict_is_true() {
    let (search, verdict) = searched(WANTED, solved);
    assert_eq!(verdict, Verdict::Passed);
    assert!(search.fitted.jets.len() < 50, "{}", search.fitted.jets.len());
    assert!(felt(&search, &WANTED) <= 0.01, "{}", felt(&search, &WANTED));
    // A far stricter tolerance needs more configurations.
    let strict = Requirements { tolerance: Tolerance { relative: 1e-4, absolute_n: 1e-4 }, ..WANTED };
    let (finer, verdict) = searched(strict, solved);
    assert_eq!(verdict, Verdict::Passed);
    assert!(finer.fitted.jets.len() > search.fitted.jets.len());
    assert!(felt(&finer, &strict) <= 0.01, "{}", felt(&finer, &strict));
}

#[test]
fn it_ends_after_ten_in_a_row_or_four_where_the_others_say_every_configuration() {
    let tolerance = Tolerance { relative: 1e-3, absolute_n: 1e-3 };
    let (search, verdict) = searched(Requirements { tolerance, ..WANTED }, solved);
    let LeaveOneOutErrors { configurations, beyond, worst } = search.fitted.leave_one_out();
    assert_eq!((verdict, configurations), (Verdict::Passed, search.fitted.jets.len() - 1));
    assert!((BATCH..STREAK).contains(&search.fitted.passes()), "{} in a row", search.fitted.passes());
    assert!(worst > 1e-6 && beyond == 0 && configurations >= STREAK, "{worst} of {configurations}");
    // One leave-one-out error beyond the tolerance: the full streak of ten is needed.
    let mut search = search;
    let passes = search.fitted.passes();
    assert_eq!(search.predictions_missing(), 0);
    search.fitted.leave_one_out[3] = 1.1;
    assert_eq!(search.predictions_missing(), STREAK - passes);
    // The short streak suffices if the kriging variance test passes.
    for (deviation, short) in
        [(MAX_DEVIATION, 0), (1.01 * MAX_DEVIATION, STREAK - passes), (f64::NAN, STREAK - passes)]
    {
        search.fitted.deviation = Some(deviation);
        assert_eq!(search.predictions_missing(), short, "{deviation}");
    }
    search.fitted.deviation = None;
    search.fitted.leave_one_out.truncate(STREAK - 1);
    assert_eq!(search.predictions_missing(), STREAK - passes);
    search.fitted.leave_one_out[3] = 0.9;
    assert_eq!(search.predictions_missing(), 1);
    // Two of nine beyond the tolerance: a streak of ten does not suffice.
    let pass = Test { index: [0; 3], error_n: 0.0, tolerance_n: 1e-3, counts: true };
    search.fitted.tests.extend([pass; STREAK]);
    assert_eq!(search.predictions_missing(), 0);
    search.fitted.leave_one_out[3] = 1.1;
    assert_eq!(search.predictions_missing(), 0);
    search.fitted.leave_one_out[4] = f64::NAN;
    assert_eq!(search.predictions_missing(), BATCH);
}

/// Positions that a hand has visited, crowded in one part of the reachable set.
#[test]
fn given_positions_are_solved_first_and_prove_nothing() {
    let given: Vec<[f64; 3]> =
        (0..14).map(|n| [1e-3 * f64::from(n % 7), 0.0, -0.004 - 1e-3 * f64::from(n / 7)]).collect();
    let mut search = Search::new(WANTED, &jet([0.0; 3])).after(&given);
    let mut order = Vec::new();
    let verdict = search.run(|search, target| {
        order.push((target.displacement_m, target.is_test));
        // Of the configurations at hand only those that the search chose have errors that count.
        let chosen = search.fitted.jets.len() - search.is_given.iter().filter(|given| **given).count();
        assert_eq!(search.fitted.leave_one_out.len(), chosen);
        assert!(chosen > 0 || search.chosen == INITIAL_LENGTH, "nothing has compared the lengths yet");
        solved(target.displacement_m)
    });
    assert_eq!(verdict, Verdict::Passed);
    let (first, later) = order.split_at(given.len());
    assert!(first.iter().all(|(_, is_test)| !is_test) && later.iter().all(|(_, is_test)| *is_test));
    assert!(first.is_sorted_by(|(a, _), (b, _)| norm(*a) <= norm(*b)), "{first:?}");
    assert_eq!(search.fitted.tests.len(), later.len());
    assert!(later.len() > BATCH && felt(&search, &WANTED) <= 0.01, "{}", felt(&search, &WANTED));
    // No more than is allowed, also of given ones.
    let few = Requirements { max_configurations: 9, ..WANTED };
    let mut search = Search::new(few, &jet([0.0; 3])).after(&given);
    assert_eq!(search.run(|_, target| solved(target.displacement_m)), Verdict::NotReached);
    assert!(search.fitted.jets.len() <= 9 + BATCH);
}

/// The deviation is computed only if the criterion depends on it; it is the fit's own at the worst position.
#[test]
fn the_deviation_is_asked_where_it_decides() {
    let tolerance = Tolerance { relative: 1e-3, absolute_n: 1e-3 };
    let (mut search, _) = searched(Requirements { tolerance, ..WANTED }, solved);
    assert_eq!(search.largest_deviation(), None, "no error is beyond the tolerance: four suffice");
    let chosen = search.chosen;
    search.fitted.leave_one_out[3] = 1.1;
    let largest = search.largest_deviation().expect("one of many is beyond");
    let places = search.fitted.places(POSITIONS);
    let shares: Vec<f64> = (search.fits[chosen].system.deviation_n(&places).iter().zip(&places))
        .map(|(n, &at)| n / tolerance.at(search.fitted.fit.force_n(at)))
        .collect();
    assert_eq!(largest, shares.iter().copied().fold(0.0, f64::max));
    assert!(largest > 2.0 * shares.iter().sum::<f64>() / shares.len() as f64, "{largest}");
    // Many errors beyond the tolerance, or a streak that is too short: the deviation is not computed.
    let leave_one_out = search.fitted.leave_one_out.clone();
    search.fitted.leave_one_out = vec![1.1; leave_one_out.len()];
    assert_eq!(search.largest_deviation(), None);
    search.fitted.leave_one_out = leave_one_out;
    search.fitted.tests.push(Test { index: [0; 3], error_n: 1.0, tolerance_n: 0.5, counts: true });
    assert_eq!(search.largest_deviation(), None);
}

#[test]
fn nothing_is_learned_from_beyond_the_limit() {
    let (search, _) = searched(WANTED, solved);
    let largest = search.fitted.jets.iter().map(|jet| norm(jet.force_n)).fold(0.0, f64::max);
    assert!(
        largest > 0.9 * WANTED.max_force_n && largest <= MAX_FORCE_FACTOR * WANTED.max_force_n,
        "{largest} N"
    );
    // A test just beyond the limit counts; a configuration that is not added to the fit does not.
    let learned = search.fitted.jets[1..].iter().filter(|jet| norm(jet.force_n) > WANTED.max_force_n).count();
    assert!(learned > 0);
    let counted = search.fitted.tests.iter().filter(|test| test.counts).count();
    assert_eq!(counted, search.fitted.jets.len() - 1);
}

#[test]
fn a_tool_that_only_pushes_stays_on_its_side() {
    let normal = [0.0, 0.6, 0.8];
    let (search, verdict) = searched(Requirements { push: Some(normal), ..FINE }, solved);
    assert_eq!(verdict, Verdict::Passed);
    let (both, _) = searched(FINE, solved);
    assert!(
        search.fitted.jets.len() < both.fitted.jets.len(),
        "{} {}",
        search.fitted.jets.len(),
        both.fitted.jets.len()
    );
    for jet in &search.fitted.jets[1..] {
        let along: f64 = (0..3).map(|i| jet.force_n[i] * normal[i]).sum();
        assert!(along < 0.2 * norm(jet.force_n), "pulls with {along} N at {:?}", jet.control_m);
    }
}

#[test]
fn a_tool_stays_in_its_workspace_and_that_takes_fewer() {
    let workspace = [[-0.02, -1.0, -0.01], [0.03, 1.0, 0.004]];
    let (search, verdict) = searched(Requirements { workspace_m: Some(workspace), ..FINE }, solved);
    assert_eq!(verdict, Verdict::Passed);
    let (all, _) = searched(FINE, solved);
    assert!(search.fitted.jets.len() < all.fitted.jets.len());
    let slack = workspace.map(|corner| corner.map(|x| x * (1.0 + 1e-9)));
    let outside = |jet: &&EnergyJet| {
        let [low, high] = slack.map(|corner| corner.map(|x| x + 1e-6 * x.signum()));
        !is_within(&[low, high], &jet.control_m)
    };
    assert_eq!(search.fitted.jets.iter().filter(outside).count(), 0);
    assert!(all.fitted.jets.iter().filter(outside).count() > 5, "too few positions are outside for the test");
    // The positions extend nearly to the sides of the box, and the reachable set ends at them.
    let highest = search.fitted.jets.iter().map(|jet| jet.control_m[2]).fold(0.0, f64::max);
    assert!(highest > 0.0034, "{highest}");
    let fit = search.fitted;
    assert!(fit.is_reachable([0.0, 0.0, 0.0039]) && !fit.is_reachable([0.0, 0.0, 0.0041]));
}

/// A force with a jump at a plane: no smooth fit is within tolerance there, and the search does not claim it.
#[test]
fn a_jump_does_not_pass() {
    let jumps = |at: [f64; 3]| {
        let mut jet = jet(at);
        if at[0] > 0.015 {
            jet.force_n[1] += 2.0;
        }
        SolveResult::Solved(jet)
    };
    assert_eq!(searched(Requirements { max_configurations: 60, ..WANTED }, jumps).1, Verdict::NotReached);
}

#[test]
fn failures_are_gone_round() {
    let strict = Tolerance { relative: 1e-4, absolute_n: 1e-4 };
    let wanted = Requirements { tolerance: strict, ..WANTED };
    let (search, verdict) =
        searched(wanted, |at| if at[2] < -0.02 { SolveResult::Failed } else { solved(at) });
    assert_eq!(verdict, Verdict::Passed);
    assert!(search.fitted.jets.iter().all(|jet| jet.control_m[2] >= -0.02));
    assert!(
        search.fitted.jets.iter().any(|jet| jet.control_m[2] < -0.01),
        "positions close to the failed ones"
    );
}

#[test]
fn nothing_solvable_ends() {
    let (search, verdict) =
        searched(Requirements { max_configurations: 20, ..WANTED }, |_| SolveResult::Failed);
    assert_eq!(verdict, Verdict::NotReached);
    assert_eq!(search.fitted.jets.len(), 1);
}
