//! `palpate`: the command line of all crates. The code is in the library.
#![forbid(unsafe_code)]

fn main() -> std::process::ExitCode {
    palpate_tools::palpate()
}
