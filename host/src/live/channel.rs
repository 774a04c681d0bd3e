//! The shared memory between the haptic loop and the solver, and its ends.
//!
//! ```text
//! loop (LoopEnd)    -- newest Hand -->          solver (SolverEnd)
//!                   <-- queue of 64 jet frames --
//!                   <-- heartbeat --
//! viewer, summary   <-- newest displacements of the surface, counters --
//! (SolverView)
//! ```
//!
//! The loop waits for nothing: every method of [`LoopEnd`] is wait-free. A full queue makes the solver wait.
//! The solver makes the memory when it knows the size of the surface, and the session checks the first words
//! once before it uses the others.

use super::Frame;
use super::hand::{HAND_WORDS, Hand};
use super::partner::{Partner, PartnerLink};
use super::ring::{self, FRAME_WORDS, RING_FRAMES};
use crate::sys::latest;
use crate::sys::{Ended, SharedWords};
use core::sync::atomic::{AtomicU64, Ordering};
use core::time::Duration;
use palpate_core::{Jet, Solver, Vec3};
use std::io;
use std::os::fd::OwnedFd;
use std::sync::Arc;

/// Age of the heartbeat at which the solver counts as silent, ns.
pub const SILENT_NS: u64 = 100_000_000;
/// Age of the heartbeat at which the solver counts as gone, ns.
pub const GONE_NS: u64 = 500_000_000;

/// Pause of the solver before it tries a full queue again: the loop takes one frame a tick.
const FULL_PAUSE: Duration = Duration::from_micros(300);

const MAGIC: u64 = u64::from_le_bytes(*b"palplive");
/// Version of the layout. Both processes are the same program; a test of another one is refused.
const VERSION: u64 = 2;

/// First words: what both ends agree on.
const FIRST: usize = 0;
/// Heartbeat of the solver: its time, and what it does. Each group has cache lines of its own.
const BEAT: usize = 8;
const WORK: usize = 9;
const COUNTERS: usize = 16;
const SENT: usize = 24;
const TAKEN: usize = 32;
const HAND: latest::Place = latest::Place { state: 40, buffers: 48, len: HAND_WORDS };
const SURFACE_STATE: usize = 48 + (3 * HAND_WORDS).next_multiple_of(8);
const RING: ring::Place = ring::Place { sent: SENT, taken: TAKEN, slots: SURFACE_STATE + 8 };
const SURFACE: usize = RING.slots + ring::Place::SLOT_WORDS;

/// Words of a page: reading one word of each makes all of them present.
const PAGE_WORDS: usize = 512;

/// Most vertices of a surface: beyond it the sizes are damaged.
const MAX_VERTICES: usize = 1 << 24;

/// The displacements: their number, then two components a word.
const fn surface(vertices: usize) -> latest::Place {
    latest::Place { state: SURFACE_STATE, buffers: SURFACE, len: 1 + (3 * vertices).div_ceil(2) }
}

const fn len(vertices: usize) -> usize {
    SURFACE + 3 * surface(vertices).len
}

fn first_words(vertices: usize) -> [u64; 6] {
    [MAGIC, VERSION, FRAME_WORDS as u64, RING_FRAMES as u64, HAND_WORDS as u64, vertices as u64]
}

/// What the solver does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Work {
    /// It waits: everything that the hand heads for is known.
    #[default]
    Idle,
    /// It solves.
    Solving,
}

/// What the solver has done so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Positions solved.
    pub solves: u64,
    /// Time spent on them, ns.
    pub busy_ns: u64,
    /// Positions at which no equilibrium was found.
    pub lost: u64,
}

