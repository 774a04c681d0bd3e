//! Which force goes to the device in this cycle: the newest one of the loop, or zero.
//!
//! A cycle is one exchange with the device, in whatever thread the maker's library gives: [`Exchange::force_n`] before the
//! force is sent, [`Exchange::publish`] with what was measured. The force is zero
//!
//! - while no loop runs, and from its first cycle on after 4 ms without a new force (a late tick);
//! - latched, after 10 ms without one, after 10 ms between two cycles, or after a fault of the device, until the user resets
//!   and the loop has sent a new force.
//!
//! Makers' libraries resume by themselves after some of these. So the latch is ours.

use super::page::{Force, Health, Measured, ProxyEnd};
use crate::device::DeviceState;
use palpate_core::{Vec3, clamp_force, vec3};
use palpate_link::DeviceFault;

/// Age from which on a force is not sent, ns.
const STALE_NS: u64 = 4_000_000;
/// Time without a tick, or without a cycle, that is a fault, ns.
pub const SILENT_NS: u64 = 10_000_000;

/// The proxy's side of the exchange with a device.
#[derive(Debug)]
pub struct Exchange {
    end: ProxyEnd,
    max_force_n: f32,
    state: DeviceState,
    fault: Option<DeviceFault>,
    /// Number of the newest latch.
    latch: u64,
    /// The loop was armed with its newest force.
    is_armed: bool,
    /// Forces up to this time were sent before the last fault, ns.
    old_ns: u64,
    /// Time of the last cycle, ns.
    cycle_ns: Option<u64>,
    /// Forces that were sent, other than zero.
    pub forces: u64,
}

impl Exchange {
    pub(super) fn new(end: ProxyEnd, max_force_n: f32) -> Self {
        let (state, latch) = (DeviceState::Open, 0);
        end.beat(0, Health { state, fault: None, latch });
        Self {
            end,
            max_force_n,
            state,
            fault: None,
            latch,
            is_armed: false,
            old_ns: 0,
            cycle_ns: None,
            forces: 0,
        }
    }

    /// The force for the device in this cycle, device frame, N. `now_ns` is read just before: a call of a library takes its time.
    pub fn force_n(&mut self, now_ns: u64) -> Vec3 {
        if let Some(before_ns) = self.cycle_ns.replace(now_ns)
            && now_ns.saturating_sub(before_ns) >= SILENT_NS
        {
            self.latch(now_ns, DeviceFault::Watchdog);
        }
        self.check_loop(now_ns);
        let Force { t_ns, force_n, is_armed } = self.end.force();
        let is_fresh = now_ns.saturating_sub(t_ns) < STALE_NS && t_ns > self.old_ns;
        let runs = self.end.page().loop_beat_ns().is_some();
        self.is_armed = is_armed && is_fresh && runs;
        let is_wanted = self.is_armed && self.fault.is_none() && self.state == DeviceState::Homed;
        if !is_wanted || !vec3::is_finite(force_n) {
            return vec3::ZERO;
        }
        let (force_n, _) = clamp_force(force_n, self.max_force_n);
        self.forces += u64::from(force_n != vec3::ZERO);
        force_n
    }

    /// Publishes what the device measured in this cycle.
    pub fn publish(&mut self, measured: &Measured) {
        self.end.publish(measured);
    }

    /// The device is ready, or no longer.
    pub fn set_state(&mut self, state: DeviceState) {
        self.state = state;
    }

    /// Whether the loop is armed, and no fault is latched: the motors may be on.
    #[must_use]
    pub const fn is_armed(&self) -> bool {
        self.is_armed && self.fault.is_none()
    }

    /// Latches a fault of the device: zero force until the user's reset.
    pub fn latch(&mut self, now_ns: u64, fault: DeviceFault) {
        self.old_ns = now_ns;
        if self.fault.is_none() {
            self.latch += 1;
        }
        self.fault.get_or_insert(fault);
    }

    /// The loop is silent, or it has reset the fault. Also for the thread beside the cycles. Returns whether it is silent.
    pub fn check_loop(&mut self, now_ns: u64) -> bool {
        let beat_ns = self.end.page().loop_beat_ns();
        let is_silent = beat_ns.is_some_and(|beat_ns| now_ns.saturating_sub(beat_ns) >= SILENT_NS);
        if is_silent {
            self.latch(now_ns, DeviceFault::Watchdog);
        } else if self.fault.is_some() && self.end.page().resets() == self.latch {
            // The loop has sent its force before this, and without knowing of it.
            (self.fault, self.old_ns) = (None, now_ns);
        }
        self.end.beat(now_ns, Health { state: self.state, fault: self.fault, latch: self.latch });
        is_silent
    }

