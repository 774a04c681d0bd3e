//! Controllers: one tick per millisecond converts a sample of the device into the force for the hand.

use core::mem::MaybeUninit;

use palpate_core::{
    Command, Config, ContactConfig, Controller, Fault, LimitConfig, Method, PassivityConfig, Phase, Sample,
    State, TouchSurface,
};

use crate::memory;
use crate::organ::{PALPATE_ALIGNMENT, PalpateCoverage, PalpateOrgan, SPACES, method, told};
use crate::status::{PalpateProblem, PalpateStatus};

/// A controller with its state, in memory of the caller. Opaque: only this library accesses its contents.
#[derive(Debug)]
pub struct PalpateController {
    controller: Controller<'static, 'static, SPACES>,
    state: State,
}

const _: () = assert!(align_of::<PalpateController>() <= PALPATE_ALIGNMENT);

/// The configuration of a controller. palpate_config fills in the defaults; change single fields afterwards.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PalpateConfig {
    /// Interpolation method, a PalpateMethod.
    pub method: u32,
    /// Bits of the buttons that start a grasp, any of them; 0 for none.
    pub grasp_button: u32,
    /// Largest distance from the HIP to the rest position of a node that it may engage, m.
    pub capture_radius_m: f32,
    /// Tension along the outward normal at which a pushing tool disengages, N.
    pub release_tension_n: f32,
    /// Height above the anchor of the contact at which a pushing tool disengages, m.
    pub release_height_m: f32,
    /// Coefficient of Coulomb friction of a pushing tool that may slide; infinite for a tool that sticks to
    /// the nearest node.
    pub friction: f32,
    /// A grasp is lost beyond this multiple of the radius of the grid or of the largest force.
    pub grasp_slip: f32,
    /// Largest distance from the surface at which a grasp begins, m.
    pub grasp_distance_m: f32,
    /// Largest force for the hand, N: the limit of the device.
    pub max_force_n: f32,
    /// Largest rate of change of that force, N/s.
    pub max_slew_n_per_s: f32,
    /// Time from zero to the full force after arming, s.
    pub ramp_s: f32,
    /// Duration of the transition over a jump of the force, s.
    pub fade_s: f32,
    /// Largest absolute coordinate of the HIP, m; a larger one is a fault.
    pub max_position_m: f32,
    /// Largest speed of the HIP, m/s; a larger one is a fault.
    pub max_speed_m_s: f32,
    /// Largest stiffness of the model that may be rendered, N/m: that of the device divided by the metres of
    /// the model per metre of the device. The forces of a stiffer organ are all scaled by one factor.
    pub max_stiffness_n_m: f32,
    /// Work on the hand in one touch that is tolerated, J.
    pub energy_margin_j: f32,
    /// Largest virtual damping of the passivity control, N s/m; 0 for none.
    pub energy_damping_n_s_m: f32,
    /// Work on the hand above which a fault is latched, J; infinite for no fault.
    pub energy_fault_j: f32,
    /// Metres of the model per metre of the device.
    pub workspace_scale: f32,
    /// Resolution of the positions, metres of the model; 0 if unlimited.
    pub position_step_m: f32,
    /// Delay from sending a force to its effect at the motors, us.
    pub force_delay_us: u32,
    /// Number of ticks without a fresh sample in which the last command is held; then the force is zero.
    pub stale_hold_ticks: u32,
    /// Age of the newest sample at which a fault is latched, us.
    pub stale_fault_us: u64,
    /// Force that carries the weight of the handle while active, model frame, N; part of the force for the hand
    /// and at most half of its limit.
    pub gravity_compensation_n: [f32; 3],
}

/// One reading of the device.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PalpateSample {
    /// Time of the reading on the clock of the ticks, us.
    pub t_us: u64,
    /// HIP, model frame, m.
    pub position_m: [f32; 3],
    /// One bit per button, 1 while pressed.
    pub buttons: u32,
}

/// State of the controller.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PalpatePhase {
    /// The force is zero until armed.
    Disarmed = 0,
    /// The organ is rendered.
    Active = 1,
    /// The force is zero after a fault, until palpate_reset and palpate_arm.
    SafeZero = 2,
}

