//! The memory that a session shares with the process that holds a maker's library.
//!
//! ```text
//! session -- beat of the loop, newest force, resets --> page <-- beat, newest measurement, state -- proxy
//! ```

use crate::device::DeviceState;
use crate::sys::SharedWords;
use crate::sys::latest::{self, Place};
use core::sync::atomic::{AtomicU64, Ordering};
use palpate_core::{Orientation, Vec3};
use palpate_link::DeviceFault;
use std::io;
use std::os::fd::OwnedFd;
use std::sync::Arc;

const LOOP_BEAT: usize = 0;
const RESETS: usize = 1;
const PROXY_BEAT: usize = 2;
const STATE: usize = 3;
const FORCE: Place = Place { state: 4, buffers: 6, len: 3 };
const MEASURED: Place = Place { state: 5, buffers: 15, len: 7 };
const WORDS: usize = 36;

/// Beat of a loop that does not run.
const NOT_RUNNING: u64 = 0;

/// A force for the hand.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Force {
    /// Time of the tick, CLOCK_MONOTONIC, ns.
    pub t_ns: u64,
    /// Device frame, N.
    pub force_n: Vec3,
    /// Whether the loop is armed.
    pub is_armed: bool,
}

/// What the device measured.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Measured {
    /// Time before the device was read, CLOCK_MONOTONIC, ns: the position is no older.
    pub t_ns: u64,
    /// Place of the handle, device frame, m.
    pub position_m: Vec3,
    /// How the grip is turned, device frame.
    pub orientation: Orientation,
    /// Bits of the buttons.
    pub buttons: u32,
    /// The force that the device says it renders, device frame, N; `None` if it says nothing.
    pub rendered_n: Option<Vec3>,
}

/// State of the device as the proxy sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Health {
    /// Its readiness.
    pub state: DeviceState,
    /// The fault that it or the proxy has latched, until a reset.
    pub fault: Option<DeviceFault>,
    /// Number of the latch; that of the last one if none is.
    pub latch: u64,
}

fn pair(low: f32, high: f32) -> u64 {
    u64::from(low.to_bits()) | u64::from(high.to_bits()) << 32
}

fn low(word: u64) -> f32 {
    f32::from_bits(word as u32)
}

fn high(word: u64) -> f32 {
    f32::from_bits((word >> 32) as u32)
}

impl Force {
    fn words(&self) -> [u64; FORCE.len] {
        let [x, y, z] = self.force_n;
        [self.t_ns, pair(x, y), u64::from(z.to_bits()) | u64::from(self.is_armed) << 32]
    }

    fn of_words([t_ns, xy, z]: [u64; FORCE.len]) -> Self {
        Self { t_ns, force_n: [low(xy), high(xy), low(z)], is_armed: z >> 32 != 0 }
    }
}

impl Measured {
    fn words(&self) -> [u64; MEASURED.len] {
        let ([px, py, pz], [x, y, z]) = (self.position_m, self.orientation.xyz);
        let [fx, fy, fz] = self.rendered_n.unwrap_or([f32::NAN; 3]);
        [
            self.t_ns,
            pair(px, py),
            u64::from(self.buttons) << 32 | u64::from(pz.to_bits()),
            pair(self.orientation.w, x),
            pair(y, z),
            pair(fx, fy),
            pair(fz, 0.0),
        ]
    }

    fn of_words([t_ns, xy, zb, wx, yz, f_xy, f_z]: [u64; MEASURED.len]) -> Self {
        let rendered_n = [low(f_xy), high(f_xy), low(f_z)];
        Self {
            t_ns,
            position_m: [low(xy), high(xy), low(zb)],
            orientation: Orientation { w: low(wx), xyz: [high(wx), low(yz), high(yz)] },
            buttons: (zb >> 32) as u32,
            rendered_n: rendered_n[0].is_finite().then_some(rendered_n),
        }
    }
}

impl Health {
    fn word(self) -> u64 {
        let place = |found: Option<usize>| found.map_or(0, |index| index as u64 + 1);
        let state = DeviceState::ALL.iter().position(|state| *state == self.state);
        let fault = self.fault.and_then(|fault| DeviceFault::ALL.iter().position(|of| *of == fault));
        place(state) | place(fault) << 8 | self.latch << 16
    }

    /// Before the proxy has written one, the device is disconnected.
    fn of_word(word: u64) -> Self {
        let at = |byte: u64| usize::try_from(byte & 0xff).unwrap_or(0).checked_sub(1);
        let state = at(word).and_then(|index| DeviceState::ALL.get(index).copied());
        let fault = at(word >> 8).and_then(|index| DeviceFault::ALL.get(index).copied());
        Self { state: state.unwrap_or(DeviceState::Disconnected), fault, latch: word >> 16 }
    }
}

/// The page, from either side. Clones are the same page.
#[derive(Debug, Clone)]
pub(super) struct Page(Arc<SharedWords>);

impl Page {
    /// A page in this process.
    pub(super) fn local() -> Self {
        Self::prepared(SharedWords::local(WORDS))
    }

    /// A page that another process can map, and its descriptor.
    pub(super) fn shared() -> io::Result<(Self, OwnedFd)> {
        let (words, fd) = SharedWords::create(c"palpate-device", WORDS)?;
        Ok((Self::prepared(words), fd))
    }

    /// Maps a page that another process has made.
    pub(super) fn map(fd: &OwnedFd) -> io::Result<Self> {
        SharedWords::map(fd, WORDS).map(|words| Self(Arc::new(words)))
    }

    fn prepared(words: SharedWords) -> Self {
        FORCE.prepare(&words);
        MEASURED.prepare(&words);
        Self(Arc::new(words))
    }

