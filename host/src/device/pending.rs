//! Which reply answers which request, on a link whose packets have no numbers.

/// After this long without an answer the next request is sent all the same, us.
const REPLY_TIMEOUT_US: u64 = 2_000;
/// Silence after which requests still open count as lost, us: longer than the pause between two requests, so that a link that is
/// late all the time is not mistaken for one that loses.
const SILENCE_US: u64 = 3_000;
/// Age of a reply from which on it is the link that is late, us: what one lost or late reply makes of those behind it is younger.
const LATE_US: u64 = 5_000;
/// Age of a reply from which on it is of no use, us: such a sample is a fault to the loop. Whoever is so late may also send twice what was asked for once,
/// and what is then taken for the answers to all that is open are those to half of it.
const USELESS_US: u64 = 10_000;
/// On a late link silence lasts longer than the reply was late, us: a link that became late both ways lets the reply through that was on its way, and
/// needs twice as long for the next.
const MORE_SILENCE_US: u64 = 2_000;
/// Longest that silence has to last, us: a link that is later than this cannot be told from one that has lost everything for as long.
const MOST_SILENCE_US: u64 = 50_000;
/// How often a zero goes out in a pause that lasts, us: the one before may have been lost, and whoever disturbs the line may do so without end.
const REPEAT_US: u64 = 6_000;
/// After this long without silence the zero that was taken for arrived is sent again all the same, us: longer than it takes to empty a link that is
/// later than any silence that is waited for.
const DOUBTED_US: u64 = 200_000;
/// Requests without an answer that are remembered. At one each 2 ms the oldest is three times the stale limit of 10 ms old.
pub(super) const MAX_PENDING: usize = 16;

/// Send times of the requests without an answer, oldest first.
///
/// One in the good case. The protocol has no numbers: after a reply that did not come it is not known whether it is lost or late, so its
/// place is kept and the next reply counts for it. Samples may look older than they are, not younger. As soon as a reply leaves
/// others open, sending pauses: either they come too, or there is silence and they were lost.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Pending {
    sent_us: [u64; MAX_PENDING],
    len: usize,
    /// Older ones that found no room: the next replies are theirs, and too old to be of any use.
    forgotten: u32,
    /// When the first of them was sent.
    forgotten_us: u64,
    /// While sending pauses: when something last came.
    pausing_since_us: Option<u64>,
    /// When the pause began.
    paused_us: u64,
    /// How long silence has to last after what came last, if something in this pause was older than a single fault explains.
    late_us: u64,
    /// When the newest request was sent.
    last_us: u64,
    /// Since when nothing but zeros was sent, if the newest was one.
    zeros_us: Option<u64>,
    /// A zero was sent again in this pause.
    repeated: bool,
    /// When a reply came in this pause that must be to one of them: now there can be silence.
    arrived_us: Option<u64>,
}

impl Pending {
    pub(super) fn sent(&mut self, now_us: u64, is_zero: bool) {
        if self.len == MAX_PENDING {
            let oldest_us = self.take_oldest();
            if self.forgotten == 0 {
                self.forgotten_us = oldest_us.unwrap_or(now_us);
            }
            self.forgotten = self.forgotten.saturating_add(1);
        }
        self.sent_us[self.len] = now_us;
        self.len += 1;
        self.last_us = now_us;
        self.zeros_us = if is_zero { self.zeros_us.or(Some(now_us)) } else { None };
    }

    fn take_oldest(&mut self) -> Option<u64> {
        let oldest = self.sent_us.first().copied().filter(|_| self.len > 0)?;
        self.sent_us.rotate_left(1);
        self.len -= 1;
        Some(oldest)
    }

    /// The request after which `newer` others were sent has never left: no reply will be its own.
    pub(super) fn never_left(&mut self, newer: u64) {
        let place = usize::try_from(newer).ok().and_then(|newer| self.len.checked_sub(newer)?.checked_sub(1));
        if let Some(open) = place.and_then(|place| self.sent_us.get_mut(place..self.len)) {
            open.rotate_left(1);
            self.len -= 1;
        }
    }

