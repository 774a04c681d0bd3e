//! `include/palpate.h` is identical to the output of cbindgen for this crate.

use std::path::Path;

#[test]
fn the_header_matches_the_code() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config =
        cbindgen::Config::from_file(here.join("cbindgen.toml")).expect("cbindgen.toml is its configuration");
    let made =
        cbindgen::Builder::new().with_crate(here).with_config(config).generate().expect("the crate parses");
    let mut text = Vec::new();
    made.write(&mut text);
    let path = here.join("include/palpate.h");
    if std::env::var_os("PALPATE_WRITE_HEADER").is_some() {
        std::fs::write(&path, &text).expect("the header can be written");
    }
    let kept = std::fs::read(&path).unwrap_or_default();
    assert!(
        kept == text,
        "palpate.h differs from the code: PALPATE_WRITE_HEADER=1 cargo test --release -p palpate-c header"
    );
}
