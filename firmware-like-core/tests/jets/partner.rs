//! Jets beside a partner: another tool on the same body.

use palpate_core::vec3::Vec3;
use palpate_core::{Jet, JetCoupling, JetFlags};

use crate::common::jets::{Tool, flat};

/// A force of 1 N that a partner at x raises by 100 N/m.
fn beside(x: f32) -> Jet {
    let mixed_n_m = [[100.0, 0.0, 0.0], [0.0; 3], [0.0; 3]];
    let coupling =
        Some(JetCoupling { control_m: [x, 0.0, 0.0], slope_n: [0.0; 3], mixed_n_m, own_n_m: [0.0; 6] });
    Jet { coupling, ..flat(0, [0.0; 3], [1.0 + 100.0 * x, 0.0, 0.0]) }
}

/// The force along x with a partner at x, after the fades.
fn felt(tool: &mut Tool<1, 8>, partner_m: Option<Vec3>) -> f32 {
    tool.memory.partner(partner_m);
    for _ in 0..200 {
        tool.at([0.0; 3]);
    }
    tool.at([0.0; 3]).force_n[0]
}

#[test]
fn a_partner_that_moves_changes_the_force() {
    let mut tool = Tool::<1, 8>::new(&[(0, 1.0)]);
    tool.learn([beside(0.001), beside(0.009)]);
    for x in [0.0, 0.001, 0.004, 0.006, 0.012] {
        let found = felt(&mut tool, Some([x, 0.0, 0.0]));
        assert!((found - 1.0 - 100.0 * x).abs() < 1e-5, "{x}: {found} N");
    }
    // No farther than the trust radius of 20 mm.
    assert!((felt(&mut tool, Some([0.5, 0.0, 0.0])) - 1.0 - 100.0 * 0.029).abs() < 1e-5);
}

/// Jets with and without a partner do not stand for each other.
#[test]
fn a_partner_that_leaves_leaves_its_jets() {
    let mut tool = Tool::<1, 8>::new(&[(0, 1.0)]);
    tool.learn([beside(0.01), flat(0, [0.003, 0.0, 0.0], [0.5, 0.0, 0.0])]);
    assert!((felt(&mut tool, Some([0.0; 3])) - 1.0).abs() < 1e-5);
    for none in [None, Some([f32::NAN, 0.0, 0.0])] {
        assert!((felt(&mut tool, none) - 0.5).abs() < 1e-5);
    }
}

/// Of a root, s is 0.1 + 5 x + 2 p: the force is its product with the slope.
#[test]
fn a_partner_changes_value_and_slope_of_a_root() {
    let partner = JetCoupling {
        control_m: [0.0; 3],
        slope_n: [2.0, 0.0, 0.0],
        mixed_n_m: [[30.0, 0.0, 0.0], [0.0; 3], [0.0; 3]],
        own_n_m: [0.0; 6],
    };
    let root = Jet {
        flags: JetFlags { root: true, ..JetFlags::default() },
        energy_j: 0.1,
        coupling: Some(partner),
        ..flat(0, [0.0; 3], [5.0, 0.0, 0.0])
    };
    let mut tool = Tool::<1, 8>::new(&[(0, 1.0)]);
    tool.learn([root]);
    for p in [0.0, 0.01, -0.02] {
        let found = felt(&mut tool, Some([p, 0.0, 0.0]));
        assert!((found - (0.1 + 2.0 * p) * (5.0 + 30.0 * p)).abs() < 1e-5, "{p}: {found} N");
    }
    tool.learn([Jet { energy_j: 0.03, ..root }]);
    assert_eq!(felt(&mut tool, Some([-0.02, 0.0, 0.0])), 0.0, "s would be negative");
}

#[test]
fn a_partner_of_wild_numbers_is_refused() {
    let mut tool = Tool::<1, 8>::new(&[(0, 1.0)]);
    let with = |change: &dyn Fn(&mut JetCoupling)| {
        let mut partner = beside(0.0).coupling.unwrap_or_default();
        change(&mut partner);
        Jet { coupling: Some(partner), ..beside(0.0) }
    };
    assert!(!tool.memory.insert(&with(&|partner| partner.control_m[1] = 1.1)));
    assert!(!tool.memory.insert(&with(&|partner| partner.slope_n[2] = f32::NAN)));
    assert!(!tool.memory.insert(&with(&|partner| partner.mixed_n_m[2][1] = f32::INFINITY)));
}
