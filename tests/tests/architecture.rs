//! Checks the dependencies between the crates from `cargo metadata`: core and link on no other; precompute on
//! core; host on core and link; hil on core, link and host; tools and tests on all.

use std::collections::BTreeSet;

use cargo_metadata::{DependencyKind, MetadataCommand};

/// The workspace packages that `package` depends on, for linking or for tests only.
fn ours(package: &str, kinds: &[DependencyKind]) -> BTreeSet<String> {
    let metadata = MetadataCommand::new().no_deps().exec().expect("cargo metadata runs in this workspace");
    let found = metadata.packages.iter().find(|p| p.name.as_str() == package);
    let found = found.unwrap_or_else(|| panic!("no package {package} in the workspace"));
    found
        .dependencies
        .iter()
        .filter(|d| kinds.contains(&d.kind) && d.name.starts_with("palpate"))
        .map(|d| d.name.clone())
        .collect()
}

fn set(names: &[&str]) -> BTreeSet<String> {
    names.iter().map(|n| (*n).to_string()).collect()
}

const LINKED: [DependencyKind; 2] = [DependencyKind::Normal, DependencyKind::Build];
const TESTED: [DependencyKind; 1] = [DependencyKind::Development];

#[test]
fn dependencies_point_one_way() {
    assert_eq!(ours("palpate-core", &LINKED), set(&[]));
    // The crate itself: its tests and examples need its feature `alloc`.
    assert_eq!(ours("palpate-core", &TESTED), set(&["palpate-core"]));
    assert_eq!(ours("palpate-link", &LINKED), set(&[]));
    assert_eq!(ours("palpate-link", &TESTED), set(&[]));
    assert_eq!(ours("palpate-devices", &LINKED), set(&[]));
    assert_eq!(ours("palpate-c", &LINKED), set(&["palpate-core"]));
    assert_eq!(ours("palpate-c", &TESTED), set(&[]));
    assert_eq!(ours("palpate-precompute", &LINKED), set(&["palpate-core", "palpate-devices"]));
    assert_eq!(ours("palpate-precompute", &TESTED), set(&[]));
    assert_eq!(ours("palpate-host", &LINKED), set(&["palpate-core", "palpate-devices", "palpate-link"]));
    assert_eq!(ours("palpate-host", &TESTED), set(&[]));
    // The emulated FTDI chip implements the host's trait, and the host's hand model holds the emulated grip.
    assert_eq!(ours("palpate-hil", &LINKED), set(&["palpate-core", "palpate-host", "palpate-link"]));
    assert_eq!(ours("palpate-hil", &TESTED), set(&[]));
}

#[test]
fn no_std_crates_use_no_default_features() {
    // A default feature of a dependency may bring `std` into a no_std crate.
    let metadata = MetadataCommand::new().no_deps().exec().expect("cargo metadata runs in this workspace");
    for name in ["palpate-core", "palpate-link"] {
        let package = metadata.packages.iter().find(|p| p.name.as_str() == name).expect("a member");
        let leaky: Vec<&str> = package
            .dependencies
            .iter()
            .filter(|d| d.kind == DependencyKind::Normal && d.uses_default_features && d.name != "libm")
            .map(|d| d.name.as_str())
            .collect();
        assert!(leaky.is_empty(), "default features of {name}: {leaky:?}");
    }
}
