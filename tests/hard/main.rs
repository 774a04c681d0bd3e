//! Hard cases, as a table of what happened, not only pass: what converges must have the right numbers, what does not must
//! say why. `cargo test --release -p palpate-tests --test hard -- --nocapture` prints the rows; `PALPATE_HARD_TABLE=FILE`
//! writes them as Markdown; `PALPATE_REFERENCE_DIR=DIR` adds a mesh that is not ours to ship.

mod bad_elements;
mod branches;
mod compression;
mod contrast;
mod held_pressure;
mod meshes;
mod near_incompressible;
mod organ_pull;
mod real_mesh;
mod shares;
mod support;
mod table;
mod tables;
mod units;
mod walk;
