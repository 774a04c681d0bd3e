//! The workspace of the tool.

/// An axis-aligned box in the model's frame: its lowest and its highest corner, m.
pub(crate) type Workspace = [[f64; 3]; 2];

/// Whether a position lies in the box, faces included.
pub(crate) fn is_within(workspace: &Workspace, at: &[f64; 3]) -> bool {
    let [low, high] = workspace;
    (0..3).all(|axis| (low[axis]..=high[axis]).contains(&at[axis]))
}
