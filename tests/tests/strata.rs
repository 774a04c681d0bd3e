//! Strata inside the crates, see [`palpate_tests::strata`]. `architecture.rs` checks the dependencies between
//! crates.

use std::fs;
use std::path::Path;

use palpate_tests::circles::circles;
use palpate_tests::strata::findings;

/// The findings in a crate of three strata after one file is replaced.
fn planted(file: &str, text: &str) -> Vec<String> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let sound = [
        ("src/lib.rs", "mod low; mod middle; mod high;\npub use high::Top;\npub use middle::inner::Deep;"),
        ("src/low.rs", "pub(crate) fn base() {}"),
        ("src/middle/mod.rs", "pub mod inner;\nuse crate::low::base;\npub fn on() { base(); inner::deep() }"),
        ("src/middle/inner.rs", "pub struct Deep;\npub fn deep() { super::super::low::base() }"),
        ("src/high.rs", "use crate::{low, middle::{self, inner::Deep}};\npub struct Top(Deep);"),
        ("shared.rs", "use crate::high::Top;"),
    ];
    for (name, content) in sound.iter().filter(|(name, _)| *name != file).chain([&(file, text)]) {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().expect("in the folder")).expect("writable");
        fs::write(path, content).expect("writable");
    }
    let found = findings(&folder.path().join("src"), &["low", "middle", "high"]);
    found.iter().map(ToString::to_string).collect()
}

#[test]
fn a_wrong_import_is_found_in_every_kind_of_path() {
    assert_eq!(planted("unused.rs", ""), [""; 0], "the crate itself is sound");
    for (text, line, what) in [
        ("use crate::middle;", 1, "low imports crate::middle"),
        ("\nuse crate::{high::{Top}};", 2, "low imports crate::high::Top"),
        ("pub use super::high::*;", 1, "low imports crate::high::*"),
        ("fn f(_: crate::high::Top) {}", 1, "low imports crate::high::Top"),
        ("fn f() { super::middle::on() }", 1, "low imports crate::middle::on"),
        ("fn f() { vec![{ crate::middle::on(); 1 }]; }", 1, "low imports crate::middle::on"),
        ("macro_rules! m { () => { $crate::high::Top } }", 1, "low imports crate::high::Top"),
        ("mod inside { use super::super::high::Top; }", 1, "low::inside imports crate::high::Top"),
    ] {
        assert_eq!(planted("src/low.rs", text), [format!("low.rs:{line}: {what} from above it")]);
    }
    for sound in [
        "#[cfg(test)]\nmod tests { use crate::high::Top; }",
        "// use crate::high::Top;",
        "pub(in crate::low) fn f() {}",
    ] {
        assert_eq!(planted("src/low.rs", sound), [""; 0]);
    }
}

#[test]
fn the_names_that_the_crate_exports_are_no_way_round() {
    let found = planted("src/middle/inner.rs", "pub struct Deep;\nfn f(_: crate::Top) {}");
    assert_eq!(found, ["middle/inner.rs:2: middle::inner imports crate::Top, which is in no stratum"]);
}

#[test]
fn every_module_is_in_a_stratum() {
    assert_eq!(planted("src/lib.rs", "mod low;\nmod other {}"), ["lib.rs:2: other is in no stratum"]);
}

#[test]
fn a_file_shared_by_a_path_attribute_is_an_import() {
    let found = planted("src/low.rs", "#[path = \"high.rs\"]\nmod copy;");
    assert!(found.contains(&"low.rs:2: low::copy imports crate::high from above it".into()), "{found:?}");
    let found = planted("src/high.rs", "#[path = \"../shared.rs\"]\nmod device;\npub struct Top;");
    assert!(found.len() == 1 && found[0].starts_with("high.rs:2: high::device compiles "), "{found:?}");
    // The imports of the included file count for the module that compiles it.
    let found = planted(
        "src/middle/inner.rs",
        "pub struct Deep;\npub fn deep() {}\n#[path = \"../../shared.rs\"]\nmod device;",
    );
    assert!(
        found
            .iter()
            .any(|found| found.contains("middle::inner::device imports crate::high::Top from above it")),
        "{found:?}"
    );
}

