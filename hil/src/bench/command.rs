//! Requests from the test in the guest to the bench, and the replies: one line of JSON each.

use serde::{Deserialize, Serialize};

/// A command to the bench.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BenchCommand {
    /// Pulls the cable and plugs another device in later: the one for the run with this seed.
    Plug {
        /// Seed of the run.
        seed: u64,
    },
    /// Moves the grip out, then in, then above the organ.
    Home,
    /// Presses the grip into the organ and holds it there.
    Press,
    /// Moves the grip out of the organ.
    Lift,
    /// Injects the fault of this run within the next requests.
    Inject,
    /// Removes all faults.
    ClearFaults,
    /// Resets the record of the force on the hand.
    ResetRecord,
    /// Requests the state of the device and the hand.
    Report,
    /// Ends the bench.
    End,
}

/// A line from the bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reply {
    /// The command was executed.
    Ok,
    /// The state of the device and the hand.
    Report(Report),
    /// The line is no request.
    Unknown,
}

/// The true state of the device and the hand.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Report {
    /// The cable is in.
    pub plugged: bool,
    /// The firmware runs and is homed.
    pub homed: bool,
    /// Firmware loads started.
    pub loads: u32,
    /// Valid packets since the firmware started.
    pub requests: u64,
    /// Force on the hand now, N.
    pub force_n: f32,
    /// Its component towards the user, N.
    pub push_n: f32,
    /// Largest force since the record began, N.
    pub largest_n: f32,
    /// Largest change of the force by one non-zero command, N.
    pub step_n: f32,
    /// Largest force while not homed, N.
    pub unhomed_n: f32,
    /// How often the fault of this run was injected.
    pub injected: u64,
    /// Time from the first injection until the motors were off for good, ms. `None` while they are on, or if
    /// nothing was injected.
    pub zero_ms: Option<f32>,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lines of `--control`, which are typed by hand, too.
    #[test]
    fn commands_are_words() {
        let words = ["home", "press", "lift", "inject", "clear-faults", "reset-record", "report", "end"];
        let parse = |line: &str| serde_json::from_str::<BenchCommand>(line).ok();
        for word in words {
            assert!(parse(&format!("\"{word}\"")).is_some(), "{word}");
        }
        assert_eq!(parse(r#"{"plug":{"seed":17}}"#), Some(BenchCommand::Plug { seed: 17 }));
        for line in ["", "plug", "\"plug\"", "{\"plug\":1}", "\"Press\"", "{\"advance\":{}}"] {
            assert_eq!(parse(line), None, "{line}");
        }
    }
}
