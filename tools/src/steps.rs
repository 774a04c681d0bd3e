//! Progress of the report by steps, and its interruption.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::failure::Failure;
use crate::files::Output;

/// Counts and prints the steps.
#[derive(Debug)]
pub(crate) struct Steps {
    done: usize,
    total: usize,
    /// Set by Ctrl-C.
    pub stop: Arc<AtomicBool>,
}

impl Steps {
    /// `total` steps are to follow.
    pub(crate) fn new(total: usize, stop: Arc<AtomicBool>) -> Self {
        Self { done: 0, total, stop }
    }

    /// Starts a step. Fails after Ctrl-C.
    pub(crate) fn next(&mut self, what: &str) -> Result<(), Failure> {
        self.go_on()?;
        self.done += 1;
        eprintln!("palpate: step {} of {}: {what}", self.done, self.total);
        Ok(())
    }

    /// Fails after Ctrl-C.
    pub(crate) fn go_on(&self) -> Result<(), Failure> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(Failure::work(
                "interrupted; finished steps are kept, run the same command to continue",
            ));
        }
        Ok(())
    }
}

/// A result that is stored beside the spaces, with its key.
#[derive(Debug, Serialize, Deserialize)]
struct Kept<T> {
    key: String,
    value: T,
}

/// The content of the file if it was made for `key`.
pub(crate) fn stored<T: DeserializeOwned>(file: &Output, key: &str) -> Option<T> {
    let bytes = std::fs::read(file.path()).ok()?;
    let kept: Kept<T> = serde_json::from_slice(&bytes).ok()?;
    (kept.key == key).then_some(kept.value)
}

/// The content of the file if it was made for `key`; otherwise computes and stores it.
pub(crate) fn kept<T: Serialize + DeserializeOwned>(
    file: &Output,
    key: String,
    make: impl FnOnce() -> Result<T, Failure>,
) -> Result<T, Failure> {
    if let Some(value) = stored(file, &key) {
        return Ok(value);
    }
    let kept = Kept { key, value: make()? };
    let text = serde_json::to_string(&kept).map_err(Failure::work)?;
    file.put(text.as_bytes())?;
    Ok(kept.value)
}
