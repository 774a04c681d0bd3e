//! The problems that a scene's body and tool make, and the names of their elements.

use std::sync::{Arc, OnceLock};

use super::{ActiveNode, SolverOptions, Tool};
use crate::fem::{Body, Contact, PressurePair, Problem};
use crate::mesh::SkinPoint;

/// Name of elements: shape functions of the displacement, and of the pressure if there is one.
pub fn elements(order: u8, pair: PressurePair, has_pressure: bool) -> &'static str {
    match (order, pair, has_pressure) {
        (1, _, false) => "P1",
        (1, PressurePair::Plain, true) => "P1/P1",
        (1, PressurePair::Stabilised, true) => "P1/P1 stab.",
        (_, _, false) => "P2",
        (..) => "P2/P1",
    }
}

/// The equilibrium problems of the contacts with one body. Those of a fingertip share their equations.
#[derive(Debug)]
pub struct Problems {
    options: SolverOptions,
    tool: Tool,
    body: Arc<Body>,
    first: OnceLock<Arc<Problem>>,
}

impl Problems {
    pub(super) fn new(options: SolverOptions, tool: Tool, body: &Arc<Body>) -> Self {
        Self { options, tool, body: body.clone(), first: OnceLock::new() }
    }

    /// The problem of this contact.
    pub fn of(&self, active: &ActiveNode) -> Arc<Problem> {
        let new = |contact| Arc::new(self.options.problem(self.body.clone(), contact));
        match active.on(&self.tool, &self.body) {
            held @ Contact::Held(_) => new(held),
            Contact::Pad(pad) => {
                let first = self.first.get_or_init(|| new(Contact::Pad(pad.clone())));
                Arc::new(first.at(pad))
            }
        }
    }

    /// The problem of the fingertip at a place of the skin.
    pub fn at(&self, place: SkinPoint) -> Arc<Problem> {
        self.of(&ActiveNode::at(place))
    }
}
