//! Assigns replies to requests on a link with sequence numbers.

use super::{CAPACITY, InFlight};
use palpate_link::is_newer;

/// Largest initial number. A number is newer than the 0 of a device in a new session if it is ahead by less
/// than 2^31.
const MAX_INITIAL_NUMBER: u32 = 1 << 30;

/// The requests of a session. A reply names the newest request that the device had received, so a late reply
/// has its true age.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::device) struct Numbered {
    /// Number and send time of the last requests, indexed by number.
    sent: [(u32, u64); CAPACITY],
    newest: u32,
    answered: u32,
    /// Time of the last reply, or of the first check of the session.
    last_reply_us: Option<u64>,
}

impl Numbered {
    /// An empty list for a new session. The numbers continue, so that a late reply of the old session matches
    /// no request. They restart before a device that starts at 0 would take them for old ones.
    pub(in crate::device) fn next_session(&self) -> Self {
        let newest = if self.newest < MAX_INITIAL_NUMBER { self.newest } else { 0 };
        Self { newest, answered: newest, ..Self::default() }
    }

    /// Assigns the number of a request that is sent now.
    pub(in crate::device) fn number(&mut self, now_us: u64) -> u32 {
        self.newest = self.newest.wrapping_add(1);
        self.sent[self.newest as usize % CAPACITY] = (self.newest, now_us);
        self.newest
    }

    /// Processes a reply and returns the send time of its request. `None` for a request that was answered,
    /// superseded, dropped or never sent.
    pub(in crate::device) fn answered(&mut self, now_us: u64, seq_echo: u32) -> Option<u64> {
        let sent_us = self.sent_us(seq_echo).filter(|_| is_newer(seq_echo, self.answered))?;
        self.answered = seq_echo;
        self.last_reply_us = Some(now_us);
        Some(sent_us)
    }

    /// Send time of a request of this session, if it is still in the list.
    pub(in crate::device) fn sent_us(&self, number: u32) -> Option<u64> {
        let (stored, sent_us) = self.sent[number as usize % CAPACITY];
        (stored == number).then_some(sent_us)
    }

    /// Time since the last reply, us.
    pub(in crate::device) fn silent_us(&mut self, now_us: u64) -> u64 {
        now_us.saturating_sub(*self.last_reply_us.get_or_insert(now_us))
    }
}

impl InFlight for Numbered {
    fn newest_open_us(&self) -> Option<u64> {
        let (_, sent_us) = self.sent[self.newest as usize % CAPACITY];
        (self.answered != self.newest).then_some(sent_us)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reply_has_the_time_of_its_request_and_counts_once() {
        let mut requests = Numbered::default();
        assert!(requests.may_send(0) && requests.answered(0, 0).is_none(), "0 is not a request");
        assert_eq!(requests.number(0), 1);
        assert!(!requests.may_send(1_000) && requests.may_send(2_000) && requests.is_overdue(2_000));
        assert_eq!(requests.number(2_000), 2);
        // The late reply, the current reply, the late reply again.
        assert_eq!(requests.answered(3_000, 1), Some(0));
        assert!(!requests.may_send(3_000), "the newest is open");
        assert_eq!(requests.answered(3_500, 2), Some(2_000));
        assert_eq!((requests.answered(3_500, 2), requests.answered(3_500, 1)), (None, None));
        assert!(requests.may_send(3_500) && requests.answered(4_000, 3).is_none(), "never sent");
        assert_eq!(requests.silent_us(10_000), 6_500);
    }

    /// A State message does not contain its session.
    #[test]
    fn a_reply_of_an_old_session_is_ignored() {
        let mut requests = Numbered::default();
        requests.number(0);
        requests.number(2_000);
        let mut requests = requests.next_session();
        assert!(requests.may_send(2_000) && !requests.is_overdue(9_000), "nothing is open");
        assert_eq!(requests.number(3_000), 3);
        for old in 0..3 {
            assert_eq!(requests.answered(4_000, old), None, "{old}");
        }
        assert_eq!(requests.answered(4_000, 3), Some(3_000));
        let last = Numbered { newest: MAX_INITIAL_NUMBER, ..Numbered::default() };
        assert_eq!(last.next_session().number(0), 1, "newer than 0");
    }

    #[test]
    fn numbers_wrap_round_and_old_requests_are_dropped() {
        let mut requests = Numbered { newest: u32::MAX - 1, answered: u32::MAX - 1, ..Numbered::default() };
        assert_eq!((requests.number(1), requests.number(2)), (u32::MAX, 0));
        assert_eq!((requests.answered(3, u32::MAX), requests.answered(3, 0)), (Some(1), Some(2)));
        for i in 0..20 {
            requests.number(10 + i);
        }
        assert_eq!((requests.answered(40, 4), requests.answered(40, 5)), (None, Some(14)));
    }
}
