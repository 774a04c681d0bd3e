//! `palpate inspect FILE.mcap`: the content of a recording, and whether it is complete.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use palpate_core::{Phase, Sample};
use palpate_host::rt::TickRecord;
use palpate_host::session::TouchStatistics;
use palpate_record::{End, Header, Recording};
use serde::Serialize;
use serde_json::json;

use super::Shown;
use super::timeline::{Timeline, Window};
use crate::failure::Failure;
use crate::files::{Output, Stream};

/// Describes the recording, and writes its ticks and draws a part of them if requested. It uses a single pass,
/// because an hour of ticks may exceed the memory.
pub(super) fn show(
    path: &Path,
    csv: Option<&Output>,
    picture: Option<(&Output, Window)>,
) -> Result<Shown, Failure> {
    let damaged = |error| Failure::input(format!("{}: {error}", path.display()));
    let source = File::open(path).map_err(|error| Failure::file(path, &error))?;
    let mut recording = Recording::open(BufReader::new(source)).map_err(damaged)?;
    let header = recording.header().clone();
    let mut table = csv.map(Table::begin).transpose()?;
    let mut timeline = picture.map(|(file, window)| (file, Timeline::new(&header, window)));
    let mut figures = Figures::default();
    for record in recording.by_ref() {
        let record = record.map_err(damaged)?;
        figures.take(&record);
        if let Some(table) = &mut table {
            table.row(&record, &header)?;
        }
        if let Some((_, timeline)) = &mut timeline {
            timeline.take(&record);
        }
    }
    if let Some(table) = table {
        table.finish()?;
    }
    if let Some((file, timeline)) = timeline {
        let Some(drawing) = timeline.svg() else {
            let last_s = figures.last_us as f64 * 1e-6;
            let line = format!(
                "{}: no tick to draw; give a --window before its end at {last_s:.3} s",
                path.display()
            );
            return Err(Failure::input(line));
        };
        file.put(drawing.as_bytes())?;
    }
    Ok(figures.describe(&header, &recording))
}

/// Sums over all ticks.
#[derive(Default)]
struct Figures {
    ticks: u64,
    last_us: u64,
    without_sample: u64,
    touch: TouchStatistics,
    /// Number of times that each fault was latched.
    faults: BTreeMap<&'static str, u64>,
    phase: Option<Phase>,
    compute_ns: u64,
    max_compute_ns: u64,
    max_lateness_ns: u64,
    skipped_periods: u64,
}

impl Figures {
    fn take(&mut self, record: &TickRecord) {
        self.ticks += 1;
        self.last_us = record.t_us;
        self.without_sample += u64::from(record.sample.is_none());
        self.touch.add(record);
        if let Phase::SafeZero(fault) = record.phase
            && self.phase != Some(record.phase)
        {
            *self.faults.entry(fault.name()).or_default() += 1;
        }
        self.phase = Some(record.phase);
        self.compute_ns = self.compute_ns.saturating_add(record.compute_ns);
        self.max_compute_ns = self.max_compute_ns.max(record.compute_ns);
        self.max_lateness_ns = self.max_lateness_ns.max(record.lateness_ns);
        self.skipped_periods = record.skipped_periods;
    }