/// The precompute crate, lowest stratum first.
const PRECOMPUTE: [&str; 63] = [
    "error",
    "files",
    "num",
    "mesh",
    "fem::element",
    "fem::kinematics",
    "fem::material",
    "fem::pressure",
    "fem::ordering",
    "fem::body",
    "fem::elastic",
    "fem::pad",
    "fem::sphere",
    "fem::counterpart",
    "fem::boundary",
    "fem::solvability",
    "fem::assembly",
    "fem::solve",
    "fem",
    "spec",
    "fit",
    "adaptive",
    "space::task",
    "space::record",
    "space::walk",
    "space::samples",
    "space::fallback",
    "space::state",
    "space::plan",
    "space::job",
    "space::store",
    "space::motion",
    "space::worker",
    "space::executor",
    "space::plans",
    "space::salvage",
    "space::expansion",
    "space",
    "scene",
    "map",
    "held_out",
    "pack",
    "live::error",
    "live::hand",
    "live::task",
    "live::times",
    "live::renewals",
    "live::branches",
    "live::skin",
    "live::beyond",
    "live::memory",
    "live::published",
    "live::tabled",
    "live::states",
    "live::workers",
    "live::choice",
    "live::solver",
    "live::truth",
    "live",
    "certificate",
    "pipeline",
    "identify",
    "plan",
];

/// The core, lowest stratum first.
const CORE: [&str; 14] = [
    "named",
    "tag",
    "num",
    "plane",
    "grid",
    "displacement",
    "method",
    "space",
    "blob",
    "touch",
    "guard",
    "field",
    "jet",
    "controller",
];

/// The real-time host, lowest stratum first. The trait of a device is below the loop; a profile uses the
/// loop's timing statistics, which are below both.
const HOST: [&str; 26] = [
    "vector_form",
    "sys",
    "first_place",
    "blob_file",
    "instructions",
    "live",
    "rt::clock",
    "rt::config",
    "rt::periodic",
    "rt::histogram",
    "rt::latency",
    "device::capstan",
    "device::workspace",
    "device::profile",
    "device",
    "rt::record",
    "rt::controls",
    "rt::haptic_loop",
    "rt::state",
    "rt::thread",
    "rt",
    "settings",
    "guard",
    "model",
    "doctor",
    "session",
];

/// The viewer, lowest stratum first.
const VIEWER: [&str; 38] = [
    "error",
    "image",
    "palette",
    "verdict",
    "ticks",
    "font",
    "camera",
    "material",
    "raster",
    "occlusion",
    "shade",
    "shapes",
    "smooth",
    "still",
    "deformation",
    "pick",
    "viewpoint",
    "reach",
    "touched",
    "regions",
    "section",
    "tool",
    "scene",
    "inset",
    "contact",
    "live",
    "help",
    "charts",
    "overlay",
    "frames",
    "navigation",
    "window",
    "mouse_tool",
    "renderer",
    "arming",
    "window_controller",
    "screen",
    "map",
];

/// Recordings and their replay, lowest stratum first.
const RECORD: [&str; 11] = [
    "format",
    "error",
    "header",
    "message",
    "jet_message",
    "writer",
    "reader",
    "recorder",
    "replay_device",
    "replay_jets",
    "replay",
];

/// The emulated devices and the tests on them, lowest stratum first.
const HIL: [&str; 29] = [
    "tick",
    "fault",
    "transport",
    "port",
    "faulty",
    "force_record",
    "mechanism",
    "link",
    "polhem",
    "falcon",
    "haply",
    "haply_rate",
    "usbredir",
    "rig",
    "session",
    "shadow",
    "matrix::reference",
    "matrix::approach",
    "matrix::ended",
    "matrix::plan",
    "matrix::outcome",
    "matrix::monitor",
    "matrix::table",
    "matrix",
    "bench",
    "hosts",
    "closed_loop",
    "contract",
    "emulate",
];

