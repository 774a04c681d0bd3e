//! The host's side of `check-cortex-m`: the answers that a Cortex-M must reproduce bit for bit.
//!
//! `cargo run --release -p palpate-core --example answers -- firmware-like-core/golden/organ-514.blob`

use std::io::{BufWriter, Write};
use std::process::ExitCode;

#[path = "../cortex-m/src/comparison.rs"]
#[allow(unreachable_pub, reason = "public in the crate of the firmware")]
mod comparison;

use comparison::{Bench, Failed, Line};
use palpate_core::AlignedBytes;

struct Host<W>(W);

impl<W: Write> Bench for Host<W> {
    fn say(&mut self, mut line: Line) -> Result<(), Failed> {
        self.0.write_all(line.text()).map_err(|_| Failed)
    }

    fn clock(&self) -> u32 {
        0
    }
}

fn main() -> ExitCode {
    let Some(path) = std::env::args_os().nth(1) else {
        eprintln!("usage: answers FILE.blob");
        return ExitCode::from(2);
    };
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(error) => {
            eprintln!("{}: {error}", path.display());
            return ExitCode::FAILURE;
        }
    };
    let mut bench = Host(BufWriter::new(std::io::stdout().lock()));
    match comparison::run(&mut bench, &AlignedBytes::from(&bytes)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failed) => {
            eprintln!(
                "{}: not a blob, or a blob without spaces: make one with `palpate pack`",
                path.display()
            );
            ExitCode::FAILURE
        }
    }
}
