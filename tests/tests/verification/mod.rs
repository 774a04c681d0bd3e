//! Verification against known solutions. Each test prints its measured error (`cargo test -- --nocapture`).

mod capsule;
mod condensed;
mod contact_patch;
mod cook;
mod golden;
mod identify;
mod live;
mod live_capsule;
mod live_sphere;
mod sphere;
mod sphere_contact;
mod sphere_field;
mod two_spheres;
