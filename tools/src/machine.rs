//! Origin of the figures: the machine, the load of other processes, versions and time.

use std::time::{SystemTime, UNIX_EPOCH};

use palpate_precompute::space::solver_version;
use serde::Serialize;

/// Data for the page's footer.
#[derive(Debug, Serialize)]
pub(crate) struct Machine {
    /// Model of the processor.
    pub cpu: String,
    /// Hardware threads.
    pub cores: usize,
    /// Memory, GB.
    pub memory_gb: Option<f64>,
    /// Distribution and kernel.
    pub system: String,
    /// Version of Palpate.
    pub palpate: &'static str,
    /// Version of the solver, and instruction set.
    pub solver: String,
    /// The compiler that built it.
    pub rustc: &'static str,
    /// When the report was finished, UTC.
    pub date: String,
    /// The command line.
    pub command: String,
    /// Worker threads.
    pub threads: usize,
    /// Share of processor time of other processes during this run.
    pub others_share: Option<f64>,
    /// Wall time of this run, s.
    pub wall_seconds: f64,
}

/// Clock ticks up to now: of all processors, busy ones, and those of this process and its ended children.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ticks {
    all: u64,
    busy: u64,
    own: u64,
}

impl Ticks {
    /// The present values; `None` if the system does not report them.
    pub(crate) fn now() -> Option<Self> {
        let whole = std::fs::read_to_string("/proc/stat").ok()?;
        let fields = whole.lines().next()?.split_whitespace().skip(1).take(8);
        let fields: Vec<u64> = fields.map(|n| n.parse().ok()).collect::<Option<_>>()?;
        let idle = fields.get(3)? + fields.get(4)?;
        let all: u64 = fields.iter().sum();
        // The program name in parentheses may contain spaces.
        let own = std::fs::read_to_string("/proc/self/stat").ok()?;
        let own: Vec<&str> = own.rsplit_once(')')?.1.split_whitespace().collect();
        // User and system time, of this process and of those that it has waited for.
        let own: u64 = own.get(11..15)?.iter().map(|n| n.parse::<u64>().ok()).sum::<Option<u64>>()?;
        Some(Self { all, busy: all - idle, own })
    }

    /// Share of processor time of other processes since these; `None` if the system does not report it.
    pub(crate) fn others_since(self) -> Option<f64> {
        let now = Self::now()?;
        let all = now.all.saturating_sub(self.all).max(1);
        let others = now.busy.saturating_sub(self.busy).saturating_sub(now.own.saturating_sub(self.own));
        Some(others as f64 / all as f64)
    }
}

impl Machine {
    /// The data of this machine.
    pub(crate) fn here(threads: usize, start: Option<Ticks>, wall_seconds: f64) -> Self {
        let memory =
            field("/proc/meminfo", "MemTotal").and_then(|kb| kb.split(' ').next()?.parse::<f64>().ok());
        let kernel = std::fs::read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
        let name = field("/etc/os-release", "PRETTY_NAME").unwrap_or_else(|| std::env::consts::OS.into());
        Self {
            cpu: cpu(),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            memory_gb: memory.map(|kb| (kb / 1e5).round() / 10.0),
            system: format!("{name}, kernel {}", kernel.trim()),
            palpate: concat!(env!("CARGO_PKG_VERSION"), ", commit ", env!("PALPATE_COMMIT")),
            solver: solver_version(),
            rustc: env!("PALPATE_RUSTC"),
            date: date(),
            command: std::env::args().collect::<Vec<_>>().join(" "),
            threads,
            others_share: start.and_then(Ticks::others_since),
            wall_seconds,
        }
    }

    /// Whether the load of other processes makes times unreliable.
    pub(crate) fn is_shared(&self) -> bool {
        is_shared(self.others_share)
    }
}

/// Whether this share of other processes makes times unreliable.
pub(crate) fn is_shared(others_share: Option<f64>) -> bool {
    others_share.is_some_and(|share| share > 0.1)
}

/// The value of a key in a file of the system.
fn field(path: &str, key: &str) -> Option<String> {
    let text = std::fs::read_to_string(path).ok()?;
    let line = text.lines().find(|line| line.starts_with(key))?;
    let value = line.split_once([':', '='])?.1;
    Some(value.trim().trim_matches('"').to_string())
}

/// The model of the processor.
pub(crate) fn cpu() -> String {
    field("/proc/cpuinfo", "model name").unwrap_or_else(|| "unknown".into())
}

/// Today in UTC, to the minute.
pub(crate) fn date() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |t| t.as_secs());
    let (year, month, day) = civil(seconds / 86_400);
    format!("{year}-{month:02}-{day:02} {:02}:{:02} UTC", seconds / 3600 % 24, seconds / 60 % 60)
}

/// Year, month and day of a number of days since 1970-01-01 (Howard Hinnant's algorithm).
fn civil(days: u64) -> (u64, u64, u64) {
    let days = days + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let shifted = (5 * of_year + 2) / 153;
    let day = of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    (year + 400 * era + u64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ended_child_is_no_other_program() {
        let before = Ticks::now().expect("Linux tells");
        let count = "i=0; while [ $i -lt 300000 ]; do i=$((i+1)); done";
        let ended = std::process::Command::new("sh").args(["-c", count]).status();
        assert!(ended.expect("a shell").success());
        assert!(Ticks::now().expect("Linux tells").own > before.own + 2, "{before:?}");
    }

    #[test]
    fn days_are_dates() {
        assert_eq!(
            [0, 59, 11_016, 20_000].map(civil),
            [(1970, 1, 1), (1970, 3, 1), (2000, 2, 29), (2024, 10, 4)]
        );
    }

    #[test]
    fn the_machine_is_known() {
        let machine = Machine::here(2, Ticks::now(), 1.0);
        assert!(machine.cores > 0 && machine.rustc.starts_with("rustc "));
        assert!(machine.others_share.is_none_or(|share| (0.0..=1.0).contains(&share)));
    }
}
