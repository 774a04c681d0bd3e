//! One tick of the haptic loop: (config, &mut state, now, sample) -> command.
//!
//! Time is an argument, nothing is allocated, locked or called, every loop is bounded, and whatever comes in, the command is
//! finite and its force within the limit. A fault is latched: zero at once, past the slew limit, until
//! [`State::reset`] and [`State::arm`]. Zero is always safe; going on with a wrong force is not.

use crate::blob::Organ;
use crate::contact::{Contact, ContactConfig};
use crate::limit::{self, Freshness, LimitConfig, StaleWatch};
use crate::method::{Coverage, ForceSample, Method};
use crate::profile::PC_SPACES;
use crate::speed::SpeedWindow;
use crate::stiffness;
use crate::table::Space;
use crate::vec3::{self, Vec3};

/// Longest time one tick counts for in the slew limit: a late tick must not buy a large step.
const MAX_SLEW_TIME_US: u64 = 2_000;

/// What stays the same during a session.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Config {
    /// Interpolation method.
    pub method: Method,
    /// When contact begins and ends.
    pub contact: ContactConfig,
    /// Limits of the force and of the motion.
    pub limits: LimitConfig,
}

impl Config {
    /// A method with the default contact and limits.
    pub fn new(method: Method) -> Self {
        Self { method, contact: ContactConfig::default(), limits: LimitConfig::default() }
    }
}

/// One reading of the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// When it was taken, on the clock that gives the tick its `now_us`.
    pub t_us: u64,
    /// HIP, model frame, metres.
    pub position_m: Vec3,
    /// One bit per button, 1 while pressed.
    pub buttons: u32,
}

/// Why the force was taken away.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Fault {
    /// A position that is NaN or infinite.
    NotFinite,
    /// No fresh sample for too long.
    Stale,
    /// The HIP moved faster than a hand.
    Overspeed,
    /// The HIP left the workspace.
    Workspace,
    /// Something that cannot happen: time ran backwards, or the engaged space is not in the organ.
    Internal,
}

impl Fault {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::NotFinite, Self::Stale, Self::Overspeed, Self::Workspace, Self::Internal];

    /// The name used in logs and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::NotFinite => "not-finite",
            Self::Stale => "stale",
            Self::Overspeed => "overspeed",
            Self::Workspace => "workspace",
            Self::Internal => "internal",
        }
    }
}

/// What the controller is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Phase {
    /// Force zero until armed.
    Disarmed,
    /// Rendering.
    Active,
    /// Force zero after a fault, until reset and armed again.
    SafeZero(Fault),
}

/// Result of one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// Force for the hand: -h, ramped and limited. Finite, and never above the limit.
    pub hand_force_n: Vec3,
    /// h of the model before any limit; zero when free.
    pub reaction_n: Vec3,
    /// Displacement of the engaged node; zero when free.
    pub displacement_m: Vec3,
    /// The HIP this stands on: the newest valid one.
    pub hip_m: Vec3,
    /// Index of the engaged space.
    pub engaged: Option<u16>,
    /// Data behind the reaction; `None` when free.
    pub coverage: Option<Coverage>,
    /// What the controller is doing.
    pub phase: Phase,
    /// Whether the reaction was beyond the force limit.
    pub clamped: bool,
}

impl Command {
    /// No touch, no force.
    const fn zero(phase: Phase, hip_m: Vec3) -> Self {
        Self {
            hand_force_n: vec3::ZERO,
            reaction_n: vec3::ZERO,
            displacement_m: vec3::ZERO,
            hip_m,
            engaged: None,
            coverage: None,
            phase,
            clamped: false,
        }
    }
}

/// Everything that changes from tick to tick.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    phase: Phase,
    armed_us: Option<u64>,
    now_us: Option<u64>,
    stale: StaleWatch,
    speed: SpeedWindow,
    contact: Contact,
    last: Command,
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
            last: Command::zero(Phase::Disarmed, vec3::ZERO),
        }
    }

    /// What the controller is doing.
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// Starts rendering, from free and zero force. True if active now; a latched fault needs [`State::reset`] first.
    pub fn arm(&mut self) -> bool {
        if self.phase == Phase::Disarmed {
            self.leave(Phase::Active);
        }
        self.phase == Phase::Active
    }

    /// Stops rendering: the next command is zero. A latched fault stays.
    pub fn disarm(&mut self) {
        if self.phase == Phase::Active {
            self.leave(Phase::Disarmed);
        }
    }

    /// Clears a latched fault. Leaves the controller disarmed.
    pub fn reset(&mut self) {
        self.leave(Phase::Disarmed);
    }

    /// Into a phase with nothing left of the one before but the clock and the HIP.
    fn leave(&mut self, phase: Phase) {
        *self =
            Self { phase, now_us: self.now_us, last: Command::zero(phase, self.last.hip_m), ..Self::new() };
    }
}

