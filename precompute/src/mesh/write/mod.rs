//! Output of solved states for other programs (ParaView, VisIt, PyVista): VTU for one state, PVD for a
//! series.
//!
//! Each file is written under a temporary name and renamed, so that a reader never sees a partial file.

mod series;
mod vtu;

pub use series::Series;
pub use vtu::{Cell, Field, Grid};

/// Escapes a text for an XML attribute.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            // XML 1.0 cannot represent most control characters.
            c if c.is_control() => out.push('?'),
            c => out.push(c),
        }
    }
    out
}