/// Makes the memory of a surface: the solver's end, and the descriptor for the session. `session` is whether the
/// session has ended.
pub(super) fn create(vertices: usize, session: Ended) -> io::Result<(SolverEnd, OwnedFd)> {
    if vertices > MAX_VERTICES {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    let (memory, fd) = SharedWords::create(c"palpate-live", len(vertices))?;
    prepare(&memory, vertices);
    Ok((SolverEnd::new(Arc::new(memory), vertices, session), fd))
}

/// Maps the memory that the solver has made for a surface. `solver` is whether its process has ended.
///
/// Errors: another version or another surface ([`io::ErrorKind::InvalidData`]); an error of the system.
pub(super) fn join(fd: &OwnedFd, vertices: usize, solver: Ended) -> io::Result<(LoopEnd, SolverView)> {
    if vertices > MAX_VERTICES {
        return Err(io::ErrorKind::InvalidData.into());
    }
    let memory = Arc::new(SharedWords::map(fd, len(vertices))?);
    let words = memory.words();
    let is_agreed = first_words(vertices)
        .iter()
        .zip(&words[FIRST..])
        .all(|(expected, found)| found.load(Ordering::Acquire) == *expected);
    if !is_agreed {
        return Err(io::ErrorKind::InvalidData.into());
    }
    // The loop must not be the first to touch a page.
    words.iter().step_by(PAGE_WORDS).for_each(|word| {
        word.fetch_or(0, Ordering::Relaxed);
    });
    Ok(session_ends(memory, vertices, solver))
}

/// The three ends in the memory of this process, for a solver on a thread.
#[must_use]
pub fn local(vertices: usize) -> (SolverEnd, LoopEnd, SolverView) {
    let memory = Arc::new(SharedWords::local(len(vertices)));
    prepare(&memory, vertices);
    let solver = SolverEnd::new(memory.clone(), vertices, Ended::default());
    let (for_loop, view) = session_ends(memory, vertices, Ended::default());
    (solver, for_loop, view)
}

fn prepare(memory: &SharedWords, vertices: usize) {
    // Every page is present before the loop needs it.
    memory.words().iter().for_each(|word| word.store(0, Ordering::Relaxed));
    HAND.prepare(memory);
    surface(vertices).prepare(memory);
    for (word, value) in memory.words()[FIRST..].iter().zip(first_words(vertices)) {
        word.store(value, Ordering::Release);
    }
}

fn session_ends(memory: Arc<SharedWords>, vertices: usize, solver: Ended) -> (LoopEnd, SolverView) {
    let view = SolverView {
        surface: latest::Reader::new(memory.clone(), surface(vertices)),
        vertices,
        meter: SolverMeter { memory: memory.clone(), ended: solver.clone() },
    };
    let for_loop = LoopEnd {
        partner: None,
        now_ns: 0,
        hand: latest::Writer::new(memory.clone(), HAND),
        jets: ring::Receiver::new(memory.clone(), RING),
        memory,
        ended: solver,
    };
    (for_loop, view)
}

/// State of a solver whose last heartbeat was at `beat_ns`.
fn judge(now_ns: u64, beat_ns: u64, has_ended: bool) -> Solver {
    match now_ns.saturating_sub(beat_ns) {
        _ if has_ended => Solver::Gone,
        GONE_NS.. => Solver::Gone,
        SILENT_NS.. => Solver::Silent,
        _ => Solver::Alive,
    }
}

/// The loop's end. Every method is wait-free.
#[derive(Debug)]
pub struct LoopEnd {
    memory: Arc<SharedWords>,
    hand: latest::Writer,
    jets: ring::Receiver,
    ended: Ended,
    /// The session of another tool on the same body.
    partner: Option<PartnerLink>,
    /// Time of the present tick.
    now_ns: u64,
}

impl LoopEnd {
    /// Copies the next jet frame; `false` if there is none.
    pub fn take(&mut self, frame: &mut Frame) -> bool {
        self.jets.take(frame)
    }

    /// Another session has a tool on the same body.
    #[must_use]
    pub fn with_partner(mut self, link: PartnerLink) -> Self {
        self.partner = Some(link);
        self
    }

    /// The other tool, if its session runs, at a time on CLOCK_MONOTONIC.
    pub fn partner(&mut self, now_ns: u64) -> Option<Partner> {
        self.now_ns = now_ns;
        self.partner.as_mut()?.partner(now_ns)
    }

    /// Tells the solver where the hand is, and the other session.
    pub fn publish(&mut self, hand: &Hand) {
        self.hand.write(hand.words().into_iter());
        if let Some(link) = &mut self.partner {
            let Hand { hip_m: position_m, velocity_m_s, presses, .. } = *hand;
            link.publish(self.now_ns, &Partner { position_m, velocity_m_s, presses });
        }
    }

    /// State of the solver at a time on the clock of its heartbeat, CLOCK_MONOTONIC.
    #[must_use]
    pub fn solver(&self, now_ns: u64) -> Solver {
        judge(now_ns, self.memory.words()[BEAT].load(Ordering::Acquire), self.ended.has_ended())
    }
}

/// The end of the threads that show the session.
#[derive(Debug)]
pub struct SolverView {
    surface: latest::Reader,
    vertices: usize,
    meter: SolverMeter,
}

impl SolverView {
    /// Number of vertices of the surface.
    #[must_use]
    pub const fn vertices(&self) -> usize {
        self.vertices
    }

    /// Copies the newest displacements of the surface, m; their number, which rises with every write of the
    /// solver. 0 before the first: the surface is at rest.
    pub fn surface(&mut self, displacements_m: &mut [Vec3]) -> u64 {
        let mut words = self.surface.read();
        let number = words.next().unwrap_or(0);
        let components = words.flat_map(|word| [word as u32, (word >> 32) as u32]);
        for (component, bits) in displacements_m.as_flattened_mut().iter_mut().zip(components) {
            *component = f32::from_bits(bits);
        }
        number
    }

    /// What the solver does and has done, for a holder of its own.
    #[must_use]
    pub fn meter(&self) -> SolverMeter {
        self.meter.clone()
    }
}

/// What the solver does and has done.
#[derive(Debug, Clone)]
pub struct SolverMeter {
    memory: Arc<SharedWords>,
    ended: Ended,
}

impl SolverMeter {
    /// What the solver does.
    #[must_use]
    pub fn work(&self) -> Work {
        match self.memory.words()[WORK].load(Ordering::Relaxed) {
            0 => Work::Idle,
            _ => Work::Solving,
        }
    }

    /// What the solver has done so far.
    #[must_use]
    pub fn counters(&self) -> Counters {
        let of = |index: usize| self.memory.words()[COUNTERS + index].load(Ordering::Relaxed);
        Counters { solves: of(0), busy_ns: of(1), lost: of(2) }
    }

    /// State of the solver, as [`LoopEnd::solver`].
    #[must_use]
    pub fn solver(&self, now_ns: u64) -> Solver {
        judge(now_ns, self.memory.words()[BEAT].load(Ordering::Acquire), self.ended.has_ended())
    }
}

/// Beats for the solver: from the thread that solves, or from one beside a long solve.
#[derive(Debug, Clone)]
pub struct Heart(Arc<SharedWords>);

impl Heart {
    /// Notes that the solver is alive at this time, CLOCK_MONOTONIC, ns.
    pub fn beat(&self, now_ns: u64) {
        self.0.words()[BEAT].store(now_ns, Ordering::Release);
    }
}

/// The session has ended: nothing that the solver sends arrives any more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SessionEnded;

/// The solver's end.
#[derive(Debug)]
pub struct SolverEnd {
    heart: Heart,
    hand: latest::Reader,
    jets: ring::Sender,
    surface: latest::Writer,
    vertices: usize,
    surfaces: u64,
    session: Ended,
}

impl SolverEnd {
    fn new(memory: Arc<SharedWords>, vertices: usize, session: Ended) -> Self {
        Self {
            hand: latest::Reader::new(memory.clone(), HAND),
            jets: ring::Sender::new(memory.clone(), RING),
            surface: latest::Writer::new(memory.clone(), surface(vertices)),
            heart: Heart(memory),
            vertices,
            surfaces: 0,
            session,
        }
    }

    /// The newest hand; the default before the first tick.
    pub fn hand(&mut self) -> Hand {
        let mut words = [0; HAND_WORDS];
        words.iter_mut().zip(self.hand.read()).for_each(|(word, value)| *word = value);
        Hand::of_words(words)
    }

    /// Sends a jet; `false` if the queue is full.
    #[must_use]
    pub fn try_send(&mut self, jet: &Jet) -> bool {
        self.jets.try_send(&jet.encode())
    }

    /// Sends a jet, and waits while the queue is full. It beats meanwhile.
    ///
    /// # Errors
    ///
    /// The session has ended.
    pub fn send(&mut self, jet: &Jet) -> Result<(), SessionEnded> {
        let frame = jet.encode();
        while !self.jets.try_send(&frame) {
            if self.has_session_ended() {
                return Err(SessionEnded);
            }
            self.heart.beat(crate::sys::monotonic_ns());
            std::thread::sleep(FULL_PAUSE);
        }
        Ok(())
    }

    /// A handle for heartbeats.
    #[must_use]
    pub fn heart(&self) -> Heart {
        self.heart.clone()
    }

    /// Notes what the solver does from now on.
    pub fn set_work(&self, work: Work) {
        let value = u64::from(work == Work::Solving);
        self.word(WORK).store(value, Ordering::Relaxed);
    }

    /// Notes what the solver has done so far.
    pub fn set_counters(&self, counters: Counters) {
        let Counters { solves, busy_ns, lost } = counters;
        for (index, value) in [solves, busy_ns, lost].into_iter().enumerate() {
            self.word(COUNTERS + index).store(value, Ordering::Relaxed);
        }
    }

    /// Shows displacements of the vertices of the surface, m: one for each of [`SolverEnd::vertices`].
    pub fn show(&mut self, displacements_m: &[Vec3]) {
        self.surfaces += 1;
        let components = displacements_m.as_flattened();
        let pairs = components.chunks(2).map(|pair| {
            let bits = |index: usize| u64::from(pair.get(index).copied().unwrap_or(0.0).to_bits());
            bits(0) | bits(1) << 32
        });
        self.surface.write(core::iter::once(self.surfaces).chain(pairs));
    }

    /// Number of vertices of the surface.
    #[must_use]
    pub const fn vertices(&self) -> usize {
        self.vertices
    }

    /// Whether the session has ended.
    #[must_use]
    pub fn has_session_ended(&self) -> bool {
        self.session.has_ended()
    }

    fn word(&self, index: usize) -> &AtomicU64 {
        &self.heart.0.words()[index]
    }
}

#[cfg(test)]
mod tests;
