//! Verification: problems with known answers, each with its observed figure in the output (`cargo test -- --nocapture`).

mod condensed;
mod constraints;
mod cook;
mod golden;
mod homogeneous;
mod manufactured;
mod sphere;
