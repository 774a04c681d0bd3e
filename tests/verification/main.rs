//! Verification against known solutions. Each test prints its measured error (`cargo test -- --nocapture`).

mod condensed;
mod constraints;
mod cook;
mod golden;
mod homogeneous;
mod manufactured;
mod sphere;
