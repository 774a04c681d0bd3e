//! The problems that a scene's body and tool make, and the names of their elements.

use std::sync::{Arc, OnceLock};

use toml::Value;

use super::{ActiveNode, Scene, SolverOptions, Tool};
use crate::error::InputError;
use crate::fem::{Body, Contact, Order, PressurePair, Problem};
use crate::mesh::SkinPoint;

/// Reach of the quadratic elements of [`ElementOrder::NearTool`] round the contact point, in radii of the tool.
/// Measured (docs/measurements.md, section 15): with two radii the force is 1 to 4 % higher than with three, at 0.6
/// times the time.
const NEAR: f64 = 3.0;

/// Order of the shape functions of the displacement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ElementOrder {
    /// Linear.
    Linear,
    /// Quadratic.
    Quadratic,
    /// Quadratic near the contact point of a tool with a size, linear beyond, with stabilised pressures there.
    NearTool,
}

impl ElementOrder {
    /// The order of the nodes.
    pub(crate) fn of_nodes(self) -> Order {
        match self {
            Self::Linear => Order::Linear,
            Self::Quadratic | Self::NearTool => Order::Quadratic,
        }
    }
}

impl Scene {
    /// The order of its elements.
    pub(super) fn order(&self) -> Result<ElementOrder, InputError> {
        let Some(order) = &self.file.mesh.get_ref().order else { return Ok(ElementOrder::Linear) };
        match order.get_ref() {
            Value::Integer(1) => Ok(ElementOrder::Linear),
            Value::Integer(2) => Ok(ElementOrder::Quadratic),
            Value::String(word) if word == "tool" => Ok(ElementOrder::NearTool),
            other => Err(self.place.error(
                order.span(),
                format!("`order` = {other} is neither 1, 2 nor \"tool\""),
                "use `order = 1`, `order = 2`, or `order = \"tool\"`: 2 near the tool and 1 beyond",
            )),
        }
    }
}

/// Name of elements: shape functions of the displacement, and of the pressure if there is one.
pub fn elements(order: ElementOrder, pair: PressurePair, has_pressure: bool) -> &'static str {
    match (order, pair, has_pressure) {
        (ElementOrder::Linear, _, false) => "P1",
        (ElementOrder::Linear, PressurePair::Plain, true) => "P1/P1",
        (ElementOrder::Linear, PressurePair::Stabilised, true) => "P1/P1 stab.",
        (ElementOrder::Quadratic, _, false) => "P2",
        (ElementOrder::Quadratic, _, true) => "P2/P1",
        (ElementOrder::NearTool, _, false) => "P2 near tool",
        (ElementOrder::NearTool, _, true) => "P2/P1 near tool",
    }
}

/// The equilibrium problems of the contacts with one body. Those of a fingertip share their equations, except with
/// quadratic elements near the tool only.
#[derive(Debug)]
pub struct Problems {
    order: ElementOrder,
    options: SolverOptions,
    tool: Tool,
    body: Arc<Body>,
    first: OnceLock<Arc<Problem>>,
}

impl Problems {
    pub(super) fn new(order: ElementOrder, options: SolverOptions, tool: Tool, body: &Arc<Body>) -> Self {
        Self { order, options, tool, body: body.clone(), first: OnceLock::new() }
    }

    /// The problem of this contact.
    pub fn of(&self, active: &ActiveNode) -> Arc<Problem> {
        let new = |contact| Arc::new(self.options.problem(self.body.clone(), contact));
        match active.on(&self.tool, &self.body) {
            Contact::Pad(pad) if self.order == ElementOrder::NearTool => {
                let near = self.body.quadratic_near(pad.centre_m, NEAR * pad.tip.radius_m);
                Arc::new(self.options.problem(Arc::new(near), pad.into()))
            }
            Contact::Pad(pad) => {
                let first = self.first.get_or_init(|| new(Contact::Pad(pad.clone())));
                Arc::new(first.at(pad))
            }
            Contact::Sphere(sphere) => {
                let first = self.first.get_or_init(|| new(Contact::Sphere(sphere.clone())));
                Arc::new(first.at(sphere))
            }
            other => new(other),
        }
    }

    /// The problem of the fingertip at a place of the skin.
    pub fn at(&self, place: SkinPoint) -> Arc<Problem> {
        self.of(&ActiveNode::at(String::new(), place))
    }
}
