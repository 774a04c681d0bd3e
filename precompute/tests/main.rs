//! Tests of the offline half from outside: the bundled scenes, laws of the user's own,
//! and the planner with workers in simulated time.

mod bundled_organ;
mod own_law;
mod scheduler;
