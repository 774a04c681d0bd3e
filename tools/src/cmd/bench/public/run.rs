//! What every section needs: amount, threads, interruption.

use std::sync::atomic::{AtomicBool, Ordering};

use super::figures::{Section, Table};
use super::interrupted;
use crate::failure::Failure;
use crate::machine::date;

/// How a section is measured.
#[derive(Debug, Clone, Copy)]
pub(super) struct Context<'s> {
    /// Fewer positions.
    pub(super) quick: bool,
    /// Worker threads.
    pub(super) threads: usize,
    /// Set by Ctrl-C.
    pub(super) stop: &'s AtomicBool,
}

impl Context<'_> {
    /// Fails after Ctrl-C.
    pub(super) fn go_on(&self) -> Result<(), Failure> {
        if self.stop.load(Ordering::Relaxed) { Err(interrupted()) } else { Ok(()) }
    }
}

/// Folder of spaces, blobs and finished sections, beside the page.
pub(super) const WORK: &str = "work";

/// A section of these tables. In the commands that repeat it OUT is the folder of the page, ASSETS that of the scenes.
pub(super) fn finished(
    context: &Context<'_>,
    key: &str,
    title: &str,
    explains: &[&str],
    repeats: &[&str],
    seconds: f64,
    tables: Vec<Table>,
) -> Section {
    let owned = |texts: &[&str]| -> Vec<String> { texts.iter().map(|text| (*text).to_owned()).collect() };
    let again = format!("palpate bench public --only {key} --out OUT --assets ASSETS");
    Section {
        key: key.into(),
        title: title.into(),
        explains: owned(explains),
        repeats: [vec![again], owned(repeats)].concat(),
        files: Vec::new(),
        quick: context.quick,
        date: date(),
        seconds,
        others_share: None,
        tables,
    }
}
