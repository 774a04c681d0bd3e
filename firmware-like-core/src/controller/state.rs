//! Input, output and state of a tick.

use crate::guard::fade::Fade;
use crate::guard::limit::StaleWatch;
use crate::guard::passivity::Passivity;
use crate::guard::speed::SpeedWindow;
use crate::method::Coverage;
use crate::named::named;
use crate::num::orientation::Orientation;
use crate::num::vec3::Vec3;
use crate::touch::NodeWeight;
use crate::touch::contact::Contact;

/// One reading of the device.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sample {
    /// When it was taken, microseconds on the clock of `now_us`.
    pub t_us: u64,
    /// HIP, model frame, metres.
    pub position_m: Vec3,
    /// One bit per button, 1 while pressed.
    pub buttons: u32,
    /// The orientation of the grip; none for a device that measures only a position.
    pub orientation: Orientation,
}

named! {
    /// Why the force was set to zero.
    pub enum Fault {
        /// A position was NaN or infinite, or an orientation no rotation.
        NotFinite = "not-finite",
        /// No fresh sample for too long.
        Stale = "stale",
        /// The HIP was faster than a hand.
        Overspeed = "overspeed",
        /// The HIP left the workspace.
        Workspace = "workspace",
        /// An impossible state: time ran backwards, or the engaged space is not in the organ.
        Internal = "internal",
        /// The hand got more energy than a passive body can give.
        Energy = "energy",
        /// The device is no longer homed or ready.
        NotReady = "not-ready",
        /// The watchdog stopped the force because the loop stood still.
        Watchdog = "watchdog",
        /// The live solver has ended or hangs, and the force has faded out.
        Solver = "solver",
    }
}

/// State of the controller as the user sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Phase {
    /// The force is zero until armed.
    #[default]
    Disarmed,
    /// The organ is rendered.
    Active,
    /// The force is zero after a fault, until reset and armed again.
    SafeZero(Fault),
}

/// Result of one tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Command {
    /// Force for the hand, newtons: -h, ramped, with the compensation of the handle's weight, and limited.
    /// Finite, and never above the limit.
    pub hand_force_n: Vec3,
    /// h of the model before any limit, newtons; zero without contact.
    pub reaction_n: Vec3,
    /// Moment of h about the HIP before any limit, newton metres: what turns a tool with an axis against the body. Zero
    /// without contact, and of a tool without an axis.
    pub reaction_n_m: Vec3,
    /// Displacement of the engaged node, metres; zero without contact.
    pub displacement_m: Vec3,
    /// The HIP that the command refers to: the newest valid one, model frame, metres.
    pub hip_m: Vec3,
    /// Index of the engaged space; the one with the largest weight if there are several.
    pub engaged: Option<u16>,
    /// The engaged spaces and their weights; all weights are 0 without contact.
    pub weights: [NodeWeight; 3],
    /// The data behind the reaction; `None` without contact.
    pub coverage: Option<Coverage>,
    /// State of the controller.
    pub phase: Phase,
    /// Whether the reaction exceeded the force limit.
    pub clamped: bool,
    /// Work on the hand in this touch, joules in metres of the device; negative while it presses.
    pub hand_work_j: f32,
    /// Whether the passivity control added damping.
    pub damped: bool,
    /// Factor of the force after arming: below 1 during the ramp, 0 while disarmed.
    pub ramp: f32,
}

impl Command {
    /// No contact and no force.
    pub(super) fn zero(phase: Phase, hip_m: Vec3) -> Self {
        Self { phase, hip_m, ..Self::default() }
    }
}

/// Everything that changes from tick to tick.
#[derive(Debug, Clone, PartialEq, Default)]
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
    /// The part of the last force that renders the organ.
    pub(super) rendered_n: Vec3,
    /// Share of the weight of the handle that is compensated.
    pub(super) carried: f32,
    /// Factor of the force that keeps the stiffness within the limit.
    pub(super) scale: Option<f32>,
}

impl State {
    /// Disarmed.
    pub fn new() -> Self {
        Self::default()
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
        let last = Command::zero(phase, self.last.hip_m);
        *self = Self { phase, now_us: self.now_us, last, ..Self::default() };
    }
}
