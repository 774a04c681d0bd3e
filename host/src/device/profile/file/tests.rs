use super::*;

const VALID: &str = r#"name = "bench"

[limits]
max_force_n = 5.0
max_stiffness_n_m = 900.0
rate_hz = 2000.0

[mechanism]
damping = { n_s_m = 0.5, measured = false }
coulomb_n = 0.1

[link]
force_delay_us = 40

[capstan]
metres_per_turn = [0.06, 0.06, -0.03]
origin_m = [-0.1, 0.0, 0.1]

[workspace]
half_m = [0.1, 0.2, 0.3]

[mapping]
axes = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
scale = 2
model_origin_m = [0.0, 0.0, 0.05]

[calibration]
counts_per_n_m = [-9000, 11000, -1e4]
gravity_n = 0.7

[simulation]
mass_kg = 0.3

[buttons]
arm = 3
"#;

#[test]
fn every_value_is_read() {
    let profile = parse(Path::new("bench.toml"), VALID).expect("valid");
    assert_eq!((profile.max_force_n, profile.max_stiffness_n_m, profile.period_us()), (5.0, 900.0, 500));
    assert_eq!(profile.mechanism.damping, Some(Damping { n_s_m: 0.5, measured: false }));
    assert_eq!((profile.mechanism.coulomb_n, profile.mechanism.encoder_quantum_m), (Some(0.1), None));
    assert_eq!((profile.position_delay_us, profile.force_delay_us), (0, 40));
    let capstan = Capstan { metres_per_turn: [0.06, 0.06, -0.03], origin_m: [-0.1, 0.0, 0.1] };
    assert_eq!(profile.capstan, Some(capstan));
    assert_eq!(profile.reach, Reach::Box { half_m: [0.1, 0.2, 0.3] });
    assert_eq!((profile.assumed.mass_kg, profile.assumed.damping_n_s_m), (0.3, 0.0));
    assert_eq!(profile.calibration.counts_per_n_m, [-9e3, 11e3, -1e4]);
    assert_eq!(profile.buttons, Buttons { arm: 0b100, grasp: 0b1 });
    // The device's y is the model's x.
    assert_eq!(profile.gravity_compensation_n(), [0.7, 0.0, 0.0]);
    assert_eq!(profile.workspace.to_model_m([0.0, 0.01, 0.0]), [0.02, 0.0, 0.05]);
}

#[track_caller]
fn refuses(from: &str, to: &str, line: usize, what: &str, fix: &str) {
    assert!(VALID.contains(from));
    let text = VALID.replacen(from, to, 1);
    let error = parse(Path::new("bench.toml"), &text).expect_err("injected fault").to_string();
    assert!(error.starts_with(&format!("bench.toml:{line}: ")), "{error}");
    let (problem, remedy) = error.split_once("; ").expect("a problem and a fix");
    assert!(problem.contains(what) && remedy.contains(fix) && !error.contains('\n'), "{error}");
}

#[test]
fn every_error_has_its_line_and_its_fix() {
    refuses("coulomb_n", "coulomb", 10, "unknown key `coulomb`", "coulomb_n");
    refuses("[link]", "[links]", 12, "unknown key `links`", "link");
    refuses("measured = false", "measurd = false", 9, "unknown key `measurd`", "measured");
    refuses(", measured = false", "", 9, "`measured` is missing", "add");
    refuses("rate_hz = 2000.0\n", "", 3, "`rate_hz` is missing", "add `rate_hz`");
    refuses("5.0", "0", 4, "`max_force_n` = 0", "above zero");
    refuses("5.0", "nan", 4, "`max_force_n` = NaN", "above zero");
    refuses("900.0", "\"stiff\"", 5, "invalid type", "expected type");
    refuses("2000.0", "50", 6, "`rate_hz` = 50", "400 to 10000 Hz");
    refuses("= 40", "= -1", 13, "`force_delay_us` = -1", "0 to 9000 us");
    refuses("= 40", "= 20000", 13, "`force_delay_us` = 20000", "0 to 9000 us");
    refuses("-0.03]", "0.0]", 16, "`metres_per_turn`", "moves down");
    refuses("-0.03]", "nan]", 16, "`metres_per_turn`", "moves down");
    refuses("[-0.1, 0.0", "[-0.1, inf", 17, "`origin_m`", "finite");
    refuses("origin_m = [-0.1", "origin = [-0.1", 17, "unknown key `origin`", "origin_m");
    refuses("half_m =", "radius_m = 0.1\nhalf_m =", 19, "[workspace]", "`radius_m`, or `half_m`");
    refuses("0.1, 0.2", "0.1, 0.0", 20, "`half_m`", "above zero");
    refuses("[1, 0, 0]]", "[-1, 0, 0]]", 23, "`axes` is not a rotation", "right-handed");
    refuses("[0, 1, 0],", "[0, 2, 0],", 23, "`axes` is not a rotation", "unit length");
    refuses("scale = 2", "scale = 0", 24, "`scale` = 0", "above zero");
    refuses("0.0, 0.05", "0.0, inf", 25, "`model_origin_m`", "finite");
    refuses("-9000,", "-900,", 28, "`counts_per_n_m`", "1000 to 100000");
    refuses("11000,", "nan,", 28, "`counts_per_n_m`", "with its sign");
    refuses("arm = 3", "arm = 0", 35, "`arm` = 0", "1 to 32");
    refuses("arm = 3", "grasp = 33", 35, "`grasp` = 33", "1 to 32");
    refuses("-9000, ", "", 28, "invalid length", "expected type");
    refuses("-9000, ", "-9000, 1, ", 28, "invalid length 4", "expected type");
    refuses("[0, 1, 0],", "[0, 1, 0, 5],", 23, "invalid length 4", "expected type");
    refuses("= 0.7", "= -0.7", 29, "`gravity_n` = -0.7", "upwards");
    refuses("= 0.7", "= 2.6", 29, "`gravity_n` = 2.6", "half");
    refuses("gravity_n", "gravity_N", 29, "unknown key `gravity_N`", "gravity_n");
    refuses("mass_kg", "coulomb_n = 1.0\nmass_kg", 32, "`coulomb_n` is assumed", "remove it");
    refuses("\"bench\"", "\"\"", 1, "the name is empty", "name the device");
    refuses("[limits]", "[limits", 3, "not valid TOML", "correct the syntax");
}
