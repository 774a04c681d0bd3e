//! Jets of s = sqrt(2 W).

use palpate_core::{Coverage, Jet, JetFlags, vec3};

/// s = 0.1 + 5 x + 40 x^2 / 2 + 30 y^2 / 2 - 2e3 x^2 y / 2 in sqrt(J), trusted to 10 mm.
fn root() -> Jet {
    Jet {
        flags: JetFlags { root: true, ..JetFlags::default() },
        energy_j: 0.1,
        force_n: [5.0, 0.0, 0.0],
        stiffness_n_m: [40.0, 0.0, 0.0, 30.0, 0.0, 0.0],
        third_n_m2: [0.0, -2e3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        trust_m: 0.01,
        ..Jet::default()
    }
}

#[test]
fn the_force_is_the_product_of_the_root_and_its_gradient() {
    let [x, y] = [0.004_f32, -0.006];
    let s = 0.1 + 5.0 * x + 20.0 * x * x + 15.0 * y * y - 1e3 * x * x * y;
    let slope = [5.0 + 40.0 * x - 2e3 * x * y, 30.0 * y - 1e3 * x * x, 0.0];
    let found = root().force([x, y, 0.0]);
    let wanted = slope.map(|of| s * of);
    assert!(vec3::distance(found.force_n, wanted) < 1e-6, "{:?} {wanted:?}", found.force_n);
    assert_eq!(found.coverage, Coverage::Scattered);
    assert!((root().energy_j([x, y, 0.0]) / (0.5 * s * s) - 1.0).abs() < 1e-6);
}

/// Without a touch s would be negative: no force and no energy, inside the trust radius and beyond.
#[test]
fn beyond_the_first_touch_there_is_nothing() {
    let light = Jet { energy_j: 0.02, ..root() };
    for x in [-0.0042, -0.009, -0.02] {
        assert_eq!(
            (light.force([x, 0.0, 0.0]).force_n, light.energy_j([x, 0.0, 0.0])),
            ([0.0; 3], 0.0),
            "{x}"
        );
    }
    assert!(light.force([-0.0039, 0.0, 0.0]).force_n[0] > 0.0);
}

/// The force is that of the energy by differences, and continuous where the expansion levels off.
#[test]
fn the_force_is_the_slope_of_the_energy() {
    let jet = root();
    let at = |share: f32| [0.6 * share, 0.8 * share, 0.0];
    for r in [0.001_f32, 0.005, 0.0095] {
        let step = 2e-4;
        let slope = (jet.energy_j(at(r + step)) - jet.energy_j(at(r - step))) / (2.0 * step);
        let along = vec3::dot(jet.force(at(r)).force_n, [0.6, 0.8, 0.0]);
        assert!((slope / along - 1.0).abs() < 1e-3, "{r}: {slope} {along}");
    }
    let [inside, outside] = [0.01 * (1.0 - 1e-5), 0.01 * (1.0 + 1e-5)].map(|r| jet.force(at(r)).force_n);
    assert!(vec3::distance(inside, outside) < 1e-4);
    let far = jet.force([10.0, 10.0, 10.0]).force_n;
    assert!(vec3::is_finite(far));
}

/// Beside the body s is negative, also where its curvature at the rim would turn it: there is no force, and s falls evenly.
#[test]
fn a_root_goes_straight_on_beyond_its_radius() {
    // s = 0.01 - 10 x + 2000 x^2 is zero at 1.4 mm, and would be positive again beyond 3.6 mm.
    let jet = Jet {
        flags: JetFlags { root: true, ..JetFlags::default() },
        energy_j: 0.01,
        force_n: [-10.0, 0.0, 0.0],
        stiffness_n_m: [4000.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        trust_m: 0.002,
        ..Jet::default()
    };
    for x in [2e-3, 4e-3, 7e-3, 10e-3, 14e-3, 30e-3] {
        assert_eq!((jet.force([x, 0.0, 0.0]).force_n, jet.energy_j([x, 0.0, 0.0])), ([0.0; 3], 0.0), "{x}");
    }
    // Inwards s' is -10 - 8 at the rim and stays so: h = s s'.
    for x in [-2e-3_f32, -4e-3, -6e-3] {
        let s = 0.01 + 0.02 + 0.008 - 18.0 * (x + 2e-3);
        let [h, ..] = jet.force([x, 0.0, 0.0]).force_n;
        assert!((h + 18.0 * s).abs() < 1e-4, "{x}: {h}");
    }
}
