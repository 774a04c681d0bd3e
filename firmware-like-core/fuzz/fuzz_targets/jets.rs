#![no_main]

use libfuzzer_sys::fuzz_target;

#[path = "../jets.rs"]
mod bodies;

fuzz_target!(|data: &[u8]| bodies::jets(data));
