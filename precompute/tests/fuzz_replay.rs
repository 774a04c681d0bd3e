//! The fuzz targets of the readers of scenes and meshes on the inputs of the corpus, and on mutations of them.
//! `tests/fuzz/run` runs the fuzzer itself.

use std::path::{Path, PathBuf};

use replay::{kept, replay};

#[path = "../../tests/fuzz/bodies/precompute.rs"]
mod bodies;
#[path = "../../tests/fuzz/replay.rs"]
#[allow(dead_code, reason = "the seeds of these targets are files")]
mod replay;

fn corpus(target: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fuzz/corpus").join(target)
}

#[test]
fn meshes_are_refused_or_valid() {
    let inputs = kept(&corpus("mesh"));
    replay(&inputs, 20, |file| _ = bodies::mesh(file));
    // Each reader, without and with regions, has a mesh that it reads; otherwise the replay would prove nothing.
    for reader in [0, 1, 2, 3, 9, 10] {
        let is_read = |file: &&Vec<u8>| file.first().is_some_and(|first| first & 11 == reader);
        assert!(inputs.iter().filter(is_read).any(|file| bodies::mesh(file)), "reader {reader}");
    }
}

#[test]
fn scenes_are_refused_or_read_back_the_same() {
    let inputs = kept(&corpus("scene"));
    replay(&inputs, 10, |text| _ = bodies::scene(text));
    let resolved = inputs.iter().filter(|text| bodies::scene(text)).count();
    assert!(resolved >= 10, "only {resolved} scenes are resolved");
}
