//! Access of the doctor to the PC: all data are files under a root folder, so a test can simulate a PC.

use std::path::{Path, PathBuf};

/// Bit of CAP_DAC_OVERRIDE in the capability masks of `/proc/self/status`.
const CAP_DAC_OVERRIDE: u32 = 1;
/// Bit of CAP_IPC_LOCK.
pub(super) const CAP_IPC_LOCK: u32 = 14;
/// Bit of CAP_SYS_NICE.
pub(super) const CAP_SYS_NICE: u32 = 23;

/// The PC under examination.
#[derive(Debug, Clone)]
pub struct Probe {
    root: PathBuf,
    /// Resolution of the clock that the loop sleeps on, ns; the only value that is not in a file.
    timer_resolution_ns: Option<u64>,
}

impl Probe {
    /// This PC.
    #[must_use]
    pub fn system() -> Self {
        Self { root: "/".into(), timer_resolution_ns: crate::sys::timer_resolution_ns() }
    }

    /// A PC whose `/proc`, `/sys` and `/dev` are under `root`.
    #[must_use]
    pub const fn with_root(root: PathBuf, timer_resolution_ns: Option<u64>) -> Self {
        Self { root, timer_resolution_ns }
    }

    pub(super) const fn timer_resolution_ns(&self) -> Option<u64> {
        self.timer_resolution_ns
    }

    fn at(&self, path: &str) -> PathBuf {
        self.root.join(path.trim_start_matches('/'))
    }

    /// Trimmed contents of a file; `None` if it cannot be read.
    pub(super) fn read(&self, path: &str) -> Option<String> {
        let bytes = std::fs::read(self.at(path)).ok()?;
        Some(String::from_utf8_lossy(&bytes).trim().into())
    }

    /// Contents of a file with one number.
    pub(super) fn number<T: std::str::FromStr>(&self, path: &str) -> Option<T> {
        self.read(path)?.parse().ok()
    }

