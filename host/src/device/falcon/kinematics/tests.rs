use super::*;

/// Reachable positions of a box of 80 x 80 x 70 mm, 4 mm apart.
fn workspace(mechanism: &Kinematics) -> Vec<([f64; 3], [f64; 3])> {
    let axis = |count: u32, from: f64, to: f64| {
        (0..count).map(move |i| from + (to - from) * f64::from(i) / f64::from(count - 1))
    };
    let side = move || axis(21, -0.04, 0.04);
    let places =
        axis(18, 0.085, 0.155).flat_map(|z| side().flat_map(move |y| side().map(move |x| [x, y, z])));
    places.filter_map(|p| Some((p, mechanism.angles_rad(p)?))).collect()
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    let d = core::array::from_fn(|i| a[i] - b[i]);
    dot(d, d).sqrt()
}

#[test]
fn counts_on_the_axis_match_the_description() {
    let mechanism = Kinematics::default();
    for (z, count) in [(0.075, -1463), (0.11, -516), (0.13, -96), (0.15, 336), (0.17, 872)] {
        assert_eq!(mechanism.counts([0.0, 0.0, z]), Some([count; 3]), "z = {z}");
    }
    assert!((COUNTS_PER_DEGREE - 27.446).abs() < 5e-4);
    assert_eq!(mechanism.counts([0.2, 0.0, 0.12]), None);
}

/// Each solution starts from the centre, the worst initial guess.
#[test]
fn positions_are_recovered_from_their_angles_in_the_whole_workspace() {
    let mechanism = Kinematics::default();
    let places = workspace(&mechanism);
    let (mut failed, mut worst_m, mut most) = (0, 0.0_f64, 0);
    for (p, angles) in &places {
        let mut solver = mechanism;
        match solver.solve_angles(*angles) {
            Solution::Solved { iterations } => {
                worst_m = worst_m.max(distance(solver.pose().position_m, *p));
                most = most.max(iterations);
            }
            Solution::Kept => failed += 1,
        }
    }
    println!("{} places, {failed} failed, worst {worst_m:.1e} m, {most} iterations", places.len());
    assert!(worst_m < 1e-9, "{worst_m}");
    assert!(places.len() > 7900 && failed <= 5, "{failed} of {}", places.len());
}

/// Along a path of the hand, as in the driver: counts are rounded, each solution starts from the last pose.
#[test]
fn a_moving_hand_is_tracked_within_a_count() {
    let mut mechanism = Kinematics::default();
    let (mut worst_m, mut most) = (0.0_f64, 0);
    for i in 0..20_000 {
        let t = f64::from(i) * 1e-3;
        let p = [0.038 * (9.0 * t).sin(), 0.038 * (7.0 * t).cos(), 0.12 + 0.033 * (5.0 * t).sin()];
        let counts = mechanism.counts(p).expect("within reach");
        let Solution::Solved { iterations } = mechanism.solve(counts) else { panic!("lost at {p:?}") };
        // The first solution starts from the centre.
        most = if i == 0 { 0 } else { most.max(iterations) };
        worst_m = worst_m.max(distance(mechanism.pose().position_m, p));
    }
    // Half a count of every encoder; a count is at most 54 um, and more near the corners.
    assert!(worst_m < 60e-6 && most <= 4, "{worst_m} m, {most} iterations");
}

#[test]
fn the_jacobian_matches_differences() {
    let mut mechanism = Kinematics::default();
    let step = 1e-4;
    for (p, angles) in workspace(&mechanism).into_iter().step_by(37) {
        assert_ne!(mechanism.solve_angles(angles), Solution::Kept, "{p:?}");
        let pose = *mechanism.pose();
        for crank in 0..3 {
            let mut at = |sign: f64| {
                let mut moved = angles;
                moved[crank] += sign * step;
                assert_ne!(mechanism.solve_angles(moved), Solution::Kept);
                mechanism.pose().position_m
            };
            let (after, before) = (at(1.0), at(-1.0));
            for axis in 0..3 {
                let slope = (after[axis] - before[axis]) / (2.0 * step);
                let j = pose.jacobian[axis][crank];
                assert!((slope - j).abs() < 1e-7 + 1e-6 * j.abs(), "{p:?}: {slope}, not {j}");
            }
        }
    }
}

/// tau . dtheta = F . dp, and in the centre a push along the axis gives three equal torques.
#[test]
fn torques_do_the_work_of_the_force() {
    let mut mechanism = Kinematics::default();
    for torque in mechanism.pose().torques_n_m([0.0, 0.0, 1.0]) {
        // The cranks turn towards the user as z grows.
        assert!((0.01..0.1).contains(&torque), "{torque}");
    }
    let (p, force) = ([0.012, -0.02, 0.13], [1.0, -2.0, 0.7]);
    let angles = mechanism.angles_rad(p).expect("within reach");
    assert_ne!(mechanism.solve_angles(angles), Solution::Kept);
    let torques = mechanism.pose().torques_n_m(force);
    let step = [1e-7, 2e-7, -1e-7];
    let moved = mechanism.angles_rad([p[0] + step[0], p[1] + step[1], p[2] + step[2]]).expect("too");
    let work = dot(torques, core::array::from_fn(|i| moved[i] - angles[i]));
    assert!((work - dot(force, step)).abs() < 1e-5 * dot(force, step).abs(), "{work}");
}

#[test]
fn counts_without_a_pose_keep_the_last_one() {
    let mut mechanism = Kinematics::default();
    assert_ne!(mechanism.solve([-516, -500, -530]), Solution::Kept);
    let good = *mechanism.pose();
    let impossible =
        [[i16::MAX, i16::MIN, 0], [i16::MIN; 3], [i16::MAX; 3], [-2500, 2500, -516], [5000, -516, -516]];
    for counts in impossible {
        assert_eq!(mechanism.solve(counts), Solution::Kept, "{counts:?}");
        assert_eq!(*mechanism.pose(), good);
    }
    assert_eq!(mechanism.solve_angles([f64::NAN, 0.0, 0.0]), Solution::Kept);
    assert_ne!(mechanism.solve([-516, -500, -530]), Solution::Kept, "later counts are solved");
    mechanism.reset();
    assert!(distance(mechanism.pose().position_m, CENTRE_M) < 1e-12);
}

/// For any input, an accepted pose has the given counts.
#[test]
fn an_accepted_pose_has_the_given_counts() {
    let (mut state, mut accepted) = (7_u32, 0);
    let mut mechanism = Kinematics::default();
    for _ in 0..20_000 {
        let counts = core::array::from_fn(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((state >> 16) as i16) / 8
        });
        if mechanism.solve(counts) != Solution::Kept {
            accepted += 1;
            assert_eq!(mechanism.counts(mechanism.pose().position_m), Some(counts));
        }
    }
    assert!(accepted > 100, "{accepted}");
}