    fn word(&self, index: usize) -> &AtomicU64 {
        &self.0.words()[index]
    }

    /// The session's end.
    pub(super) fn session(self) -> SessionEnd {
        let force = latest::Writer::new(self.0.clone(), FORCE);
        let measured = latest::Reader::new(self.0.clone(), MEASURED);
        SessionEnd { page: self, force, measured }
    }

    /// The proxy's end.
    pub(super) fn proxy(self) -> ProxyEnd {
        let force = latest::Reader::new(self.0.clone(), FORCE);
        let measured = latest::Writer::new(self.0.clone(), MEASURED);
        ProxyEnd { page: self, force, measured }
    }

    /// Time of the loop's last tick, ns; `None` while no loop runs.
    pub(super) fn loop_beat_ns(&self) -> Option<u64> {
        Some(self.word(LOOP_BEAT).load(Ordering::Acquire)).filter(|beat| *beat != NOT_RUNNING)
    }

    /// Number of the newest latch that the user has reset.
    pub(super) fn resets(&self) -> u64 {
        self.word(RESETS).load(Ordering::Acquire)
    }

    /// The state of the device.
    pub(super) fn health(&self) -> Health {
        Health::of_word(self.word(STATE).load(Ordering::Acquire))
    }
}

/// The page as the loop uses it.
#[derive(Debug)]
pub(super) struct SessionEnd {
    page: Page,
    force: latest::Writer,
    measured: latest::Reader,
}

impl SessionEnd {
    /// Notes a tick of the loop with its force.
    pub(super) fn send(&mut self, force: Force) {
        self.force.write(force.words().into_iter());
        self.page.word(LOOP_BEAT).store(force.t_ns.max(1), Ordering::Release);
    }

    /// No loop runs: from now on there is no force.
    pub(super) fn end_loop(&self) {
        self.page.word(LOOP_BEAT).store(NOT_RUNNING, Ordering::Release);
    }

    /// Ends the latch with this number: not one that has come since.
    pub(super) fn reset(&self, latch: u64) {
        self.page.word(RESETS).store(latch, Ordering::Release);
    }

    /// The newest measurement; with the time 0 before the first.
    pub(super) fn measured(&mut self) -> Measured {
        let mut words = [0; MEASURED.len];
        words.iter_mut().zip(self.measured.read()).for_each(|(to, word)| *to = word);
        Measured::of_words(words)
    }

    /// Time of the proxy's last check, ns.
    pub(super) fn proxy_beat_ns(&self) -> u64 {
        self.page.word(PROXY_BEAT).load(Ordering::Acquire)
    }

    /// The state of the device.
    pub(super) fn health(&self) -> Health {
        self.page.health()
    }
}

/// The page as the proxy uses it.
#[derive(Debug)]
pub(super) struct ProxyEnd {
    page: Page,
    force: latest::Reader,
    measured: latest::Writer,
}

impl ProxyEnd {
    /// The newest force; with the time 0 before the first.
    pub(super) fn force(&mut self) -> Force {
        let mut words = [0; FORCE.len];
        words.iter_mut().zip(self.force.read()).for_each(|(to, word)| *to = word);
        Force::of_words(words)
    }

    /// Publishes a measurement.
    pub(super) fn publish(&mut self, measured: &Measured) {
        self.measured.write(measured.words().into_iter());
    }

    /// Notes a check of the proxy, and the state of the device.
    pub(super) fn beat(&self, now_ns: u64, health: Health) {
        self.page.word(STATE).store(health.word(), Ordering::Release);
        self.page.word(PROXY_BEAT).store(now_ns, Ordering::Release);
    }

    pub(super) fn page(&self) -> &Page {
        &self.page
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ends_see_the_newest_values() {
        let (page, fd) = Page::shared().expect("memory");
        let (mut session, mut proxy) = (page.session(), Page::map(&fd).expect("the same").proxy());
        assert_eq!((proxy.force(), proxy.page().loop_beat_ns()), (Force::default(), None));
        let force = Force { t_ns: 7, force_n: [1.0, -2.0, 3.5], is_armed: true };
        session.send(Force { t_ns: 6, force_n: [9.0; 3], is_armed: false });
        session.send(force);
        assert_eq!((proxy.force(), proxy.page().loop_beat_ns()), (force, Some(7)));
        let measured = Measured {
            t_ns: u64::MAX / 3,
            position_m: [0.1, -0.2, 0.3],
            orientation: Orientation { w: 0.5, xyz: [0.5, -0.5, 0.5] },
            buttons: 0x8000_0001,
            rendered_n: Some([0.25, 0.5, -1.0]),
        };
        proxy.publish(&measured);
        assert_eq!(session.measured(), measured);
        proxy.publish(&Measured { rendered_n: None, ..measured });
        assert_eq!(session.measured(), Measured { rendered_n: None, ..measured }, "it says nothing");
        session.end_loop();
        session.reset(7);
        assert_eq!((proxy.page().loop_beat_ns(), proxy.page().resets()), (None, 7));
    }

    #[test]
    fn every_state_and_fault_crosses_the_page() {
        let page = Page::local();
        assert_eq!(page.health(), Health { state: DeviceState::Disconnected, fault: None, latch: 0 });
        let proxy = page.clone().proxy();
        for state in DeviceState::ALL {
            for fault in DeviceFault::ALL.map(Some).into_iter().chain([None]) {
                let health = Health { state, fault, latch: 70_000 };
                proxy.beat(5, health);
                assert_eq!(page.health(), health);
            }
        }
        // A damaged word is a state without a force.
        page.word(STATE).store(u64::MAX, Ordering::Relaxed);
        let Health { state, fault, .. } = page.health();
        assert_eq!((state, fault), (DeviceState::Disconnected, None));
    }
}