/// Why the force was set to zero.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PalpateFault {
    /// No fault.
    None = 0,
    /// A position was NaN or infinite.
    NotFinite = 1,
    /// No fresh sample for too long.
    Stale = 2,
    /// The HIP was faster than a hand.
    Overspeed = 3,
    /// The HIP left the workspace.
    Workspace = 4,
    /// An impossible state, for example a time that ran backwards.
    Internal = 5,
    /// The hand got more energy than a passive body can give.
    Energy = 6,
    /// The device is no longer homed or ready. Only the host reports this fault, not this library.
    NotReady = 7,
    /// A watchdog stopped the force. Only a host with a watchdog reports this fault, not this library.
    Watchdog = 8,
    /// The live solver has ended. Only a host with a live solver reports this fault, not this library.
    Solver = 9,
}

/// Result of one tick.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PalpateCommand {
    /// Force for the hand, model frame, N: finite, and never above the limit.
    pub hand_force_n: [f32; 3],
    /// h of the model before any limit, N; zero without contact.
    pub reaction_n: [f32; 3],
    /// Displacement of the engaged node, m; zero without contact.
    pub displacement_m: [f32; 3],
    /// The HIP that the command refers to, model frame, m.
    pub hip_m: [f32; 3],
    /// Index of the engaged space, or -1 without contact.
    pub engaged: i32,
    /// The data behind the reaction.
    pub coverage: PalpateCoverage,
    /// State of the controller.
    pub phase: PalpatePhase,
    /// The latched fault in the phase SAFE_ZERO, otherwise NONE.
    pub fault: PalpateFault,
    /// Work on the hand since first touch, joules in metres of the device; negative while it presses.
    pub hand_work_j: f32,
    /// Whether the reaction exceeded the force limit.
    pub clamped: bool,
    /// Whether the passivity control added damping.
    pub damped: bool,
}

impl PalpateCommand {
    const fn zero(phase: PalpatePhase, fault: PalpateFault) -> Self {
        Self {
            hand_force_n: [0.0; 3],
            reaction_n: [0.0; 3],
            displacement_m: [0.0; 3],
            hip_m: [0.0; 3],
            engaged: -1,
            coverage: PalpateCoverage::None,
            phase,
            fault,
            hand_work_j: 0.0,
            clamped: false,
            damped: false,
        }
    }
}

impl From<Phase> for PalpatePhase {
    fn from(phase: Phase) -> Self {
        match phase {
            Phase::Disarmed => Self::Disarmed,
            Phase::Active => Self::Active,
            Phase::SafeZero(_) => Self::SafeZero,
        }
    }
}

impl From<Phase> for PalpateFault {
    fn from(phase: Phase) -> Self {
        match phase {
            Phase::Disarmed | Phase::Active => Self::None,
            Phase::SafeZero(Fault::NotFinite) => Self::NotFinite,
            Phase::SafeZero(Fault::Stale) => Self::Stale,
            Phase::SafeZero(Fault::Overspeed) => Self::Overspeed,
            Phase::SafeZero(Fault::Workspace) => Self::Workspace,
            Phase::SafeZero(Fault::Internal) => Self::Internal,
            Phase::SafeZero(Fault::Energy) => Self::Energy,
            Phase::SafeZero(Fault::NotReady) => Self::NotReady,
            Phase::SafeZero(Fault::Watchdog) => Self::Watchdog,
            Phase::SafeZero(Fault::Solver) => Self::Solver,
        }
    }
}

impl From<Command> for PalpateCommand {
    fn from(command: Command) -> Self {
        Self {
            hand_force_n: command.hand_force_n,
            reaction_n: command.reaction_n,
            displacement_m: command.displacement_m,
            hip_m: command.hip_m,
            engaged: command.engaged.map_or(-1, i32::from),
            coverage: command.coverage.into(),
            phase: command.phase.into(),
            fault: command.phase.into(),
            hand_work_j: command.hand_work_j,
            clamped: command.clamped,
            damped: command.damped,
        }
    }
}

