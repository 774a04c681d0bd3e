//! One tick of the haptic loop: (config, &mut state, now, sample) -> command.
//!
//! Time is an argument, nothing is allocated, locked or called, every loop is bounded, and whatever comes in, the command is
//! finite and its force within the limit. A fault is latched: zero at once, past the slew limit, until
//! [`State::reset`] and [`State::arm`]. Zero is always safe; going on with a wrong force is not.

use crate::blob::Organ;
use crate::contact::{Contact, ContactConfig, ContactKind, ContactState, Engaged};
use crate::fade::Fade;
use crate::limit::{self, Freshness, LimitConfig, StaleWatch};
use crate::method::{Coverage, ForceSample, Method};
use crate::passivity::{Passivity, PassivityConfig, Verdict};
use crate::profile::PC_SPACES;
use crate::speed::SpeedWindow;
use crate::stiffness;
use crate::surface::{Share, TouchSurface};
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
    /// The guard on energy.
    pub passivity: PassivityConfig,
}

impl Config {
    /// A method with the default contact and limits.
    pub fn new(method: Method) -> Self {
        Self {
            method,
            contact: ContactConfig::default(),
            limits: LimitConfig::default(),
            passivity: PassivityConfig::default(),
        }
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
    /// The hand was given more energy than a body can give.
    Energy,
    /// The device is not where it was: not homed, or not ready any more.
    NotReady,
    /// The watchdog took the force away because the loop stood still.
    Watchdog,
}

impl Fault {
    /// All of them.
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
    /// Index of the engaged space; of the one with the largest share where several answer.
    pub engaged: Option<u16>,
    /// The spaces that answered and their shares; none of a weight above 0 when free.
    pub shares: [Share; 3],
    /// Data behind the reaction; `None` when free.
    pub coverage: Option<Coverage>,
    /// What the controller is doing.
    pub phase: Phase,
    /// Whether the reaction was beyond the force limit.
    pub clamped: bool,
    /// Work done on the hand since it touched, joules, in device metres: below 0 while it presses.
    pub hand_work_j: f32,
    /// Whether the guard on energy added damping.
    pub damped: bool,
    /// Share of the force since arming: below 1 while it ramps up, 0 while disarmed.
    pub ramp: f32,
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
    phase: Phase,
    armed_us: Option<u64>,
    now_us: Option<u64>,
    stale: StaleWatch,
    speed: SpeedWindow,
    contact: Contact,
    passivity: Passivity,
    fade: Fade,
    /// The next force comes from another organ.
    handed_over: bool,
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
            passivity: Passivity::new(),
            fade: Fade::new(),
            handed_over: false,
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

    /// Takes the force away for a reason that the controller cannot see, and latches it. What is disarmed has no force to lose.
    pub fn trip(&mut self, fault: Fault) {
        if self.phase == Phase::Active {
            self.leave(Phase::SafeZero(fault));
        }
    }

