//! What is identified, and where the work is.

use super::bounds::Bounds;
use super::loss::Loss;

/// What is identified, and how.
#[derive(Debug, Clone)]
pub struct Options {
    /// Names of the free constants, as in the scene: `c10_pa`, or `tumour.c10_pa` if there are several materials.
    pub free: Vec<String>,
    /// Bounds of some of them; by default moduli that must be positive are.
    pub bounds: Vec<(String, Bounds)>,
    /// The loss.
    pub loss: Loss,
    /// Confidence of the intervals, between 0 and 1.
    pub confidence: f64,
    /// Where the tool is, if the table does not say it.
    pub active: Option<String>,
}

impl Default for Options {
    fn default() -> Self {
        Self { free: Vec::new(), bounds: Vec::new(), loss: Loss::Linear, confidence: 0.95, active: None }
    }
}

/// Where an identification is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Number of the evaluation, from 1.
    pub evaluation: usize,
    /// Solved places of this evaluation, and all.
    pub solved: usize,
    /// All places of an evaluation.
    pub places: usize,
    /// RMS residual before this evaluation, N.
    pub rms_n: Option<f64>,
}
