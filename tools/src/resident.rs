//! Resident memory of this process during a session, which shows whether it grows.

use std::fmt;

use palpate_host::TickRecord;

use crate::memory;

/// After this time every ring buffer of a session has been filled once, so memory should no longer grow, us.
const SETTLED_US: u64 = 20_000_000;

/// Resident memory at three times of a session, kB; `None` if the system does not report it.
#[derive(Debug)]
pub(crate) struct Resident {
    start_kb: Option<u64>,
    settled_kb: Option<u64>,
    end_kb: Option<u64>,
}

impl Resident {
    /// Measures at the start.
    pub(crate) fn start() -> Self {
        Self { start_kb: resident_kb(), settled_kb: None, end_kb: None }
    }

    /// Takes every record, outside the loop's thread.
    pub(crate) fn take(&mut self, record: &TickRecord) {
        if self.settled_kb.is_none() && record.t_us >= SETTLED_US {
            self.settled_kb = resident_kb();
        }
    }

    /// Measures at the end.
    pub(crate) fn end(mut self) -> Self {
        self.end_kb = resident_kb();
        self
    }
}

impl Resident {
    /// The values at the start, after the buffers are filled (if the session was long enough) and at the end,
    /// kB; null if the system does not report them.
    pub(crate) fn figures(&self) -> serde_json::Value {
        serde_json::json!({ "start": self.start_kb, "after_20_s": self.settled_kb, "end": self.end_kb })
    }
}

impl fmt::Display for Resident {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let part = |f: &mut fmt::Formatter<'_>, kb: Option<u64>, when: &str| match kb {
            Some(kb) => write!(f, " {:.1} MB {when}", kb as f64 / 1024.0),
            None => Ok(()),
        };
        if self.end_kb.is_none() {
            return f.write_str("memory       not reported by this system");
        }
        f.write_str("memory      ")?;
        part(f, self.start_kb, "at the start,")?;
        part(f, self.settled_kb, "after 20 s,")?;
        part(f, self.end_kb, "at the end")
    }
}

fn resident_kb() -> Option<u64> {
    memory::resident_bytes().map(|bytes| bytes >> 10)
}
