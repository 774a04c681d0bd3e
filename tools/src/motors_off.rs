//! Output of a session with the motors off: the position of the hand, and the force that is not sent.

use palpate_core::Sample;
use palpate_host::rt::{SessionState, TickRecord};

/// Ticks between two lines.
const EVERY_TICKS: u64 = 200;

/// Prints lines on standard error at intervals.
#[derive(Debug, Default)]
pub(crate) struct Lines {
    /// The last sample; not every tick has one.
    newest: Option<Sample>,
}

impl Lines {
    /// Takes a tick, and prints it if a line is due.
    pub(crate) fn take(&mut self, record: &TickRecord) {
        self.newest = record.sample.or(self.newest);
        if record.tick.is_multiple_of(EVERY_TICKS) {
            eprintln!("palpate: {}", line(record, self.newest));
        }
    }
}

/// State, position of the hand in the model, buttons, and the computed force.
fn line(record: &TickRecord, newest: Option<Sample>) -> String {
    let [x, y, z] = record.hand_force_n;
    let place = newest.map_or_else(
        || "no position".into(),
        |Sample { position_m, buttons, .. }| {
            let [x, y, z] = position_m.map(|metres| 1e3 * metres);
            format!("x {x:+.1} y {y:+.1} z {z:+.1} mm, buttons {buttons:04b}")
        },
    );
    format!("{}: {place}; not sent {x:+.2} {y:+.2} {z:+.2} N", SessionState::of(record))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_where_and_what_with_signs() {
        let sample =
            Sample { t_us: 0, position_m: [0.012, -0.0034, 0.0], buttons: 0b101, ..Sample::default() };
        let record =
            TickRecord { sample: Some(sample), hand_force_n: [0.0, 1.25, -0.5], ..TickRecord::EMPTY };
        let shown = line(&record, record.sample);
        assert!(
            shown.ends_with(": x +12.0 y -3.4 z +0.0 mm, buttons 0101; not sent +0.00 +1.25 -0.50 N"),
            "{shown}"
        );
        assert!(line(&TickRecord::EMPTY, None).contains("no position"));
    }
}
