//! Tests of the offline half from outside: the bundled scenes, laws of the user's own,
//! and modules of the benches.

mod bundled_organ;
mod fuzz_replay;
mod long_touch;
mod no_allocation;
mod own_law;
mod sampling;
mod scheduler;

/// Ends the process at an allocation inside `assert_no_alloc`, and only there.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
