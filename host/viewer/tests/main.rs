//! The integration tests of the viewer in one binary.

#[path = "../../tests/common/synthetic.rs"]
mod synthetic;

mod frames;
mod picture;
