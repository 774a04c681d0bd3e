//! Commands from the test in the guest to the bench, one line each, and the replies.

use core::fmt;
use core::str::FromStr;

/// A command to the bench.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

impl fmt::Display for BenchCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Plug { seed } => return write!(f, "plug {seed}"),
            Self::Home => "home",
            Self::Press => "press",
            Self::Lift => "lift",
            Self::Inject => "inject",
            Self::ClearFaults => "clear-faults",
            Self::ResetRecord => "reset-record",
            Self::Report => "report",
            Self::End => "end",
        })
    }
}

/// A line that is no known command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UnknownCommand;

impl fmt::Display for UnknownCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("unknown command")
    }
}

impl core::error::Error for UnknownCommand {}

impl FromStr for BenchCommand {
    type Err = UnknownCommand;

    fn from_str(line: &str) -> Result<Self, UnknownCommand> {
        let known = [
            Self::Home,
            Self::Press,
            Self::Lift,
            Self::Inject,
            Self::ClearFaults,
            Self::ResetRecord,
            Self::Report,
            Self::End,
        ];
        if let Some(seed) = line.strip_prefix("plug ") {
            return seed.parse().map(|seed| Self::Plug { seed }).map_err(|_| UnknownCommand);
        }
        known.into_iter().find(|command| command.to_string() == line).ok_or(UnknownCommand)
    }
}

/// The true state of the device and the hand.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
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

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { plugged, homed, loads, requests, force_n, push_n, .. } = self;
        let Self { largest_n, step_n, unhomed_n, injected, zero_ms, .. } = self;
        write!(f, "report {} {} {loads} {requests} ", u8::from(*plugged), u8::from(*homed))?;
        write!(f, "{force_n:.4} {push_n:.4} {largest_n:.4} {step_n:.4} {unhomed_n:.4} {injected} ")?;
        match zero_ms {
            Some(zero_ms) => write!(f, "{zero_ms:.3}"),
            None => f.write_str("-"),
        }
    }
}

impl FromStr for Report {
    type Err = UnknownCommand;

    fn from_str(line: &str) -> Result<Self, UnknownCommand> {
        fn next<'l, T: FromStr>(words: &mut impl Iterator<Item = &'l str>) -> Result<T, UnknownCommand> {
            words.next().and_then(|word| word.parse().ok()).ok_or(UnknownCommand)
        }
        let mut words = line.strip_prefix("report ").ok_or(UnknownCommand)?.split(' ');
        let words = &mut words;
        let report = Self {
            plugged: next::<u8>(words)? != 0,
            homed: next::<u8>(words)? != 0,
            loads: next(words)?,
            requests: next(words)?,
            force_n: next(words)?,
            push_n: next(words)?,
            largest_n: next(words)?,
            step_n: next(words)?,
            unhomed_n: next(words)?,
            injected: next(words)?,
            zero_ms: match words.next() {
                Some("-") => None,
                word => Some(word.and_then(|word| word.parse().ok()).ok_or(UnknownCommand)?),
            },
        };
        if words.next().is_some() { Err(UnknownCommand) } else { Ok(report) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::RigRequest;

    #[test]
    fn commands_round_trip_through_text() {
        let commands = [
            BenchCommand::Plug { seed: 17 },
            BenchCommand::Home,
            BenchCommand::Press,
            BenchCommand::Lift,
            BenchCommand::Inject,
            BenchCommand::ClearFaults,
            BenchCommand::ResetRecord,
            BenchCommand::Report,
            BenchCommand::End,
        ];
        for command in commands {
            assert_eq!(command.to_string().parse(), Ok(command));
        }
        for line in ["", "plug", "plug x", "press ", "Press"] {
            assert_eq!(line.parse::<BenchCommand>(), Err(UnknownCommand));
        }
        // The server reads a line as a request to the stepped rig first.
        for command in commands {
            assert!(
                command.to_string().parse::<RigRequest>().is_err(),
                "`{command}` is in both vocabularies"
            );
        }
    }

    #[test]
    fn reports_round_trip_through_text() {
        let report = Report {
            plugged: true,
            homed: false,
            loads: 2,
            requests: 12_345,
            force_n: 1.5,
            push_n: -0.25,
            largest_n: 2.5,
            step_n: 0.5,
            unhomed_n: 0.0,
            injected: 3,
            zero_ms: Some(12.5),
        };
        assert_eq!(report.to_string(), "report 1 0 2 12345 1.5000 -0.2500 2.5000 0.5000 0.0000 3 12.500");
        for report in [report, Report { zero_ms: None, ..report }] {
            assert_eq!(report.to_string().parse(), Ok(report));
        }
        for line in ["ok", "report 1 0 2", "report 1 0 2 12345 1.5 1.5 2.5 0.5 0 3 - 4"] {
            assert_eq!(line.parse::<Report>(), Err(UnknownCommand));
        }
    }
}
