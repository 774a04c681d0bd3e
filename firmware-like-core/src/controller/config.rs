//! The configuration of a controller, and its check.

use crate::guard::{LimitConfig, PassivityConfig};
use crate::method::Method;
use crate::touch::ContactConfig;

/// The configuration of a controller, constant during a session.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Config {
    /// Interpolation method.
    pub method: Method,
    /// When contact begins and ends.
    pub contact: ContactConfig,
    /// Limits of the force and of the motion.
    pub limits: LimitConfig,
    /// The passivity control.
    pub passivity: PassivityConfig,
}

impl Config {
    /// A method with the default contact, limits and passivity control.
    pub fn new(method: Method) -> Self {
        Self {
            method,
            contact: ContactConfig::default(),
            limits: LimitConfig::default(),
            passivity: PassivityConfig::default(),
        }
    }

    /// Checks the range of every number.
    pub(super) fn check(&self) -> Result<(), ControllerError> {
        let Self { contact, limits, passivity, .. } = self;
        let positive = [
            ("capture_radius_m", contact.capture_radius_m),
            ("release_height_m", contact.release_height_m),
            ("grasp_slip", contact.grasp_slip),
            ("grasp_distance_m", contact.grasp_distance_m),
            ("max_force_n", limits.max_force_n),
            ("max_slew_n_per_s", limits.max_slew_n_per_s),
            ("max_position_m", limits.max_position_m),
            ("max_speed_m_s", limits.max_speed_m_s),
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
        ];
        // An infinite value means that there is no limit.
        let unlimited = [
            ("max_stiffness_n_m", limits.max_stiffness_n_m > 0.0),
            ("friction", contact.friction >= 0.0),
            ("fault_j", passivity.fault_j >= 0.0),
        ];
        let finite =
            |(what, value): (&'static str, f32), is_sound: bool| (what, is_sound && value.is_finite());
        let checks = positive.map(|named| finite(named, named.1 > 0.0));
        let checks = checks.into_iter().chain(not_negative.map(|named| finite(named, named.1 >= 0.0)));
        match checks.chain(unlimited).find(|(_, is_sound)| !is_sound) {
            None => Ok(()),
            Some((what, _)) => Err(ControllerError::Config { what }),
        }
    }
}

/// Why a controller was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ControllerError {
    /// The blob lacks the tables of the method for a space.
    #[error("space {space} has no table for {name}: pack the blob with --method {name}", name = .method.name())]
    MissingMethod {
        /// The method.
        method: Method,
        /// Index of the space.
        space: u16,
    },
    /// A number of the configuration is out of its range.
    #[error("{what} is out of range: give a positive, finite number")]
    Config {
        /// The field.
        what: &'static str,
    },
}
