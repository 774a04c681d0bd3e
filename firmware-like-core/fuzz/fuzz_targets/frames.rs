#![no_main]

use libfuzzer_sys::fuzz_target;

#[path = "../frames.rs"]
mod bodies;

fuzz_target!(|data: &[u8]| {
    bodies::frames(data);
});