/// Why a controller was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ControllerError {
    /// The blob lacks the tables of the method for a space.
    MissingMethod {
        /// The method.
        method: Method,
        /// Index of the space.
        space: u16,
    },
    /// A number in the configuration is not finite or not positive.
    Config {
        /// The field.
        what: &'static str,
    },
}

impl core::fmt::Display for ControllerError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::MissingMethod { method, space } => {
                let name = method.name();
                write!(f, "space {space} has no table for {name}: pack the blob with --method {name}")
            }
            Self::Config { what } => write!(f, "{what} must be a finite number above zero"),
        }
    }
}

impl core::error::Error for ControllerError {}

/// An organ and how to render it.
#[derive(Debug, Clone, Copy)]
pub struct Controller<'o, 'a, const N: usize = PC_SPACES> {
    organ: &'o Organ<'a, N>,
    config: Config,
    stiffest_n_m: f32,
    force_share: f32,
}

impl<'o, 'a, const N: usize> Controller<'o, 'a, N> {
    /// Checks the configuration, and that every space has the method; finds the stiffest place.
    pub fn new(organ: &'o Organ<'a, N>, config: Config) -> Result<Self, ControllerError> {
        let Config { method, contact, limits } = config;
        let positive = [
            ("capture_radius_m", contact.capture_radius_m),
            ("release_height_m", contact.release_height_m),
            ("max_force_n", limits.max_force_n),
            ("max_slew_n_per_s", limits.max_slew_n_per_s),
            ("max_position_m", limits.max_position_m),
            ("max_speed_m_s", limits.max_speed_m_s),
            ("max_stiffness_n_m", limits.max_stiffness_n_m),
        ];
        let not_negative = [("release_tension_n", contact.release_tension_n), ("ramp_s", limits.ramp_s)];
        for (what, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(ControllerError::Config { what });
            }
        }
        for (what, value) in not_negative {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(ControllerError::Config { what });
            }
        }
        match (0..u16::MAX).zip(&organ.spaces).find(|(_, space)| !space.has(method)) {
            Some((space, _)) => Err(ControllerError::MissingMethod { method, space }),
            None => {
                let stiffest = |space| stiffness::stiffest_n_m(space, method);
                let capped = limits.max_stiffness_n_m < f32::MAX;
                let spaces = organ.spaces.iter().filter(|_| capped);
                let stiffest_n_m = spaces.map(stiffest).fold(0.0, f32::max);
                // Infinite is far too stiff, and no organ that moves.
                let force_share = if stiffest_n_m > limits.max_stiffness_n_m {
                    limits.max_stiffness_n_m / stiffest_n_m
                } else {
                    1.0
                };
                Ok(Self { organ, config, stiffest_n_m, force_share })
            }
        }
    }

    /// Largest stiffness of the organ, newtons a metre of the model; 0 if there is no limit to hold it against.
    pub const fn stiffest_n_m(&self) -> f32 {
        self.stiffest_n_m
    }

    /// What every force for the hand is scaled by, to keep that within the limit: 1 where nothing has to be.
    pub const fn force_share(&self) -> f32 {
        self.force_share
    }

    /// The organ it renders.
    pub const fn organ(&self) -> &'o Organ<'a, N> {
        self.organ
    }

    /// How it renders.
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// One tick: what to send to the hand now. `sample` is the newest reading, or `None` if none came since the last tick.
    pub fn tick(&self, state: &mut State, now_us: u64, sample: Option<&Sample>) -> Command {
        self.tick_with(state, now_us, sample, |space, displacement_m| {
            space.force(self.config.method, *displacement_m)
        })
    }

    /// [`Controller::tick`] with the caller's own way to the force of a space: that of [`Space::force`] for the method of the
    /// configuration, but on the instructions of the machine at hand.
    pub fn tick_with(
        &self,
        state: &mut State,
        now_us: u64,
        sample: Option<&Sample>,
        force: impl FnOnce(&Space<'_>, &Vec3) -> Option<ForceSample>,
    ) -> Command {
        let command = match state.phase {
            Phase::Active => match self.render(state, now_us, sample, force) {
                Ok(command) => command,
                Err(fault) => {
                    state.leave(Phase::SafeZero(fault));
                    state.last
                }
            },
            phase => {
                let seen_m = sample.map(|sample| sample.position_m).filter(|&hip_m| vec3::is_finite(hip_m));
                Command::zero(phase, seen_m.unwrap_or(state.last.hip_m))
            }
        };
        state.now_us = Some(now_us);
        state.last = command;
        command
    }

    fn render(
        &self,
        state: &mut State,
        now_us: u64,
        sample: Option<&Sample>,
        force: impl FnOnce(&Space<'_>, &Vec3) -> Option<ForceSample>,
    ) -> Result<Command, Fault> {
        let limits = &self.config.limits;
        let before_us = state.now_us.unwrap_or(now_us);
        let elapsed_us = now_us.checked_sub(before_us).ok_or(Fault::Internal)?;
        let armed_us = match state.armed_us {
            Some(armed_us) => armed_us,
            None => {
                state.stale = StaleWatch::new(now_us);
                *state.armed_us.insert(now_us)
            }
        };
        let fresh = match (state.stale.judge(limits, now_us, sample.map(|sample| sample.t_us)), sample) {
            (Freshness::Fresh, Some(sample)) => sample,
            (Freshness::Fresh | Freshness::Hold, _) => return Ok(state.last),
            (Freshness::Zero, _) => return Ok(Command { hand_force_n: vec3::ZERO, ..state.last }),
            (Freshness::Fault, _) => return Err(Fault::Stale),
        };
        self.check_motion(&mut state.speed, fresh)?;

        let model = self.reaction(&mut state.contact, fresh, force)?;
        let share = limit::ramp(now_us.saturating_sub(armed_us), limits.ramp_s);
        let capped_n = vec3::scale(model.reaction_n, -self.force_share);
        let (wanted_n, clamped) = limit::clamp_force(capped_n, limits.max_force_n);
        let step_n = limits.max_slew_n_per_s * (elapsed_us.min(MAX_SLEW_TIME_US) as f32 * 1e-6);
        let slewed_n = limit::slew(state.last.hand_force_n, vec3::scale(wanted_n, share), step_n);
        // The slew stays inside the ball but for rounding; this makes the limit exact.
        let (hand_force_n, _) = limit::clamp_force(slewed_n, limits.max_force_n);
        Ok(Command { hand_force_n, clamped, ..model })
    }

    /// Trips on a position that no hand can have brought about.
    fn check_motion(&self, speed: &mut SpeedWindow, sample: &Sample) -> Result<(), Fault> {
        let limits = &self.config.limits;
        if !vec3::is_finite(sample.position_m) {
            return Err(Fault::NotFinite);
        }
        if vec3::max_abs(sample.position_m) > limits.max_position_m {
            return Err(Fault::Workspace);
        }
        if speed.speed_m_s(sample.t_us, sample.position_m) > limits.max_speed_m_s {
            return Err(Fault::Overspeed);
        }
        Ok(())
    }

    /// Contact and model force for one sample, before any limit.
    fn reaction(
        &self,
        contact: &mut Contact,
        sample: &Sample,
        force: impl FnOnce(&Space<'_>, &Vec3) -> Option<ForceSample>,
    ) -> Result<Command, Fault> {
        let hip_m = sample.position_m;
        let free = Command::zero(Phase::Active, hip_m);
        let spaces = &self.organ.spaces;
        let Some(touch) = contact.update(&self.config.contact, spaces, hip_m, sample.buttons) else {
            return Ok(free);
        };
        let space = spaces.get(usize::from(touch.space)).ok_or(Fault::Internal)?;
        let answer = force(space, &touch.displacement_m).ok_or(Fault::Internal)?;
        if contact.release_if_tensile(&self.config.contact, space.outward_normal, answer.force_n, hip_m) {
            return Ok(free);
        }
        Ok(Command {
            reaction_n: answer.force_n,
            displacement_m: touch.displacement_m,
            engaged: Some(touch.space),
            coverage: Some(answer.coverage),
            ..free
        })
    }
}
