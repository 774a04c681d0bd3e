//! Tests of the offline half from outside: the bundled scenes, and laws of the user's own.

mod bundled_organ;
mod own_law;
