//! `palpate`: the command line over all crates; everything is in the library.
#![forbid(unsafe_code)]

fn main() -> std::process::ExitCode {
    palpate_tools::palpate()
}
