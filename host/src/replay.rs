//! Replays a recording: the very tick of the haptic loop, at the recorded times, with the recorded samples and requests, its forces
//! compared with the recorded ones bit for bit.
//!
//! The loop is driven tick by tick on a virtual clock that is set to each recorded time, so the controller sees the same sequence of
//! (now, sample, requests) as it did, and late and skipped ticks are late and skipped again. Nothing is in real time but a window.
//! The samples are those of the recording whatever force comes out: with another method this is the same stroke under another hand's
//! force, not what that hand would have done.

use crate::device::replay::{Answer, ReplayDevice};
use crate::model::{self, ModelError, TouchMemory};
use crate::recording::{Recording, RecordingError};
use crate::rt::{Clock, Controls, HapticLoop, Outputs, TickRecord, VirtualClock};
use crate::session::{Screen, TouchFigures, View};
use crate::viewer::{Live, ViewerError};
use core::fmt;
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use palpate_core::{Config, Method, Organ, Vec3, vec3};
use std::io::Read;
use std::time::Instant;

/// Why a replay did not come about or did not end well.
#[derive(Debug)]
pub enum ReplayError {
    /// The recording was made with another blob.
    OtherBlob {
        /// BLAKE3 of the recording's.
        recorded: Vec<String>,
        /// Its scene.
        scene: String,
    },
    /// These organs cannot be rendered, or not together, or not with this configuration.
    Model(ModelError),
    /// The recording is damaged.
    Recording(RecordingError),
    /// Nothing to show on, or a frame was not written.
    Viewer(ViewerError),
}

impl fmt::Display for ReplayError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OtherBlob { recorded, scene } => {
                let short: Vec<&str> = recorded.iter().map(|hash| hash.get(..12).unwrap_or(hash)).collect();
                write!(
                    f,
                    "recorded with another blob (scene {scene}, BLAKE3 {}...); replay it with the same, byte for byte and in the same order",
                    short.join("..., ")
                )
            }
            Self::Model(error) => error.fmt(f),
            Self::Recording(error) => error.fmt(f),
            Self::Viewer(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for ReplayError {}

impl From<ModelError> for ReplayError {
    fn from(error: ModelError) -> Self {
        Self::Model(error)
    }
}

impl From<RecordingError> for ReplayError {
    fn from(error: RecordingError) -> Self {
        Self::Recording(error)
    }
}

impl From<ViewerError> for ReplayError {
    fn from(error: ViewerError) -> Self {
        Self::Viewer(error)
    }
}

/// A tick that came out otherwise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    /// Its number.
    pub tick: u64,
    /// Its time, us.
    pub t_us: u64,
    /// Force for the hand as recorded, N.
    pub recorded_n: Vec3,
    /// Force for the hand now, N.
    pub replayed_n: Vec3,
}

impl Difference {
    /// Distance between the two forces, N.
    #[must_use]
    pub fn size_n(&self) -> f32 {
        vec3::distance(self.recorded_n, self.replayed_n)
    }
}

/// What a replay came to.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplaySummary {
    /// Method it was recorded with.
    pub recorded_method: Method,
    /// Method it was replayed with.
    pub method: Method,
    /// Ticks replayed.
    pub ticks: u64,
    /// Those that came out otherwise.
    pub different: u64,
    /// The first of them.
    pub first: Option<Difference>,
    /// The one whose force for the hand is furthest from the recorded one.
    pub largest: Option<Difference>,
    /// Records missing where the replay had to end; 0 if it came to the end.
    pub lost: u64,
    /// Whether the file was cut.
    pub is_cut: bool,
    /// Whether the replay was stopped on its way.
    pub is_stopped: bool,
    /// Forces, displacements, contacts, as replayed.
    pub touch: TouchFigures,
    /// Frames written.
    pub frames_written: u64,
}

impl ReplaySummary {
    /// Whether every tick of the recording was replayed and gave the same bits.
    #[must_use]
    pub const fn is_identical(&self) -> bool {
        self.different == 0 && self.lost == 0 && !self.is_stopped
    }
}

