//! `palpate-mpi`: `palpate precompute` on many machines. The code is in the library.
#![forbid(unsafe_code)]

fn main() -> std::process::ExitCode {
    palpate_tools::palpate_mpi()
}
