//! The offline half computes the same bits on every machine: it calls no transcendental function of the
//! platform, see [`palpate_tests::platform_math`].

use std::fs;
use std::path::Path;

use palpate_tests::platform_math::platform_calls;

#[test]
fn precompute_calls_no_transcendental_function_of_the_platform() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("../precompute/src");
    let found: Vec<String> = platform_calls(&src).iter().map(ToString::to_string).collect();
    assert!(found.is_empty(), "{found:#?}");
}

#[test]
fn a_call_is_found_in_every_form_and_tests_are_skipped() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("writable");
    write(
        "lib.rs",
        "mod low;\n#[cfg(test)]\nmod made_up;\nfn f(x: f64) -> f64 { x.exp() }\nfn g(x: [f64; 1]) -> [f64; 1] { \
         x.map(f64::ln_1p) }\nfn h(x: f64) -> String { format!(\"{}\", x.cbrt()) }\nfn i(x: f64) -> Vec<f64> { \
         vec![f64::sin(x)] }\n#[cfg(test)]\nmod tests { fn f(x: f64) -> f64 { x.tan() } }",
    );
    write(
        "low.rs",
        "fn f(x: f64) -> f64 { libm::exp(x).sqrt().powi(2) }\nfn g(x: f32) -> f32 { x.hypot(x) }\nfn h(x: f64) -> \
         f64 { nalgebra::ComplexField::exp(x) }",
    );
    write("made_up.rs", "fn f(x: f64) -> f64 { x.sinh() }");
    let found: Vec<String> = platform_calls(folder.path()).iter().map(ToString::to_string).collect();
    let wanted = [
        ("lib.rs:4", "exp"),
        ("lib.rs:5", "ln_1p"),
        ("lib.rs:6", "cbrt"),
        ("lib.rs:7", "sin"),
        ("low.rs:2", "hypot"),
        ("low.rs:3", "exp"),
    ];
    assert_eq!(found, wanted.map(|(at, name)| format!("{at}: {name} of the platform: use the crate libm")));
}
