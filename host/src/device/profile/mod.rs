//! Profiles of devices in TOML: limits, mechanism, link, workspace.
//!
//! A bundled profile is selected by its name, any other by its file. A profile omits quantities that are not
//! measured, and conservative defaults apply instead. Assumptions for the simulation are under
//! `[simulation]`; no limit depends on them.

mod cap;
mod file;

pub use cap::{
    CapReason, CapVerdict, DEFAULT_CAP_N_M, HARD_CAP_N_M, LATENESS_ALLOWANCE, StiffnessCap, Timing,
};
pub use file::ProfileError;

use super::capstan::Capstan;
use super::workspace::{Reach, Workspace};
use palpate_core::{LimitConfig, Vec3};
use std::path::Path;

/// A device's profile.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Name for the user.
    pub name: String,
    /// Largest force it renders, N.
    pub max_force_n: f32,
    /// Largest stiffness stated by its maker or by the listed source, N/m in device metres; an upper bound of
    /// the cap.
    pub max_stiffness_n_m: f32,
    /// Cycles per second.
    pub rate_hz: f32,
    /// Known properties of the mechanism.
    pub mechanism: Mechanism,
    /// Delay of a position from the device to this program, us.
    pub position_delay_us: u32,
    /// Delay of a force from this program to the hand, us.
    pub force_delay_us: u32,
    /// Conversion of encoder counts to metres and newtons to torques, for the driver of the device link.
    pub capstan: Option<Capstan>,
    /// Range of the handle round the mapping's device origin, device frame.
    pub reach: Reach,
    /// Placement of the workspace in the model.
    pub workspace: Workspace,
    /// Values determined on the individual device.
    pub calibration: Calibration,
    /// The buttons that arm and grasp.
    pub buttons: Buttons,
    /// Assumptions of the simulation for unknown properties.
    pub assumed: Assumed,
}

/// Bits of the device's buttons. They differ on a device with several buttons, so that a hand that grasps does
/// not arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Buttons {
    /// The button that arms.
    pub arm: u32,
    /// The button that grasps while it is held.
    pub grasp: u32,
}

impl Default for Buttons {
    fn default() -> Self {
        Self { arm: 1, grasp: 1 }
    }
}

/// Properties of an individual device, determined at its first power-up (docs/devices.md).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// Motor counts per N m at the crank, with sign; for a Falcon.
    pub counts_per_n_m: [f32; 3],
    /// Force along the device's +y that compensates the weight of the handle, N.
    pub gravity_n: f32,
}

impl Default for Calibration {
    fn default() -> Self {
        // The uncalibrated default; value from libnifalcon.
        Self { counts_per_n_m: [-10_000.0; 3], gravity_n: 0.0 }
    }
}

/// Known properties of a mechanism; `None` is unknown.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mechanism {
    /// Effective mass at the handle, kg.
    pub mass_kg: Option<f32>,
    /// Viscous damping at the handle.
    pub damping: Option<Damping>,
    /// Coulomb friction at the handle, N.
    pub coulomb_n: Option<f32>,
    /// Resolution of the position at the handle, the coarsest, m.
    pub encoder_quantum_m: Option<f32>,
    /// Resolution of the force at the handle, N.
    pub motor_quantum_n: Option<f32>,
}

/// Damping for the cap on the stiffness.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Damping {
    /// N s/m.
    pub n_s_m: f32,
    /// Whether it is measured; otherwise it is a conservative value.
    pub measured: bool,
}

/// Assumed properties for the simulation only.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Assumed {
    /// Effective mass at the handle, kg.
    pub mass_kg: f32,
    /// Viscous damping at the handle, N s/m.
    pub damping_n_s_m: f32,
    /// Coulomb friction at the handle, N.
    pub coulomb_n: f32,
}

impl Default for Assumed {
    fn default() -> Self {
        // A light mechanism without dissipation is the least stable case.
        Self { mass_kg: 0.1, damping_n_s_m: 0.0, coulomb_n: 0.0 }
    }
}

impl Profile {
    /// The bundled profile with that name, or the profile in a file whose name ends in `.toml`.
    pub fn load(name_or_file: &str) -> Result<Self, ProfileError> {
        if name_or_file.ends_with(".toml") {
            return file::read(Path::new(name_or_file));
        }
        Self::bundled(name_or_file).ok_or_else(|| {
            let names: Vec<&str> = Self::names().collect();
            ProfileError {
                file: name_or_file.into(),
                line: None,
                what: "there is no device profile with this name".into(),
                fix: format!("choose {}, or give a file that ends in .toml", names.join(", ")),
            }
        })
    }

    /// A bundled profile.
    #[must_use]
    pub fn bundled(name: &str) -> Option<Self> {
        let (name, text) = palpate_devices::PROFILES.into_iter().find(|(known, _)| *known == name)?;
        // A test parses all of them.
        Some(file::parse(Path::new(name), text).expect("bundled profiles are valid"))
    }

