//! Solved states as files for other programs: VTU for one state, PVD for a series of them (ParaView, VisIt, PyVista).
//!
//! Every file is written under a temporary name and renamed, so that a reader never sees half of one.

pub mod series;
pub mod vtu;

pub use series::Series;
pub use vtu::{Cells, Field, Grid};

/// A text as the value of an XML attribute.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            // XML 1.0 has no way to write most control characters.
            c if c.is_control() => out.push('?'),
            c => out.push(c),
        }
    }
    out
}
