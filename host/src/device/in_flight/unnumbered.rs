//! Assigns replies to requests on a link whose packets have no sequence numbers.

use super::{CAPACITY, InFlight};

/// Silence after which open requests count as lost, us. It is longer than the pause between two requests, so
/// that a link with constant delay is not mistaken for one with loss.
const SILENCE_US: u64 = 3_000;
/// Age of a reply above which the link itself is delayed, us. One lost or late reply makes the following
/// replies appear younger than this.
const LATE_US: u64 = 5_000;
/// Age of a reply above which it is unusable, us: the loop treats such a sample as a fault. A link with this
/// delay may also duplicate replies, so that the replies to half of the open requests look like replies to
/// all of them.
const UNUSABLE_US: u64 = 10_000;
/// Extra silence required on a delayed link, beyond the delay of the last reply, us. When both directions
/// become delayed, the reply under way still arrives, and the next one takes twice as long.
const EXTRA_SILENCE_US: u64 = 2_000;
/// Longest silence required, us. A link with a longer delay cannot be distinguished from one that has lost
/// all requests.
const MAX_SILENCE_US: u64 = 50_000;
/// Period at which a zero is repeated in a lasting pause, us: the previous one may be lost, and the
/// disturbance of the line may not end.
const REPEAT_PERIOD_US: u64 = 6_000;
/// Time without silence after which an acknowledged zero is sent again, us. It is longer than the largest
/// delay that the pause allows for.
const RECHECK_US: u64 = 200_000;

/// Send times of the requests without a reply, oldest first.
///
/// Normally there is one. The protocol has no numbers: if a reply is missing, it is either lost or late. Its
/// entry is kept and the next reply is assigned to it, so samples may appear older than they are, but not
/// younger. When a reply leaves other requests open, sending pauses until the other replies arrive or a
/// silence shows that they are lost.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::device) struct Unnumbered {
    sent_us: [u64; CAPACITY],
    len: usize,
    /// Number of older requests dropped for lack of room. The next replies belong to them and are too old to
    /// use.
    dropped: u32,
    /// Send time of the first of them.
    dropped_us: u64,
    /// During a pause: time of the last arrival.
    pausing_since_us: Option<u64>,
    /// Start of the pause.
    paused_us: u64,
    /// Silence required after the last arrival, if a reply in this pause was older than a single fault
    /// explains.
    late_us: u64,
    /// Send time of the newest request.
    last_us: u64,
    /// Send time of the first of the newest requests that are all zeros, if the newest is a zero.
    zeros_us: Option<u64>,
    /// Whether a zero was repeated in this pause.
    repeated: bool,
    /// Time of a reply in this pause that must belong to one of these zeros.
    acknowledged_us: Option<u64>,
}

