//! The cost of a scene, predicted before it is solved: [`Plan::of`].
//!
//! `probe` solves some configurations on each active node. `surrogate` fits them by a body that is cheap
//! to evaluate. On it the adaptive sampling, the lattice's plan and the packer's fits run as on the real
//! body. `tables` measures the results. `node` combines them for a node, `model` for other
//! discretisations, `rows` for the scene. `draws` are possible outcomes of the sampling that the scene
//! asks for, `prediction` their intervals. `check` compares a saved prediction with later results.

mod check;
mod draws;
mod error;
mod model;
mod node;
mod planned;
mod prediction;
mod probe;
mod results;
mod row;
mod rows;
mod surrogate;
mod tables;

pub use check::{Compared, Comparison, PackedBlob, compare};
pub use error::PlanError;
pub use planned::{Plan, PlannedMethod, PlannedNode, PlannedSampling};
pub use prediction::{Interval, Line, Prediction, Takeover};
pub use row::Row;
pub use tables::VisualModel;
