//! The report of a session: as text, or as one JSON object.

use std::time::{Duration, Instant};

use palpate_host::device::profile::Profile;
use palpate_host::rt::{Miss, TickRecord};
use serde_json::{Map, Value, json};

use super::{Outputs, SessionArgs};
use crate::failure::Failure;
use crate::output::Table;
use crate::resident::Resident;
use crate::touch::Touched;
use crate::{motors_off, output, summary};

/// Prints the largest deadline misses, and the part of their tick that took the time.
fn print_misses(worst: &[Miss]) -> Result<(), Failure> {
    if worst.is_empty() {
        return Ok(());
    }
    let mut table = Table::new(0, ["tick", "late, ms", "woken late, ms", "device, ms", "controller, ms"]);
    for Miss { tick, late_ns, times, .. } in worst {
        let ms = |ns: u64| format!("{:.3}", ns as f64 * 1e-6);
        let [wake, device, compute] = [times.wake_ns, times.device_ns, times.compute_ns].map(ms);
        table.row([tick.to_string(), ms(*late_ns), wake, device, compute]);
    }
    output::line(format!("\nworst misses\n{table}"))
}

/// Watches the records of a session for its report.
#[derive(Debug)]
pub(crate) struct Watcher {
    begun: Instant,
    ready: Option<Duration>,
    unsent: Option<motors_off::Lines>,
    resident: Resident,
}

impl Watcher {
    /// The session began to start at `begun`.
    pub(crate) fn new(args: &SessionArgs, begun: Instant) -> Self {
        let unsent = args.motors_off.then(motors_off::Lines::default);
        Self { begun, ready: None, unsent, resident: Resident::start() }
    }

    /// From the command to the first tick.
    pub(crate) fn ready(&self) -> Option<Duration> {
        self.ready
    }

    /// Takes the next record.
    pub(crate) fn take(&mut self, record: &TickRecord) {
        self.ready.get_or_insert_with(|| self.begun.elapsed());
        if let Some(unsent) = &mut self.unsent {
            unsent.take(record);
        }
        self.resident.take(record);
    }
}

/// What a report states besides the session's own figures.
#[derive(Debug)]
pub(crate) struct Figures<'a> {
    /// What was touched, for JSON.
    pub(crate) of: Map<String, Value>,
    /// Method of the force.
    pub(crate) method: &'a str,
    /// Number of bytes that were loaded.
    pub(crate) bytes: usize,
    /// The guard of the device, if it has one.
    pub(crate) guard: Option<String>,
    /// The profile of the device, if it is known.
    pub(crate) profile: Option<&'a Profile>,
    /// More lines of text.
    pub(crate) lines: Vec<String>,
}

impl Figures<'_> {
    /// Prints the report, writes the histograms, and fails if the recording did.
    pub(crate) fn print(
        self,
        args: &SessionArgs,
        outputs: &Outputs,
        touched: &Touched,
        watcher: Watcher,
    ) -> Result<(), Failure> {
        let Watcher { ready, resident, .. } = watcher;
        let resident = resident.end();
        let say = |text: String| if args.json { Ok(()) } else { output::line(text) };
        let session = &touched.summary;
        if args.json {
            let mut figures = self.of;
            let mut add = |key: &str, value: Value| figures.insert(key.into(), value);
            add("method", json!(self.method));
            add("session", summary::session(session, touched.frames));
            add("profile", json!(self.profile.map(|profile| summary::profile(profile, &session.latency))));
            add("guard", json!(self.guard));
            add("start_s", json!(ready.map(|ready| ready.as_secs_f64())));
            add("memory_kb", json!(resident.figures()));
            let recording = args.record.as_ref().zip(touched.recording.as_ref()).map(|(path, report)| {
                json!({
                    "file": path, "ticks": report.ticks, "dropped": report.dropped,
                    "error": report.error.as_ref().map(ToString::to_string),
                })
            });
            add("recording", json!(recording));
            output::line(format!("{:#}", Value::Object(figures)))?;
        }
        say(summary::headline(session))?;
        say(format!("\nmethod       {}\n{}", self.method, touched.text()))?;
        for line in self.lines {
            say(line)?;
        }
        if let Some(guard) = &self.guard {
            say(format!("guard        {guard}"))?;
        }
        if let Some(profile) = self.profile {
            say(format!("profile      {}: {}", profile.name, profile.verdict(&session.latency)))?;
        }
        if let Some(ready) = ready {
            let (seconds, megabytes) = (ready.as_secs_f64(), self.bytes as f64 * 1e-6);
            say(format!("start        {seconds:.2} s from {megabytes:.1} MB to the first tick"))?;
        }
        say(resident.to_string())?;
        if args.verbose && !args.json {
            output::line(format!("\n{}", session.latency.histograms.bars()))?;
            print_misses(&session.latency.worst)?;
        }
        if let Some(file) = &outputs.histograms {
            output::histograms(file, &session.latency)?;
            say(format!("histograms   {}", file.path().display()))?;
        }
        if let (Some(path), Some(report)) = (&args.record, &touched.recording) {
            let (path, ticks, dropped) = (path.display(), report.ticks, report.dropped);
            say(format!("recording    {path}: {ticks} ticks, {dropped} more dropped while writing"))?;
            if let Some(error) = &report.error {
                return Err(Failure::work(format!("{path}: {error}; the recording ends there")));
            }
        }
        Ok(())
    }
}
