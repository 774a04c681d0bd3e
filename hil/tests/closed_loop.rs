//! A minute of palpation with each device profile.

use palpate_core::Method;
use palpate_hil::closed_loop::{Table, palpate_all};
use palpate_hil::rig;
use palpate_host::device::profile::Profile;

#[test]
fn a_minute_of_palpation_is_what_the_organ_says_and_does_not_shake() {
    let all = palpate_all(&rig::all(), Method::Energy, 60).expect("nothing is wrong with the links");
    println!("{}", Table(&all));
    // The Falcon twice: its driver has threads of its own, or not.
    assert_eq!(all.len(), Profile::names().count() + 1);
    for found in all {
        assert_eq!(found.strokes, 20);
        assert_eq!(found.broken(), None, "{found:?}");
    }
}
