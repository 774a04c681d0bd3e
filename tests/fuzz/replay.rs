//! Replays the fuzzer's corpus and seeded mutations of it, for the tests: a short run of the fuzzer.

use std::path::{Path, PathBuf};

/// The inputs in a folder of the corpus, in the order of their names.
pub(crate) fn kept(folder: &Path) -> Vec<Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.expect("readable").path()).collect();
    paths.sort();
    assert!(paths.len() >= 3, "{}: the corpus is incomplete", folder.display());
    paths.iter().map(|path| std::fs::read(path).expect("readable")).collect()
}

struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % n.max(1)
    }
}

/// A copy with one to four bytes changed, a number inserted, or a piece removed.
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

/// Writes the seeds of a target; run by hand after a change of its format.
pub(crate) fn write_seeds(folder: &Path, seeds: &[Vec<u8>]) {
    std::fs::create_dir_all(folder).expect("a folder");
    for (number, seed) in seeds.iter().enumerate() {
        std::fs::write(folder.join(format!("seed-{number}")), seed).expect("written");
    }
}

/// Runs a target on each input and on `mutations` mutations of it.
pub(crate) fn replay(inputs: &[Vec<u8>], mutations: usize, body: fn(&[u8])) {
    let mut random = Random(7);
    for input in inputs {
        body(input);
        for _ in 0..mutations {
            body(&mutated(input, &mut random));
        }
    }
}
