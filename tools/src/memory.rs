//! Memory of this process, on systems that report it.

/// Largest resident size since the start or the last [`forget_peak`], bytes.
pub(crate) fn peak_bytes() -> Option<u64> {
    status_bytes("VmHWM:")
}

/// Largest resident size, MB.
pub(crate) fn peak_mb() -> Option<u64> {
    peak_bytes().map(|bytes| bytes >> 20)
}

/// The value for tables.
pub(crate) fn shown(mb: Option<u64>) -> String {
    mb.map_or_else(|| "?".into(), |mb| mb.to_string())
}

/// Present resident size, bytes.
pub(crate) fn resident_bytes() -> Option<u64> {
    status_bytes("VmRSS:")
}

/// Resets the peak to the present resident size (Linux). On other systems the peak of earlier work remains,
/// which is an upper bound.
pub(crate) fn forget_peak() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

fn status_bytes(key: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(key))?;
    line.split_whitespace().next()?.parse::<u64>().ok().map(|kib| kib << 10)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    /// Half a block of tolerance: other tests run in this process at the same time, and the counters behind
    /// the system's peak lag some pages behind the resident size.
    #[test]
    fn the_peak_holds_what_was_resident_and_is_gone() {
        const BLOCK: usize = 256 << 20;
        let before = resident_bytes().unwrap();
        assert!(before > 1 << 20, "{before}");
        let block = std::hint::black_box(vec![1_u8; BLOCK]);
        let with = resident_bytes().unwrap();
        drop(block);
        let peak = peak_bytes().unwrap();
        let at_least = before + BLOCK as u64 / 2;
        assert!(with > at_least && peak > at_least, "{before} B, {with} B with the block, peak {peak} B");
    }
}
