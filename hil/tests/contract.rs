//! Every device on every transport is held to the one contract. A new rig is a line here and in `palpate_hil::rig::all`.

use palpate_hil::contract::CHECKS;
use palpate_hil::rig;

/// All checks, also after one that is broken: what a fault breaks says what it is.
fn keeps_the_contract(name: &str) {
    let kind = rig::all().into_iter().find(|kind| kind.name == name).expect("it is listed");
    let broken: Vec<String> = CHECKS
        .iter()
        .filter_map(|check| check.run(kind).err().map(|why| format!("{}: {why}", check.name)))
        .collect();
    assert!(broken.is_empty(), "{name} breaks {} of {}:\n{}", broken.len(), CHECKS.len(), broken.join("\n"));
}

#[test]
fn falcon_in_memory() {
    keeps_the_contract("falcon-memory");
}

#[test]
fn falcon_in_memory_by_threads() {
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
fn every_rig_is_held_to_it() {
    let names: Vec<&str> = rig::all().iter().map(|kind| kind.name).collect();
    assert_eq!(
        names,
        ["falcon-memory", "falcon-threads", "link-memory", "link-pty", "polhem-memory", "polhem-pty"],
        "a test above for each of them"
    );
}
