//! Tests across the crates: the tree itself, verification against known solutions, hard cases of the solver,
//! and the way from a scene to a blob.

mod architecture;
mod bare_machine;
mod between;
mod certificate;
mod documents;
mod figures;
mod hard;
mod hazards;
mod held_out;
mod parity;
mod platform_math;
mod read_blob;
mod records;
mod release;
mod scattered;
mod sizes;
mod sliding;
mod space;
mod stability;
mod stored_fit;
mod strata;
mod verification;
