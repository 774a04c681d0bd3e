//! Finite elements: shape functions and their integrals over one element.

pub mod tet4;

pub use tet4::Tet4;
