//! What the test in the guest asks of the bench, a line each, and the line it gets back.

use core::fmt;
use core::str::FromStr;

/// A line to the bench.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Pulls the cable, and after a while puts another device in: that of the run with this seed.
    Plug {
        /// The run's.
        seed: u64,
    },
    /// The hand pulls the grip out, pushes it in, and holds it above the organ.
    Home,
    /// The hand presses the grip into the organ and stays there.
    Press,
    /// The hand takes it out again.
    Lift,
    /// The fault of this run strikes soon.
    Strike,
    /// No more faults.
    Calm,
    /// The record of what the hand felt begins anew.
    Forget,
    /// The truth, please.
    Report,
    /// All is done.
    End,
}

impl fmt::Display for Order {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Plug { seed } => return write!(f, "plug {seed}"),
            Self::Home => "home",
            Self::Press => "press",
            Self::Lift => "lift",
            Self::Strike => "strike",
            Self::Calm => "calm",
            Self::Forget => "forget",
            Self::Report => "report",
            Self::End => "end",
        })
    }
}

/// A line that is none of ours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NotUnderstood;

impl fmt::Display for NotUnderstood {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("not understood")
    }
}

impl core::error::Error for NotUnderstood {}

impl FromStr for Order {
    type Err = NotUnderstood;

    fn from_str(line: &str) -> Result<Self, NotUnderstood> {
        let known = [
            Self::Home,
            Self::Press,
            Self::Lift,
            Self::Strike,
            Self::Calm,
            Self::Forget,
            Self::Report,
            Self::End,
        ];
        if let Some(seed) = line.strip_prefix("plug ") {
            return seed.parse().map(|seed| Self::Plug { seed }).map_err(|_| NotUnderstood);
        }
        known.into_iter().find(|order| order.to_string() == line).ok_or(NotUnderstood)
    }
}

/// The truth about the device and the hand on it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Report {
    /// The cable is in.
    pub plugged: bool,
    /// The firmware runs and is homed.
    pub homed: bool,
    /// Loads of firmware begun.
    pub loads: u32,
    /// Packets the firmware understood since it started.
    pub requests: u64,
    /// Force on the hand now, N.
    pub force_n: f32,
    /// Its part towards the user, N.
    pub push_n: f32,
    /// Largest force since the record began, N.
    pub largest_n: f32,
    /// Largest change of the force by one command that was not zero, N.
    pub step_n: f32,
    /// Largest force while not homed, N.
    pub unhomed_n: f32,
    /// How often the fault of this run has struck.
    pub struck: u64,
    /// From the first time until the motors were off and stayed so, ms; nothing as long as they are on, or nothing has struck.
    pub zero_ms: Option<f32>,
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { plugged, homed, loads, requests, force_n, push_n, .. } = self;
        let Self { largest_n, step_n, unhomed_n, struck, zero_ms, .. } = self;
        write!(f, "report {} {} {loads} {requests} ", u8::from(*plugged), u8::from(*homed))?;
        write!(f, "{force_n:.4} {push_n:.4} {largest_n:.4} {step_n:.4} {unhomed_n:.4} {struck} ")?;
        match zero_ms {
            Some(zero_ms) => write!(f, "{zero_ms:.3}"),
            None => f.write_str("-"),
        }
    }
}

impl FromStr for Report {
    type Err = NotUnderstood;

    fn from_str(line: &str) -> Result<Self, NotUnderstood> {
        fn next<'l, T: FromStr>(words: &mut impl Iterator<Item = &'l str>) -> Result<T, NotUnderstood> {
            words.next().and_then(|word| word.parse().ok()).ok_or(NotUnderstood)
        }
        let mut words = line.strip_prefix("report ").ok_or(NotUnderstood)?.split(' ');
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
            struck: next(words)?,
            zero_ms: match words.next() {
                Some("-") => None,
                word => Some(word.and_then(|word| word.parse().ok()).ok_or(NotUnderstood)?),
            },
        };
        if words.next().is_some() { Err(NotUnderstood) } else { Ok(report) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_are_read_as_they_are_written() {
        let orders = [
            Order::Plug { seed: 17 },
            Order::Home,
            Order::Press,
            Order::Lift,
            Order::Strike,
            Order::Calm,
            Order::Forget,
            Order::Report,
            Order::End,
        ];
        for order in orders {
            assert_eq!(order.to_string().parse(), Ok(order));
        }
        for line in ["", "plug", "plug x", "press ", "Press"] {
            assert_eq!(line.parse::<Order>(), Err(NotUnderstood));
        }
    }

    #[test]
    fn so_are_reports() {
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
            struck: 3,
            zero_ms: Some(12.5),
        };
        assert_eq!(report.to_string(), "report 1 0 2 12345 1.5000 -0.2500 2.5000 0.5000 0.0000 3 12.500");
        for report in [report, Report { zero_ms: None, ..report }] {
            assert_eq!(report.to_string().parse(), Ok(report));
        }
        for line in ["ok", "report 1 0 2", "report 1 0 2 12345 1.5 1.5 2.5 0.5 0 3 - 4"] {
            assert_eq!(line.parse::<Report>(), Err(NotUnderstood));
        }
    }
}