impl fmt::Display for ReplaySummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (ticks, touch) = (self.ticks, &self.touch);
        write!(f, "replay       {ticks} ticks")?;
        match (&self.first, &self.largest) {
            (Some(_), Some(largest)) if self.method != self.recorded_method => write!(
                f,
                ", recorded with {}, replayed with {}: {} differ, by {:.4} N at most (tick {})",
                self.recorded_method.name(),
                self.method.name(),
                self.different,
                largest.size_n(),
                largest.tick
            )?,
            (Some(first), Some(largest)) => write!(
                f,
                ", {} differ, by {:e} N at most; the first is tick {} ({:.3} s): force for the hand {:?} N recorded, {:?} N now",
                self.different,
                largest.size_n(),
                first.tick,
                first.t_us as f64 * 1e-6,
                first.recorded_n,
                first.replayed_n
            )?,
            _ => write!(f, ", all forces bit-identical")?,
        }
        write!(
            f,
            "\ntouch        {} contacts, {:.1} % of the ticks; peak force {:.2} N on the body, {:.2} N for the hand; \
             peak displacement {:.1} mm",
            touch.contacts,
            100.0 * touch.engaged_ticks as f64 / ticks.max(1) as f64,
            touch.peak_reaction_n,
            touch.peak_hand_force_n,
            touch.peak_displacement_m * 1e3
        )?;
        if self.lost > 0 {
            write!(
                f,
                "\nlosses       {} records are missing; what came after them cannot be replayed",
                self.lost
            )?;
        }
        if self.is_cut {
            write!(f, "\nend          the recording was cut here")?;
        }
        if self.is_stopped {
            write!(f, "\nend          stopped before the end of the recording")?;
        }
        if self.frames_written > 0 {
            write!(f, "\nframes       {} written", self.frames_written)?;
        }
        Ok(())
    }
}