impl Unnumbered {
    pub(in crate::device) fn sent(&mut self, now_us: u64, is_zero: bool) {
        if self.len == CAPACITY {
            let oldest_us = self.take_oldest();
            if self.dropped == 0 {
                self.dropped_us = oldest_us.unwrap_or(now_us);
            }
            self.dropped = self.dropped.saturating_add(1);
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

    /// Removes the request that was sent before the `newer` last ones: it was never transmitted and has no
    /// reply.
    pub(in crate::device) fn not_transmitted(&mut self, newer: u64) {
        let place = usize::try_from(newer).ok().and_then(|newer| self.len.checked_sub(newer)?.checked_sub(1));
        if let Some(open) = place.and_then(|place| self.sent_us.get_mut(place..self.len)) {
            open.rotate_left(1);
            self.len -= 1;
        }
    }

    /// Assigns a reply, or the remains of one, to the oldest request and returns its send time. `None` if
    /// that is unknown or not usable.
    pub(in crate::device) fn answered(&mut self, now_us: u64, damaged: bool) -> Option<u64> {
        // The exact age of a dropped request is unknown; this is an upper bound.
        let first_us = if self.dropped > 0 { self.dropped_us } else { self.sent_us[0] };
        let age_us = now_us.saturating_sub(first_us);
        let is_late = self.len > 0 && age_us > LATE_US;
        let late_us = if is_late { (age_us + EXTRA_SILENCE_US).min(MAX_SILENCE_US) } else { 0 };
        self.late_us = if self.pausing_since_us.is_some() { self.late_us.max(late_us) } else { late_us };
        let is_unusable = self.late_us >= UNUSABLE_US + EXTRA_SILENCE_US;
        let oldest = if let Some(others) = self.dropped.checked_sub(1) {
            self.dropped = others;
            self.pause_from(now_us);
            None
        } else {
            let oldest = self.take_oldest();
            if self.len > 0 || damaged || is_unusable {
                self.pause_from(now_us);
            } else {
                self.pausing_since_us = None;
            }
            oldest
        };
        // All requests before a zero are answered, or only zeros were sent for longer than the largest delay.
        let is_to_a_zero = self.zeros_us.is_some_and(|since_us| {
            oldest.is_some_and(|sent_us| sent_us >= since_us)
                || now_us.saturating_sub(since_us) >= MAX_SILENCE_US
        });
        if !damaged && is_to_a_zero {
            self.acknowledged_us = self.acknowledged_us.or(Some(now_us));
        }
        // A reply between repeated zeros proves that one arrived, but its age is unknown. As a sample it
        // would make the force flicker.
        let is_trusted = !self.repeated && !is_unusable;
        self.repeated &= self.pausing_since_us.is_some();
        oldest.filter(|_| is_trusted)
    }

    const fn pause_from(&mut self, now_us: u64) {
        if self.pausing_since_us.is_none() {
            (self.paused_us, self.repeated, self.acknowledged_us) = (now_us, false, None);
        }
        self.pausing_since_us = Some(now_us);
    }

    /// Ends the pause after silence; true if it just ended. A pause with repeated zeros ends only after one
    /// is acknowledged: otherwise the replies under way would be assigned to newer requests.
    pub(in crate::device) fn ends_pause(&mut self, now_us: u64) -> bool {
        let silence_us = SILENCE_US.max(self.late_us);
        let is_silent =
            self.pausing_since_us.is_some_and(|since_us| now_us.saturating_sub(since_us) >= silence_us);
        let ends = is_silent && (!self.repeated || self.acknowledged_us.is_some());
        if ends {
            *self = Self { zeros_us: self.zeros_us, ..Self::default() };
        }
        ends
    }

    /// Pauses sending until there is silence.
    pub(in crate::device) const fn pause(&mut self, now_us: u64) {
        self.pause_from(now_us);
        self.late_us = 0;
    }

    /// Whether to repeat a zero: in a lasting pause until a reply acknowledges one, and again if no silence
    /// follows.
    pub(in crate::device) fn may_repeat_zero(&mut self, now_us: u64) -> bool {
        let since = |us: u64| now_us.saturating_sub(us);
        if self.pausing_since_us.is_none()
            || since(self.paused_us) < REPEAT_PERIOD_US
            || since(self.last_us) < REPEAT_PERIOD_US
            || self.acknowledged_us.is_some_and(|us| since(us) <= RECHECK_US)
        {
            return false;
        }
        (self.repeated, self.acknowledged_us) = (true, None);
        true
    }
}

impl InFlight for Unnumbered {
    fn newest_open_us(&self) -> Option<u64> {
        self.len.checked_sub(1).map(|last| self.sent_us[last])
    }

    fn is_pausing(&self) -> bool {
        self.pausing_since_us.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reply_has_the_time_of_its_request() {
        let mut pending = Unnumbered::default();
        assert!(pending.may_send(0));
        pending.sent(0, true);
        assert!(!pending.may_send(1_000), "one request at a time");
        assert_eq!(pending.answered(1_500, false), Some(0));
        assert!(pending.may_send(2_000));
    }

    /// The late reply is assigned to the request that timed out, and the next reply to the next request.
    #[test]
    fn a_late_reply_is_not_assigned_to_a_newer_request() {
        let mut pending = Unnumbered::default();
        pending.sent(0, true);
        assert!(pending.is_overdue(2_000) && pending.may_send(2_000));
        pending.sent(2_000, true);
        assert_eq!(pending.answered(3_000, false), Some(0));
        assert!(!pending.may_send(4_500), "another request is open: wait for silence");
        assert_eq!(pending.answered(5_000, false), Some(2_000));
        assert!(pending.may_send(5_000) && pending.answered(6_000, false).is_none());
    }

    /// If the request stayed in the list, the reply to the last one would leave an entry open for ever and
    /// sending would pause.
    #[test]
    fn a_request_that_was_not_transmitted_is_removed() {
        let sent = |times: &[u64]| {
            let mut pending = Unnumbered::default();
            times.iter().for_each(|us| pending.sent(*us, true));
            pending
        };
        let mut pending = sent(&[0, 2_000, 3_000]);
        pending.not_transmitted(1);
        assert_eq!([pending.answered(3_500, false), pending.answered(3_600, false)], [Some(0), Some(3_000)]);
        assert!(pending.may_send(3_600));
        let mut pending = sent(&[0, 2_000]);
        pending.not_transmitted(0);
        assert_eq!(pending.answered(2_500, false), Some(0));
        assert!(pending.may_send(2_500));
        for long_dropped in [2, 15, u64::MAX] {
            let mut pending = sent(&[0, 2_000]);
            pending.not_transmitted(long_dropped);
            assert_eq!(
                [pending.answered(2_500, false), pending.answered(2_600, false)],
                [Some(0), Some(2_000)]
            );
        }
    }

    #[test]
    fn after_silence_open_requests_count_as_lost() {
        let mut pending = Unnumbered::default();
        pending.sent(0, true);
        pending.sent(2_000, true);
        assert_eq!(pending.answered(3_000, false), Some(0));
        assert!(!pending.ends_pause(5_999) && pending.ends_pause(6_000));
        pending.sent(6_000, true);
        assert_eq!(pending.answered(7_000, false), Some(6_000));
        pending.pause(7_000);
        assert!(!pending.may_send(9_000) && pending.ends_pause(10_000));
    }

    /// Both directions become delayed by 22 ms while a reply is under way: it arrives after 22 ms, and the
    /// next after 44 ms.
    #[test]
    fn a_link_with_a_new_delay_in_both_directions_is_not_taken_for_silent() {
        let mut pending = Unnumbered::default();
        pending.sent(0, true);
        for tick in 1..12 {
            pending.sent(2_000 * tick, true);
        }
        assert_eq!(pending.answered(23_000, false), None, "too old to use");
        for ms in 24..46 {
            assert!(!pending.ends_pause(1_000 * ms) && !pending.may_send(1_000 * ms), "{ms}");
        }
        assert_eq!(pending.answered(46_000, false), None);
        assert!(
            !pending.ends_pause(91_999) && pending.ends_pause(92_000),
            "44 ms late, and no further reply"
        );

        // By 36 ms: the first requests are dropped from the list by then.
        let mut pending = Unnumbered::default();
        for tick in 0..18 {
            pending.sent(2_000 * tick, true);
        }
        assert_eq!(pending.answered(37_000, false), None);
        assert!(!pending.ends_pause(75_000) && pending.ends_pause(76_000));
    }

    /// Requests are duplicated and replies are 21 ms late: twice as many replies arrive as were requested.
    /// The surplus must not be assigned to later requests.
    #[test]
    fn duplicated_replies_of_a_late_link_do_not_look_younger() {
        for late_ms in 1..45_u64 {
            let (mut pending, mut last) = (Unnumbered::default(), None);
            // Send time, and arrival times of both replies.
            let mut under_way = std::collections::VecDeque::new();
            for ms in 0..600_u64 {
                let now_us = 1_000 * ms;
                while under_way.front().is_some_and(|(_, due_us)| *due_us <= now_us) {
                    let (sent_us, _) = under_way.pop_front().expect("looked at");
                    let stamp = pending.answered(now_us, false);
                    let passes = |us: u64| now_us - us < UNUSABLE_US;
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
            assert!(last > Some(590_000), "{late_ms}: after the fault the link is used again, not {last:?}");
        }
    }

    /// Another process writes without pause while a zero is required: the zero is repeated until it is
    /// acknowledged. Then silence can follow.
    #[test]
    fn a_zero_is_repeated_until_it_is_acknowledged() {
        let mut pending = Unnumbered::default();
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
        // The disturbance ends; the zero under way is answered.
        assert!(!pending.ends_pause(260_000), "before that, the requests under way are unknown");
        pending.sent(260_000, true);
        pending.answered(261_000, false);
        assert!(!pending.may_repeat_zero(270_000));
        assert!(pending.may_send(270_000) || pending.ends_pause(270_000));
    }

    /// Requests are lost and replies are 30 ms late. In spite of repeated zeros, no reply is assigned to a
    /// request sent after its own.
    #[test]
    fn repeated_zeros_do_not_make_a_reply_look_younger() {
        for lost_ms in 1..80 {
            let mut pending = Unnumbered::default();
            // Send time, and arrival time of the reply.
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

    /// The delay exceeds the capacity of the list: no reply is assigned to a request sent long after its own.
    #[test]
    fn replies_to_dropped_requests_are_not_assigned_to_others() {
        let mut pending = Unnumbered::default();
        for i in 0..100 {
            pending.sent(i, true);
        }
        for reply in 0..100 {
            let kept = (reply >= 100 - CAPACITY as u64).then_some(reply);
            assert_eq!(pending.answered(200 + reply, false), kept);
            assert_eq!(pending.may_send(200 + reply), reply == 99, "{reply}");
        }
        for i in 0..100 {
            pending.sent(300 + i, true);
        }
        assert_eq!(pending.answered(500, false), None);
        assert!(pending.ends_pause(3_500) && pending.may_send(3_500), "all lost");
    }
}
