//! The reachable set of a tool.

use palpate_precompute::num::norm;
use palpate_precompute::spec::Requirements;

/// Whether a displacement, m, is in the workspace.
pub(crate) fn is_inside(wanted: &Requirements, at: [f64; 3]) -> bool {
    wanted.workspace_m.is_none_or(|[low, high]| (0..3).all(|i| (low[i]..=high[i]).contains(&at[i])))
}

/// Whether the tool can cause this force.
pub(crate) fn is_reached(wanted: &Requirements, force_n: [f64; 3]) -> bool {
    let along = |normal: [f64; 3]| force_n.iter().zip(normal).map(|(h, n)| h * n).sum::<f64>();
    norm(force_n) <= wanted.max_force_n && wanted.push.is_none_or(|normal| along(normal) <= 0.0)
}