/// Replays a recording on organs read from the blobs with these BLAKE3, with the recorded method or another one.
///
/// As fast as the computing goes, frames by recorded time; a window shows it in real time. Of the window's keys only those that look
/// and quit count. `stop` ends it from outside.
pub fn replay<R: Read, const N: usize>(
    organs: &[&Organ<'_, N>],
    blob_blake3: &[String],
    recording: &mut Recording<R>,
    method: Option<Method>,
    view: &View,
    stop: &AtomicBool,
) -> Result<ReplaySummary, ReplayError> {
    let header = recording.header().clone();
    if header.blob_blake3 != blob_blake3 {
        return Err(ReplayError::OtherBlob { recorded: header.blob_blake3, scene: header.scene });
    }
    let config = Config { method: method.unwrap_or(header.config.method), ..header.config };
    let mut memory = TouchMemory::default();
    let controllers = model::controllers(organs, config, &mut memory)?;
    let first = organs[0];
    let mut show = Show::open(organs, &config, view)?;
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let (mut answers, fed) = rtrb::RingBuffer::new(1);
    let (records, mut replayed) = rtrb::RingBuffer::new(1);
    let (latest, _newest) = triple_buffer::triple_buffer(&TickRecord::NOTHING);
    let mut haptic = HapticLoop::of_models(
        &controllers,
        ReplayDevice::new(header.device, fed),
        &clock,
        header.haptic,
        &controls,
        Outputs { records, latest },
    );
    let mut summary = ReplaySummary {
        recorded_method: header.config.method,
        method: config.method,
        ticks: 0,
        different: 0,
        first: None,
        largest: None,
        lost: 0,
        is_cut: false,
        is_stopped: false,
        touch: TouchFigures::default(),
        frames_written: 0,
    };
    while let Some(recorded) = recording.next() {
        let recorded = recorded?;
        summary.lost = recording.lost();
        if summary.lost > 0 {
            break;
        }
        summary.is_stopped = stop.load(Ordering::Relaxed) || show.is_closed();
        if summary.is_stopped {
            break;
        }
        controls.repeat(recorded.applied);
        controls.select(recorded.model);
        let answer = Answer { sample: recorded.sample, state: recorded.device };
        answers.push(answer).expect("every tick takes one");
        let start_ns = recorded.t_us.saturating_mul(1_000);
        clock.wait_until(start_ns, 0);
        haptic
            .tick(recorded.tick, 0, start_ns.saturating_sub(recorded.lateness_ns))
            .expect("the device has an answer for every tick");
        let now = replayed.pop().expect("every tick leaves a record");
        summary.compare(&recorded, &now);
        show.take(
            organs.get(usize::from(now.model)).copied().unwrap_or(first),
            &TickRecord { lateness_ns: recorded.lateness_ns, compute_ns: recorded.compute_ns, ..now },
        )?;
    }
    summary.is_cut = recording.is_cut();
    summary.frames_written = show.screen.frames_written();
    Ok(summary)
}

/// The bits of all that a tick decides.
fn decided(record: &TickRecord) -> impl PartialEq {
    let vectors = [record.hip_m, record.displacement_m, record.reaction_n, record.hand_force_n];
    let shares = record.shares.map(|share| (share.space, share.weight.to_bits()));
    let (work, ramp) = (record.hand_work_j.to_bits(), record.ramp.to_bits());
    let rest = (record.t_us, record.engaged, record.coverage, record.phase, record.clamped);
    (vectors.map(|vector| vector.map(f32::to_bits)), rest, shares, (work, ramp, record.damped, record.model))
}

impl ReplaySummary {
    fn compare(&mut self, recorded: &TickRecord, now: &TickRecord) {
        self.ticks += 1;
        self.touch.take(now);
        if decided(recorded) == decided(now) {
            return;
        }
        self.different += 1;
        let difference = Difference {
            tick: recorded.tick,
            t_us: recorded.t_us,
            recorded_n: recorded.hand_force_n,
            replayed_n: now.hand_force_n,
        };
        self.first.get_or_insert(difference);
        if self.largest.is_none_or(|largest| difference.size_n() > largest.size_n()) {
            self.largest = Some(difference);
        }
    }
}

/// The viewer, and the pace it asks for.
struct Show {
    screen: Screen,
    live: Live,
    pace: Pace,
    /// Keys that would steer a session.
    ignored: Controls,
    closed: AtomicBool,
}

enum Pace {
    Free,
    /// A frame each so many us of recorded time.
    Frames {
        interval_us: u64,
        due_us: u64,
    },
    /// As it was, from here on.
    Real(Instant),
}

impl Show {
    fn open<const N: usize>(
        organs: &[&Organ<'_, N>],
        config: &Config,
        view: &View,
    ) -> Result<Self, ViewerError> {
        let pace = match view {
            View::Nothing => Pace::Free,
            View::Frames { rate_hz, .. } | View::Gif { rate_hz, .. } => {
                Pace::Frames { interval_us: (1e6 / rate_hz.clamp(0.01, 1000.0)) as u64, due_us: 0 }
            }
            View::Window { .. } => Pace::Real(Instant::now()),
        };
        let screen = Screen::open(organs, config, view)?;
        let (live, ignored) = (Live::new(), Controls::default());
        Ok(Self { screen, live, pace, ignored, closed: AtomicBool::new(false) })
    }

    fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Relaxed)
    }

    fn take<const N: usize>(&mut self, organ: &Organ<'_, N>, record: &TickRecord) -> Result<(), ViewerError> {
        self.live.take(record);
        let is_due = match &mut self.pace {
            Pace::Free => false,
            Pace::Frames { interval_us, due_us } => {
                let is_due = record.t_us >= *due_us;
                if is_due {
                    *due_us = record.t_us.saturating_add(*interval_us);
                }
                is_due
            }
            Pace::Real(begun) => {
                std::thread::sleep(Duration::from_micros(record.t_us).saturating_sub(begun.elapsed()));
                self.screen.is_due()
            }
        };
        if is_due {
            self.screen.show(organ, record, &mut self.live, &self.ignored, &self.closed)?;
        }
        Ok(())
    }
}