    /// A reply, or what is left of one, has come: when its request was sent. Nothing if that is not known any more.
    pub(super) fn answered(&mut self, now_us: u64, damaged: bool) -> Option<u64> {
        // The age of one that was forgotten is not known: at most this.
        let first_us = if self.forgotten > 0 { self.forgotten_us } else { self.sent_us[0] };
        let age_us = now_us.saturating_sub(first_us);
        let is_late = self.len > 0 && age_us > LATE_US;
        let late_us = if is_late { (age_us + MORE_SILENCE_US).min(MOST_SILENCE_US) } else { 0 };
        self.late_us = if self.pausing_since_us.is_some() { self.late_us.max(late_us) } else { late_us };
        let is_useless = self.late_us >= USELESS_US + MORE_SILENCE_US;
        let oldest = if let Some(others) = self.forgotten.checked_sub(1) {
            self.forgotten = others;
            self.pause_from(now_us);
            None
        } else {
            let oldest = self.take_oldest();
            if self.len > 0 || damaged || is_useless {
                self.pause_from(now_us);
            } else {
                self.pausing_since_us = None;
            }
            oldest
        };
        // All before a zero are answered, or nothing but zeros went out for longer than anything is on its way.
        let is_to_a_zero = self.zeros_us.is_some_and(|since_us| {
            oldest.is_some_and(|sent_us| sent_us >= since_us)
                || now_us.saturating_sub(since_us) >= MOST_SILENCE_US
        });
        if !damaged && is_to_a_zero {
            self.arrived_us = self.arrived_us.or(Some(now_us));
        }
        // What comes between repeated zeros says that they arrive, and not how old it is: a loop that took it for a sample would flicker.
        let is_trusted = !self.repeated && !is_useless;
        self.repeated &= self.pausing_since_us.is_some();
        oldest.filter(|_| is_trusted)
    }

    const fn pause_from(&mut self, now_us: u64) {
        if self.pausing_since_us.is_none() {
            (self.paused_us, self.repeated, self.arrived_us) = (now_us, false, None);
        }
        self.pausing_since_us = Some(now_us);
    }

    /// Ends the pause after silence; true if it just ended. Not while a zero is repeated: what is on its way then would answer for newer requests.
    pub(super) fn ends_pause(&mut self, now_us: u64) -> bool {
        let silence_us = SILENCE_US.max(self.late_us);
        let is_silent =
            self.pausing_since_us.is_some_and(|since_us| now_us.saturating_sub(since_us) >= silence_us);
        let ends = is_silent && (!self.repeated || self.arrived_us.is_some());
        if ends {
            *self = Self { zeros_us: self.zeros_us, ..Self::default() };
        }
        ends
    }

    /// Whether the newest request has waited too long.
    pub(super) fn is_overdue(&self, now_us: u64) -> bool {
        let newest_us = self.len.checked_sub(1).map(|last| self.sent_us[last]);
        newest_us.is_some_and(|sent_us| now_us.saturating_sub(sent_us) >= REPLY_TIMEOUT_US)
    }

    /// Stops sending until there was silence.
    pub(super) const fn pause(&mut self, now_us: u64) {
        self.pause_from(now_us);
        self.late_us = 0;
    }

    /// Whether a zero may go once more: in a pause that lasts, until a reply says that one has arrived; and again where there is no silence after that.
    pub(super) fn may_repeat_zero(&mut self, now_us: u64) -> bool {
        let since = |us: u64| now_us.saturating_sub(us);
        if self.pausing_since_us.is_none()
            || since(self.paused_us) < REPEAT_US
            || since(self.last_us) < REPEAT_US
            || self.arrived_us.is_some_and(|us| since(us) <= DOUBTED_US)
        {
            return false;
        }
        (self.repeated, self.arrived_us) = (true, None);
        true
    }

