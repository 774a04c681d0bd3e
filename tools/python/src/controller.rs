//! A controller that Python steps in virtual time.

use std::collections::HashMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use palpate_core::{Config, Controller as Core, Orientation, Sample, State, TouchSurface};
use palpate_host::device::{DeviceInfo, DeviceState};
use palpate_host::rt::{Applied, LoopConfig, TickRecord};
use palpate_host::settings::controller_config;
use palpate_record::{Header, TickWriter};
use pyo3::prelude::*;
use self_cell::{MutBorrow, self_cell};

use crate::arrays;
use crate::command::{Command, phase_name};
use crate::failure::Failure;
use crate::organ::{Blob, Organ};

/// What a controller borrows: the blob, and the lists of its surface.
pub(crate) struct Borrowed {
    pub(crate) blob: Arc<Blob>,
    lists: MutBorrow<Vec<u32>>,
}

type View<'a> = Core<'a, 'a>;

self_cell!(
    /// A controller with its organ.
    pub(crate) struct Owned {
        owner: Borrowed,
        #[covariant]
        dependent: View,
    }
);

impl Owned {
    /// The controller of a blob, which touches its surface.
    pub(crate) fn of_blob(blob: Arc<Blob>, config: Config) -> Result<Self, Failure> {
        let lists = MutBorrow::new(vec![0; TouchSurface::words(blob.organ())]);
        Self::try_new(Borrowed { blob, lists }, |borrowed| {
            let organ = borrowed.blob.organ();
            let controller = Core::new(organ, config).map_err(Failure::input)?;
            Ok(controller.on_surface(TouchSurface::new(organ, borrowed.lists.borrow_mut())))
        })
    }

    /// The controller.
    pub(crate) fn controller(&self) -> &View<'_> {
        self.borrow_dependent()
    }
}

/// The device that Python simulates: it sets no limits.
pub(crate) fn simulated_device() -> DeviceInfo {
    DeviceInfo {
        name: "python".into(),
        self_arming: true,
        max_force_n: f32::INFINITY,
        max_stiffness_n_m: f32::INFINITY,
        resolution_m: 0.0,
    }
}

/// Changes settings by their names.
pub(crate) fn set(config: &mut Config, given: Option<HashMap<String, f32>>) -> Result<(), Failure> {
    let Config { contact, limits, passivity, .. } = config;
    let mut fields = [
        ("max_force_n", &mut limits.max_force_n),
        ("max_slew_n_per_s", &mut limits.max_slew_n_per_s),
        ("ramp_s", &mut limits.ramp_s),
        ("fade_s", &mut limits.fade_s),
        ("max_position_m", &mut limits.max_position_m),
        ("max_speed_m_s", &mut limits.max_speed_m_s),
        ("max_stiffness_n_m", &mut limits.max_stiffness_n_m),
        ("friction", &mut contact.friction),
        ("release_height_m", &mut contact.release_height_m),
        ("margin_j", &mut passivity.margin_j),
        ("max_damping_n_s_m", &mut passivity.max_damping_n_s_m),
        ("fault_j", &mut passivity.fault_j),
        ("position_step_m", &mut passivity.position_step_m),
    ];
    let mut given: Vec<_> = given.unwrap_or_default().into_iter().collect();
    given.sort_by(|(one, _), (other, _)| one.cmp(other));
    for (name, value) in given {
        match fields.iter_mut().find(|(known, _)| *known == name) {
            Some((_, field)) => **field = value,
            None => {
                let known = fields.map(|(known, _)| known).join(", ");
                return Err(Failure::input(format!("unknown setting `{name}`; use one of: {known}")));
            }
        }
    }
    Ok(())
}

/// The sample of a tick.
pub(crate) fn sample(
    t_us: u64,
    position_m: Option<&Bound<'_, PyAny>>,
    buttons: u32,
    orientation: Option<[f32; 4]>,
) -> Result<Option<Sample>, Failure> {
    let Some(position_m) = position_m else { return Ok(None) };
    let position_m = arrays::three("position_m", position_m)?.map(|x| x as f32);
    let orientation =
        orientation.map_or_else(Orientation::default, |[w, x, y, z]| Orientation { w, xyz: [x, y, z] });
    Ok(Some(Sample { t_us, position_m, buttons, orientation }))
}

/// What changes from tick to tick.
struct Changing {
    state: State,
    ticks: u64,
    applied: Applied,
    recorder: Option<TickWriter<BufWriter<File>>>,
}

