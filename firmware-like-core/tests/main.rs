//! Tests of the core from outside.

#[macro_use]
mod common;

mod approach;
mod blob;
mod blob_planes;
mod contact;
mod continuity;
mod controller;
mod crossing;
mod displacement;
mod fuzz_replay;
mod grasp;
mod grid;
mod interpolation;
mod jets;
mod kernel;
mod sessions;
mod slip;
mod sphere_field;
mod stale;
mod touch_surface;