impl PalpateConfig {
    fn of(number: u32, config: Config) -> Self {
        let Config { contact, limits, passivity, .. } = config;
        Self {
            method: number,
            grasp_button: contact.grasp_button,
            capture_radius_m: contact.capture_radius_m,
            release_tension_n: contact.release_tension_n,
            release_height_m: contact.release_height_m,
            friction: contact.friction,
            grasp_slip: contact.grasp_slip,
            grasp_distance_m: contact.grasp_distance_m,
            max_force_n: limits.max_force_n,
            max_slew_n_per_s: limits.max_slew_n_per_s,
            ramp_s: limits.ramp_s,
            fade_s: limits.fade_s,
            max_position_m: limits.max_position_m,
            max_speed_m_s: limits.max_speed_m_s,
            max_stiffness_n_m: limits.max_stiffness_n_m,
            energy_margin_j: passivity.margin_j,
            energy_damping_n_s_m: passivity.max_damping_n_s_m,
            energy_fault_j: passivity.fault_j,
            workspace_scale: passivity.workspace_scale,
            position_step_m: passivity.position_step_m,
            force_delay_us: passivity.force_delay_us,
            stale_hold_ticks: limits.stale_hold_ticks,
            stale_fault_us: limits.stale_fault_us,
            gravity_compensation_n: config.gravity_compensation_n,
        }
    }

    fn to_config(self) -> Option<Config> {
        Some(Config {
            method: Some(method(self.method)?),
            contact: ContactConfig {
                capture_radius_m: self.capture_radius_m,
                release_tension_n: self.release_tension_n,
                release_height_m: self.release_height_m,
                friction: self.friction,
                grasp_slip: self.grasp_slip,
                grasp_distance_m: self.grasp_distance_m,
                grasp_button: self.grasp_button,
            },
            limits: LimitConfig {
                max_force_n: self.max_force_n,
                max_slew_n_per_s: self.max_slew_n_per_s,
                ramp_s: self.ramp_s,
                fade_s: self.fade_s,
                stale_hold_ticks: self.stale_hold_ticks,
                stale_fault_us: self.stale_fault_us,
                max_position_m: self.max_position_m,
                max_speed_m_s: self.max_speed_m_s,
                max_stiffness_n_m: self.max_stiffness_n_m,
            },
            passivity: PassivityConfig {
                margin_j: self.energy_margin_j,
                max_damping_n_s_m: self.energy_damping_n_s_m,
                fault_j: self.energy_fault_j,
                workspace_scale: self.workspace_scale,
                position_step_m: self.position_step_m,
                force_delay_us: self.force_delay_us,
            },
            gravity_compensation_n: self.gravity_compensation_n,
        })
    }
}

/// Writes the default configuration of a method: contact, limits of 8 N and 1 N/ms, a ramp of 0.5 s.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_config(
    method_number: u32,
    config: Option<&mut MaybeUninit<PalpateConfig>>,
) -> PalpateStatus {
    let Some(config) = config else { return PalpateStatus::NullArgument };
    let known = method(method_number);
    config.write(PalpateConfig::of(method_number, Config::new(known.unwrap_or(Method::Energy))));
    if known.is_some() { PalpateStatus::Ok } else { PalpateStatus::NoSuchMethod }
}

/// Number of bytes of memory that a controller needs.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_controller_size() -> usize {
    size_of::<PalpateController>()
}

/// Checks a configuration and creates a disarmed controller in `memory`.
///
/// `memory` has at least palpate_controller_size() bytes, aligned to PALPATE_ALIGNMENT. `memory` and the
/// organ must exist as long as the controller is used. `problem` may be null.
///
/// # Safety
///
/// If `memory` is not null, `memory_len` bytes may be written there, and only this library changes them
/// afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn palpate_controller_open(
    memory: *mut u8,
    memory_len: usize,
    organ: Option<&'static PalpateOrgan>,
    config: Option<&PalpateConfig>,
    controller: Option<&mut MaybeUninit<*mut PalpateController>>,
    problem: Option<&mut MaybeUninit<PalpateProblem>>,
) -> PalpateStatus {
    // SAFETY: the caller has the same obligation.
    let mut opened = unsafe { open(memory, memory_len, organ, config) };
    match controller {
        Some(controller) => {
            let handle = opened.as_mut().map_or(core::ptr::null_mut(), |opened| core::ptr::from_mut(*opened));
            controller.write(handle);
            told(opened, problem)
        }
        None => told(Err::<(), _>(PalpateProblem::of(PalpateStatus::NullArgument)), problem),
    }
}

