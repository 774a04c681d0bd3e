//! The fit of an analytic energy.

use super::super::synthetic::{jet, spread};
use super::*;

fn system(configurations: u32, length_m: f64) -> KernelSystem {
    let mut system = KernelSystem::of_energy(length_m, jet([0.0; 3]).stiffness_n_m);
    system.add(&[jet([0.0; 3])]).expect("the first");
    for n in 1..configurations {
        system.add(&[jet(spread(n, 0.05))]).expect("apart");
    }
    system
}

fn fit(configurations: u32, length_m: f64) -> KernelFit {
    system(configurations, length_m).fit
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

fn worst_n(fit: &KernelFit) -> f64 {
    let at = |n| spread(n, 0.045);
    (1000..1200).map(|n| apart(fit.force_n(at(n)), jet(at(n)).force_n)).fold(0.0, f64::max)
}

#[test]
fn a_taylor_force_is_exact_to_third_order() {
    let from = jet([0.01, -0.02, 0.015]);
    let error = |step: f64| {
        let at = [0.01 + 0.8 * step, -0.02 + 0.3 * step, 0.015 - 0.5 * step];
        apart(from.taylor_force_n(at), jet(at).force_n)
    };
    let order = (error(0.008) / error(0.004)).log2();
    assert!((order - 3.0).abs() < 0.1, "order {order}");
}

#[test]
fn few_configurations_are_enough_and_more_are_better() {
    let errors = [4, 12, 36].map(|n| worst_n(&fit(n, 0.04)));
    // The largest force is about 20 N.
    assert!(errors[2] < 0.01 && errors[0] > 10.0 * errors[1] && errors[1] > 5.0 * errors[2], "{errors:?} N");
}

#[test]
fn what_is_given_is_met() {
    let fit = fit(20, 0.03);
    for n in 1..20 {
        let (given, found) = (jet(spread(n, 0.05)), fit.derivatives(spread(n, 0.05)));
        assert!((found[0][0][0] - given.energy_j).abs() < 1e-6, "{n}");
        assert!(apart([found[1][0][0], found[0][1][0], found[0][0][1]], given.force_n) < 1e-4, "{n}");
        assert!((found[1][1][0] - given.stiffness_n_m[(0, 1)]).abs() < 0.02, "{n}");
    }
}

/// All 27 derivatives, each compared with a difference of the next lower one.
#[test]
fn derivatives_are_those_of_the_energy() {
    let (fit, at, step) = (fit(15, 0.03), [0.012, -0.008, 0.019], 1e-5);
    let here = fit.derivatives(at);
    assert!(apart([here[1][0][0], here[0][1][0], here[0][0][1]], fit.force_n(at)) < 1e-9);
    let jet = fit.jet(at);
    assert!(apart(jet.force_n, fit.force_n(at)) < 1e-9 && (jet.energy_j - here[0][0][0]).abs() < 1e-12);
    assert!((jet.stiffness_n_m[(0, 1)] - here[1][1][0]).abs() < 1e-9 * here[1][1][0].abs().max(1.0));
    // W_xxy and W_xyz.
    for (third, exact) in [(jet.third_n_m2[1], here[2][1][0]), (jet.third_n_m2[4], here[1][1][1])] {
        assert!((third - exact).abs() < 1e-9 * exact.abs().max(1.0), "{third} {exact}");
    }
    for axis in 0..3 {
        let beside = [-step, step].map(|step| {
            let mut at = at;
            at[axis] += step;
            fit.derivatives(at)
        });
        for (a, b, c) in (0..27).map(|n| (n / 9, n / 3 % 3, n % 3)) {
            let mut below = [a, b, c];
            if below[axis] == 0 {
                continue;
            }
            below[axis] -= 1;
            let [i, j, k] = below;
            let difference = (beside[1][i][j][k] - beside[0][i][j][k]) / (2.0 * step);
            let size = 1.0 + here[a][b][c].abs();
            assert!(
                (difference - here[a][b][c]).abs() < 1e-3 * size,
                "{a}{b}{c}: {difference} {}",
                here[a][b][c]
            );
        }
    }
}

/// The jet of a touched body: the energy at p = 0 is not zero.
fn touched(p: [f64; 3]) -> EnergyJet {
    let jet = jet(p);
    EnergyJet { energy_j: jet.energy_j + 2.0, ..jet }
}

fn root_system(configurations: u32, length_m: f64) -> KernelSystem {
    let base = Base::of(Quantity::Root, &touched([0.0; 3])).expect("a root");
    let mut system = KernelSystem::new(length_m, Quantity::Root, base);
    let places = std::iter::once([0.0; 3]).chain((1..configurations).map(|n| spread(n, 0.05)));
    system.add(&places.map(touched).collect::<Vec<_>>()).expect("apart");
    system
}

#[test]
fn a_root_is_squared_to_its_energy() {
    let whole = touched([0.01, -0.02, 0.015]);
    let back = whole.root(LEAST_ROOT_J).expect("a root").squared();
    for (found, exact) in back.numbers().into_iter().zip(whole.numbers()) {
        assert!((found - exact).abs() < 1e-12 * exact.abs().max(1.0), "{found} {exact}");
    }
    assert_eq!(EnergyJet { energy_j: 1e-6, ..whole }.root(LEAST_ROOT_J), None);
    let beside = EnergyJet { energy_j: -0.1, ..whole }.squared();
    assert!(beside.numbers().iter().all(|x| *x == 0.0));
}

/// A fit of the root has the force, the energy and the derivatives of the energy, and knows its errors.
#[test]
fn a_fit_of_the_root_gives_the_energy() {
    let errors = [6, 12, 36].map(|n| {
        let fit = root_system(n, 0.04).fit;
        let at = |n| spread(n, 0.045);
        (1000..1200).map(|n| apart(fit.force_n(at(n)), touched(at(n)).force_n)).fold(0.0, f64::max)
    });
    assert!(errors[2] < 0.02 && errors[0] > 2.0 * errors[1] && errors[1] > 5.0 * errors[2], "{errors:?} N");
    let system = root_system(36, 0.04);
    let at = [0.012, -0.008, 0.019];
    let (found, exact) = (system.fit.jet(at), touched(at));
    assert!((found.energy_j - exact.energy_j).abs() < 1e-4, "{} {}", found.energy_j, exact.energy_j);
    assert!(apart(found.force_n, system.fit.force_n(at)) < 1e-9);
    // Its derivatives are those of its force: the square of the root is differentiated right.
    for axis in 0..3 {
        let beside = [-1e-5, 1e-5].map(|step| {
            let mut at = at;
            at[axis] += step;
            system.fit.jet(at)
        });
        let slope = |value: &dyn Fn(&EnergyJet) -> f64| (value(&beside[1]) - value(&beside[0])) / 2e-5;
        for i in 0..3 {
            let stiffness_n_m = slope(&|jet| jet.force_n[i]);
            assert!(
                (found.stiffness_n_m[(i, axis)] - stiffness_n_m).abs() < 1e-4 * stiffness_n_m.abs().max(1.0)
            );
        }
        let pure = found.third_n_m2[[0, 6, 9][axis]];
        let third = slope(&|jet| jet.stiffness_n_m[(axis, axis)]);
        assert!((pure - third).abs() < 1e-4 * third.abs().max(1.0), "{axis}: {pure} {third}");
        let mixed = slope(&|jet| jet.stiffness_n_m[((axis + 1) % 3, (axis + 2) % 3)]);
        assert!((found.third_n_m2[4] - mixed).abs() < 1e-4 * mixed.abs().max(1.0), "{mixed}");
    }
    // The table holds the root itself.
    let (value, slope) = system.fit.value_and_slope(at);
    let table = system.fit.derivatives(at);
    assert!((value - (2.0 * exact.energy_j).sqrt()).abs() < 1e-4, "{value}");
    assert!((table[0][0][0] - value).abs() < 1e-12 && (table[0][1][0] - slope[1]).abs() < 1e-9);
    // What the others say of one is what a fit without it says.
    let (left, missed) = (20, system.leave_one_out_n().nth(20).expect("an error"));
    let base = Base::of(Quantity::Root, &touched([0.0; 3])).expect("a root");
    let mut without = KernelSystem::new(0.04, Quantity::Root, base);
    let places = std::iter::once([0.0; 3]).chain((1..36).map(|n| spread(n, 0.05)));
    let others: Vec<EnergyJet> =
        places.enumerate().filter(|(n, _)| *n != left).map(|(_, at)| touched(at)).collect();
    without.add(&others).expect("apart");
    let truth = touched(spread(left as u32, 0.05));
    let said = without.fit.force_n(truth.control_m);
    let expected: [f64; 3] = std::array::from_fn(|i| truth.force_n[i] - said[i]);
    assert!(apart(missed, expected) < 1e-5 + 1e-3 * apart(expected, [0.0; 3]), "{missed:?} {expected:?}");
}

#[test]
fn one_by_one_is_as_all_at_once() {
    let jets: Vec<EnergyJet> = (1..12).map(|n| jet(spread(n, 0.05))).collect();
    let mut whole = KernelSystem::of_energy(0.03, jet([0.0; 3]).stiffness_n_m);
    whole.add(&[&[jet([0.0; 3])], &jets[..]].concat()).expect("apart");
    let at = [0.02, 0.01, -0.03];
    assert!(apart(whole.fit.force_n(at), fit(12, 0.03).force_n(at)) < 1e-6);
}

#[test]
fn the_same_configuration_twice_changes_nothing_or_is_refused() {
    let mut system = system(5, 0.03);
    let before = system.fit.force_n([0.01; 3]);
    let twice = system.add(&[jet(spread(3, 0.05)), jet(spread(3, 0.05))]);
    assert!(twice.is_err() == (system.fit.centres.len() == 5));
    assert!(apart(before, system.fit.force_n([0.01; 3])) < 1e-3);
}
