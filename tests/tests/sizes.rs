//! Limits of the lines of files and functions in the core, in precompute, in the recorder, in the viewer and in the
//! Python package.

use std::fs;
use std::path::Path;

use palpate_tests::sizes::too_long;

const FILE: usize = 450;
const FUNCTION: usize = 80;

#[test]
fn a_long_file_and_a_long_function_are_found() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let body = |lines: usize| "    f();\n".repeat(lines);
    let tests = format!("#[cfg(test)]\nmod tests {{\nfn t() {{\n{}}}\n}}\n", body(90));
    let put = |name: &str, text: String| fs::write(folder.path().join(name), text).expect("writable");
    put("a.rs", format!("fn short() {{\n{}}}\nfn long() {{\n{}}}\n{tests}", body(78), body(79)));
    put("b.rs", format!("impl A {{\nfn long(\na: A,\n) {{\n{}}}\n}}\n", body(77)));
    put("c.rs", "//\n".repeat(450));
    put("d.rs", "//\n".repeat(451));
    let found = too_long(folder.path(), FILE, FUNCTION);
    assert_eq!(found, ["a.rs: long has 81 lines", "b.rs: long has 81 lines", "d.rs: 451 lines"]);
}

#[test]
fn no_file_is_over_450_lines_and_no_function_over_80() {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace");
    for name in ["firmware-like-core", "precompute", "host/record", "host/viewer", "tools/python"] {
        let found = too_long(&workspace.join(name).join("src"), FILE, FUNCTION);
        assert!(found.is_empty(), "{name}:\n{}", found.join("\n"));
    }
}
