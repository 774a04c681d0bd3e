//! Reports the first difference between a store and the scene of a resumed run.

use super::{Store, StoreError, StoreIdentity};

impl Store {
    /// Refuses a store of another scene or mesh, and reports the first difference.
    pub(in crate::space) fn expect_content(&self, identity: &StoreIdentity) -> Result<(), StoreError> {
        let stored = self.meta("content_hash")?;
        if stored == identity.content_hash {
            return Ok(());
        }
        let (stored, wanted) =
            self.first_difference(identity)?.unwrap_or((stored, identity.content_hash.clone()));
        Err(self.mismatch("scene or mesh", &stored, &wanted))
    }

    fn first_difference(&self, identity: &StoreIdentity) -> Result<Option<(String, String)>, StoreError> {
        let stored = self.meta("mesh_hash")?;
        let wanted = blake3::Hash::from_bytes(identity.mesh_hash).to_string();
        if stored != wanted {
            let mesh = |hash: &str| format!("mesh {}", hash.chars().take(8).collect::<String>());
            return Ok(Some((mesh(&stored), mesh(&wanted))));
        }
        let stored = self.meta("scene")?;
        // The stored text has no comments and a fixed order of keys, so every differing line is a difference
        // of content.
        let (old, new) = (entries(&stored), entries(&identity.scene));
        if let Some(at) = (0..old.len().max(new.len())).find(|&at| old.get(at) != new.get(at)) {
            // If an entry occurs later in the other text, it is unchanged: another entry was added or removed
            // before it.
            let later = |others: &[Entry<'_>], entry: Option<&Entry<'_>>| {
                entry.is_some_and(|entry| others.get(at..).is_some_and(|rest| rest.contains(entry)))
            };
            let line = |entry: Option<&Entry<'_>>| entry.map_or("nothing", |(_, line)| line).to_string();
            let (was, is) = (old.get(at), new.get(at));
            return Ok(Some(match (later(&new, was), later(&old, is)) {
                (true, false) => (line(None), line(is)),
                (false, true) => (line(was), line(None)),
                _ => (line(was), line(is)),
            }));
        }
        let stored = self.parsed::<f64>("max_force_n")?;
        Ok((stored != identity.max_force_n).then(|| {
            (format!("max_force_n = {stored:?}"), format!("max_force_n = {:?}", identity.max_force_n))
        }))
    }
}

/// A line of a scene with its table.
type Entry<'t> = (&'t str, &'t str);

/// Lines of a scene's canonical text that affect the space: all but names and rendering keys.
fn entries(text: &str) -> Vec<Entry<'_>> {
    let (mut table, mut entries) = ("", Vec::new());
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
        let key = line.split(" =").next().unwrap_or(line);
        if line.starts_with('[') {
            table = line;
        } else if !["name", "file", "visual", "displacement_rms_mm", "displacement_max_mm"].contains(&key) {
            entries.push((table, line));
        }
    }
    entries
}
