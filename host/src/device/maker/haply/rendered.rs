//! Whether the service renders the force that it was sent.
//!
//! An older service ignores a key that it does not know without any error, and the hand feels nothing. The reported force
//! may differ from the commanded one, because the service filters it: only one that is absent, opposite or several times as
//! large is a fault.

use palpate_core::{Vec3, vec3};

/// Smallest commanded force whose absence is judged, N.
const JUDGED_N: f32 = 0.3;
/// Smallest share of the commanded force that is to be reported along it.
const LEAST_SHARE: f32 = 0.1;
/// Largest reported force, as a multiple of the commanded one and beyond that in N.
const LARGEST: (f32, f32) = (3.0, 2.0);
/// Time until it is a fault, ns.
const PATIENCE_NS: u64 = 50_000_000;

/// A force that is not rendered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct NotRendered {
    pub(super) commanded_n: f32,
    pub(super) reported_n: f32,
}

/// The comparison of one reply after another.
#[derive(Debug, Default)]
pub(super) struct Comparison {
    /// Time of the first of the differing replies, ns.
    since_ns: Option<u64>,
}

impl Comparison {
    /// Compares the force of a command with that of the reply to it.
    pub(super) fn judge(&mut self, now_ns: u64, commanded_n: Vec3, reported_n: Vec3) -> Option<NotRendered> {
        let (commanded, reported) = (vec3::norm(commanded_n), vec3::norm(reported_n));
        let along = vec3::dot(commanded_n, reported_n);
        let is_absent = commanded > JUDGED_N && along < LEAST_SHARE * commanded * commanded;
        let is_excess = reported > LARGEST.0 * commanded + LARGEST.1;
        if !is_absent && !is_excess {
            self.since_ns = None;
            return None;
        }
        let since_ns = *self.since_ns.get_or_insert(now_ns);
        let is_fault = now_ns.saturating_sub(since_ns) > PATIENCE_NS;
        if is_fault {
            self.since_ns = None;
        }
        is_fault.then_some(NotRendered { commanded_n: commanded, reported_n: reported })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    /// Milliseconds until the fault.
    fn found_ms(commanded_n: Vec3, reported_n: impl Fn(u64) -> Vec3) -> Option<u64> {
        let mut comparison = Comparison::default();
        (0..200).find(|ms| comparison.judge(ms * MS, commanded_n, reported_n(*ms)).is_some())
    }

    #[test]
    fn a_force_that_is_absent_opposite_or_far_too_large_is_found() {
        let up = [0.0, 0.0, 1.0];
        for wrong in [vec3::ZERO, [0.0, 0.0, -1.0], [0.0, 0.0, 6.0], [1.0, 0.0, 0.05]] {
            assert_eq!(found_ms(up, |_| wrong), Some(51), "{wrong:?}");
        }
        for right in [up, [0.0, 0.0, 0.4], [0.3, 0.3, 0.8], [0.0, 0.0, 3.0]] {
            assert_eq!(found_ms(up, |_| right), None, "{right:?}");
        }
        assert_eq!(found_ms([0.0, 0.0, 0.2], |_| vec3::ZERO), None, "too small to judge");
        assert_eq!(found_ms(vec3::ZERO, |_| [0.0, 2.5, 0.0]), Some(51), "a force of another program");
        let late = |ms: u64| if ms < 40 { vec3::ZERO } else { up };
        assert_eq!(found_ms(up, late), None, "the force comes late");
        let at_times = |ms: u64| if ms.is_multiple_of(20) { up } else { vec3::ZERO };
        assert_eq!(found_ms(up, at_times), None);
    }
}
