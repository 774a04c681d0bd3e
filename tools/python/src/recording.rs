//! A recording of the haptic loop as columns.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use numpy::IntoPyArray;
use palpate_core::{Coverage, Fault, Phase};
use palpate_host::device::DeviceState;
use palpate_host::rt::TickRecord;
use palpate_record::Recording;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::vectors;
use crate::command::phase_name;
use crate::failure::Failure;

/// What a file holds.
struct Read {
    ticks: Vec<TickRecord>,
    header: String,
    end: Option<String>,
    is_cut: bool,
    lost: u64,
}

fn read(path: &Path) -> Result<Read, Failure> {
    let refused =
        |error: palpate_record::RecordingError| Failure::input(format!("{}: {error}", path.display()));
    let file = File::open(path).map_err(|error| Failure::file(path, &error))?;
    let mut recording = Recording::open(BufReader::new(file)).map_err(refused)?;
    let header = serde_json::to_string(recording.header()).map_err(Failure::work)?;
    let ticks = recording.by_ref().collect::<Result<Vec<_>, _>>().map_err(refused)?;
    let end = recording.end().map(serde_json::to_string).transpose().map_err(Failure::work)?;
    Ok(Read { ticks, header, end, is_cut: recording.is_cut(), lost: recording.lost() })
}

/// Names of the codes of a column; -1 is none.
fn names<'py>(py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
    let all = PyDict::new(py);
    all.set_item("coverage", Coverage::ALL.map(Coverage::name))?;
    all.set_item("device", DeviceState::ALL.map(DeviceState::name))?;
    all.set_item("fault", Fault::ALL.map(Fault::name))?;
    all.set_item("phase", PHASES.map(phase_name))?;
    Ok(all)
}

/// One of each phase.
const PHASES: [Phase; 3] = [Phase::Disarmed, Phase::Active, Phase::SafeZero(Fault::Internal)];

/// Number of a phase in [`PHASES`].
const fn phase_code(phase: Phase) -> i8 {
    match phase {
        Phase::Disarmed => 0,
        Phase::Active => 1,
        Phase::SafeZero(_) => 2,
    }
}

fn code<T: PartialEq>(all: &[T], one: Option<T>) -> i8 {
    one.and_then(|one| all.iter().position(|other| *other == one)).map_or(-1, |at| at as i8)
}

/// Reads a whole recording: columns by name, names of the codes, header and end as JSON, whether the file is
/// cut, and the number of missing records.
#[pyfunction]
pub(crate) fn read_recording<'py>(py: Python<'py>, path: PathBuf) -> Result<Bound<'py, PyDict>, Failure> {
    let Read { ticks, header, end, is_cut, lost } = py.detach(|| read(&path))?;
    let all = PyDict::new(py);
    all.set_item("columns", columns(py, &ticks)?)?;
    all.set_item("names", names(py)?)?;
    all.set_item("header", header)?;
    all.set_item("end", end)?;
    all.set_item("is_cut", is_cut)?;
    all.set_item("lost", lost)?;
    Ok(all)
}

fn columns<'py>(py: Python<'py>, ticks: &[TickRecord]) -> PyResult<Bound<'py, PyDict>> {
    const NONE: [f32; 3] = [f32::NAN; 3];
    let all = PyDict::new(py);
    macro_rules! column {
        ($name:literal, $value:expr) => {{
            let values: Vec<_> = ticks.iter().map($value).collect();
            all.set_item($name, values.into_pyarray(py))?;
        }};
    }
    macro_rules! vector_column {
        ($name:literal, $value:expr) => {{
            let rows = ticks.iter().map($value).collect();
            all.set_item($name, vectors(py, rows)?)?;
        }};
    }
    column!("tick", |tick| tick.tick);
    column!("t_us", |tick| tick.t_us);
    column!("has_sample", |tick| tick.sample.is_some());
    column!("sample_t_us", |tick| tick.sample.map_or(0, |sample| sample.t_us));
    vector_column!("sample_position_m", |tick| tick.sample.map_or(NONE, |sample| sample.position_m));
    column!("buttons", |tick| tick.sample.map_or(0, |sample| sample.buttons));
    column!("device", |tick| code(&DeviceState::ALL, Some(tick.device)));
    column!("zeroed", |tick| tick.applied.zeroed);
    column!("reset", |tick| tick.applied.reset);
    column!("arm", |tick| tick.applied.arm);
    column!("disarm", |tick| tick.applied.disarm);
    column!("model", |tick| tick.model);
    vector_column!("hip_m", |tick| tick.hip_m);
    vector_column!("displacement_m", |tick| tick.displacement_m);
    column!("engaged", |tick| tick.engaged.map_or(-1, i32::from));
    vector_column!("shares_space", |tick| tick.shares.map(|share| share.space));
    vector_column!("shares_weight", |tick| tick.shares.map(|share| share.weight));
    vector_column!("reaction_n", |tick| tick.reaction_n);
    vector_column!("reaction_n_m", |tick| tick.reaction_n_m);
    vector_column!("hand_force_n", |tick| tick.hand_force_n);
    vector_column!("reported_n", |tick| tick.reported_n.unwrap_or(NONE));
    column!("coverage", |tick| code(&Coverage::ALL, tick.coverage));
    column!("phase", |tick| phase_code(tick.phase));
    column!("fault", |tick| match tick.phase {
        Phase::SafeZero(fault) => code(&Fault::ALL, Some(fault)),
        Phase::Disarmed | Phase::Active => -1,
    });
    column!("ramp", |tick| tick.ramp);
    column!("clamped", |tick| tick.clamped);
    column!("damped", |tick| tick.damped);
    column!("hand_work_j", |tick| tick.hand_work_j);
    column!("compute_ns", |tick| tick.compute_ns);
    column!("device_ns", |tick| tick.device_ns.unwrap_or(0));
    column!("live_jets", |tick| tick.live.map_or(0, |live| live.jets));
    column!("live_hand_overs", |tick| tick.live.map_or(0, |live| live.hand_overs));
    column!("lateness_ns", |tick| tick.lateness_ns);
    column!("skipped_periods", |tick| tick.skipped_periods);
    Ok(all)
}
