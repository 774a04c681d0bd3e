//! Hard cases, reported as a table of results. A solve that converges must have the right numbers; one that
//! does not must report its reason. `cargo test --release -p palpate-tests hard:: -- --nocapture` prints
//! the rows.

mod bad_elements;
mod branches;
mod compression;
mod contrast;
mod held_pressure;
mod large;
mod meshes;
mod near_incompressible;
mod organ_pull;
mod support;
mod table;
mod tables;
mod units;
mod walk;
