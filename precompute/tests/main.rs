//! Tests of the offline half from outside: the bundled scenes, laws of the user's own,
//! and modules of the benches.

mod bundled_organ;
mod own_law;
mod sampling;
mod scheduler;
