//! Why a scene cannot be touched live.

use thiserror::Error;

use crate::fem::SolveFailure;

/// Why a scene cannot be touched live.
#[derive(Debug, Error)]
pub enum LiveError {
    /// The elements depend on the contact point.
    #[error(
        "`order = \"tool\"` gives every contact point elements of its own, and live touch shares one body; use `order = 1` or `order = 2`"
    )]
    NearTool,
    /// The skin has more vertices than a command can name.
    #[error("the skin has {0} vertices, live touch at most {most}; use a coarser mesh", most = palpate_core::Limits::LIVE.spaces)]
    TooManyContacts(usize),
    /// Every triangle of the skin has a fixed corner.
    #[error("no triangle of the skin is free of fixed nodes; fix fewer nodes")]
    NothingToTouch,
    /// Another tool, mesh, order or set of pressures.
    #[error(
        "the changed scene has another tool, mesh, order or kind of law, so the touch cannot go on; start it as a session of its own"
    )]
    OtherBody,
    /// A blob of another model.
    #[error("the blob has {0}, so its forces are not those of this scene; give the blob that was made of it")]
    OtherBlob(&'static str),
    /// The body, under its body force, has no rest state.
    #[error(
        "the body cannot be solved at rest: {0}; check its material and its fixed nodes with `palpate inspect`"
    )]
    Rest(#[from] SolveFailure),
    /// The scene's mesh, materials or elements are refused.
    #[error("{0}")]
    Body(String),
}
