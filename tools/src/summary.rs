//! Results of sessions and replays as JSON: SI units, machine times in ns, null for missing values.

use palpate_core::{Coverage, Phase};
use palpate_host::device::profile::{Profile, StiffnessCap, Timing};
use palpate_host::doctor::SystemInfo;
use palpate_host::rt::{LatencyReport, LoopEnd, Miss, Percentiles};
use palpate_host::session::TouchStatistics;
use palpate_host::sys::RtReport;
use palpate_host::{DeviceInfo, SessionSummary};
use palpate_record::End;
use palpate_record::replay::{Difference, ReplaySummary};
use palpate_viewer::Frames;
use serde_json::{Map, Value, json};

/// The result of a session in one line.
pub(crate) fn headline(summary: &SessionSummary) -> String {
    let (touch, latency) = (&summary.touch, &summary.latency);
    let end = match (summary.phase, summary.end) {
        (Phase::SafeZero(fault), _) => format!("FAULT {}, force zero", fault.name()),
        (_, LoopEnd::DeviceLost(_)) => "DEVICE LOST".into(),
        (_, LoopEnd::Stopped) => "stopped".into(),
        (_, LoopEnd::Completed) => "completed".into(),
    };
    let plural = |count: u64| if count == 1 { "" } else { "s" };
    format!(
        "{end}: {} ticks, {} deadline{} missed, compute p99 {:.1} us; {} contact{}, at most {:.2} N on the hand",
        summary.ticks,
        latency.skipped_periods,
        plural(latency.skipped_periods),
        latency.compute.p99_ns as f64 * 1e-3,
        touch.contacts,
        plural(touch.contacts),
        touch.peak_hand_force_n
    )
}

/// The summary of a session.
pub(crate) fn session(summary: &SessionSummary, frames: Frames) -> Value {
    let DeviceInfo { name, self_arming, max_force_n, max_stiffness_n_m, resolution_m } = &summary.device;
    let SystemInfo { kernel, governor, isolated } = &summary.system;
    let fault = match summary.phase {
        Phase::SafeZero(fault) => Some(fault.name()),
        Phase::Disarmed | Phase::Active => None,
    };
    // As in a recording, except the fault, which is a field of its own.
    let End { reason, phase, .. } = End::of_session(summary);
    json!({
        "device": {
            "name": name, "self_arming": self_arming, "max_force_n": max_force_n, "max_stiffness_n_m": max_stiffness_n_m,
            "resolution_m": resolution_m,
        },
        "instructions": summary.instructions.to_string(),
        "stiffest_n_m": summary.stiffest_n_m, "force_share": summary.force_share,
        "real_time": real_time(&summary.real_time),
        "surroundings": { "kernel": kernel, "governor": governor, "isolated": isolated },
        "ticks": summary.ticks,
        "latency": latency(&summary.latency),
        "touch": touch(&summary.touch),
        "dropped_records": summary.dropped_records, "dropped_by_recorder": summary.dropped_by_recorder,
        "device_errors": summary.device_errors,
        "frames": frames.written, "mean_frame_ms": frames.mean_ms,
        "end": reason, "phase": phase.split(':').next(), "fault": fault,
    })
}

/// What the operating system granted.
fn real_time(report: &RtReport) -> Value {
    json!({
        "scheduler": report.scheduler.to_string(), "policy": report.policy.to_string(), "memory_lock": report.memory.to_string(),
        "cpu_pinning": report.affinity.to_string(), "cpu": report.cpu, "cpus_awake": report.awake.to_string(),
        "timer_slack": report.timer_slack.to_string(),
    })
}

fn latency(report: &LatencyReport) -> Value {
    let worst = |miss: &Miss| {
        json!({
            "tick": miss.tick, "late_ns": miss.late_ns, "wake_ns": miss.times.wake_ns, "device_ns": miss.times.device_ns,
            "compute_ns": miss.times.compute_ns,
        })
    };
    json!({
        "lateness_ns": percentiles(&report.wake), "device_ns": percentiles(&report.device),
        "compute_ns": percentiles(&report.compute), "overruns": report.overruns, "missed_deadlines": report.skipped_periods,
        "worst": report.worst.iter().map(worst).collect::<Vec<_>>(),
    })
}

/// The percentiles of one quantity, ns.
pub(crate) fn percentiles(of: &Percentiles) -> Value {
    json!({ "count": of.count, "mean": of.mean_ns, "p50": of.p50_ns, "p99": of.p99_ns, "p999": of.p999_ns, "max": of.max_ns })
}

fn touch(figures: &TouchStatistics) -> Value {
    let coverage: Map<String, Value> = Coverage::ALL
        .iter()
        .zip(figures.coverage_ticks)
        .map(|(kind, ticks)| (kind.name().to_owned(), ticks.into()))
        .collect();
    json!({
        "contacts": figures.contacts, "ticks": figures.engaged_ticks, "coverage_ticks": coverage,
        "peak_reaction_n": figures.peak_reaction_n, "peak_reaction_n_m": figures.peak_reaction_n_m, "peak_hand_force_n": figures.peak_hand_force_n,
        "peak_displacement_m": figures.peak_displacement_m, "clamped_ticks": figures.clamped_ticks,
        "largest_step_n": figures.largest_step_n, "largest_work_j": figures.largest_work_j, "damped_ticks": figures.damped_ticks,
        "not_finite_ticks": figures.not_finite_ticks,
    })
}

/// A device's profile compared with the timing of a session.
pub(crate) fn profile(profile: &Profile, report: &LatencyReport) -> Value {
    let verdict = profile.verdict(report);
    let StiffnessCap { n_m, timing, .. } = verdict.cap;
    let of = |timing: Timing| json!({ "cycle_s": timing.cycle_s, "delay_s": timing.delay_s });
    json!({
        "name": profile.name, "cap_n_m": n_m, "held": verdict.held, "stands_on": of(timing), "measured": of(verdict.measured),
        "cap_at_measured_n_m": verdict.at_measured.map(|cap| cap.n_m), "verdict": verdict.to_string(),
    })
}

/// The summary of a replay.
pub(crate) fn replay(summary: &ReplaySummary, frames: Frames) -> Value {
    let difference = |of: &Difference| {
        json!({
            "tick": of.tick, "t_us": of.t_us, "recorded_n": of.recorded_n, "replayed_n": of.replayed_n, "size_n": of.size_n(),
        })
    };
    json!({
        "recorded_method": summary.recorded_method_name(), "method": summary.method_name(), "ticks": summary.ticks,
        "identical": summary.is_identical(), "different": summary.different,
        "first": summary.first.as_ref().map(difference), "largest": summary.largest.as_ref().map(difference),
        "lost": summary.lost, "cut": summary.is_cut, "stopped": summary.is_stopped, "touch": touch(&summary.touch),
        "frames": frames.written,
    })
}
