#![no_main]

use libfuzzer_sys::fuzz_target;

#[path = "../bodies/jets.rs"]
mod body;

fuzz_target!(|data: &[u8]| body::jets(data));
