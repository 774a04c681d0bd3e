#![no_main]

use libfuzzer_sys::fuzz_target;

#[path = "../bodies.rs"]
#[allow(dead_code, reason = "each target has its own body")]
mod bodies;

fuzz_target!(|data: &[u8]| {
    bodies::frames(data);
});