    /// Sorted names in a folder; empty if it does not exist.
    pub(super) fn list(&self, path: &str) -> Vec<String> {
        let entries = std::fs::read_dir(self.at(path)).into_iter().flatten().flatten();
        let mut names: Vec<String> =
            entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    /// The value after `key` at the start of a line, for instance of `/proc/self/status`.
    pub(super) fn value(&self, path: &str, key: &str) -> Option<String> {
        let text = self.read(path)?;
        let value = text.lines().find_map(|line| line.strip_prefix(key))?;
        Some(value.trim_start_matches(':').trim().into())
    }

    /// Whether this process has a capability.
    pub(super) fn has_capability(&self, bit: u32) -> bool {
        let mask = self.value("/proc/self/status", "CapEff");
        mask.and_then(|mask| u64::from_str_radix(&mask, 16).ok()).is_some_and(|mask| mask >> bit & 1 == 1)
    }

    /// Soft limit of `/proc/self/limits`; `u64::MAX` is unlimited.
    pub(super) fn limit(&self, name: &str) -> Option<u64> {
        match self.value("/proc/self/limits", name)?.split_whitespace().next()? {
            "unlimited" => Some(u64::MAX),
            number => number.parse().ok(),
        }
    }

    /// Whether this user may write to a file, from its owner, group and mode; `None` if it does not exist.
    /// The file is not opened: opening a serial port resets some boards.
    #[cfg(unix)]
    pub(super) fn may_write(&self, path: &str) -> Option<bool> {
        use std::os::unix::fs::MetadataExt;
        let metadata = std::fs::metadata(self.at(path)).ok()?;
        let ids = |key: &str| -> Vec<u32> {
            let value = self.value("/proc/self/status", key).unwrap_or_default();
            value.split_whitespace().filter_map(|id| id.parse().ok()).collect()
        };
        let effective = |ids: Vec<u32>| ids.get(1).copied();
        if self.has_capability(CAP_DAC_OVERRIDE) {
            return Some(true);
        }
        let in_group =
            effective(ids("Gid")) == Some(metadata.gid()) || ids("Groups").contains(&metadata.gid());
        let bit = match () {
            () if effective(ids("Uid")) == Some(metadata.uid()) => 0o200,
            () if in_group => 0o020,
            () => 0o002,
        };
        Some(metadata.mode() & bit != 0)
    }

    /// Whether any user may write to a file.
    #[cfg(unix)]
    pub(super) fn is_open_to_others(&self, path: &str) -> bool {
        use std::os::unix::fs::MetadataExt;
        std::fs::metadata(self.at(path)).is_ok_and(|metadata| metadata.mode() & 0o002 != 0)
    }

    /// Whether this process is in a group, or may open files of every group; `None` if the groups cannot be
    /// read.
    pub(super) fn is_in_group(&self, name: &str) -> Option<bool> {
        let groups = self.read("/etc/group")?;
        let own = self.value("/proc/self/status", "Groups")?;
        let gid = self.value("/proc/self/status", "Gid")?;
        let line = groups.lines().find(|line| line.split(':').next() == Some(name));
        let wanted = line.and_then(|line| line.split(':').nth(2));
        let mut ids = own.split_whitespace().chain(gid.split_whitespace());
        Some(self.has_capability(CAP_DAC_OVERRIDE) || ids.any(|id| wanted == Some(id)))
    }

    /// Not available on this system.
    #[cfg(not(unix))]
    pub(super) fn may_write(&self, _path: &str) -> Option<bool> {
        None
    }

    /// Whether a file or folder exists.
    pub(super) fn is_there(&self, path: &str) -> bool {
        Path::exists(&self.at(path))
    }

    /// CPUs that are online.
    pub(super) fn online(&self) -> Vec<usize> {
        cpus(&self.read("/sys/devices/system/cpu/online").unwrap_or_default())
    }
}

/// Parses a kernel list of CPUs: `0-3,7`.
pub(super) fn cpus(list: &str) -> Vec<usize> {
    let mut all = Vec::new();
    for part in list.split(',') {
        let (from, to) = part.split_once('-').unwrap_or((part, part));
        if let (Ok(from), Ok(to)) = (from.trim().parse::<usize>(), to.trim().parse::<usize>()) {
            // No PC has more CPUs; a damaged file must not exhaust the memory.
            all.extend((from..=to).take(4_096));
        }
    }
    all
}

/// Formats a list of CPUs like the kernel.
pub(super) fn list_of(cpus: &[usize]) -> String {
    let mut text = String::new();
    let mut rest = cpus;
    while let Some((&first, _)) = rest.split_first() {
        let run = rest.iter().zip(first..).take_while(|(cpu, expected)| *cpu == expected).count();
        if !text.is_empty() {
            text.push(',');
        }
        text.push_str(&first.to_string());
        if run > 1 {
            text.push_str(&format!("-{}", first + run - 1));
        }
        rest = &rest[run..];
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_cpus_are_parsed_and_formatted() {
        assert_eq!(cpus("0-3,7"), [0, 1, 2, 3, 7]);
        assert_eq!(cpus(""), [0; 0]);
        assert_eq!(cpus("text,2-x,5"), [5]);
        assert!(cpus("0-18446744073709551615").len() <= 4_096);
        for list in ["0-3,7", "0", "", "1,3,5-6"] {
            assert_eq!(list_of(&cpus(list)), list);
        }
    }

    #[test]
    fn a_pc_without_files_has_no_values() {
        let root = tempfile::tempdir().expect("a temporary directory");
        let probe = Probe::with_root(root.path().into(), None);
        assert_eq!((probe.read("/proc/version"), probe.limit("Max realtime priority")), (None, None));
        assert_eq!(probe.may_write("/dev/cpu_dma_latency"), None);
        assert!(!probe.has_capability(CAP_SYS_NICE) && probe.list("/sys").is_empty());
    }
}
