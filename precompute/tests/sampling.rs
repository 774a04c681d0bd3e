//! The reachable set of the bench `sampling`.

#[path = "../benches/sampling/reach.rs"]
#[allow(dead_code, reason = "a module of the bench, which uses all of it")]
mod reach;

use palpate_precompute::num::{in_ball, norm};
use palpate_precompute::spec::{Quantity, Requirements, Tolerance};
use reach::is_reached;

#[test]
fn positions_fill_the_ball_and_what_a_tool_meets_has_a_side() {
    let inside = (0..4000).filter(|&n| norm(in_ball(n, 0.5, 1.0)) < 0.5).count();
    assert!((450..550).contains(&inside), "{inside}: an eighth is in the inner half");
    let wanted = Requirements {
        tolerance: Tolerance::IMPERCEPTIBLE,
        radius_m: 1.0,
        max_force_n: 2.0,
        push: Some([0.0, 0.0, 1.0]),
        workspace_m: None,
        column: None,
        quantity: Quantity::Energy,
        max_configurations: 9,
    };
    assert!(is_reached(&wanted, [0.0, 0.0, -1.0]) && !is_reached(&wanted, [0.0, 0.0, 1.0]));
    assert!(!is_reached(&wanted, [0.0, 0.0, -2.1]));
}
