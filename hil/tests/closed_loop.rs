//! A minute of palpation with each device profile.

use palpate_core::Method;
use palpate_hil::closed_loop::{Table, palpate_all};
use palpate_hil::rig;
use palpate_host::device::profile::Profile;

#[test]
fn a_minute_of_palpation_renders_the_organ_without_oscillation() {
    let all = palpate_all(&rig::all(), Method::Energy, 60).expect("the links have no faults");
    println!("{}", Table(&all));
    // There are two rigs for the Falcon: with and without threads in the driver.
    assert_eq!(all.len(), Profile::names().count() + 1);
    for result in all {
        assert_eq!(result.strokes, 20);
        assert_eq!(result.violation(), None, "{result:?}");
    }
}
