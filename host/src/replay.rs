//! Replays a recording through the haptic loop, at the recorded times and with the recorded samples and
//! requests. The forces are compared with the recorded ones bit for bit.
//!
//! A virtual clock, set to each recorded time, drives the loop tick by tick. The controller receives the same
//! sequence of (now, sample, requests) as in the session; late and skipped ticks are reproduced. Only a
//! window runs in real time. The samples are those of the recording, whatever force is computed: with another
//! method the stroke is the same and the forces differ. The response of the hand to those forces is not
//! modelled.

use crate::device::replay::{RecordedReply, ReplayDevice};
use crate::model::{self, ModelError, TouchMemory};
use crate::recording::{Recording, RecordingError};
use crate::rt::{Clock, Controls, HapticLoop, Outputs, TickRecord, VirtualClock};
use crate::session::{Screen, TouchStatistics, View};
use crate::viewer::{Live, ViewerError};
use core::fmt;
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use palpate_core::{Config, Method, Organ, Vec3, vec3};
use std::io::Read;
use std::time::Instant;

/// Reason why a replay did not start or failed.
#[derive(Debug)]
pub enum ReplayError {
    /// The recording was made with another blob.
    OtherBlob {
        /// BLAKE3 of the recorded blobs.
        recorded: Vec<String>,
        /// Scene of the recorded blobs.
        scene: String,
    },
    /// The controller refuses these organs, their combination or the configuration.
    Model(ModelError),
    /// The recording is damaged.
    Recording(RecordingError),
    /// No display is available, or a frame could not be written.
    Viewer(ViewerError),
}

impl fmt::Display for ReplayError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OtherBlob { recorded, scene } => {
                let short: Vec<&str> = recorded.iter().map(|hash| hash.get(..12).unwrap_or(hash)).collect();
                write!(
                    f,
                    "recorded with another blob (scene {scene}, BLAKE3 {}...); replay it with the same blobs, byte for byte and in the same order",
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

/// A tick whose result differs from the recorded one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    /// Number of the tick.
    pub tick: u64,
    /// Time of the tick, us.
    pub t_us: u64,
    /// Force for the hand as recorded, N.
    pub recorded_n: Vec3,
    /// Replayed force for the hand, N.
    pub replayed_n: Vec3,
}

impl Difference {
    /// Distance between the two forces, N.
    #[must_use]
    pub fn size_n(&self) -> f32 {
        vec3::distance(self.recorded_n, self.replayed_n)
    }
}

/// Summary of a replay.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplaySummary {
    /// Method of the recording.
    pub recorded_method: Method,
    /// Method of the replay.
    pub method: Method,
    /// Ticks replayed.
    pub ticks: u64,
    /// Ticks whose result differs from the recording.
    pub different: u64,
    /// The first such tick.
    pub first: Option<Difference>,
    /// The tick with the largest difference of the force for the hand.
    pub largest: Option<Difference>,
    /// Number of missing records at which the replay ended; 0 if it reached the end.
    pub lost: u64,
    /// Whether the file is truncated.
    pub is_cut: bool,
    /// Whether the replay was stopped before the end.
    pub is_stopped: bool,
    /// Replayed forces, displacements and contacts.
    pub touch: TouchStatistics,
    /// Frames written.
    pub frames_written: u64,
}

impl ReplaySummary {
    /// Whether every tick of the recording was replayed with the same bits.
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
                "\nlosses       {} records are missing; the ticks after them cannot be replayed",
                self.lost
            )?;
        }
        if self.is_cut {
            write!(f, "\nend          the recording is truncated here")?;
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

/// Replays a recording on the organs whose blobs have these BLAKE3 hashes, with the recorded method or
/// another one.
///
/// The replay runs at full speed and takes frames by recorded time; with a window it runs in real time. The
/// window accepts only its view and quit keys. `stop` ends the replay from outside.
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
    let (mut replies, fed) = rtrb::RingBuffer::new(1);
    let (records, mut replayed) = rtrb::RingBuffer::new(1);
    let (latest, _newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let mut haptic = HapticLoop::with_models(
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
        touch: TouchStatistics::default(),
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
        let reply = RecordedReply { sample: recorded.sample, state: recorded.device };
        replies.push(reply).expect("every tick consumes one");
        let start_ns = recorded.t_us.saturating_mul(1_000);
        clock.wait_until(start_ns, 0);
        haptic
            .tick(recorded.tick, 0, start_ns.saturating_sub(recorded.lateness_ns))
            .expect("the device has an reply for every tick");
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

/// The bits of all outputs of a tick.
fn output_bits(record: &TickRecord) -> impl PartialEq {
    let vectors = [record.hip_m, record.displacement_m, record.reaction_n, record.hand_force_n];
    let shares = record.shares.map(|share| (share.space, share.weight.to_bits()));
    let (work, ramp) = (record.hand_work_j.to_bits(), record.ramp.to_bits());
    let rest = (record.t_us, record.engaged, record.coverage, record.phase, record.clamped);
    (vectors.map(|vector| vector.map(f32::to_bits)), rest, shares, (work, ramp, record.damped, record.model))
}

impl ReplaySummary {
    fn compare(&mut self, recorded: &TickRecord, now: &TickRecord) {
        self.ticks += 1;
        self.touch.add(now);
        if output_bits(recorded) == output_bits(now) {
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

/// The viewer and its playback mode.
struct Show {
    screen: Screen,
    live: Live,
    playback: Playback,
    /// Controls whose requests the replay ignores.
    ignored: Controls,
    closed: AtomicBool,
}

enum Playback {
    Free,
    /// One frame per interval of recorded time.
    Frames {
        interval_us: u64,
        due_us: u64,
    },
    /// In real time, from this instant.
    Real(Instant),
}

impl Show {
    fn open<const N: usize>(
        organs: &[&Organ<'_, N>],
        config: &Config,
        view: &View,
    ) -> Result<Self, ViewerError> {
        let playback = match view {
            View::Nothing => Playback::Free,
            View::Frames { rate_hz, .. } | View::Gif { rate_hz, .. } => {
                Playback::Frames { interval_us: (1e6 / rate_hz.clamp(0.01, 1000.0)) as u64, due_us: 0 }
            }
            View::Window { .. } => Playback::Real(Instant::now()),
        };
        let screen = Screen::open(organs, config, view)?;
        let (live, ignored) = (Live::new(), Controls::default());
        Ok(Self { screen, live, playback, ignored, closed: AtomicBool::new(false) })
    }

    fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Relaxed)
    }

    fn take<const N: usize>(&mut self, organ: &Organ<'_, N>, record: &TickRecord) -> Result<(), ViewerError> {
        self.live.push(record);
        let is_due = match &mut self.playback {
            Playback::Free => false,
            Playback::Frames { interval_us, due_us } => {
                let is_due = record.t_us >= *due_us;
                if is_due {
                    *due_us = record.t_us.saturating_add(*interval_us);
                }
                is_due
            }
            Playback::Real(started) => {
                std::thread::sleep(Duration::from_micros(record.t_us).saturating_sub(started.elapsed()));
                self.screen.is_due()
            }
        };
        if is_due {
            self.screen.show(organ, record, &mut self.live, &self.ignored, &self.closed)?;
        }
        Ok(())
    }
}
