//! A device as the proxy holds it, whichever library or service drives it.

use core::fmt;
use serde::{Deserialize, Serialize};

/// What an open device says of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Opened {
    /// Model, serial number and version of the library or service.
    pub name: String,
    /// Largest force, N; 0 if it states none.
    pub max_force_n: f32,
    /// Largest stiffness, N/m; 0 if it states none.
    pub max_stiffness_n_m: f32,
}

/// An open device. A last zero is sent, and it is closed, when this is dropped.
pub trait Driven: fmt::Debug {
    /// What it says of itself.
    fn opened(&self) -> &Opened;

    /// A line for the user of what has happened since the last call. Called a few times a second.
    fn news(&mut self) -> Option<String>;
}

/// The lower of a limit that the device states, if it states one, and that of the profile.
#[must_use]
pub fn lower(stated: f32, profile: f32) -> f32 {
    if stated > 0.0 { stated.min(profile) } else { profile }
}