    /// Whether the next request may go: nothing is open, or what is open has been given up.
    pub(super) fn may_send(&self, now_us: u64) -> bool {
        self.pausing_since_us.is_none() && (self.len == 0 || self.is_overdue(now_us))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reply_is_as_old_as_its_request() {
        let mut pending = Pending::default();
        assert!(pending.may_send(0));
        pending.sent(0, true);
        assert!(!pending.may_send(1_000), "one at a time");
        assert_eq!(pending.answered(1_500, false), Some(0));
        assert!(pending.may_send(2_000));
    }

    /// The late reply counts for the request that was given up, and the next one for the next.
    #[test]
    fn a_late_reply_is_not_one_to_a_newer_request() {
        let mut pending = Pending::default();
        pending.sent(0, true);
        assert!(pending.is_overdue(2_000) && pending.may_send(2_000));
        pending.sent(2_000, true);
        assert_eq!(pending.answered(3_000, false), Some(0));
        assert!(!pending.may_send(4_500), "another is open: silence first");
        assert_eq!(pending.answered(5_000, false), Some(2_000));
        assert!(pending.may_send(5_000) && pending.answered(6_000, false).is_none());
    }

    /// Without being told, the reply to the last would leave one open for ever, and sending would pause.
    #[test]
    fn what_has_never_left_is_not_waited_for() {
        let sent = |times: &[u64]| {
            let mut pending = Pending::default();
            times.iter().for_each(|us| pending.sent(*us, true));
            pending
        };
        let mut pending = sent(&[0, 2_000, 3_000]);
        pending.never_left(1);
        assert_eq!([pending.answered(3_500, false), pending.answered(3_600, false)], [Some(0), Some(3_000)]);
        assert!(pending.may_send(3_600));
        let mut pending = sent(&[0, 2_000]);
        pending.never_left(0);
        assert_eq!(pending.answered(2_500, false), Some(0));
        assert!(pending.may_send(2_500));
        for long_forgotten in [2, 15, u64::MAX] {
            let mut pending = sent(&[0, 2_000]);
            pending.never_left(long_forgotten);
            assert_eq!(
                [pending.answered(2_500, false), pending.answered(2_600, false)],
                [Some(0), Some(2_000)]
            );
        }
    }

    #[test]
    fn silence_means_that_they_were_lost() {
        let mut pending = Pending::default();
        pending.sent(0, true);
        pending.sent(2_000, true);
        assert_eq!(pending.answered(3_000, false), Some(0));
        assert!(!pending.ends_pause(5_999) && pending.ends_pause(6_000));
        pending.sent(6_000, true);
        assert_eq!(pending.answered(7_000, false), Some(6_000));
        pending.pause(7_000);
        assert!(!pending.may_send(9_000) && pending.ends_pause(10_000));
    }

    /// The link becomes late by 22 ms both ways while a reply is on its way: that one comes after 22 ms, and the next after 44.
    #[test]
    fn a_link_that_became_late_both_ways_is_not_silent_in_between() {
        let mut pending = Pending::default();
        pending.sent(0, true);
        for tick in 1..12 {
            pending.sent(2_000 * tick, true);
        }
        assert_eq!(pending.answered(23_000, false), None, "too old for any use");
        for ms in 24..46 {
            assert!(!pending.ends_pause(1_000 * ms) && !pending.may_send(1_000 * ms), "{ms}");
        }
        assert_eq!(pending.answered(46_000, false), None);
        assert!(!pending.ends_pause(91_999) && pending.ends_pause(92_000), "44 ms late, and no more came");

        // By 36 ms: the first ones are forgotten by then.
        let mut pending = Pending::default();
        for tick in 0..18 {
            pending.sent(2_000 * tick, true);
        }
        assert_eq!(pending.answered(37_000, false), None);
        assert!(!pending.ends_pause(75_000) && pending.ends_pause(76_000));
    }

    /// Requests arrive twice, and replies are 21 ms late: twice as many come as were asked for, and those that are not ours must not pass for the answers to
    /// what is asked next.
    #[test]
    fn twice_the_replies_of_a_late_link_make_none_look_younger() {
        for late_ms in 1..45_u64 {
            let (mut pending, mut last) = (Pending::default(), None);
            // Sent, and when both replies come.
            let mut under_way = std::collections::VecDeque::new();
            for ms in 0..600_u64 {
                let now_us = 1_000 * ms;
                while under_way.front().is_some_and(|(_, due_us)| *due_us <= now_us) {
                    let (sent_us, _) = under_way.pop_front().expect("looked at");
                    let stamp = pending.answered(now_us, false);
                    let passes = |us: u64| now_us - us < USELESS_US;
                    let is_young = stamp.is_some_and(passes) && !passes(sent_us);
                    assert!(!is_young, "{late_ms}: {stamp:?} for {sent_us}");
                    last = stamp.or(last);
                }
                pending.ends_pause(now_us);
                if pending.may_send(now_us) || pending.may_repeat_zero(now_us) {
                    pending.sent(now_us, ms >= 110);
                    let (late_us, copies) = match ms {
                        100..300 => (1_000 * late_ms, 2),
                        _ => (500, 1),
                    };
                    under_way.extend([(now_us, now_us + late_us)].repeat(copies));
                }
            }
            assert!(last > Some(590_000), "{late_ms}: and once it is sound again it is used, not {last:?}");
        }
    }

    /// Somebody talks without a pause while a zero is wanted: it goes out again and again, and once it is answered there is silence.
    #[test]
    fn a_zero_is_repeated_until_it_has_arrived() {
        let mut pending = Pending::default();
        pending.sent(0, false);
        pending.sent(2_000, true);
        pending.answered(2_500, true);
        let mut zeros = Vec::new();
        for ms in 3..200 {
            let now_us = 1_000 * ms;
            pending.answered(now_us, true);
            assert!(!pending.ends_pause(now_us) && !pending.may_send(now_us));
            if pending.may_repeat_zero(now_us) {
                pending.sent(now_us, true);
                zeros.push(ms);
            }
        }
        assert_eq!(zeros[..3], [9, 15, 21]);
        assert!(zeros.windows(2).all(|pair| pair[1] - pair[0] == 6) && zeros.last() > Some(&190));
        // The chatter ends; the zero on its way is answered.
        assert!(!pending.ends_pause(260_000), "until then nobody knows what is on its way");
        pending.sent(260_000, true);
        pending.answered(261_000, false);
        assert!(!pending.may_repeat_zero(270_000));
        assert!(pending.may_send(270_000) || pending.ends_pause(270_000));
    }

    /// Requests are lost, and replies 30 ms late: whatever is repeated meanwhile, no reply counts for a request that was sent after its own.
    #[test]
    fn repeated_zeros_make_no_reply_look_younger() {
        for lost_ms in 1..80 {
            let mut pending = Pending::default();
            // Sent, and when its reply comes.
            let mut under_way = std::collections::VecDeque::new();
            for ms in 0..600_u64 {
                let now_us = 1_000 * ms;
                let is_lost = (100..100 + lost_ms).contains(&ms);
                while under_way.front().is_some_and(|(_, due_us)| *due_us <= now_us) {
                    let (sent_us, _) = under_way.pop_front().expect("looked at");
                    let stamp = pending.answered(now_us, false);
                    assert!(stamp.is_none_or(|us| us <= sent_us), "{lost_ms}: {stamp:?} for {sent_us}");
                }
                pending.ends_pause(now_us);
                if pending.may_send(now_us) || pending.may_repeat_zero(now_us) {
                    pending.sent(now_us, ms >= 100);
                    if !is_lost {
                        let late_us = if ms < 100 { 500 } else { 30_000 };
                        under_way.push_back((now_us, now_us + late_us));
                    }
                }
            }
        }
    }

    /// A link that is late by more than what is remembered: no reply may count for a request that was sent long after its own.
    #[test]
    fn the_oldest_are_forgotten_and_their_replies_count_for_no_other() {
        let mut pending = Pending::default();
        for i in 0..100 {
            pending.sent(i, true);
        }
        for reply in 0..100 {
            let kept = (reply >= 100 - MAX_PENDING as u64).then_some(reply);
            assert_eq!(pending.answered(200 + reply, false), kept);
            assert_eq!(pending.may_send(200 + reply), reply == 99, "{reply}");
        }
        for i in 0..100 {
            pending.sent(300 + i, true);
        }
        assert_eq!(pending.answered(500, false), None);
        assert!(pending.ends_pause(3_500) && pending.may_send(3_500), "lost, all of them");
    }
}