    /// The next tick is another controller's, of another organ: the force goes over smoothly. A touch goes on if the new organ has the same
    /// active nodes on the same surface, and ends otherwise.
    pub fn hand_over(&mut self, same_nodes: bool) {
        self.handed_over = true;
        if !same_nodes {
            self.contact.release(self.last.hip_m);
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
    surface: Option<TouchSurface<'o>>,
    config: Config,
    stiffest_n_m: f32,
    force_share: f32,
}

impl<'o, 'a, const N: usize> Controller<'o, 'a, N> {
    /// Checks the configuration, and that every space has the method; finds the stiffest place. Contact is with the planes of the
    /// nodes until [`Controller::on_surface`] gives it more.
    pub fn new(organ: &'o Organ<'a, N>, config: Config) -> Result<Self, ControllerError> {
        let Config { method, contact, limits, passivity } = config;
        let positive = [
            ("capture_radius_m", contact.capture_radius_m),
            ("release_height_m", contact.release_height_m),
            ("max_force_n", limits.max_force_n),
            ("max_slew_n_per_s", limits.max_slew_n_per_s),
            ("max_position_m", limits.max_position_m),
            ("max_speed_m_s", limits.max_speed_m_s),
            ("max_stiffness_n_m", limits.max_stiffness_n_m),
            ("grasp_slip", contact.grasp_slip),
            ("grasp_distance_m", contact.grasp_distance_m),
            ("stale_fault_us", limits.stale_fault_us as f32),
            ("workspace_scale", passivity.workspace_scale),
        ];
        let not_negative = [
            ("release_tension_n", contact.release_tension_n),
            ("ramp_s", limits.ramp_s),
            ("fade_s", limits.fade_s),
            ("margin_j", passivity.margin_j),
            ("max_damping_n_s_m", passivity.max_damping_n_s_m),
            ("position_step_m", passivity.position_step_m),
            // Infinite is allowed: these then never act.
            ("friction", finite_or_most(contact.friction)),
            ("fault_j", finite_or_most(passivity.fault_j)),
        ];
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
                let capped = limits.max_stiffness_n_m < f32::MAX;
                let spaces = if capped { organ.spaces.as_slice() } else { &[] };
                let (cap_n_m, limit_n) = (limits.max_stiffness_n_m, limits.max_force_n);
                let (stiffest_n_m, force_share) = stiffness::share(spaces, method, cap_n_m, limit_n);
                Ok(Self { organ, surface: None, config, stiffest_n_m, force_share })
            }
        }
    }

