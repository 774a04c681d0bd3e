//! Memory of this process, where the system tells it.

/// Largest resident size since the start or the last [`forget_peak`], MB.
pub(super) fn peak_mb() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kb| kb / 1024)
}

/// Starts a new peak at what is resident now (Linux); elsewhere peaks add up, which errs on the safe side.
pub(super) fn forget_peak() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// For tables.
pub(super) fn shown(mb: Option<u64>) -> String {
    mb.map_or_else(|| "?".into(), |mb| mb.to_string())
}
