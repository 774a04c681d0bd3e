//! Jets of a live solver: frame, force, hand-over, memory, ladder and tick.

mod capsule;
mod force;
mod frame;
mod hand_over;
mod ladder;
mod memory;
mod model;
mod partner;
mod root;
mod tick;
