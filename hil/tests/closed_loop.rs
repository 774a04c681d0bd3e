//! A minute of palpation with each device profile.

use palpate_core::{Method, Phase};
use palpate_hil::closed_loop::{Table, palpate_all};
use palpate_hil::rig;
use palpate_host::device::profile::Profile;

#[test]
fn a_minute_of_palpation_is_what_the_organ_says_and_does_not_shake() {
    let all = palpate_all(&rig::all(), Method::Energy, 60).expect("nothing is wrong with the links");
    println!("{}", Table(&all));
    assert_eq!(all.len(), Profile::names().count());
    for found in all {
        assert_eq!(found.phase, Phase::Active, "{found:?}");
        assert!(found.touches >= 15 && found.touching_us > 20_000_000, "{found:?}");
        // A tenth of the largest force is about what a hand can tell.
        assert!(found.delay.rms() + found.steps.rms() < 0.1 * found.peak_n, "{found:?}");
        // A hand at rest: no limit cycle beyond a step of the encoders.
        assert!(found.rest_m < found.count_m, "{found:?}");
        // What a step of the encoders is worth at the largest force, each time it touches.
        let quantum_j = f64::from(found.touches) * f64::from(found.count_m * found.peak_n);
        assert!(found.given_j <= quantum_j, "{found:?}");
    }
}