    /// Contact with the organ's surface instead of the planes of its nodes.
    #[must_use]
    pub const fn on_surface(self, surface: Option<TouchSurface<'o>>) -> Self {
        Self { surface, ..self }
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
        force: impl Fn(&Space<'_>, &Vec3) -> Option<ForceSample>,
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
        force: impl Fn(&Space<'_>, &Vec3) -> Option<ForceSample>,
    ) -> Result<Command, Fault> {
        let limits = &self.config.limits;
        let before_us = state.now_us.unwrap_or(now_us);
        let elapsed_us = now_us.checked_sub(before_us).ok_or(Fault::Internal)?;
        // The exchange that brought this sample has sent it.
        state.passivity.sent(now_us, state.last.hand_force_n);
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
        let touching = matches!(state.contact.state(), ContactState::Engaged(_));
        let stored_j = touching.then(|| self.most_stored_j(&state.last));
        let at = (fresh.t_us, fresh.position_m);
        let guard = &self.config.passivity;
        let damping_n = match state.passivity.observe(guard, at, stored_j) {
            Verdict::Damp(force_n) => force_n,
            Verdict::Active => return Err(Fault::Energy),
        };

        let model = self.reaction(&mut state.contact, fresh, force)?;
        let share = limit::ramp(now_us.saturating_sub(armed_us), limits.ramp_s);
        let capped_n = vec3::scale(model.reaction_n, -self.force_share);
        let (clamped_n, clamped) = limit::clamp_force(capped_n, limits.max_force_n);
        let wanted_n = vec3::add(vec3::scale(clamped_n, share), damping_n);
        // What ends otherwise than at no force (a slip, a button, another organ) goes on from what the hand feels: after a gap that is nothing.
        if state.handed_over || (model.engaged.is_none() && state.last.engaged.is_some()) {
            state.fade.begin(now_us, vec3::sub(state.last.hand_force_n, wanted_n));
            state.handed_over = false;
        }
        let bridged_n = vec3::add(wanted_n, state.fade.rest_n(now_us, limits.fade_s));
        let step_n = limits.max_slew_n_per_s * (elapsed_us.min(MAX_SLEW_TIME_US) as f32 * 1e-6);
        let slewed_n = limit::slew(state.last.hand_force_n, bridged_n, step_n);
        // The slew stays inside the ball but for rounding; this makes the limit exact.
        let (hand_force_n, _) = limit::clamp_force(slewed_n, limits.max_force_n);
        let (hand_work_j, damped) = (state.passivity.work_j(), damping_n != vec3::ZERO);
        Ok(Command { hand_force_n, clamped, hand_work_j, damped, ramp: share, ..model })
    }

    /// The most that the body can have stored as the hand feels it, J in metres of the device: |h| |d|, twice what a spring has, and more than any
    /// force that grows with its displacement.
    fn most_stored_j(&self, last: &Command) -> f32 {
        let felt_n = self.force_share * vec3::norm(last.reaction_n);
        felt_n * vec3::norm(last.displacement_m) / self.config.passivity.workspace_scale
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
        force: impl Fn(&Space<'_>, &Vec3) -> Option<ForceSample>,
    ) -> Result<Command, Fault> {
        let (config, spaces) = (&self.config.contact, &self.organ.spaces);
        let (surface, hip_m) = (self.surface.as_ref(), sample.position_m);
        let free = Command::zero(Phase::Active, hip_m);
        let Some(at) = contact.update(config, spaces, surface, hip_m, sample.buttons) else {
            return Ok(free);
        };
        let displacement_m = vec3::sub(hip_m, at.anchor_m);
        let answer = self.answer(&at, displacement_m, force).ok_or(Fault::Internal)?;
        if self.lets_go(&at, displacement_m, answer.force_n) {
            contact.release(hip_m);
            return Ok(free);
        }
        contact.slip(config, spaces, surface, (displacement_m, answer.force_n));
        Ok(Command {
            reaction_n: answer.force_n,
            displacement_m,
            engaged: Some(at.heaviest()),
            shares: at.shares,
            coverage: Some(answer.coverage),
            ..free
        })
    }

    /// h = sum w_i h_i(d). Covered as badly as the worst of them.
    fn answer(
        &self,
        at: &Engaged,
        displacement_m: Vec3,
        force: impl Fn(&Space<'_>, &Vec3) -> Option<ForceSample>,
    ) -> Option<ForceSample> {
        let mut sum: Option<ForceSample> = None;
        for share in at.shares.iter().filter(|share| share.weight > 0.0) {
            let space = self.organ.spaces.get(usize::from(share.space))?;
            let one = force(space, &displacement_m)?;
            // Alone its weight is 1, and its bits stay.
            let force_n = vec3::scale(one.force_n, share.weight);
            sum = Some(match sum {
                None => ForceSample { force_n, ..one },
                Some(others) => ForceSample {
                    force_n: vec3::add(others.force_n, force_n),
                    coverage: if one.coverage == Coverage::Extrapolated {
                        one.coverage
                    } else {
                        others.coverage
                    },
                },
            });
        }
        sum
    }

    /// Whether a pushing tool goes where the model would pull it, or a grasping one pulls harder or further than it can hold.
    ///
    /// Pressing has h . n < 0. A tool that only leans on tissue cannot pull it out.
    fn lets_go(&self, at: &Engaged, displacement_m: Vec3, reaction_n: Vec3) -> bool {
        let Config { contact, limits, .. } = &self.config;
        match at.kind {
            ContactKind::Push => vec3::dot(reaction_n, at.normal) > contact.release_tension_n,
            ContactKind::Grasp => {
                let radius_m = |share: &Share| {
                    let space = self.organ.spaces.get(usize::from(share.space));
                    space.map_or(0.0, |space| space.lattice.radius_m())
                };
                let held = at.shares.iter().filter(|share| share.weight > 0.0);
                let reach_m = contact.grasp_slip * held.map(radius_m).fold(f32::INFINITY, f32::min);
                let strength_n = contact.grasp_slip * limits.max_force_n;
                vec3::norm(displacement_m) > reach_m || vec3::norm(reaction_n) * self.force_share > strength_n
            }
        }
    }
}

/// Infinity as the largest number; NaN stays what it is.
const fn finite_or_most(value: f32) -> f32 {
    if value == f32::INFINITY { f32::MAX } else { value }
}