    /// Names of the bundled profiles.
    pub fn names() -> impl Iterator<Item = &'static str> {
        palpate_devices::PROFILES.into_iter().map(|(name, _)| name)
    }

    /// Parses a profile; `path` is the file in messages.
    pub fn parse(path: &Path, text: &str) -> Result<Self, ProfileError> {
        file::parse(path, text)
    }

    /// Time between two cycles, us.
    #[must_use]
    pub fn period_us(&self) -> u32 {
        (1e6 / f64::from(self.rate_hz)).round().max(1.0) as u32
    }

    /// The same device with another period of the loop; cap, simulation and verdict use that period.
    #[must_use]
    pub fn at_period(self, period_us: u32) -> Self {
        Self { rate_hz: (1e6 / f64::from(period_us.max(1))) as f32, ..self }
    }

    /// Largest stiffness of the MODEL that may be rendered, N/m: the cap divided by the workspace scale.
    #[must_use]
    pub fn max_model_stiffness_n_m(&self) -> f32 {
        self.cap().n_m / self.workspace.scale
    }

    /// Force that compensates the weight of the handle, model frame, N.
    #[must_use]
    pub fn gravity_compensation_n(&self) -> Vec3 {
        // The model's axes in device coordinates: the y component of each.
        self.workspace.axes.map(|axis| axis[1] * self.calibration.gravity_n)
    }

    /// Lowers limits to those of the device; no limit is raised.
    pub fn lower_limits(&self, limits: &mut LimitConfig) {
        limits.max_force_n = limits.max_force_n.min(self.max_force_n);
        limits.max_stiffness_n_m = limits.max_stiffness_n_m.min(self.max_model_stiffness_n_m());
    }

    /// Half-width of the box round the model's origin that contains all positions of the handle, m.
    ///
    /// It includes a margin of a tenth, because a mechanism reaches slightly beyond its listed workspace.
    #[must_use]
    pub fn largest_position_m(&self) -> f32 {
        let Workspace { scale, model_origin_m, .. } = self.workspace;
        palpate_core::vec3::max_abs(model_origin_m) + 1.1 * scale * self.reach.farthest_m()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bundled_profile_is_valid_and_within_the_listed_values() {
        // Force and stiffness as listed by CHAI3D, in newtons and newtons per metre.
        let listed = [
            ("touch", 3.3, 400.0),
            ("omni", 3.3, 700.0),
            ("desktop", 7.9, 1000.0),
            ("premium-1.5", 8.5, 800.0),
            ("omega", 12.0, 5000.0),
            ("delta.3", 20.0, 5000.0),
            ("sigma.7", 12.0, 4000.0),
            ("falcon", 8.0, 3000.0),
        ];
        for (name, force_n, stiffness_n_m) in listed {
            let profile = Profile::bundled(name).expect("bundled");
            assert_eq!((profile.max_force_n, profile.max_stiffness_n_m), (force_n, stiffness_n_m), "{name}");
        }
        for name in Profile::names() {
            let profile = Profile::load(name).expect("valid");
            let cap = profile.cap();
            assert!(cap.n_m <= HARD_CAP_N_M.min(profile.max_stiffness_n_m), "{name}: {cap:?}");
            if profile.mechanism.damping.is_none() {
                assert!(cap.n_m <= DEFAULT_CAP_N_M, "{name} states no damping: {cap:?}");
            }
            assert_eq!(profile.period_us(), 1_000, "{name}");
        }
        assert!(Profile::names().is_sorted(), "as `--profile` lists them");
        for name in ["falcon", "polhem", "link", "touch", "omni", "haply"] {
            // The damping is not measured. Adding a value requires a change of this line and of the comment
            // in the profile.
            assert_eq!(Profile::bundled(name).expect("bundled").mechanism.damping, None, "{name}");
        }
    }

    #[test]
    fn limits_are_lowered_and_never_raised() {
        let falcon = Profile::bundled("falcon").expect("bundled");
        let mut limits = LimitConfig::default();
        falcon.lower_limits(&mut limits);
        assert_eq!(limits.max_force_n, 8.0);
        // With a workspace scale of three: a third of the cap of 1000 N/m.
        assert!((limits.max_stiffness_n_m - 1000.0 / 3.0).abs() < 1e-3);
        let before = limits;
        Profile::bundled("delta.3").expect("bundled").lower_limits(&mut limits);
        assert_eq!(limits, before);
        // 40 mm, times the scale of three, plus a tenth.
        assert!((falcon.largest_position_m() - 0.132).abs() < 1e-6);
    }

    #[test]
    fn the_error_for_an_unknown_name_lists_the_known_ones() {
        let refused = Profile::load("falcom").expect_err("no such profile").to_string();
        assert!(refused.contains("falcon") && refused.contains(".toml"), "{refused}");
    }
}
