//! What a session renders: one organ, or several models of it of which one is under the hand, with its surface ready to be touched.

use crate::rt::controls::MOST_MODELS;
use core::fmt;
use palpate_core::controller::ControllerError;
use palpate_core::{Config, Controller, Organ, TouchSurface};

/// Memory for the surfaces of some organs; the lists of [`TouchSurface`] live here.
#[derive(Debug, Default)]
pub struct TouchMemory(Vec<Vec<u32>>);

/// Why some organs cannot be rendered together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ModelError {
    /// None, or more than the loop takes.
    Count,
    /// The one with this index is of another body, or has other active nodes.
    OtherNodes(usize),
    /// The controller refused an organ or the configuration.
    Controller(ControllerError),
}

impl fmt::Display for ModelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count => write!(f, "a session needs 1 to {MOST_MODELS} organs"),
            Self::OtherNodes(index) => write!(
                f,
                "blob {} has another surface or other active nodes than the first: take models of one mesh with the same active nodes",
                index + 1
            ),
            Self::Controller(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for ModelError {}

/// Whether a touch of one organ means the same on another.
fn same_nodes<const N: usize>(one: &Organ<'_, N>, other: &Organ<'_, N>) -> bool {
    let places = |organ: &Organ<'_, N>| -> Vec<_> {
        organ.spaces.iter().map(|space| (space.node, space.rest_position_m, space.outward_normal)).collect()
    };
    places(one) == places(other) && one.surface == other.surface
}

/// A controller for each organ, all with the same settings; the organs are models of one body with the same active nodes.
pub fn controllers<'o, 'a, const N: usize>(
    organs: &[&'o Organ<'a, N>],
    config: Config,
    memory: &'o mut TouchMemory,
) -> Result<Vec<Controller<'o, 'a, N>>, ModelError> {
    if organs.is_empty() || organs.len() > MOST_MODELS {
        return Err(ModelError::Count);
    }
    if let Some(index) = organs.iter().position(|organ| !same_nodes(organs[0], organ)) {
        return Err(ModelError::OtherNodes(index));
    }
    memory.0 = organs.iter().map(|organ| vec![0; TouchSurface::words(organ)]).collect();
    let with_surface = |(organ, memory): (&&'o Organ<'a, N>, &'o mut Vec<u32>)| {
        let controller = Controller::new(*organ, config).map_err(ModelError::Controller)?;
        Ok(controller.on_surface(TouchSurface::new(*organ, memory)))
    };
    organs.iter().zip(&mut memory.0).map(with_surface).collect()
}
