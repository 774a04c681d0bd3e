//! Where the report stands: which step of how many, and what has been asked to stop.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::failure::Failure;
use crate::files::Output;

/// Counts the steps aloud.
#[derive(Debug)]
pub(super) struct Steps {
    done: usize,
    total: usize,
    /// Raised by Ctrl-C.
    pub stop: Arc<AtomicBool>,
}

impl Steps {
    /// `total` steps to come.
    pub(super) fn new(total: usize, stop: Arc<AtomicBool>) -> Self {
        Self { done: 0, total, stop }
    }

    /// Begins a step, unless it was asked to stop.
    pub(super) fn next(&mut self, what: &str) -> Result<(), Failure> {
        self.go_on()?;
        self.done += 1;
        eprintln!("palpate: step {} of {}: {what}", self.done, self.total);
        Ok(())
    }

    /// An error if it was asked to stop.
    pub(super) fn go_on(&self) -> Result<(), Failure> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(Failure::work("interrupted; what is done is kept, run the same command to go on"));
        }
        Ok(())
    }
}

/// Something solved that is kept beside the spaces, with what it was solved for.
#[derive(Debug, Serialize, Deserialize)]
struct Kept<T> {
    key: String,
    value: T,
}

/// What the file holds if it was made for `key`; otherwise made now, and kept.
pub(super) fn kept<T: Serialize + DeserializeOwned>(
    file: &Output,
    key: String,
    make: impl FnOnce() -> Result<T, Failure>,
) -> Result<T, Failure> {
    let there = std::fs::read(file.path()).ok();
    let there: Option<Kept<T>> = there.and_then(|bytes| serde_json::from_slice(&bytes).ok());
    if let Some(kept) = there.filter(|kept| kept.key == key) {
        return Ok(kept.value);
    }
    let kept = Kept { key, value: make()? };
    let text = serde_json::to_string(&kept).map_err(Failure::work)?;
    file.put(text.as_bytes())?;
    Ok(kept.value)
}
