//! `palpate inspect FILE.mcap`: the content of a recording, and whether it is complete.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use palpate_core::Phase;
use palpate_host::Recording;
use palpate_host::recording::{End, Header};
use palpate_host::rt::TickRecord;
use palpate_host::session::TouchStatistics;
use serde::Serialize;
use serde_json::json;

use super::Shown;
use crate::failure::Failure;
use crate::files::{Output, Stream};

/// Describes the recording, and writes its ticks if requested. It uses a single pass, because an
/// hour of ticks may exceed the memory.
pub(super) fn show(path: &Path, csv: Option<&Output>) -> Result<Shown, Failure> {
    let damaged = |error| Failure::input(format!("{}: {error}", path.display()));
    let source = File::open(path).map_err(|error| Failure::file(path, &error))?;
    let mut recording = Recording::open(BufReader::new(source)).map_err(damaged)?;
    let header = recording.header().clone();
    let mut table = csv.map(Table::begin).transpose()?;
    let mut figures = Figures::default();
    for record in recording.by_ref() {
        let record = record.map_err(damaged)?;
        figures.take(&record);
        if let Some(table) = &mut table {
            table.row(&record, &header)?;
        }
    }
    if let Some(table) = table {
        table.finish()?;
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
             touch        {} contacts, {:.1} % of the ticks; peak force {:.2} N on the body, {:.2} N for the hand; \
             peak displacement {:.1} mm\ntiming       compute {mean_compute_us:.1} us mean, {:.1} us max; at most {:.1} us late\n\
             faults       {}\nlosses       {} records missing between ticks, {dropped} counted as dropped\nend          {}",
            if is_whole { "complete" } else { "INCOMPLETE" },
            self.ticks,
            self.faults.values().sum::<u64>(),
            header.device.name,
            header.scene,
            header.active.join(", "),
            header.blob_blake3.join(", "),
            header.config.method.name(),
            header.instructions,
            header.program,
            header.start_unix_ns as f64 * 1e-9,
            self.ticks,
            self.skipped_periods,
            self.without_sample,
            touch.contacts,
            100.0 * touch.engaged_ticks as f64 / self.ticks.max(1) as f64,
            touch.peak_reaction_n,
            touch.peak_hand_force_n,
            touch.peak_displacement_m * 1e3,
            self.max_compute_ns as f64 * 1e-3,
            self.max_lateness_ns as f64 * 1e-3,
            if faults.is_empty() { "none".into() } else { faults.join(", ") },
            recording.lost(),
            ended(recording.is_cut(), end),
        );
        let figures = json!({
            "device": header.device.name, "scene": header.scene, "active": header.active,
            "blob_blake3": header.blob_blake3, "method": header.config.method.name(),
            "instructions": header.instructions, "program": header.program,
            "start_unix_ns": header.start_unix_ns, "period_us": header.haptic.period_us,
            "max_force_n": header.config.limits.max_force_n,
            "ticks": self.ticks, "seconds": seconds, "skipped_periods": self.skipped_periods,
            "without_sample": self.without_sample, "contacts": touch.contacts,
            "engaged_ticks": touch.engaged_ticks, "clamped_ticks": touch.clamped_ticks,
            "peak_reaction_n": touch.peak_reaction_n, "peak_hand_force_n": touch.peak_hand_force_n,
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

/// One tick. As in the table of a space, `x_m` is the displacement of the active node and `fx_n` the force of
/// the tool on the body.
#[derive(Serialize)]
struct Row<'r> {
    tick: u64,
    t_us: u64,
    active: &'r str,
    x_m: f32,
    y_m: f32,
    z_m: f32,
    fx_n: f32,
    fy_n: f32,
    fz_n: f32,
    coverage: &'r str,
    hand_fx_n: f32,
    hand_fy_n: f32,
    hand_fz_n: f32,
    clamped: u8,
    phase: &'r str,
    fault: &'r str,
    hip_x_m: f32,
    hip_y_m: f32,
    hip_z_m: f32,
    sample_t_us: Option<u64>,
    sample_x_m: Option<f32>,
    sample_y_m: Option<f32>,
    sample_z_m: Option<f32>,
    buttons: Option<u32>,
    reset: u8,
    arm: u8,
    disarm: u8,
    zeroed: u8,
    model: u8,
    device: &'static str,
    ramp: f32,
    hand_work_j: f32,
    damped: u8,
    compute_ns: u64,
    device_ns: Option<u64>,
    lateness_ns: u64,
    skipped_periods: u64,
}

impl<'r> Row<'r> {
    fn of(record: &TickRecord, header: &'r Header) -> Self {
        let [x_m, y_m, z_m] = record.displacement_m;
        let [fx_n, fy_n, fz_n] = record.reaction_n;
        let [hand_fx_n, hand_fy_n, hand_fz_n] = record.hand_force_n;
        let [hip_x_m, hip_y_m, hip_z_m] = record.hip_m;
        let [sample_x_m, sample_y_m, sample_z_m] = match record.sample {
            Some(sample) => sample.position_m.map(Some),
            None => [None; 3],
        };
        let name = |space: u16| header.active.get(usize::from(space)).map_or("?", String::as_str);
        let (phase, fault) = match record.phase {
            Phase::Disarmed => ("disarmed", ""),
            Phase::Active => ("active", ""),
            Phase::SafeZero(fault) => ("safe-zero", fault.name()),
        };
        Self {
            tick: record.tick,
            t_us: record.t_us,
            active: record.engaged.map_or("", name),
            x_m,
            y_m,
            z_m,
            fx_n,
            fy_n,
            fz_n,
            coverage: record.coverage.map_or("", |coverage| coverage.name()),
            hand_fx_n,
            hand_fy_n,
            hand_fz_n,
            clamped: record.clamped.into(),
            phase,
            fault,
            hip_x_m,
            hip_y_m,
            hip_z_m,
            sample_t_us: record.sample.map(|sample| sample.t_us),
            sample_x_m,
            sample_y_m,
            sample_z_m,
            buttons: record.sample.map(|sample| sample.buttons),
            reset: record.applied.reset.into(),
            arm: record.applied.arm.into(),
            disarm: record.applied.disarm.into(),
            zeroed: record.applied.zeroed.into(),
            model: record.model,
            device: record.device.name(),
            ramp: record.ramp,
            hand_work_j: record.hand_work_j,
            damped: record.damped.into(),
            compute_ns: record.compute_ns,
            device_ns: record.device_ns,
            lateness_ns: record.lateness_ns,
            skipped_periods: record.skipped_periods,
        }
    }
}

/// The table, written row by row.
struct Table<'o> {
    file: &'o Output,
    writer: csv::Writer<Stream>,
}

impl<'o> Table<'o> {
    fn begin(file: &'o Output) -> Result<Self, Failure> {
        Ok(Self { file, writer: csv::Writer::from_writer(file.stream()?) })
    }

    fn row(&mut self, record: &TickRecord, header: &Header) -> Result<(), Failure> {
        self.writer.serialize(Row::of(record, header)).map_err(|error| self.file.failure(&error.into()))
    }

    fn finish(self) -> Result<(), Failure> {
        self.writer.into_inner().map_err(|error| self.file.failure(error.error()))?.finish()
    }
}
