//! Runs the contract checks on every device and transport. A new rig needs an entry here and in
//! `palpate_hil::rig::all`.

use palpate_hil::contract::CHECKS;
use palpate_hil::rig;

/// Runs all checks, also after a violation, so that a defect shows all its effects.
fn keeps_the_contract(name: &str) {
    let kind = rig::all().into_iter().find(|kind| kind.name == name).expect("it is listed");
    let violation: Vec<String> = CHECKS
        .iter()
        .filter_map(|check| check.run(kind).err().map(|why| format!("{}: {why}", check.name)))
        .collect();
    assert!(
        violation.is_empty(),
        "{name} violates {} of {}:\n{}",
        violation.len(),
        CHECKS.len(),
        violation.join("\n")
    );
}

#[test]
fn falcon_in_memory() {
    keeps_the_contract("falcon-memory");
}

#[test]
fn falcon_in_memory_with_threads() {
    keeps_the_contract("falcon-threads");
}

#[test]
fn link_in_memory() {
    keeps_the_contract("link-memory");
}

#[test]
fn link_over_a_pseudo_terminal() {
    keeps_the_contract("link-pty");
}

#[test]
fn polhem_in_memory() {
    keeps_the_contract("polhem-memory");
}

#[test]
fn polhem_over_a_pseudo_terminal() {
    keeps_the_contract("polhem-pty");
}

#[test]
fn touch_on_its_library() {
    keeps_the_contract("touch-library");
}

#[test]
fn omega_on_its_library() {
    keeps_the_contract("omega-library");
}

#[test]
fn inverse3_on_its_service() {
    keeps_the_contract("haply-service");
}

#[test]
fn every_rig_has_a_test() {
    let names: Vec<&str> = rig::all().iter().map(|kind| kind.name).collect();
    assert_eq!(
        names,
        [
            "falcon-memory",
            "falcon-threads",
            "link-memory",
            "link-pty",
            "polhem-memory",
            "polhem-pty",
            "touch-library",
            "omega-library",
            "haply-service"
        ],
        "one test above for each"
    );
}
