//! Replays a recording through the haptic loop, at the recorded times and with the recorded samples and
//! requests. The forces are compared with the recorded ones bit for bit.
//!
//! A virtual clock, set to each recorded time, drives the loop tick by tick. The controller receives the same
//! sequence of (now, sample, requests) as in the session; late and skipped ticks are reproduced. Only a
//! window runs in real time. The samples are those of the recording, whatever force is computed: with another
//! method the stroke is the same and the forces differ. The response of the hand to those forces is not
//! modelled.

use crate::error::RecordingError;
use crate::header::Header;
use crate::reader::Recording;
use crate::replay_device::{RecordedReply, ReplayDevice};
use crate::replay_jets::{RecordedLive, ReplayJets};
use core::fmt;
use core::ops::ControlFlow;
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use palpate_core::{Config, Method, Organ, Vec3, vec3};
use palpate_host::live::{Frame, LiveField};
use palpate_host::model::{self, ModelError, TouchMemory};
use palpate_host::rt::{Clock, Controls, HapticLoop, Outputs, TickRecord, VirtualClock};
use palpate_host::session::{Observer, TouchStatistics};
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
    /// A method was named for a live recording, whose organ has no tables.
    Live,
    /// The memory of a live replay could not be made.
    Memory(std::io::Error),
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
            Self::Live => {
                f.write_str("recorded in a live session, which has jets and no tables: name no method")
            }
            Self::Memory(error) => write!(f, "no memory for the jets: {error}"),
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
    pub recorded_method: Option<Method>,
    /// Method of the replay; `None` with the recorded jets.
    pub method: Option<Method>,
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
    /// Number of missing jets at which it ended.
    pub lost_jets: u32,
    /// Whether the file is truncated.
    pub is_cut: bool,
    /// Whether the replay was stopped before the end.
    pub is_stopped: bool,
    /// Replayed forces, displacements and contacts.
    pub touch: TouchStatistics,
}

impl ReplaySummary {
    /// Name of the method of the recording, or `jets`.
    #[must_use]
    pub fn recorded_method_name(&self) -> &'static str {
        name_of(self.recorded_method)
    }

    /// Name of the method of the replay, or `jets`.
    #[must_use]
    pub fn method_name(&self) -> &'static str {
        name_of(self.method)
    }

    /// Whether every tick of the recording was replayed with the same bits.
    #[must_use]
    pub const fn is_identical(&self) -> bool {
        self.different == 0 && self.lost == 0 && self.lost_jets == 0 && !self.is_stopped
    }
}

fn name_of(method: Option<Method>) -> &'static str {
    Config { method, ..Config::live() }.method_name()
}

impl fmt::Display for ReplaySummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (ticks, touch) = (self.ticks, &self.touch);
        write!(f, "replay       {ticks} ticks")?;
        match (&self.first, &self.largest) {
            (Some(_), Some(largest)) if self.method != self.recorded_method => write!(
                f,
                ", recorded with {}, replayed with {}: {} differ, by {:.4} N at most (tick {})",
                self.recorded_method_name(),
                self.method_name(),
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
        write!(f, "\ntouch        {}", touch.in_words(ticks))?;
        if self.lost > 0 {
            write!(
                f,
                "\nlosses       {} records are missing; the ticks after them cannot be replayed",
                self.lost
            )?;
        }
        if self.lost_jets > 0 {
            write!(
                f,
                "\nlosses       {} jets are missing; the ticks after them cannot be replayed",
                self.lost_jets
            )?;
        }
        if self.is_cut {
            write!(f, "\nend          the recording is truncated here")?;
        }
        if self.is_stopped {
            write!(f, "\nend          stopped before the end of the recording")?;
        }
        Ok(())
    }
}

/// Refuses blobs other than the recorded ones, so a caller can check before it opens a screen.
///
/// # Errors
///
/// [`ReplayError::OtherBlob`].
pub fn check_blobs(header: &Header, blob_blake3: &[String]) -> Result<(), ReplayError> {
    if header.blob_blake3 == blob_blake3 {
        return Ok(());
    }
    Err(ReplayError::OtherBlob { recorded: header.blob_blake3.clone(), scene: header.scene.clone() })
}