/// The command line, lowest stratum first.
const TOOLS: [&str; 72] = [
    "memory",
    "resident",
    "timing",
    "usage",
    "version",
    "failure",
    "files",
    "output",
    "words",
    "plot",
    "html",
    "machine",
    "steps",
    "points",
    "setting",
    "interrupt",
    "progress",
    "analysis",
    "blob",
    "displacements",
    "regions",
    "control",
    "friction",
    "touch",
    "truth",
    "summary",
    "motors_off",
    "device_spec",
    "hardware",
    "session",
    "documents",
    "cmd::inspect::scattered",
    "cmd::inspect::certificate",
    "cmd::inspect::overview",
    "cmd::precompute",
    "cmd::paper::held_out",
    "cmd::paper::protocol",
    "cmd::path",
    "cmd::paper::compare",
    "cmd::paper",
    "cmd::doctor",
    "cmd::guard",
    "cmd::live_solver",
    "cmd::live",
    "cmd::control",
    "cmd::man",
    "cmd::completions",
    "cmd::plan",
    "cmd::pack",
    "cmd::query",
    "cmd::run",
    "cmd::inspect",
    "cmd::demo",
    "cmd::bench",
    "cmd::report::args",
    "cmd::report::outputs",
    "cmd::report::plan",
    "cmd::report::solve",
    "cmd::report::tables",
    "cmd::report::measure",
    "cmd::report::bodies",
    "cmd::report::curves",
    "cmd::report::forms",
    "cmd::report::hard",
    "cmd::report::ledger",
    "cmd::report::parts",
    "cmd::report::results",
    "cmd::report::files",
    "cmd::report::page",
    "cmd::report",
    "cmd",
    "cluster",
];

/// The Python package, lowest stratum first.
const PYTHON: [&str; 13] = [
    "failure",
    "arrays",
    "running",
    "command",
    "pack",
    "path",
    "scene",
    "identify",
    "organ",
    "controller",
    "recording",
    "jets",
    "live",
];

#[test]
fn every_crate_imports_downwards() {
    let crates: [(&str, &[&str]); 8] = [
        ("firmware-like-core", &CORE),
        ("precompute", &PRECOMPUTE),
        ("host", &HOST),
        ("host/viewer", &VIEWER),
        ("host/record", &RECORD),
        ("hil", &HIL),
        ("tools", &TOOLS),
        ("tools/python", &PYTHON),
    ];
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace");
    for (name, strata) in crates {
        let found = findings(&workspace.join(name).join("src"), strata);
        let lines: String = found.iter().map(|found| format!("{found}\n")).collect();
        assert!(found.is_empty(), "{name}:\n{lines}");
    }
}

/// A crate of these files; its circles.
fn circles_of(files: &[(&str, &str)]) -> Vec<Vec<String>> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, content) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().expect("in the folder")).expect("writable");
        fs::write(path, content).expect("writable");
    }
    circles(folder.path())
}

#[test]
fn a_circle_between_files_is_found_also_through_a_facade() {
    let lib = ("lib.rs", "mod group;");
    let facade = ("group/mod.rs", "mod one; mod two; mod three;\npub use one::One;\npub struct Own;");
    let one = ("group/one.rs", "use super::Own;\nuse super::two::Two;\npub struct One(Own, Two);");
    let sound =
        [lib, facade, one, ("group/two.rs", "pub struct Two;"), ("group/three.rs", "use super::One;")];
    assert_eq!(circles_of(&sound), [[""; 0]; 0]);
    for back in ["use super::One;", "use super::one::One;", "fn f() -> crate::group::One { todo!() }"] {
        let mut files = sound;
        files[3].1 = back;
        assert_eq!(circles_of(&files), [["group::one", "group::two"]], "{back}");
    }
    let mut files = sound;
    files[3].1 = "use super::three::Three;\npub struct Two;";
    assert_eq!(circles_of(&files), [["group::one", "group::three", "group::two"]]);
}

#[test]
fn no_files_of_a_crate_import_one_another() {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace");
    let of = |name: &str| circles(&workspace.join(name).join("src"));
    let found: Vec<String> = [
        "firmware-like-core",
        "firmware-like-core/link",
        "precompute",
        "host",
        "host/viewer",
        "host/record",
        "hil",
        "tools",
        "tools/python",
        "tests",
    ]
    .iter()
    .flat_map(|name| of(name))
    .map(|c| c.join(", "))
    .collect();
    assert!(found.is_empty(), "{}", found.join("\n"));
}