#[allow(clippy::mut_from_ref, reason = "in the caller's memory, not in the organ's")]
unsafe fn open(
    memory: *mut u8,
    memory_len: usize,
    organ: Option<&'static PalpateOrgan>,
    config: Option<&PalpateConfig>,
) -> Result<&'static mut PalpateController, PalpateProblem> {
    let of = PalpateProblem::of;
    let (Some(PalpateOrgan { organ }), Some(config)) = (organ, config) else {
        return Err(of(PalpateStatus::NullArgument));
    };
    let config = config.to_config().ok_or(of(PalpateStatus::NoSuchMethod))?;
    let controller = Controller::new(organ, config)?;
    let state = State::new();
    // SAFETY: the caller's obligation.
    unsafe { memory::place(memory, memory_len, PalpateController { controller, state }) }
        .ok_or(of(PalpateStatus::Memory))
}

/// Number of 32-bit words of memory that contact with the surface of an organ needs; 0 if the blob has no
/// surface.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_surface_words(organ: Option<&PalpateOrgan>) -> usize {
    organ.map_or(0, |PalpateOrgan { organ }| TouchSurface::words(organ))
}

/// Uses the surface of the organ for contact instead of the planes of its active nodes.
///
/// The tool then slides between neighbouring active nodes. Call it before palpate_arm: it visits every
/// triangle. `memory` has at least palpate_surface_words(organ) words and must exist as long as the
/// controller is used.
///
/// # Safety
///
/// If `memory` is not null, `memory_len` words may be written there, and only this library changes them
/// afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn palpate_controller_on_surface(
    controller: Option<&mut PalpateController>,
    memory: *mut u32,
    memory_len: usize,
) -> PalpateStatus {
    let Some(PalpateController { controller, .. }) = controller else { return PalpateStatus::NullArgument };
    // SAFETY: the caller has the same obligation.
    let Some(words) = (unsafe { memory::words(memory, memory_len) }) else { return PalpateStatus::Memory };
    match TouchSurface::new(controller.organ(), words) {
        Some(surface) => {
            *controller = controller.on_surface(Some(surface));
            PalpateStatus::Ok
        }
        None => PalpateStatus::Memory,
    }
}

/// Starts rendering, from zero force. Returns whether the controller is active; after a fault call
/// palpate_reset first.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_arm(controller: Option<&mut PalpateController>) -> bool {
    controller.is_some_and(|controller| controller.state.arm())
}

/// Stops rendering: the next command is zero. A latched fault remains.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_disarm(controller: Option<&mut PalpateController>) {
    if let Some(controller) = controller {
        controller.state.disarm();
    }
}

/// Clears a latched fault and leaves the controller disarmed.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_reset(controller: Option<&mut PalpateController>) {
    if let Some(controller) = controller {
        controller.state.reset();
    }
}

/// One tick: computes the force to send to the hand now.
///
/// `now_us` must not decrease. `sample` is the newest reading, or null if there is none since the last tick.
/// The time is bounded; there is no lock, allocation or system call. A call that fails writes zero force.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_tick(
    controller: Option<&mut PalpateController>,
    now_us: u64,
    sample: Option<&PalpateSample>,
    command: Option<&mut MaybeUninit<PalpateCommand>>,
) -> PalpateStatus {
    let Some(command) = command else { return PalpateStatus::NullArgument };
    let Some(PalpateController { controller, state }) = controller else {
        command.write(PalpateCommand::zero(PalpatePhase::SafeZero, PalpateFault::Internal));
        return PalpateStatus::NullArgument;
    };
    let sample = sample.map(|&PalpateSample { t_us, position_m, buttons }| Sample {
        t_us,
        position_m,
        buttons,
        ..Sample::default()
    });
    command.write(controller.tick(state, now_us, sample.as_ref()).into());
    PalpateStatus::Ok
}
