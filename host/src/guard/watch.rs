//! Decides when the guard zeroes the force, without processes or devices.

/// State of the watch over the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Watch {
    limit_ns: u64,
    /// Time of the last zero in this silence.
    zeroed_ns: Option<u64>,
    /// Whether the line has not accepted the last zero.
    is_refused: bool,
}

/// Time between two attempts while the line accepts nothing, ns.
const RETRY_NS: u64 = 1_000_000;
/// Checks per limit: how often the guard beats.
const CHECKS_PER_LIMIT: u64 = 4;

/// What to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Action {
    /// Nothing.
    Wait,
    /// The loop has just become silent: close the fence, and zero.
    CloseAndZero,
    /// It is still silent: zero again, because a zero can be lost on the line.
    ZeroAgain,
}

impl Watch {
    /// A watch that acts after `limit_ns` without a beat.
    #[must_use]
    pub(super) const fn new(limit_ns: u64) -> Self {
        Self { limit_ns, zeroed_ns: None, is_refused: false }
    }

    /// Checks the loop's newest beat; `None` while no loop runs.
    #[must_use]
    pub(super) fn check(&self, now_ns: u64, beat_ns: Option<u64>) -> Action {
        let Some(beat_ns) = beat_ns.filter(|beat_ns| now_ns.saturating_sub(*beat_ns) >= self.limit_ns) else {
            return Action::Wait;
        };
        match self.zeroed_ns.filter(|zeroed_ns| *zeroed_ns >= beat_ns) {
            None => Action::CloseAndZero,
            Some(zeroed_ns) if now_ns - zeroed_ns.min(now_ns) >= self.pause_ns() => Action::ZeroAgain,
            Some(_) => Action::Wait,
        }
    }

    const fn pause_ns(&self) -> u64 {
        if self.is_refused { RETRY_NS } else { self.limit_ns }
    }

    /// Notes a zero that was sent, or that the line has refused for now.
    pub(super) const fn note_zero(&mut self, now_ns: u64, is_refused: bool) {
        (self.zeroed_ns, self.is_refused) = (Some(now_ns), is_refused);
    }

    /// Longest time until the next check, ns.
    #[must_use]
    pub(super) fn pause_until_check_ns(&self, now_ns: u64, beat_ns: Option<u64>) -> u64 {
        let regular_ns = self.limit_ns / CHECKS_PER_LIMIT;
        let silence_ns = match beat_ns.map(|beat_ns| beat_ns + self.limit_ns) {
            Some(due_ns) if now_ns < due_ns => due_ns - now_ns,
            Some(_) if self.is_refused => RETRY_NS,
            _ => regular_ns,
        };
        regular_ns.min(silence_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT_NS: u64 = 10_000_000;
    const MS: u64 = 1_000_000;

    #[test]
    fn no_loop_and_a_beating_loop_need_nothing() {
        let watch = Watch::new(LIMIT_NS);
        assert_eq!(watch.check(u64::MAX, None), Action::Wait);
        for ms in 0..1_000 {
            assert_eq!(watch.check(ms * MS + LIMIT_NS - 1, Some(ms * MS)), Action::Wait, "{ms}");
        }
        // A clock that is ahead does not extend the limit by more than its lead.
        assert_eq!(watch.check(5, Some(10)), Action::Wait);
    }

    #[test]
    fn silence_is_zeroed_at_the_limit_and_once_per_limit() {
        let mut watch = Watch::new(LIMIT_NS);
        let mut zeros = Vec::new();
        for ms in 100..=135 {
            match watch.check(ms * MS, Some(100 * MS)) {
                Action::Wait => {}
                action => {
                    zeros.push((ms, action));
                    watch.note_zero(ms * MS, false);
                }
            }
        }
        assert_eq!(zeros, [(110, Action::CloseAndZero), (120, Action::ZeroAgain), (130, Action::ZeroAgain)]);
        // The loop resumes, and stops again: another silence closes the fence again.
        assert_eq!(watch.check(141 * MS, Some(140 * MS)), Action::Wait);
        assert_eq!(watch.check(150 * MS, Some(140 * MS)), Action::CloseAndZero);
    }

    #[test]
    fn a_refused_zero_is_repeated_after_a_millisecond() {
        let mut watch = Watch::new(LIMIT_NS);
        assert_eq!(watch.check(20 * MS, Some(10 * MS)), Action::CloseAndZero);
        watch.note_zero(20 * MS, true);
        assert_eq!(watch.pause_until_check_ns(20 * MS, Some(10 * MS)), RETRY_NS);
        assert_eq!(watch.check(21 * MS, Some(10 * MS)), Action::ZeroAgain);
        watch.note_zero(21 * MS, false);
        assert_eq!(watch.check(30 * MS, Some(10 * MS)), Action::Wait);
        assert_eq!(watch.check(31 * MS, Some(10 * MS)), Action::ZeroAgain);
    }

    #[test]
    fn the_check_comes_when_the_silence_is_complete() {
        let watch = Watch::new(LIMIT_NS);
        assert_eq!(watch.pause_until_check_ns(0, None), LIMIT_NS / 4);
        assert_eq!(watch.pause_until_check_ns(10 * MS, Some(9 * MS)), LIMIT_NS / 4);
        assert_eq!(watch.pause_until_check_ns(18 * MS + 5, Some(9 * MS)), MS - 5);
    }
}
