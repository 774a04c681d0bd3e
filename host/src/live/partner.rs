//! Two sessions on one body: each tells the other in every tick where its tool is.
//!
//! The first session makes a few words of shared memory and starts the second one with them. Neither waits for the
//! other. A session that ends or hangs counts as without a touch after [`STALE_NS`], and the force that its tool adds
//! fades like any other change of the jets.

use crate::sys::SharedWords;
use crate::sys::latest;
use crate::vector_form as vector;
use core::sync::atomic::Ordering;
use palpate_core::Vec3;
use serde::{Deserialize, Serialize};
use std::io;
use std::os::fd::OwnedFd;
use std::sync::Arc;

/// Age of what a session has told at which its tool no longer counts, ns.
pub const STALE_NS: u64 = 20_000_000;
/// A tool presses from this force on, N.
pub(super) const PRESSES_N: f32 = 1e-3;

const MAGIC: u64 = u64::from_le_bytes(*b"palptwin");
const WORDS: usize = 5;
/// Whether the second session is ready for its first tick.
const READY: usize = 1;
/// Whether the loop of the first session has ended, and that of the second one.
const ENDED: usize = 2;
const OVER: usize = 3;
const PLACES: [latest::Place; 2] = [
    latest::Place { state: 8, buffers: 24, len: WORDS },
    latest::Place { state: 16, buffers: 24 + 3 * WORDS, len: WORDS },
];
const LEN: usize = 24 + 6 * WORDS;

/// The tool of the other session.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Partner {
    /// Its position, model frame, m.
    #[serde(with = "vector")]
    pub position_m: Vec3,
    /// Its velocity, m/s.
    #[serde(with = "vector")]
    pub velocity_m_s: Vec3,
    /// Whether it presses the body: only then it changes the force.
    pub presses: bool,
}

impl Partner {
    /// Position and velocity, two components a word.
    pub(super) fn words(&self) -> [u64; 3] {
        let ([x, y, z], [vx, vy, vz]) = (self.position_m, self.velocity_m_s);
        [[x, y], [z, vx], [vy, vz]]
            .map(|[low, high]| u64::from(low.to_bits()) | u64::from(high.to_bits()) << 32)
    }

    pub(super) fn of_words(words: [u64; 3], presses: bool) -> Self {
        let halves = words.map(|word| [word as u32, (word >> 32) as u32].map(f32::from_bits));
        let [[x, y], [z, vx], [vy, vz]] = halves;
        Self { position_m: [x, y, z], velocity_m_s: [vx, vy, vz], presses }
    }
}

/// One end of the link between two sessions.
#[derive(Debug)]
pub struct PartnerLink {
    memory: Arc<SharedWords>,
    own: latest::Writer,
    other: latest::Reader,
}

impl PartnerLink {
    /// The end of the first session, and the descriptor for the second one.
    ///
    /// # Errors
    ///
    /// There is no memory.
    pub fn create() -> io::Result<(Self, OwnedFd)> {
        let (memory, fd) = SharedWords::create(c"palpate-partner", LEN)?;
        Ok((Self::first(memory), fd))
    }

    /// The end of the second session.
    ///
    /// # Errors
    ///
    /// The descriptor is not that of a first session ([`io::ErrorKind::InvalidData`]); an error of the system.
    pub fn join(fd: &OwnedFd) -> io::Result<Self> {
        let memory = SharedWords::map(fd, LEN)?;
        if memory.words()[0].load(Ordering::Acquire) != MAGIC {
            return Err(io::ErrorKind::InvalidData.into());
        }
        Ok(Self::end(Arc::new(memory), 1))
    }

    /// Both ends in the memory of this process.
    #[must_use]
    pub fn local() -> [Self; 2] {
        let first = Self::first(SharedWords::local(LEN));
        let second = Self::end(Arc::clone(&first.memory), 1);
        [first, second]
    }

    fn first(memory: SharedWords) -> Self {
        PLACES.iter().for_each(|place| place.prepare(&memory));
        memory.words()[0].store(MAGIC, Ordering::Release);
        Self::end(Arc::new(memory), 0)
    }

