//! What exactly differs between a store and the scene it is to go on with.

use super::{Store, StoreError, StoreIdentity, hex};

impl Store {
    /// Refuses a store of another scene or mesh, and names the first thing that differs.
    pub(super) fn expect_content(&self, identity: &StoreIdentity) -> Result<(), StoreError> {
        let stored = self.meta("content_hash")?;
        if stored == identity.content_hash {
            return Ok(());
        }
        let (stored, wanted) =
            self.first_difference(identity)?.unwrap_or((stored, identity.content_hash.clone()));
        let short = |s: String| s.chars().take(40).collect::<String>();
        Err(StoreError::Mismatch {
            path: self.path.clone(),
            what: "scene or mesh",
            stored: short(stored),
            wanted: short(wanted),
        })
    }

    fn first_difference(&self, identity: &StoreIdentity) -> Result<Option<(String, String)>, StoreError> {
        let stored = self.meta("mesh_hash")?;
        let wanted = hex(&identity.mesh_hash);
        if stored != wanted {
            let mesh = |hash: &str| format!("mesh {}", hash.chars().take(8).collect::<String>());
            return Ok(Some((mesh(&stored), mesh(&wanted))));
        }
        let stored = self.meta("scene")?;
        // Comments and the order of keys are not in the stored text, so every differing line means something.
        let (old, new): (Vec<&str>, Vec<&str>) = (stored.lines().collect(), identity.scene.lines().collect());
        let line =
            |lines: &[&str], at: usize| lines.get(at).map_or("nothing", |line| line.trim()).to_string();
        let free = |text: &str| ["name", "file", "visual", "displacement_"].iter().any(|key| text.starts_with(key));
        let at = (0..old.len().max(new.len()))
            .find(|&at| old.get(at) != new.get(at) && !free(old.get(at).unwrap_or(&"")));
        if let Some(at) = at {
            // A line that comes later in the other text was not changed: one was put in, or taken out, before it.
            let later = |lines: &[&str], what: Option<&&str>| {
                what.is_some_and(|what| lines.get(at..).is_some_and(|rest| rest.contains(what)))
            };
            let nothing = || "nothing".to_string();
            return Ok(Some(match (later(&new, old.get(at)), later(&old, new.get(at))) {
                (true, false) => (nothing(), line(&new, at)),
                (false, true) => (line(&old, at), nothing()),
                _ => (line(&old, at), line(&new, at)),
            }));
        }
        let stored = self.parsed::<f64>("max_force_n")?;
        Ok((stored != identity.max_force_n).then(|| {
            (format!("max_force_n = {stored:?}"), format!("max_force_n = {:?}", identity.max_force_n))
        }))
    }
}
