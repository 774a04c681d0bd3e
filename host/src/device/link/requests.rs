//! Which answer is for which request, on a link whose answers have numbers.

use palpate_core::link::guard::is_newer;

/// After this long without an answer the next request is sent all the same, us.
pub(super) const REPLY_TIMEOUT_US: u64 = 2_000;
/// Requests that are remembered: at one each 2 ms the oldest is three times the stale limit of 10 ms old.
const REMEMBERED: usize = 16;
/// A number is newer than the 0 of a device in a new session if it is ahead by less than 2^31.
const MOST_AT_START: u32 = 1 << 30;

/// The requests of a session. An answer names the newest request that the device had seen, so that one that is late keeps its true age.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Requests {
    /// Number and time of the last ones, by number.
    sent: [(u32, u64); REMEMBERED],
    newest: u32,
    answered: u32,
    /// When an answer last came, or the session was first looked at.
    heard_us: Option<u64>,
}

impl Requests {
    /// None of these, for a session that begins. The numbers go on, so that a late answer of the old one is an answer to nothing; before a device that
    /// begins at 0 would take them for old ones they begin anew.
    pub(super) fn next_session(&self) -> Self {
        let newest = if self.newest < MOST_AT_START { self.newest } else { 0 };
        Self { newest, answered: newest, ..Self::default() }
    }

    /// The number of the next request, which is sent now.
    pub(super) fn number(&mut self, now_us: u64) -> u32 {
        self.newest = self.newest.wrapping_add(1);
        self.sent[self.newest as usize % REMEMBERED] = (self.newest, now_us);
        self.newest
    }

    /// An answer has come: when its request was sent. Nothing for one that was answered, overtaken or forgotten, or never sent.
    pub(super) fn answered(&mut self, now_us: u64, seq_echo: u32) -> Option<u64> {
        let sent_us = self.sent_us(seq_echo).filter(|_| is_newer(seq_echo, self.answered))?;
        self.answered = seq_echo;
        self.heard_us = Some(now_us);
        Some(sent_us)
    }

    /// When a request of this session was sent, if it is remembered.
    pub(super) fn sent_us(&self, number: u32) -> Option<u64> {
        let (remembered, sent_us) = self.sent[number as usize % REMEMBERED];
        (remembered == number).then_some(sent_us)
    }

    /// Whether the newest request has waited too long.
    pub(super) fn is_overdue(&self, now_us: u64) -> bool {
        let (_, sent_us) = self.sent[self.newest as usize % REMEMBERED];
        self.answered != self.newest && now_us.saturating_sub(sent_us) >= REPLY_TIMEOUT_US
    }

    /// Whether the next request may go: the newest was answered or is given up.
    pub(super) fn may_send(&self, now_us: u64) -> bool {
        self.answered == self.newest || self.is_overdue(now_us)
    }

    /// How long nothing has come, us.
    pub(super) fn silent_us(&mut self, now_us: u64) -> u64 {
        now_us.saturating_sub(*self.heard_us.get_or_insert(now_us))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_as_old_as_its_own_request_and_counts_once() {
        let mut requests = Requests::default();
        assert!(requests.may_send(0) && requests.answered(0, 0).is_none(), "0 is no request");
        assert_eq!(requests.number(0), 1);
        assert!(!requests.may_send(1_000) && requests.may_send(2_000) && requests.is_overdue(2_000));
        assert_eq!(requests.number(2_000), 2);
        // The late one, the present one, the late one again.
        assert_eq!(requests.answered(3_000, 1), Some(0));
        assert!(!requests.may_send(3_000), "the newest is open");
        assert_eq!(requests.answered(3_500, 2), Some(2_000));
        assert_eq!((requests.answered(3_500, 2), requests.answered(3_500, 1)), (None, None));
        assert!(requests.may_send(3_500) && requests.answered(4_000, 3).is_none(), "never sent");
        assert_eq!(requests.silent_us(10_000), 6_500);
    }

    /// A State does not say of which session it is.
    #[test]
    fn an_answer_of_an_old_session_is_none() {
        let mut requests = Requests::default();
        requests.number(0);
        requests.number(2_000);
        let mut requests = requests.next_session();
        assert!(requests.may_send(2_000) && !requests.is_overdue(9_000), "nothing is open");
        assert_eq!(requests.number(3_000), 3);
        for old in 0..3 {
            assert_eq!(requests.answered(4_000, old), None, "{old}");
        }
        assert_eq!(requests.answered(4_000, 3), Some(3_000));
        let last = Requests { newest: MOST_AT_START, ..Requests::default() };
        assert_eq!(last.next_session().number(0), 1, "newer than 0");
    }

    #[test]
    fn numbers_wrap_round_and_old_ones_are_forgotten() {
        let mut requests = Requests { newest: u32::MAX - 1, answered: u32::MAX - 1, ..Requests::default() };
        assert_eq!((requests.number(1), requests.number(2)), (u32::MAX, 0));
        assert_eq!((requests.answered(3, u32::MAX), requests.answered(3, 0)), (Some(1), Some(2)));
        for i in 0..20 {
            requests.number(10 + i);
        }
        assert_eq!((requests.answered(40, 4), requests.answered(40, 5)), (None, Some(14)));
    }
}
