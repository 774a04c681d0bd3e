//! Fitted tables: one measured blob per method, in a file that a second run reads again.

use palpate_core::{Method, Organ};
use palpate_host::BlobFile;
use palpate_precompute::certificate::{Certificate, MethodCertificate, SpaceCertificate, certify};
use palpate_precompute::held_out::Summary;
use palpate_precompute::pack::{PackError, PackOptions, Packed, pack};
use palpate_precompute::space::Store;

use super::plan::Plan;
use crate::failure::Failure;
use crate::files::Output;

/// A method's tables of one space.
#[derive(Debug)]
pub(super) struct Fitted {
    /// The method.
    pub method: Method,
    /// The blob in the loop's format.
    pub file: BlobFile,
    /// Bytes of a complete blob, with the skin and the certificate.
    pub blob_bytes: usize,
    /// Bytes of the method's tables alone.
    pub table_bytes: usize,
    /// Certificate of this method only, although other methods may use the same tables.
    pub certificate: Certificate,
}

impl Fitted {
    /// The one space.
    pub(super) fn space(&self) -> &SpaceCertificate {
        &self.certificate.spaces[0]
    }

    /// The one method's figures.
    pub(super) fn figures(&self) -> &MethodCertificate {
        &self.space().methods[0]
    }

    /// The packed organ, with one space.
    pub(super) fn organ(&self) -> Result<Organ<'_>, Failure> {
        let organ: Organ<'_> = Organ::read(self.file.bytes()).map_err(Failure::work)?;
        if organ.spaces.is_empty() { Err(Failure::work("a blob without a space")) } else { Ok(organ) }
    }
}

/// A method without tables, and the reason.
#[derive(Debug, Clone, serde::Serialize)]
pub(super) struct LeftOut {
    /// The case.
    pub case: String,
    /// The method.
    pub method: &'static str,
    /// The reason.
    pub why: String,
}

/// Fits and measures each method separately, unless a blob of the same space, held-out solutions and version
/// exists and is not to be fitted `again`. `name` begins the names of the blobs.
pub(super) fn fitted(
    plan: &Plan,
    store: &Store,
    (name, again): (&str, bool),
    mut before: impl FnMut(Method) -> Result<(), Failure>,
) -> Result<(Vec<Fitted>, Vec<LeftOut>), Failure> {
    let packed = |methods: &[Method]| {
        pack(store, &PackOptions { methods, use_intermediate_states: true, threads: plan.threads })
    };
    let solved = store.records(0)?.iter().filter(|r| r.tag().is_solved()).count();
    let truths: u32 = Summary::of(store, 0)?.values().map(|sum| sum.positions).sum();
    let bare_bytes = packed(&[])?.bytes()?.len();
    let (mut all, mut left_out) = (Vec::new(), Vec::new());
    for &method in &plan.methods {
        before(method)?;
        let blob = plan.work.file(&format!("{name}-{}.blob", method.name()));
        let there = if again { None } else { reusable(&blob, store, method, solved, truths)? };
        let fitted = match there {
            Some(there) => there,
            None => match packed(&[method]) {
                Ok(packed) => measured(&blob, store, method, packed)?,
                Err(PackError::Fit { error, .. }) => {
                    let why = error.to_string();
                    left_out.push(LeftOut { case: name.into(), method: method.name(), why });
                    continue;
                }
                Err(error) => return Err(error.into()),
            },
        };
        let certificate_bytes = fitted.with_organ(|organ| organ.certificate.map_or(0, <[u8]>::len))?;
        let table_bytes = fitted.blob_bytes.saturating_sub(certificate_bytes + bare_bytes);
        all.push(Fitted { table_bytes, ..fitted });
    }
    Ok((all, left_out))
}

impl Fitted {
    fn with_organ<T>(&self, see: impl FnOnce(&Organ<'_>) -> T) -> Result<T, Failure> {
        Ok(see(&Organ::read(self.file.bytes()).map_err(Failure::work)?))
    }

    fn of(method: Method, file: BlobFile, mut certificate: Certificate) -> Self {
        for space in &mut certificate.spaces {
            space.methods.retain(|of| of.method == method.name());
        }
        Self { method, blob_bytes: file.bytes().len(), table_bytes: 0, file, certificate }
    }
}

fn measured(blob: &Output, store: &Store, method: Method, mut packed: Packed) -> Result<Fitted, Failure> {
    let bare = BlobFile::of(&packed.bytes()?);
    let organ: Organ<'_> = Organ::read(bare.bytes()).map_err(Failure::work)?;
    let certificate = certify(store, &organ)?;
    let json = serde_json::to_string(&certificate).map_err(Failure::work)?;
    packed.certify(&json)?;
    // Parsed as in a second run: numbers in JSON may lose their last bit.
    let certificate: Certificate = serde_json::from_str(&json).map_err(Failure::work)?;
    let bytes = packed.bytes()?;
    blob.put(&bytes)?;
    Ok(Fitted::of(method, BlobFile::of(&bytes), certificate))
}

/// The existing blob, if it is of the same space and was measured with the same held-out solutions.
fn reusable(
    blob: &Output,
    store: &Store,
    method: Method,
    solved: usize,
    truths: u32,
) -> Result<Option<Fitted>, Failure> {
    let Ok(file) = BlobFile::load(blob.path()) else { return Ok(None) };
    let certificate: Option<Certificate> = {
        let organ: Result<Organ<'_>, _> = Organ::read(file.bytes());
        let json = organ.ok().and_then(|organ| organ.certificate);
        json.and_then(|bytes| serde_json::from_slice(bytes).ok())
    };
    let Some(certificate) = certificate else { return Ok(None) };
    let same_origin = certificate.origin.content_hash == store.identity()?.content_hash
        && certificate.origin.solver == store.meta("solver")?;
    let same_work = match &certificate.spaces[..] {
        [space] => {
            let there = space.methods.iter().any(|m| m.method == method.name());
            let cost = &space.cost;
            there && cost.configurations == solved && cost.held_out == truths
        }
        _ => false,
    };
    if !(same_origin && same_work) {
        return Ok(None);
    }
    Ok(Some(Fitted::of(method, file, certificate)))
}
