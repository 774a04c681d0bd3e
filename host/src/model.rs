//! The models that a session renders: one organ, or several models of one body, each with its touch surface.

use crate::rt::controls::MAX_MODELS;
use core::fmt;
use palpate_core::{Config, Controller, ControllerError, Organ, TouchSurface};

/// Backing memory for the [`TouchSurface`] of each organ.
#[derive(Debug, Default)]
pub struct TouchMemory(Vec<Vec<u32>>);

/// Reason why some organs cannot be rendered together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ModelError {
    /// No organ, or more than the loop accepts.
    Count,
    /// The organ with this index has another surface or other active nodes.
    OtherNodes(usize),
    /// The controller refused an organ or the configuration.
    Controller(ControllerError),
}

impl fmt::Display for ModelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count => write!(f, "a session needs 1 to {MAX_MODELS} organs"),
            Self::OtherNodes(index) => write!(
                f,
                "blob {} differs from the first in its surface or its active nodes: use models of one mesh with the same active nodes",
                index + 1
            ),
            Self::Controller(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for ModelError {}

/// Whether two organs have the same surface and the same active nodes.
fn same_nodes<const N: usize>(one: &Organ<'_, N>, other: &Organ<'_, N>) -> bool {
    let nodes = |organ: &Organ<'_, N>| -> Vec<_> {
        organ
            .spaces
            .iter()
            .map(|space| (space.active.node, space.active.rest_position_m, space.active.outward_normal))
            .collect()
    };
    nodes(one) == nodes(other) && one.surface == other.surface
}

/// Makes one controller per organ, all with the same settings. The organs are models of one body.
pub fn controllers<'o, 'a, const N: usize>(
    organs: &[&'o Organ<'a, N>],
    config: Config,
    memory: &'o mut TouchMemory,
) -> Result<Vec<Controller<'o, 'a, N>>, ModelError> {
    if organs.is_empty() || organs.len() > MAX_MODELS {
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
