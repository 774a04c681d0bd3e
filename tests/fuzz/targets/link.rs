#![no_main]

use libfuzzer_sys::fuzz_target;

#[path = "../bodies/link.rs"]
mod body;

fuzz_target!(|data: &[u8]| {
    body::link(data);
});