    fn end(memory: Arc<SharedWords>, number: usize) -> Self {
        let own = latest::Writer::new(Arc::clone(&memory), PLACES[number]);
        let other = latest::Reader::new(Arc::clone(&memory), PLACES[1 - number]);
        Self { memory, own, other }
    }

    /// Start and end of both sessions, for another thread.
    #[must_use]
    pub fn state(&self) -> LinkState {
        LinkState(Arc::clone(&self.memory))
    }

    /// Tells where the own tool is at a time on CLOCK_MONOTONIC. Wait-free.
    pub fn publish(&mut self, now_ns: u64, tool: &Partner) {
        let head = [now_ns, u64::from(tool.presses)];
        self.own.write(head.into_iter().chain(tool.words()));
    }

    /// The other tool, if its session runs. Wait-free.
    pub fn partner(&mut self, now_ns: u64) -> Option<Partner> {
        let mut words = [0; WORDS];
        words.iter_mut().zip(self.other.read()).for_each(|(word, value)| *word = value);
        let [told_ns, presses, place @ ..] = words;
        let is_fresh = told_ns > 0 && now_ns.saturating_sub(told_ns) < STALE_NS;
        is_fresh.then(|| Partner::of_words(place, presses != 0))
    }
}

/// Start and end of two sessions on one body.
#[derive(Debug, Clone)]
pub struct LinkState(Arc<SharedWords>);

impl LinkState {
    fn set(&self, word: usize) {
        self.0.words()[word].store(1, Ordering::Release);
    }

    fn is_set(&self, word: usize) -> bool {
        self.0.words()[word].load(Ordering::Acquire) != 0
    }

    /// The second session is ready for its first tick.
    pub fn set_ready(&self) {
        self.set(READY);
    }

    /// Whether it is.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.is_set(READY)
    }

    /// The loop of the first session has ended: that of the second one ends too.
    pub fn end(&self) {
        self.set(ENDED);
    }

    /// Whether the loop of the first session has ended.
    pub(super) fn has_ended(&self) -> bool {
        self.is_set(ENDED)
    }

    /// The loop of the second session has ended: nothing stops what it does afterwards.
    pub fn set_over(&self) {
        self.set(OVER);
    }

    /// Whether the loop of the second session has ended.
    pub(super) fn is_over(&self) -> bool {
        self.is_set(OVER)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOOL: Partner =
        Partner { position_m: [0.1, -0.2, 1e-9], velocity_m_s: [-0.0, 3.5, 0.25], presses: true };

    #[test]
    fn each_session_sees_the_tool_of_the_other_one_while_that_runs() {
        let (mut first, fd) = PartnerLink::create().expect("memory");
        let mut second = PartnerLink::join(&fd).expect("the same memory");
        assert!(first.partner(5).is_none() && second.partner(5).is_none() && !first.state().is_ready());
        second.state().set_ready();
        first.state().end();
        second.publish(1_000, &TOOL);
        assert!(first.state().is_ready() && second.state().has_ended() && second.partner(1_000).is_none());
        assert_eq!(first.partner(1_000), Some(TOOL));
        assert_eq!(first.partner(1_000 + STALE_NS - 1), Some(TOOL));
        assert_eq!(first.partner(1_000 + STALE_NS), None, "a session that hangs");
        let free = Partner { presses: false, ..TOOL };
        second.publish(2_000, &free);
        assert_eq!(first.partner(2_000), Some(free));
        let [mut one, mut other] = PartnerLink::local();
        one.publish(7, &TOOL);
        assert_eq!(other.partner(7), Some(TOOL));
    }

    #[test]
    fn other_memory_is_refused() {
        let (_, short) = SharedWords::create(c"palpate-test", 3).expect("memory");
        assert!(PartnerLink::join(&short).is_err());
        let (_, other) = SharedWords::create(c"palpate-test", LEN).expect("memory");
        let refused = PartnerLink::join(&other).expect_err("no first session");
        assert_eq!(refused.kind(), io::ErrorKind::InvalidData);
    }
}