    fn describe<R: std::io::Read>(&self, header: &Header, recording: &Recording<R>) -> Shown {
        let (touch, end) = (&self.touch, recording.end());
        let seconds = self.last_us as f64 * 1e-6;
        let mean_compute_us = self.compute_ns as f64 * 1e-3 / self.ticks.max(1) as f64;
        let faults: Vec<String> =
            self.faults.iter().map(|(name, times)| format!("{name} ({times})")).collect();
        let dropped = end.map_or(0, |end| end.dropped_by_loop.saturating_add(end.dropped_by_recorder));
        let is_whole = !recording.is_cut() && recording.lost() + dropped == 0;
        let text = format!(
            "{}: {} ticks in {seconds:.1} s, {} faults\n\ndevice       {}\nscene        {} (active nodes {})\nblob         {}\nmethod       {} ({}, {})\n\
             begun        {:.3} s after 1970\nticks        {}, {seconds:.3} s; {} deadlines skipped, {} without a sample\n\
             touch        {}\ntiming       compute {mean_compute_us:.1} us mean, {:.1} us max; at most {:.1} us late\n\
             faults       {}\nlosses       {} records missing between ticks, {dropped} counted as dropped\nend          {}",
            if is_whole { "complete" } else { "INCOMPLETE" },
            self.ticks,
            self.faults.values().sum::<u64>(),
            header.device.name,
            header.scene,
            header.active.join(", "),
            header.blob_blake3.join(", "),
            header.config.method_name(),
            header.instructions,
            header.program,
            header.start_unix_ns as f64 * 1e-9,
            self.ticks,
            self.skipped_periods,
            self.without_sample,
            touch.in_words(self.ticks),
            self.max_compute_ns as f64 * 1e-3,
            self.max_lateness_ns as f64 * 1e-3,
            if faults.is_empty() { "none".into() } else { faults.join(", ") },
            recording.lost(),
            ended(recording.is_cut(), end),
        );
        let figures = json!({
            "device": header.device.name, "scene": header.scene, "active": header.active,
            "blob_blake3": header.blob_blake3, "method": header.config.method_name(),
            "instructions": header.instructions, "program": header.program,
            "start_unix_ns": header.start_unix_ns, "period_us": header.haptic.period_us,
            "max_force_n": header.config.limits.max_force_n,
            "ticks": self.ticks, "seconds": seconds, "skipped_periods": self.skipped_periods,
            "without_sample": self.without_sample, "contacts": touch.contacts,
            "engaged_ticks": touch.engaged_ticks, "clamped_ticks": touch.clamped_ticks,
            "peak_reaction_n": touch.peak_reaction_n, "peak_reaction_n_m": touch.peak_reaction_n_m, "peak_hand_force_n": touch.peak_hand_force_n,
            "peak_displacement_m": touch.peak_displacement_m,
            "mean_compute_us": mean_compute_us, "max_compute_us": self.max_compute_ns as f64 * 1e-3,
            "max_lateness_us": self.max_lateness_ns as f64 * 1e-3, "faults": self.faults,
            "lost": recording.lost(), "dropped_by_loop": end.map(|end| end.dropped_by_loop),
            "dropped_by_recorder": end.map(|end| end.dropped_by_recorder),
            "device_errors": end.map(|end| end.device_errors), "cut": recording.is_cut(),
            "end": end.map(|end| &end.reason), "phase": end.map(|end| &end.phase),
        });
        (text, figures)
    }
}

fn ended(is_cut: bool, end: Option<&End>) -> String {
    match end {
        _ if is_cut => "truncated: the file ends before the end of the recording".into(),
        Some(end) => format!("{}, {}, {} device exchanges failed", end.reason, end.phase, end.device_errors),
        None => "not known".into(),
    }
}

/// A value of the table. Numbers keep their type, so a float is written with the digits that restore its bits.
#[derive(Serialize)]
#[serde(untagged)]
enum Cell<'r> {
    Count(u64),
    Number(f32),
    Text(&'r str),
    Empty(()),
}