    /// The latched fault.
    #[must_use]
    pub const fn fault(&self) -> Option<DeviceFault> {
        self.fault
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::maker::page::{Page, SessionEnd};

    const MS: u64 = 1_000_000;

    fn ends() -> (SessionEnd, Exchange) {
        let page = Page::local();
        let mut exchange = Exchange::new(page.clone().proxy(), 3.0);
        exchange.set_state(DeviceState::Homed);
        (page.session(), exchange)
    }

    fn force(t_ns: u64, x: f32) -> Force {
        Force { t_ns, force_n: [x, 0.0, 0.0], is_armed: true }
    }

    #[test]
    fn the_newest_force_is_sent_while_it_is_young() {
        let (mut session, mut exchange) = ends();
        assert_eq!(exchange.force_n(MS), vec3::ZERO, "no loop runs");
        session.send(force(2 * MS, 1.0));
        assert_eq!(exchange.force_n(2 * MS + 1), [1.0, 0.0, 0.0]);
        assert_eq!(exchange.force_n(6 * MS - 1), [1.0, 0.0, 0.0]);
        assert_eq!((exchange.force_n(6 * MS), exchange.fault()), (vec3::ZERO, None), "a late tick");
        session.send(force(7 * MS, 9.0));
        let [x, ..] = exchange.force_n(7 * MS);
        assert!(x <= 3.0 && x > 2.999, "the limit: {x}");
        session.send(force(8 * MS, f32::NAN));
        assert_eq!(exchange.force_n(8 * MS), vec3::ZERO);
        session.send(force(9 * MS, 1.0));
        exchange.set_state(DeviceState::Unhomed);
        assert_eq!(exchange.force_n(9 * MS), vec3::ZERO, "not homed");
        exchange.set_state(DeviceState::Homed);
        session.send(force(10 * MS, 1.0));
        session.end_loop();
        assert_eq!((exchange.force_n(10 * MS), exchange.fault()), (vec3::ZERO, None), "the loop has ended");
        assert_eq!(exchange.forces, 3);
    }

    /// A silent loop, a gap between two cycles, and a fault of the device: zero until a reset and a newer force.
    #[test]
    fn a_fault_stays_until_the_reset_and_a_new_force() {
        let silent = |session: &mut SessionEnd, exchange: &mut Exchange| {
            session.send(force(MS, 1.0));
            (MS..=11 * MS).step_by(MS as usize).for_each(|now_ns| {
                exchange.force_n(now_ns);
            });
        };
        let gap = |session: &mut SessionEnd, exchange: &mut Exchange| {
            session.send(force(MS, 1.0));
            exchange.force_n(MS);
            session.send(force(11 * MS, 1.0));
            assert_eq!(exchange.force_n(11 * MS), vec3::ZERO, "the library resumes by itself");
        };
        let of_device = |session: &mut SessionEnd, exchange: &mut Exchange| {
            session.send(force(11 * MS, 1.0));
            exchange.latch(11 * MS, DeviceFault::Hardware);
        };
        for (what, fault, make) in [
            ("silent", DeviceFault::Watchdog, &silent as &dyn Fn(&mut SessionEnd, &mut Exchange)),
            ("gap", DeviceFault::Watchdog, &gap),
            ("device", DeviceFault::Hardware, &of_device),
        ] {
            let (mut session, mut exchange) = ends();
            make(&mut session, &mut exchange);
            assert_eq!(exchange.fault(), Some(fault), "{what}");
            session.send(force(12 * MS, 1.0));
            assert_eq!(exchange.force_n(12 * MS), vec3::ZERO, "{what}: a new force alone");
            assert_eq!(session.health().fault, Some(fault), "{what}");
            session.reset(session.health().latch);
            session.send(force(13 * MS, 2.0));
            assert_eq!(
                exchange.force_n(13 * MS),
                vec3::ZERO,
                "{what}: a force from before the end of the latch"
            );
            session.send(force(14 * MS, 2.0));
            assert_eq!(exchange.force_n(14 * MS), [2.0, 0.0, 0.0], "{what}");
            assert_eq!(session.health().fault, None, "{what}");
        }
        // A force from before the fault does not come back with the reset.
        let (mut session, mut exchange) = ends();
        session.send(force(MS, 1.0));
        exchange.latch(2 * MS, DeviceFault::Overspeed);
        session.reset(1);
        assert_eq!(exchange.force_n(2 * MS), vec3::ZERO);
    }

    /// A latch stays while nobody resets it, and a reset ends only the latch that it names.
    #[test]
    fn a_reset_does_not_end_a_latch_that_comes_after_it() {
        let (mut session, mut exchange) = ends();
        exchange.latch(MS, DeviceFault::Hardware);
        for ms in 2..5_000 {
            session.send(force(ms * MS, 1.0));
            assert_eq!(exchange.force_n(ms * MS), vec3::ZERO, "{ms} ms");
        }
        session.reset(session.health().latch);
        exchange.check_loop(5_000 * MS);
        assert_eq!(exchange.fault(), None);
        // The reset is still in the page when the next fault comes.
        exchange.latch(5_001 * MS, DeviceFault::Overspeed);
        exchange.check_loop(5_001 * MS);
        session.send(force(5_002 * MS, 1.0));
        assert_eq!(exchange.force_n(5_002 * MS), vec3::ZERO);
        assert_eq!(
            session.health(),
            Health { state: DeviceState::Homed, fault: Some(DeviceFault::Overspeed), latch: 2 }
        );
    }

    #[test]
    fn a_loop_that_is_not_armed_has_no_force() {
        let (mut session, mut exchange) = ends();
        session.send(Force { is_armed: false, ..force(MS, 1.0) });
        assert_eq!((exchange.force_n(MS), exchange.is_armed()), (vec3::ZERO, false));
        session.send(force(2 * MS, 1.0));
        assert_eq!((exchange.force_n(2 * MS), exchange.is_armed()), ([1.0, 0.0, 0.0], true));
        assert!(exchange.force_n(7 * MS) == vec3::ZERO && !exchange.is_armed(), "a late tick");
        exchange.latch(8 * MS, DeviceFault::Hardware);
        assert!(!exchange.is_armed());
    }
}
