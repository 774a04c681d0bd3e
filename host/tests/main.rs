//! The integration tests of the host in one binary, one module a subject.

#[path = "common/closed_loop.rs"]
mod closed_loop;
#[path = "../../firmware-like-core/tests/common/mod.rs"]
mod core_blobs;
#[path = "common/fake_solver.rs"]
mod fake_solver;
#[path = "common/synthetic.rs"]
mod synthetic;

mod deploy;
mod guard;
mod instructions;
mod live;
mod no_allocation;
mod soak;
mod stability;
mod states;

/// Ends the process at an allocation inside `assert_no_alloc`, and only there.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
