//! The configuration of a controller, and its check.

use crate::guard::{LimitConfig, PassivityConfig};
use crate::method::Method;
use crate::num::vec3::{self, Vec3};
use crate::touch::ContactConfig;

/// The configuration of a controller, constant during a session.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Config {
    /// Interpolation method; `None` where jets give the force.
    pub method: Option<Method>,
    /// When contact begins and ends.
    pub contact: ContactConfig,
    /// Limits of the force and of the motion.
    pub limits: LimitConfig,
    /// The passivity control.
    pub passivity: PassivityConfig,
    /// Force that carries the weight of the handle while the controller is active, model frame, newtons; zero
    /// for none. It is part of the force for the hand, within its limit, and rises over
    /// [`LimitConfig::ramp_s`]. The passivity control does not count it: it is no force of the body.
    pub gravity_compensation_n: Vec3,
}

impl Config {
    /// A method with the default contact, limits and passivity control.
    pub fn new(method: Method) -> Self {
        Self { method: Some(method), ..Self::live() }
    }

    /// The default contact, limits and passivity control without a method: jets of a live solver give the
    /// force.
    pub fn live() -> Self {
        Self {
            method: None,
            contact: ContactConfig::default(),
            limits: LimitConfig::default(),
            passivity: PassivityConfig::default(),
            gravity_compensation_n: vec3::ZERO,
        }
    }

    /// Name of the method, or `jets` without one.
    pub const fn method_name(&self) -> &'static str {
        match self.method {
            Some(method) => method.name(),
            None => "jets",
        }
    }

    /// Checks the range of every number.
    pub(super) fn check(&self) -> Result<(), ControllerError> {
        let Self { contact, limits, passivity, gravity_compensation_n, .. } = self;
        let positive = |value: f32| value > 0.0 && value.is_finite();
        let not_negative = |value: f32| value >= 0.0 && value.is_finite();
        let checks = [
            ("capture_radius_m", positive(contact.capture_radius_m)),
            ("release_height_m", positive(contact.release_height_m)),
            ("grasp_slip", positive(contact.grasp_slip)),
            ("grasp_distance_m", positive(contact.grasp_distance_m)),
            ("max_force_n", positive(limits.max_force_n)),
            ("max_slew_n_per_s", positive(limits.max_slew_n_per_s)),
            ("max_position_m", positive(limits.max_position_m)),
            ("max_speed_m_s", positive(limits.max_speed_m_s)),
            ("stale_fault_us", limits.stale_fault_us > 0),
            ("workspace_scale", positive(passivity.workspace_scale)),
            ("release_tension_n", not_negative(contact.release_tension_n)),
            ("ramp_s", not_negative(limits.ramp_s)),
            ("fade_s", not_negative(limits.fade_s)),
            ("margin_j", not_negative(passivity.margin_j)),
            ("max_damping_n_s_m", not_negative(passivity.max_damping_n_s_m)),
            ("position_step_m", not_negative(passivity.position_step_m)),
            // An infinite value means that there is no limit.
            ("max_stiffness_n_m", limits.max_stiffness_n_m > 0.0),
            ("friction", (0.0..=1.0).contains(&contact.friction) || contact.friction == f32::INFINITY),
            ("fault_j", passivity.fault_j >= 0.0),
            // With a larger one little would remain for the organ.
            (
                "gravity_compensation_n",
                vec3::is_finite(*gravity_compensation_n)
                    && 2.0 * vec3::norm(*gravity_compensation_n) <= limits.max_force_n,
            ),
        ];
        match checks.into_iter().find(|(_, is_sound)| !is_sound) {
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
