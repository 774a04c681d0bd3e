//! Input, output and state of a tick.

use crate::guard::fade::Fade;
use crate::guard::limit::StaleWatch;
use crate::guard::passivity::Passivity;
use crate::guard::speed::SpeedWindow;
use crate::method::Coverage;
use crate::num::vec3::{self, Vec3};
use crate::touch::Share;
use crate::touch::contact::Contact;

/// One reading of the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// When it was taken, microseconds on the clock of `now_us`.
    pub t_us: u64,
    /// HIP, model frame, metres.
    pub position_m: Vec3,
    /// One bit per button, 1 while pressed.
    pub buttons: u32,
}

/// Why the force was set to zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Fault {
    /// A position was NaN or infinite.
    NotFinite,
    /// No fresh sample for too long.
    Stale,
    /// The HIP was faster than a hand.
    Overspeed,
    /// The HIP left the workspace.
    Workspace,
    /// An impossible state: time ran backwards, or the engaged space is not in the organ.
    Internal,
    /// The hand got more energy than a passive body can give.
    Energy,
    /// The device is no longer homed or ready.
    NotReady,
    /// The watchdog stopped the force because the loop stood still.
    Watchdog,
}

impl Fault {
    /// Every fault.
    pub const ALL: [Self; 8] = [
        Self::NotFinite,
        Self::Stale,
        Self::Overspeed,
        Self::Workspace,
        Self::Internal,
        Self::Energy,
        Self::NotReady,
        Self::Watchdog,
    ];

    /// The name used in logs and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::NotFinite => "not-finite",
            Self::Stale => "stale",
            Self::Overspeed => "overspeed",
            Self::Workspace => "workspace",
            Self::Internal => "internal",
            Self::Energy => "energy",
            Self::NotReady => "not-ready",
            Self::Watchdog => "watchdog",
        }
    }
}

/// State of the controller as the user sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Phase {
    /// The force is zero until armed.
    Disarmed,
    /// The organ is rendered.
    Active,
    /// The force is zero after a fault, until reset and armed again.
    SafeZero(Fault),
}

/// Result of one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// Force for the hand, newtons: -h, ramped and limited. Finite, and never above the limit.
    pub hand_force_n: Vec3,
    /// h of the model before any limit, newtons; zero without contact.
    pub reaction_n: Vec3,
    /// Displacement of the engaged node, metres; zero without contact.
    pub displacement_m: Vec3,
    /// The HIP that the command refers to: the newest valid one, model frame, metres.
    pub hip_m: Vec3,
    /// Index of the engaged space; the one with the largest weight if there are several.
    pub engaged: Option<u16>,
    /// The engaged spaces and their weights; all weights are 0 without contact.
    pub shares: [Share; 3],
    /// The data behind the reaction; `None` without contact.
    pub coverage: Option<Coverage>,
    /// State of the controller.
    pub phase: Phase,
    /// Whether the reaction exceeded the force limit.
    pub clamped: bool,
    /// Work on the hand since first touch, joules in metres of the device; negative while it presses.
    pub hand_work_j: f32,
    /// Whether the passivity control added damping.
    pub damped: bool,
    /// Share of the force after arming: below 1 during the ramp, 0 while disarmed.
    pub ramp: f32,
}

impl Command {
    /// No contact and no force.
    pub(super) const fn zero(phase: Phase, hip_m: Vec3) -> Self {
        Self {
            hand_force_n: vec3::ZERO,
            reaction_n: vec3::ZERO,
            displacement_m: vec3::ZERO,
            hip_m,
            engaged: None,
            shares: [Share { space: 0, weight: 0.0 }; 3],
            coverage: None,
            phase,
            clamped: false,
            hand_work_j: 0.0,
            damped: false,
            ramp: 0.0,
        }
    }
}

/// Everything that changes from tick to tick.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    pub(super) phase: Phase,
    pub(super) armed_us: Option<u64>,
    pub(super) now_us: Option<u64>,
    pub(super) stale: StaleWatch,
    pub(super) speed: SpeedWindow,
    pub(super) contact: Contact,
    pub(super) passivity: Passivity,
    pub(super) fade: Fade,
    /// The next force comes from another organ.
    pub(super) handed_over: bool,
    pub(super) last: Command,
}

impl Default for State {
    fn default() -> Self {
        Self::new()
    }
}

impl State {
    /// Disarmed.
    pub const fn new() -> Self {
        Self {
            phase: Phase::Disarmed,
            armed_us: None,
            now_us: None,
            stale: StaleWatch::new(0),
            speed: SpeedWindow::new(),
            contact: Contact::new(),
            passivity: Passivity::new(),
            fade: Fade::new(),
            handed_over: false,
            last: Command::zero(Phase::Disarmed, vec3::ZERO),
        }
    }

    /// State of the controller.
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// Starts rendering, without contact and from zero force. Returns whether the controller is active now;
    /// after a fault [`State::reset`] is needed first.
    pub fn arm(&mut self) -> bool {
        if self.phase == Phase::Disarmed {
            self.enter(Phase::Active);
        }
        self.phase == Phase::Active
    }

    /// Stops rendering: the next command is zero. A latched fault remains.
    pub fn disarm(&mut self) {
        if self.phase == Phase::Active {
            self.enter(Phase::Disarmed);
        }
    }

    /// Latches a fault that the controller cannot detect itself. The force is zero from the next command on.
    /// No effect while disarmed.
    pub fn trip(&mut self, fault: Fault) {
        if self.phase == Phase::Active {
            self.enter(Phase::SafeZero(fault));
        }
    }

    /// Announces that the next tick belongs to a controller of another organ: the force makes a smooth
    /// transition.
    ///
    /// A touch continues if the new organ has the same active nodes on the same surface, otherwise it ends.
    pub fn hand_over(&mut self, same_nodes: bool) {
        self.handed_over = true;
        if !same_nodes {
            self.contact.release(self.last.hip_m);
        }
    }

    /// Clears a latched fault and leaves the controller disarmed.
    pub fn reset(&mut self) {
        self.enter(Phase::Disarmed);
    }

    /// Enters a phase and resets all state except the clock and the HIP.
    pub(super) fn enter(&mut self, phase: Phase) {
        *self =
            Self { phase, now_us: self.now_us, last: Command::zero(phase, self.last.hip_m), ..Self::new() };
    }
}
