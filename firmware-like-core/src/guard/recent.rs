//! The last few vectors with their times.

use crate::num::vec3::{self, Vec3};

/// A ring buffer; zeros before the first entry. Times are the low 32 bits, for differences only.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Recent<const N: usize> {
    entries: [(u32, Vec3); N],
    newest: usize,
}

impl<const N: usize> Default for Recent<N> {
    fn default() -> Self {
        Self { entries: [(0, vec3::ZERO); N], newest: 0 }
    }
}

impl<const N: usize> Recent<N> {
    pub(super) fn push(&mut self, t_us: u64, value: Vec3) {
        self.newest = (self.newest + 1) % N;
        if let Some(entry) = self.entries.get_mut(self.newest) {
            *entry = (t_us as u32, value);
        }
    }

    /// From the newest to the oldest.
    pub(super) fn iter(&self) -> impl Iterator<Item = (u32, Vec3)> {
        let (newer, older) = self.entries.split_at_checked(self.newest + 1).unwrap_or((&self.entries, &[]));
        newer.iter().rev().chain(older.iter().rev()).copied()
    }
}
