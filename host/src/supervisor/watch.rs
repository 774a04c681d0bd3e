//! When a force may act: the supervisor's judgement, without sockets, devices or clocks.
//!
//! A session is what the host renders in. It ends when the force is taken away, by silence or on request, and the next one begins when the host
//! sends a tick of it; the host does that after its user has reset the fault. A tick of any other session is a heartbeat and no more.

use palpate_core::{Vec3, vec3};

/// What it knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Watch {
    limit_ns: u64,
    session: u32,
    /// The host has sent a tick of the session.
    entered: bool,
    /// When the newest tick was sent; `None` while nothing is watched.
    heard_ns: Option<u64>,
    /// When the force was last taken away in this silence.
    zeroed_ns: Option<u64>,
}

impl Watch {
    /// Watches nothing before the first tick.
    #[must_use]
    pub const fn new(limit_ns: u64) -> Self {
        Self { limit_ns, session: 0, entered: false, heard_ns: None, zeroed_ns: None }
    }

    /// The session in which a force is obeyed.
    #[must_use]
    pub const fn session(&self) -> u32 {
        self.session
    }

    /// A tick has come: the force that may go to the device.
    pub fn tick(&mut self, now_ns: u64, sent_ns: u64, session: u32, force_n: Vec3) -> Vec3 {
        let age_ns = now_ns.saturating_sub(sent_ns);
        (self.heard_ns, self.zeroed_ns) = (Some(sent_ns.min(now_ns)), None);
        if session != self.session {
            return vec3::ZERO;
        }
        self.entered = true;
        if age_ns >= self.limit_ns {
            // This process was late, or the host was held up between reading its clock and sending: where the hand was then says nothing.
            self.latch();
            return vec3::ZERO;
        }
        force_n
    }

    /// Ends the session, if the host has entered it.
    pub const fn latch(&mut self) {
        if self.entered {
            self.session = self.session.wrapping_add(1);
            self.entered = false;
        }
    }

    /// Nothing is watched until the next tick.
    pub const fn rest(&mut self) {
        (self.heard_ns, self.zeroed_ns) = (None, None);
    }

    /// When the force must be taken away, or once more, if nothing comes.
    #[must_use]
    pub fn due_ns(&self) -> Option<u64> {
        self.heard_ns.map(|heard_ns| self.zeroed_ns.unwrap_or(heard_ns).saturating_add(self.limit_ns))
    }

    /// Whether it must be now; the session is over then. Once a limit in a silence, for a zero may be lost on the line.
    pub fn is_overdue(&mut self, now_ns: u64) -> bool {
        let overdue = self.due_ns().is_some_and(|due_ns| now_ns >= due_ns);
        if overdue {
            self.latch();
            self.zeroed_ns = Some(now_ns);
        }
        overdue
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT_NS: u64 = 10_000_000;
    const FORCE_N: Vec3 = [1.0, 2.0, 3.0];

    #[test]
    fn silence_takes_the_force_away_and_no_tick_of_that_session_brings_it_back() {
        let mut watch = Watch::new(LIMIT_NS);
        assert!(
            watch.due_ns().is_none() && !watch.is_overdue(u64::MAX),
            "nothing to watch before the first tick"
        );
        for ms in 0..100 {
            let now_ns = ms * 1_000_000 + 5;
            assert_eq!(watch.tick(now_ns, now_ns - 5, 0, FORCE_N), FORCE_N);
            assert!(!watch.is_overdue(now_ns));
        }
        assert!(!watch.is_overdue(109 * 1_000_000 - 1));
        let fired: Vec<u64> = (109..140).filter(|ms| watch.is_overdue(ms * 1_000_000)).collect();
        assert_eq!((fired, watch.session()), (vec![109, 119, 129, 139], 1), "one silence ends one session");

        // The host comes back, as if nothing had been.
        for ms in 140..200 {
            assert_eq!(watch.tick(ms * 1_000_000, ms * 1_000_000, 0, FORCE_N), vec3::ZERO);
        }
        assert_eq!(watch.tick(200_000_000, 200_000_000, 2, FORCE_N), vec3::ZERO, "one that never was");
        assert_eq!(watch.tick(201_000_000, 201_000_000, 1, FORCE_N), FORCE_N, "its user has reset it");
    }

    #[test]
    fn a_second_silence_before_a_reset_ends_nothing_more() {
        let mut watch = Watch::new(LIMIT_NS);
        watch.tick(0, 0, 0, FORCE_N);
        assert!(watch.is_overdue(LIMIT_NS));
        watch.tick(20_000_000, 20_000_000, 0, FORCE_N);
        assert!(watch.is_overdue(40_000_000));
        watch.latch();
        assert_eq!(watch.session(), 1, "the host may reset what it was told of");
    }

    #[test]
    fn an_order_that_was_long_on_its_way_is_none() {
        let mut watch = Watch::new(LIMIT_NS);
        assert_eq!(watch.tick(LIMIT_NS - 1, 0, 0, FORCE_N), FORCE_N);
        assert_eq!(watch.tick(2 * LIMIT_NS, LIMIT_NS, 0, FORCE_N), vec3::ZERO);
        assert_eq!(watch.session(), 1);
        // A clock that is ahead buys no time.
        let mut watch = Watch::new(LIMIT_NS);
        watch.tick(0, u64::MAX, 0, FORCE_N);
        assert!(watch.is_overdue(LIMIT_NS));
    }

    #[test]
    fn at_rest_nothing_is_watched() {
        let mut watch = Watch::new(LIMIT_NS);
        watch.tick(0, 0, 0, FORCE_N);
        watch.rest();
        assert!(!watch.is_overdue(u64::MAX));
        assert_eq!((watch.session(), watch.due_ns()), (0, None));
    }
}
