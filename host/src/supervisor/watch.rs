//! State machine that decides when a force may act, without sockets, devices or clocks.
//!
//! The host renders in a session. The session ends when the force is zeroed, by silence or on request. The
//! next one begins when the host sends a tick of it, which it does after its user has reset the fault. A tick
//! of any other session counts only as a heartbeat.

use palpate_core::{Vec3, vec3};

/// State of the watch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Watch {
    limit_ns: u64,
    session: u32,
    /// Whether the host has sent a tick of the session.
    entered: bool,
    /// Send time of the newest tick; `None` while the watch is inactive.
    last_tick_ns: Option<u64>,
    /// Time of the last zero in this silence.
    zeroed_ns: Option<u64>,
}

impl Watch {
    /// A watch that is inactive until the first tick.
    #[must_use]
    pub const fn new(limit_ns: u64) -> Self {
        Self { limit_ns, session: 0, entered: false, last_tick_ns: None, zeroed_ns: None }
    }

    /// The session in which forces are executed.
    #[must_use]
    pub const fn session(&self) -> u32 {
        self.session
    }

    /// Processes a tick and returns the force that may go to the device.
    pub fn tick(&mut self, now_ns: u64, sent_ns: u64, session: u32, force_n: Vec3) -> Vec3 {
        let age_ns = now_ns.saturating_sub(sent_ns);
        (self.last_tick_ns, self.zeroed_ns) = (Some(sent_ns.min(now_ns)), None);
        if session != self.session {
            return vec3::ZERO;
        }
        self.entered = true;
        if age_ns >= self.limit_ns {
            // This process was late, or the host stalled between reading its clock and sending: the position
            // is too old.
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

    /// Deactivates the watch until the next tick.
    pub const fn pause(&mut self) {
        (self.last_tick_ns, self.zeroed_ns) = (None, None);
    }

    /// Time at which the force must be zeroed, or zeroed again, if no tick arrives.
    #[must_use]
    pub fn due_ns(&self) -> Option<u64> {
        self.last_tick_ns
            .map(|last_tick_ns| self.zeroed_ns.unwrap_or(last_tick_ns).saturating_add(self.limit_ns))
    }

    /// Whether it must be zeroed now; this ends the session. It repeats once per limit in a silence, because
    /// a zero can be lost on the line.
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
    fn silence_zeroes_the_force_and_ends_the_session() {
        let mut watch = Watch::new(LIMIT_NS);
        assert!(watch.due_ns().is_none() && !watch.is_overdue(u64::MAX), "inactive before the first tick");
        for ms in 0..100 {
            let now_ns = ms * 1_000_000 + 5;
            assert_eq!(watch.tick(now_ns, now_ns - 5, 0, FORCE_N), FORCE_N);
            assert!(!watch.is_overdue(now_ns));
        }
        assert!(!watch.is_overdue(109 * 1_000_000 - 1));
        let fired: Vec<u64> = (109..140).filter(|ms| watch.is_overdue(ms * 1_000_000)).collect();
        assert_eq!((fired, watch.session()), (vec![109, 119, 129, 139], 1), "one silence ends one session");

        // The host resumes with its old session.
        for ms in 140..200 {
            assert_eq!(watch.tick(ms * 1_000_000, ms * 1_000_000, 0, FORCE_N), vec3::ZERO);
        }
        assert_eq!(
            watch.tick(200_000_000, 200_000_000, 2, FORCE_N),
            vec3::ZERO,
            "a session that does not exist"
        );
        assert_eq!(watch.tick(201_000_000, 201_000_000, 1, FORCE_N), FORCE_N, "after the user's reset");
    }

    #[test]
    fn a_second_silence_before_a_reset_ends_no_other_session() {
        let mut watch = Watch::new(LIMIT_NS);
        watch.tick(0, 0, 0, FORCE_N);
        assert!(watch.is_overdue(LIMIT_NS));
        watch.tick(20_000_000, 20_000_000, 0, FORCE_N);
        assert!(watch.is_overdue(40_000_000));
        watch.latch();
        assert_eq!(watch.session(), 1, "the host may reset the session that was reported");
    }

    #[test]
    fn an_order_that_arrives_late_has_no_force() {
        let mut watch = Watch::new(LIMIT_NS);
        assert_eq!(watch.tick(LIMIT_NS - 1, 0, 0, FORCE_N), FORCE_N);
        assert_eq!(watch.tick(2 * LIMIT_NS, LIMIT_NS, 0, FORCE_N), vec3::ZERO);
        assert_eq!(watch.session(), 1);
        // A clock that is ahead does not extend the limit.
        let mut watch = Watch::new(LIMIT_NS);
        watch.tick(0, u64::MAX, 0, FORCE_N);
        assert!(watch.is_overdue(LIMIT_NS));
    }

    #[test]
    fn the_watch_is_inactive_after_a_stop() {
        let mut watch = Watch::new(LIMIT_NS);
        watch.tick(0, 0, 0, FORCE_N);
        watch.pause();
        assert!(!watch.is_overdue(u64::MAX));
        assert_eq!((watch.session(), watch.due_ns()), (0, None));
    }
}