/// The controller of the haptic loop: contact, force and limits of one tick at a time, in the time of the
/// caller.
///
/// The real-time loop runs the same code in Rust; this one is for simulated hands, tests and studies.
#[pyclass(module = "palpate", frozen)]
pub(crate) struct Controller {
    owned: Owned,
    changing: Mutex<Changing>,
    record: Option<PathBuf>,
}

#[pymethods]
impl Controller {
    #[new]
    #[pyo3(signature = (organ, method=None, record=None, **settings))]
    fn new(
        organ: &Organ,
        method: Option<&str>,
        record: Option<PathBuf>,
        settings: Option<HashMap<String, f32>>,
    ) -> Result<Self, Failure> {
        let method = organ.method(method)?;
        let info = simulated_device();
        let mut config = controller_config(&[organ.organ()], method, &info, None);
        set(&mut config, settings)?;
        let owned = Owned::of_blob(organ.blob.clone(), config)?;
        let recorder = record.as_ref().map(|path| {
            let file = File::create(path).map_err(|error| Failure::file(path, &error))?;
            let since =
                SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
            let hashes = vec![organ.blake3.clone()];
            let header = Header::new(organ.organ(), hashes, config, LoopConfig::default(), info, since);
            TickWriter::new(BufWriter::new(file), &header)
                .map_err(|error| Failure::work(format!("{}: {error}", path.display())))
        });
        let recorder = recorder.transpose()?;
        let changing = Changing { state: State::new(), ticks: 0, applied: Applied::default(), recorder };
        Ok(Self { owned, changing: Mutex::new(changing), record })
    }

    /// Starts rendering, from zero force. Returns whether the controller is active; after a fault `reset` is
    /// needed first.
    fn arm(&self) -> bool {
        let mut changing = self.changing();
        changing.applied.arm = true;
        changing.state.arm()
    }

    /// Stops rendering: the next force is zero.
    fn disarm(&self) {
        let mut changing = self.changing();
        changing.applied.disarm = true;
        changing.state.disarm();
    }

    /// Clears a fault; the controller is disarmed.
    fn reset(&self) {
        let mut changing = self.changing();
        changing.applied.reset = true;
        changing.state.reset();
    }

    /// disarmed, active or safe-zero.
    #[getter]
    fn phase(&self) -> &'static str {
        phase_name(self.changing().state.phase())
    }

    /// One tick: the force for the hand now.
    ///
    /// `t_us`: time, us, which must not decrease. `position_m` (3,): position of the tool in the frame of the
    /// model, m, or None without a new sample. `buttons`: one bit a button. `orientation`: quaternion w, x,
    /// y, z of the grip.
    #[pyo3(signature = (t_us, position_m=None, buttons=0, orientation=None))]
    fn tick(
        &self,
        t_us: u64,
        position_m: Option<&Bound<'_, PyAny>>,
        buttons: u32,
        orientation: Option<[f32; 4]>,
    ) -> Result<Command, Failure> {
        let sample = sample(t_us, position_m, buttons, orientation)?;
        let mut changing = self.changing();
        let Changing { state, ticks, applied, recorder } = &mut *changing;
        let command = self.owned.controller().tick(state, t_us, sample.as_ref());
        let (tick, applied) = (*ticks, std::mem::take(applied));
        if let Some(writer) = recorder {
            let device = DeviceState::Homed;
            let record = TickRecord { tick, t_us, sample, device, applied, ..TickRecord::of(&command) };
            writer.write(&record).map_err(|error| self.not_recorded(error))?;
        }
        *ticks += 1;
        Ok(Command(command))
    }

    /// Ends the recording; without one nothing happens.
    fn close(&self) -> Result<(), Failure> {
        match self.changing().recorder.take() {
            Some(writer) => writer.finish(None).map(drop).map_err(|error| self.not_recorded(error)),
            None => Ok(()),
        }
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&self, _exception: &Bound<'_, PyAny>) -> Result<(), Failure> {
        self.close()
    }
}

impl Controller {
    fn changing(&self) -> MutexGuard<'_, Changing> {
        self.changing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn not_recorded(&self, error: impl std::fmt::Display) -> Failure {
        let path = self.record.as_ref().map(|path| path.display().to_string()).unwrap_or_default();
        Failure::work(format!("{path}: {error}; the recording ends here"))
    }
}
