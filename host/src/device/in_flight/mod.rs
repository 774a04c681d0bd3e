//! Requests in flight: when the next one may be sent, and which request a reply belongs to.
//!
//! One rule for every link ([`InFlight`]): one request at a time, and a request without a reply for 2 ms does not
//! hold up the next. Replies with sequence numbers are assigned by them ([`Numbered`]); without numbers they are
//! assigned in the order of the requests ([`Unnumbered`]).

mod numbered;
mod unnumbered;

pub(super) use numbered::Numbered;
pub(super) use unnumbered::Unnumbered;

/// Time without a reply after which the next request is sent, us.
pub(super) const REPLY_TIMEOUT_US: u64 = 2_000;
/// Number of requests whose send times are kept: at one per 2 ms the oldest is three times as old as the stale
/// limit of 10 ms.
const CAPACITY: usize = 16;

/// The requests of a link.
pub(super) trait InFlight {
    /// Send time of the newest request, if it has no reply.
    fn newest_open_us(&self) -> Option<u64>;

    /// Whether sending waits for the link to become silent.
    fn is_pausing(&self) -> bool {
        false
    }

    /// Whether the newest request has timed out.
    fn is_overdue(&self, now_us: u64) -> bool {
        self.newest_open_us().is_some_and(|sent_us| now_us.saturating_sub(sent_us) >= REPLY_TIMEOUT_US)
    }

    /// Whether the next request may be sent: the newest was answered or has timed out, and nothing pauses.
    fn may_send(&self, now_us: u64) -> bool {
        !self.is_pausing() && (self.newest_open_us().is_none() || self.is_overdue(now_us))
    }
}
