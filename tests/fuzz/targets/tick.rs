#![no_main]

use libfuzzer_sys::fuzz_target;

#[path = "../bodies/core.rs"]
#[allow(dead_code, reason = "each target has its own body")]
mod body;

fuzz_target!(|data: &[u8]| body::tick(data));
