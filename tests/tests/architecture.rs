//! Checks the dependencies between the crates from `cargo metadata`: core and link on no other; precompute on
//! core; host on core and link; viewer and record on core and host; hil on core, link and host; the Python
//! package on core, precompute, host and record; tools and tests on all.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use cargo_metadata::{DependencyKind, MetadataCommand, PackageId};

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
    for beside in ["palpate-viewer", "palpate-record"] {
        assert_eq!(ours(beside, &LINKED), set(&["palpate-core", "palpate-host"]));
        assert_eq!(ours(beside, &TESTED), set(&[]));
    }
    // The emulated FTDI chip implements the host's trait, and the host's hand model holds the emulated grip.
    let emulated = ["palpate-core", "palpate-host", "palpate-link", "palpate-maker-stub"];
    assert_eq!(ours("palpate-hil", &LINKED), set(&emulated));
    assert_eq!(ours("palpate-hil", &TESTED), set(&[]));
    let from_python = ["palpate-core", "palpate-host", "palpate-precompute", "palpate-record"];
    assert_eq!(ours("palpate-python", &LINKED), set(&from_python));
    assert_eq!(ours("palpate-python", &TESTED), set(&[]));
    // A library of its own, which the driver loads.
    assert_eq!(ours("palpate-maker-stub", &LINKED), set(&[]));
}

/// A driver author compiles the host alone, and the guest of the QEMU bench hil alone.
#[test]
fn host_and_hil_link_no_window_picture_or_recording() {
    let metadata = MetadataCommand::new().exec().expect("cargo metadata runs in this workspace");
    let nodes = &metadata.resolve.as_ref().expect("a graph").nodes;
    let name = |id: &PackageId| metadata[id].name.to_string();
    for crate_name in ["palpate-host", "palpate-hil"] {
        let first = nodes.iter().find(|node| name(&node.id) == crate_name).expect("a member");
        let (mut linked, mut open) = (BTreeSet::new(), vec![first.id.clone()]);
        while let Some(id) = open.pop() {
            let node = nodes.iter().find(|node| node.id == id).expect("in the graph");
            let deps =
                node.deps.iter().filter(|dep| dep.dep_kinds.iter().any(|kind| LINKED.contains(&kind.kind)));
            open.extend(deps.map(|dep| dep.pkg.clone()).filter(|dep| linked.insert(name(dep))));
        }
        assert!(linked.contains("palpate-core") && linked.contains("rusb"), "{linked:?}");
        let heavy = ["minifb", "glam", "png", "mcap", "palpate-viewer", "palpate-record"];
        let found: Vec<&str> = heavy.into_iter().filter(|heavy| linked.contains(*heavy)).collect();
        assert!(found.is_empty(), "{crate_name} links {found:?}");
    }
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

/// Files and folders with tests that `main.rs` or `mod.rs` of their folder does not declare.
fn left_out(root: &Path) -> Vec<String> {
    let folder = root.parent().expect("a folder");
    let declared = fs::read_to_string(root).expect("readable");
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("readable").path();
        let inner = path.join("mod.rs");
        let is_module = path.extension().is_some_and(|extension| extension == "rs") || inner.exists();
        let name = path.file_stem().and_then(|stem| stem.to_str()).expect("a plain name");
        if is_module && path != root && !declared.contains(&format!("mod {name};")) {
            found.push(path.display().to_string());
        }
        if inner.exists() {
            found.extend(left_out(&inner));
        }
    }
    found
}

#[test]
fn a_crate_has_one_binary_of_tests_with_every_file() {
    let metadata = MetadataCommand::new().no_deps().exec().expect("cargo metadata runs in this workspace");
    for package in &metadata.packages {
        let roots: Vec<&Path> =
            package.targets.iter().filter(|t| t.is_test()).map(|t| t.src_path.as_std_path()).collect();
        let one = roots.iter().filter(|root| root.ends_with("tests/main.rs")).count();
        assert!(roots.len() == one, "{} has tests beside tests/main.rs", package.name);
        let found: Vec<String> =
            roots.iter().filter(|r| r.ends_with("main.rs")).flat_map(|r| left_out(r)).collect();
        assert!(found.is_empty(), "no module of a test: {found:?}");
    }
}

#[test]
fn a_forgotten_file_of_tests_is_found() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let put = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("writable");
    fs::create_dir(folder.path().join("group")).expect("writable");
    put("main.rs", "mod a;\nmod group;\n");
    put("a.rs", "");
    put("group/mod.rs", "mod b;\n");
    put("group/b.rs", "");
    assert_eq!(left_out(&folder.path().join("main.rs")), [""; 0]);
    put("group/c.rs", "");
    let found = left_out(&folder.path().join("main.rs"));
    assert!(found.len() == 1 && found[0].ends_with("group/c.rs"), "{found:?}");
}
