//! A change of the body's model while the tool touches.

use palpate_core::{Coverage, Field, Jet};

use crate::common::jets::{Tool, flat};

/// The energy tells the tool where to slip: a step of it would throw the contact over the skin.
#[test]
fn the_energy_goes_over_to_a_new_model_without_a_step() {
    let mut tool = Tool::<3, 8>::new(&[(0, 1.0)]);
    let with = |model, energy_j| Jet { model, energy_j, ..flat(0, [0.0; 3], [1.0, 0.0, 0.0]) };
    let place = [0.002, 0.0, 0.0];
    tool.learn([with(0, 5e-3)]);
    tool.at(place);
    let before_j = tool.memory.energy_j(0, place).expect("a jet");
    tool.learn([with(1, 9e-3)]);
    tool.at(place);
    let after_j = tool.memory.energy_j(0, place).expect("a jet");
    assert!((after_j - before_j).abs() < 1e-6, "{before_j} {after_j}");
    for _ in 0..2_000 {
        tool.at(place);
    }
    let late_j = tool.memory.energy_j(0, place).expect("a jet");
    assert!((late_j - before_j - 4e-3).abs() < 1e-6, "{before_j} {late_j}");
}

#[test]
fn the_force_goes_over_to_a_new_model_without_a_step() {
    let mut tool = Tool::<3, 8>::new(&[(0, 1.0)]);
    tool.learn([flat(0, [0.0; 3], [1.0, 0.0, 0.0]), flat(1, [0.0; 3], [1.0, 0.0, 0.0])]);
    assert_eq!(tool.at([0.002, 0.0, 0.0]).force_n[0], 1.0);
    tool.learn([Jet { model: 1, ..flat(0, [0.0; 3], [3.0, 0.0, 0.0]) }]);
    let after: Vec<f32> = (0..1_500).map(|_| tool.at([0.002, 0.0, 0.0]).force_n[0]).collect();
    assert_eq!(after[0], 1.0, "the force of the change itself");
    for (tick, force_n) in after.iter().enumerate().take(500) {
        let exact_n = 3.0 - 2.0 * (-0.01 * tick as f32).exp();
        assert!((force_n - exact_n).abs() < 1e-4, "tick {tick}: {force_n} {exact_n}");
    }
    assert_eq!(after.last(), Some(&3.0), "nothing remains");
    // A jet that comes late belongs to a model that is over, and so do those of a point that was not touched.
    assert!(tool.memory.insert(&flat(0, [0.0; 3], [9.0, 0.0, 0.0])));
    assert_eq!(tool.at([0.002, 0.0, 0.0]).force_n[0], 3.0);
    assert_eq!([0, 1].map(|contact| tool.memory.jets(contact)), [1, 0]);
    tool.hold(&[(1, 1.0)]);
    tool.memory.insert(&Jet { model: 1, ..flat(2, [0.0; 3], [0.0; 3]) });
    assert_eq!(tool.at([0.002, 0.0, 0.0]).coverage, Coverage::Extrapolated);
}
