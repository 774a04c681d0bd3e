//! Opens a blob for a command.

use std::path::Path;

use palpate_core::{Method, Organ};
use palpate_host::{BlobFile, PREFERENCE};
use palpate_precompute::certificate::{self, Certificate};
use palpate_viewer::Verdict;

use crate::failure::Failure;

/// Loads the file at `path`.
pub(crate) fn load(path: &Path) -> Result<BlobFile, Failure> {
    BlobFile::load(path).map_err(|error| Failure::file(path, &error))
}

/// Checks a loaded file and returns the view of it that the loop uses.
pub(crate) fn organ<'a>(path: &Path, file: &'a BlobFile) -> Result<Organ<'a>, Failure> {
    Organ::read(file.bytes()).map_err(|error| Failure::input(format!("{}: {error}", path.display())))
}

/// The default method for these organs: one that all their active nodes have.
pub(crate) fn preferred(organs: &[&Organ<'_>]) -> Option<Method> {
    let has = |method: &Method| organs.iter().all(|organ| organ.spaces.iter().all(|s| s.has(*method)));
    PREFERENCE.into_iter().find(has)
}

/// The certificate's verdict on each active node, for the picture; unknown where it states none.
pub(crate) fn verdicts<const N: usize>(organ: &Organ<'_, N>) -> Vec<Verdict> {
    let certificate: Option<Certificate> =
        organ.certificate.and_then(|bytes| serde_json::from_slice(bytes).ok());
    let health = |name: &str| {
        let space = certificate.as_ref()?.spaces.iter().find(|space| space.active == name)?;
        Some(space.health.as_ref()?.verdict)
    };
    let word = |verdict| match verdict {
        Some(certificate::Verdict::Green) => Verdict::Green,
        Some(certificate::Verdict::Yellow) => Verdict::Yellow,
        Some(certificate::Verdict::Red) => Verdict::Red,
        None => Verdict::Unknown,
    };
    organ.spaces.iter().map(|space| word(health(space.active.name.as_str()))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_precompute::certificate::{Health, Origin, SpaceCertificate};

    const BLOB: &[u8] = include_bytes!("../../firmware-like-core/golden/organ-514.blob");

    #[test]
    fn a_verdict_belongs_to_the_node_of_its_name() {
        let file = BlobFile::of(BLOB);
        let stored: Organ<'_> = Organ::read(file.bytes()).expect("a sound blob");
        let text = stored.certificate.expect("the golden blob is certified");
        let certificate: Certificate = serde_json::from_slice(text).expect("it can be read");
        let names: Vec<&str> = stored.spaces.iter().map(|space| space.active.name.as_str()).collect();
        assert_eq!(verdicts(&stored), vec![Verdict::Unknown; names.len()], "it states no health");
        let origin: Origin = certificate.origin;
        for (verdict, word) in [
            (certificate::Verdict::Green, Verdict::Green),
            (certificate::Verdict::Yellow, Verdict::Yellow),
            (certificate::Verdict::Red, Verdict::Red),
        ] {
            let health = Some(Health { verdict, ..Health::default() });
            let of = |name: &str, health: Option<Health>| SpaceCertificate {
                active: name.into(),
                health,
                ..Default::default()
            };
            // In another order than the blob, and with one that the blob does not hold.
            let spaces = vec![of("other", None), of(names[names.len() - 1], health)];
            let certificate = Certificate { origin: origin.clone(), spaces, discretisation: None };
            let text = serde_json::to_vec(&certificate).expect("JSON");
            let mut organ = stored.clone();
            organ.certificate = Some(&text);
            let found = verdicts(&organ);
            assert_eq!(found[names.len() - 1], word);
            assert!(found[..names.len() - 1].iter().all(|one| *one == Verdict::Unknown));
        }
        let mut organ = stored.clone();
        for certificate in [None, Some(&b"no JSON"[..])] {
            organ.certificate = certificate;
            assert!(verdicts(&organ).iter().all(|one| *one == Verdict::Unknown));
        }
    }
}
