//! The fuzzer's bodies over the inputs it kept, over the seeds it began with, and over seeded mutations of both: every run of the tests
//! is a short run of the fuzzer. `check-fuzz` is the long one.

mod common;

use std::path::{Path, PathBuf};

use common::Recipe;

#[path = "../fuzz/bodies.rs"]
mod bodies;

fn corpus(target: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target)
}

/// The kept inputs, in the order of their names.
fn kept(target: &str) -> Vec<Vec<u8>> {
    let folder = corpus(target);
    let entries = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.expect("readable").path()).collect();
    paths.sort();
    assert!(paths.len() >= 3, "{}: the corpus is lost", folder.display());
    paths.iter().map(|path| std::fs::read(path).expect("readable")).collect()
}

/// Small blobs with every kind of table, hole and fold.
fn blobs() -> Vec<Vec<u8>> {
    let small = || Recipe { radius_m: 0.01, slopes: 2, outlier: Some([0, -1, 0]), ..Recipe::default() };
    let recipes = [
        small(),
        Recipe { nodes: vec![[0.0; 3], [0.1, 0.0, 0.02]], rbf: false, ..small() },
        Recipe { solved: |ijk| ijk != [0, 1, 0], displacement: false, ..small() },
        Recipe { fold: |ijk| ijk == [0; 3], lattice_table: false, slopes: 0, ..small() },
        Recipe { hermite: false, displacement: false, ..small() },
    ];
    recipes.iter().map(|recipe| recipe.blob().bytes().to_vec()).collect()
}

struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % n.max(1)
    }
}

/// One to four bytes changed, a number put in, or a piece cut out.
fn mutated(input: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = input.to_vec();
    if bytes.is_empty() {
        return vec![random.below(256) as u8];
    }
    match random.below(4) {
        0 => {
            let at = random.below(bytes.len());
            let number = [u32::MAX, 0x7fc0_0000, 0x7f80_0000, 0, 1 << 31][random.below(5)].to_le_bytes();
            bytes.iter_mut().skip(at).zip(number).for_each(|(byte, new)| *byte = new);
        }
        1 => {
            let from = random.below(bytes.len());
            bytes.drain(from..(from + 1 + random.below(16)).min(input.len()));
        }
        _ => {
            for _ in 0..=random.below(4) {
                // Mostly near the front, where headers are.
                let end = if random.below(2) == 0 { bytes.len() } else { bytes.len().min(700) };
                let at = random.below(end);
                bytes[at] = random.below(256) as u8;
            }
        }
    }
    bytes
}

fn replay(inputs: &[Vec<u8>], mutations: usize, body: fn(&[u8])) {
    let mut random = Random(7);
    for input in inputs {
        body(input);
        for _ in 0..mutations {
            body(&mutated(input, &mut random));
        }
    }
}

#[test]
fn blobs_are_refused_or_good() {
    replay(&blobs(), 400, bodies::blob);
    replay(&kept("blob"), 3, bodies::blob);
}

#[test]
fn frames_are_refused_or_obeyed_safely() {
    replay(&kept("frames"), 50, bodies::frames);
}

#[test]
fn ticks_are_finite_and_within_limits() {
    replay(&kept("tick"), 10, bodies::tick);
}

#[test]
#[ignore = "writes what the fuzzer begins with"]
fn write_seeds() {
    for (number, blob) in blobs().iter().enumerate() {
        std::fs::write(corpus("blob").join(format!("seed-{number}")), blob).expect("written");
    }
}