/// Replays a recording on the organs whose blobs have these BLAKE3 hashes, with the recorded method or
/// another one.
///
/// `observer` receives every replayed record and shows those that `pace` selects. Its requests have no effect
/// except `Break`, which ends the replay, as `stop` does from outside. The times of a shown record are the
/// recorded ones.
///
/// # Errors
///
/// [`ReplayError`]: another blob, a damaged recording, a method for a live one, or organs that the controller
/// refuses.
pub fn replay<R: Read, const N: usize>(
    organs: &[&Organ<'_, N>],
    blob_blake3: &[String],
    recording: &mut Recording<R>,
    method: Option<Method>,
    stop: &AtomicBool,
    observer: &mut impl Observer,
    pace: Pace,
) -> Result<ReplaySummary, ReplayError> {
    let header = recording.header().clone();
    check_blobs(&header, blob_blake3)?;
    if header.is_live() && method.is_some() {
        return Err(ReplayError::Live);
    }
    let config = Config { method: method.or(header.config.method), ..header.config };
    let mut memory = TouchMemory::default();
    let controllers = model::controllers(organs, config, &mut memory)?;
    let mut shown =
        Shown { observer, pace, due_us: 0, started: Instant::now(), ignored: Controls::default() };
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let (mut inputs, replies, jets) = Inputs::new();
    let (records, mut replayed) = rtrb::RingBuffer::new(1);
    let (latest, _newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let (device, outputs) = (ReplayDevice::new(header.device, replies), Outputs { records, latest });
    let mut haptic = match controllers.first() {
        Some(controller) if config.method.is_none() => {
            let jets = LiveField::new(jets).map_err(ReplayError::Memory)?;
            HapticLoop::live(*controller, jets, device, &clock, header.haptic, &controls, outputs)
        }
        _ => HapticLoop::with_models(&controllers, device, &clock, header.haptic, &controls, outputs),
    };
    let mut summary = ReplaySummary::new(header.config.method, config.method);
    let mut is_closed = false;
    while let Some(recorded) = recording.next() {
        let recorded = recorded?;
        (summary.lost, summary.lost_jets) = (recording.lost(), recording.lost_jets());
        if summary.lost > 0 || summary.lost_jets > 0 {
            break;
        }
        summary.is_stopped = is_closed || stop.load(Ordering::Relaxed);
        if summary.is_stopped {
            break;
        }
        controls.repeat(recorded.applied);
        controls.select(recorded.model);
        inputs.feed(&recorded, recording.take_jet(&recorded));
        let start_ns = recorded.t_us.saturating_mul(1_000);
        clock.wait_until(start_ns, 0);
        haptic
            .tick(recorded.tick, 0, start_ns.saturating_sub(recorded.lateness_ns))
            .expect("the device has an reply for every tick");
        let now = replayed.pop().expect("every tick leaves a record");
        summary.compare(&recorded, &now);
        let times = TickRecord { lateness_ns: recorded.lateness_ns, compute_ns: recorded.compute_ns, ..now };
        is_closed = shown.take(&times).is_break();
    }
    summary.is_cut = recording.is_cut();
    Ok(summary)
}

/// What the loop reads in a tick, besides the clock and the requests.
struct Inputs {
    replies: rtrb::Producer<RecordedReply>,
    live: rtrb::Producer<RecordedLive>,
}

impl Inputs {
    fn new() -> (Self, rtrb::Consumer<RecordedReply>, ReplayJets) {
        let (replies, replied) = rtrb::RingBuffer::new(1);
        let (live, fed) = rtrb::RingBuffer::new(1);
        (Self { replies, live }, replied, ReplayJets::new(fed))
    }

    /// Makes the recorded inputs of a tick ready for it.
    fn feed(&mut self, recorded: &TickRecord, frame: Option<Frame>) {
        let reply = RecordedReply { sample: recorded.sample, state: recorded.device };
        self.replies.push(reply).expect("every tick consumes one");
        if let Some(live) = recorded.live {
            let recorded = RecordedLive { frame, solver: live.solver, partner: live.partner };
            // Tables read none of them: the first stays in the queue.
            let _ = self.live.push(recorded);
        }
    }
}

/// When a replay shows a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// Never: at full speed.
    Unseen,
    /// At full speed, once in every interval of recorded time.
    Recorded(Duration),
    /// In real time, whenever the observer is due.
    RealTime,
}

/// The bits of all outputs of a tick.
fn output_bits(record: &TickRecord) -> impl PartialEq {
    let vectors = [record.hip_m, record.displacement_m, record.reaction_n, record.hand_force_n];
    let shares = record.shares.map(|share| (share.space, share.weight.to_bits()));
    let (work, ramp) = (record.hand_work_j.to_bits(), record.ramp.to_bits());
    let rest = (record.t_us, record.engaged, record.coverage, record.phase, record.clamped, record.live);
    (vectors.map(|vector| vector.map(f32::to_bits)), rest, shares, (work, ramp, record.damped, record.model))
}

impl ReplaySummary {
    /// Before the first tick.
    fn new(recorded_method: Option<Method>, method: Option<Method>) -> Self {
        Self {
            recorded_method,
            method,
            ticks: 0,
            different: 0,
            first: None,
            largest: None,
            lost: 0,
            lost_jets: 0,
            is_cut: false,
            is_stopped: false,
            touch: TouchStatistics::default(),
        }
    }

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

/// The observer and when it is shown a record.
struct Shown<'o, O> {
    observer: &'o mut O,
    pace: Pace,
    /// Recorded time of the next picture.
    due_us: u64,
    started: Instant,
    /// Controls whose requests the replay ignores.
    ignored: Controls,
}

impl<O: Observer> Shown<'_, O> {
    fn take(&mut self, record: &TickRecord) -> ControlFlow<()> {
        self.observer.record(record);
        let is_due = match self.pace {
            Pace::Unseen => false,
            Pace::Recorded(interval) => {
                let is_due = record.t_us >= self.due_us;
                if is_due {
                    self.due_us = record.t_us.saturating_add(interval.as_micros() as u64);
                }
                is_due
            }
            Pace::RealTime => {
                let at = Duration::from_micros(record.t_us);
                std::thread::sleep(at.saturating_sub(self.started.elapsed()));
                self.observer.time_to_frame().is_zero()
            }
        };
        if is_due { self.observer.show(record, &self.ignored) } else { ControlFlow::Continue(()) }
    }
}