/// A column and its value in the row of a tick. As in the table of a space, `x_m` is the displacement of the
/// active node and `fx_n` the force of the tool on the body.
type Column = (&'static str, for<'r> fn(&'r TickRecord, &'r Header) -> Cell<'r>);

const COLUMNS: [Column; 47] = [
    ("tick", |r, _| Cell::Count(r.tick)),
    ("t_us", |r, _| Cell::Count(r.t_us)),
    ("active", |r, header| Cell::Text(r.engaged.map_or("", |space| node(header, space)))),
    ("x_m", |r, _| Cell::Number(r.displacement_m[0])),
    ("y_m", |r, _| Cell::Number(r.displacement_m[1])),
    ("z_m", |r, _| Cell::Number(r.displacement_m[2])),
    ("fx_n", |r, _| Cell::Number(r.reaction_n[0])),
    ("fy_n", |r, _| Cell::Number(r.reaction_n[1])),
    ("fz_n", |r, _| Cell::Number(r.reaction_n[2])),
    ("coverage", |r, _| Cell::Text(r.coverage.map_or("", |coverage| coverage.name()))),
    ("hand_fx_n", |r, _| Cell::Number(r.hand_force_n[0])),
    ("hand_fy_n", |r, _| Cell::Number(r.hand_force_n[1])),
    ("hand_fz_n", |r, _| Cell::Number(r.hand_force_n[2])),
    ("clamped", |r, _| Cell::Count(r.clamped.into())),
    ("phase", |r, _| Cell::Text(phase(r).0)),
    ("fault", |r, _| Cell::Text(phase(r).1)),
    ("hip_x_m", |r, _| Cell::Number(r.hip_m[0])),
    ("hip_y_m", |r, _| Cell::Number(r.hip_m[1])),
    ("hip_z_m", |r, _| Cell::Number(r.hip_m[2])),
    ("sample_t_us", |r, _| sampled(r, |sample| Cell::Count(sample.t_us))),
    ("sample_x_m", |r, _| sampled(r, |sample| Cell::Number(sample.position_m[0]))),
    ("sample_y_m", |r, _| sampled(r, |sample| Cell::Number(sample.position_m[1]))),
    ("sample_z_m", |r, _| sampled(r, |sample| Cell::Number(sample.position_m[2]))),
    ("buttons", |r, _| sampled(r, |sample| Cell::Count(sample.buttons.into()))),
    ("reset", |r, _| Cell::Count(r.applied.reset.into())),
    ("arm", |r, _| Cell::Count(r.applied.arm.into())),
    ("disarm", |r, _| Cell::Count(r.applied.disarm.into())),
    ("zeroed", |r, _| Cell::Count(r.applied.zeroed.into())),
    ("model", |r, _| Cell::Count(r.model.into())),
    ("device", |r, _| Cell::Text(r.device.name())),
    ("ramp", |r, _| Cell::Number(r.ramp)),
    ("hand_work_j", |r, _| Cell::Number(r.hand_work_j)),
    ("damped", |r, _| Cell::Count(r.damped.into())),
    ("compute_ns", |r, _| Cell::Count(r.compute_ns)),
    ("device_ns", |r, _| r.device_ns.map_or(Cell::Empty(()), Cell::Count)),
    ("lateness_ns", |r, _| Cell::Count(r.lateness_ns)),
    ("skipped_periods", |r, _| Cell::Count(r.skipped_periods)),
    ("tx_n_m", |r, _| Cell::Number(r.reaction_n_m[0])),
    ("ty_n_m", |r, _| Cell::Number(r.reaction_n_m[1])),
    ("tz_n_m", |r, _| Cell::Number(r.reaction_n_m[2])),
    ("grip_w", |r, _| sampled(r, |sample| Cell::Number(sample.orientation.w))),
    ("grip_x", |r, _| sampled(r, |sample| Cell::Number(sample.orientation.xyz[0]))),
    ("grip_y", |r, _| sampled(r, |sample| Cell::Number(sample.orientation.xyz[1]))),
    ("grip_z", |r, _| sampled(r, |sample| Cell::Number(sample.orientation.xyz[2]))),
    ("reported_fx_n", |r, _| reported(r, 0)),
    ("reported_fy_n", |r, _| reported(r, 1)),
    ("reported_fz_n", |r, _| reported(r, 2)),
];

/// The name of an active node.
fn node(header: &Header, space: u16) -> &str {
    header.active.get(usize::from(space)).map_or("?", String::as_str)
}

/// The phase, and the fault of a safe zero.
fn phase(record: &TickRecord) -> (&'static str, &'static str) {
    match record.phase {
        Phase::Disarmed => ("disarmed", ""),
        Phase::Active => ("active", ""),
        Phase::SafeZero(fault) => ("safe-zero", fault.name()),
    }
}

/// A component of the force that the device reported; empty if it reported none.
fn reported(record: &TickRecord, axis: usize) -> Cell<'static> {
    record.reported_n.map_or(Cell::Empty(()), |force_n| Cell::Number(force_n[axis]))
}

/// A value of the sample; empty if the device sent none.
fn sampled(record: &TickRecord, value: impl FnOnce(Sample) -> Cell<'static>) -> Cell<'static> {
    record.sample.map_or(Cell::Empty(()), value)
}

/// The table, written row by row.
struct Table<'o> {
    file: &'o Output,
    writer: csv::Writer<Stream>,
}

impl<'o> Table<'o> {
    fn begin(file: &'o Output) -> Result<Self, Failure> {
        let mut writer = csv::Writer::from_writer(file.stream()?);
        let named = writer.write_record(COLUMNS.map(|(name, _)| name));
        named.map_err(|error| file.failure(&error.into()))?;
        Ok(Self { file, writer })
    }

    fn row(&mut self, record: &TickRecord, header: &Header) -> Result<(), Failure> {
        let row = COLUMNS.map(|(_, value)| value(record, header));
        self.writer.serialize(row.as_slice()).map_err(|error| self.file.failure(&error.into()))
    }

    fn finish(self) -> Result<(), Failure> {
        self.writer.into_inner().map_err(|error| self.file.failure(error.error()))?.finish()
    }
}
