//! What a device can do, as a TOML file says it: limits, mechanism, link, workspace.
//!
//! Bundled ones go by their name; any other is a file. What nobody has measured is left out of a profile, and then the cautious
//! default holds instead of a guess; guesses stand under `[simulation]`, and no limit stands on them.

mod cap;
mod file;

#[path = "../../../../assets/devices/bundled.rs"]
mod bundled;

pub use cap::{
    CapReason, CapVerdict, DEFAULT_CAP_N_M, HARD_CAP_N_M, LATENESS_ALLOWANCE, StiffnessCap, Timing,
};
pub use file::ProfileError;

use super::link::Capstan;
use super::workspace::{Reach, Workspace};
use palpate_core::{LimitConfig, Vec3};
use std::path::Path;

/// A device's profile.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Name for people.
    pub name: String,
    /// Largest force it renders, N.
    pub max_force_n: f32,
    /// Largest stiffness its maker (or whoever lists it) names, N/m of the device; the cap is never above it.
    pub max_stiffness_n_m: f32,
    /// Cycles a second.
    pub rate_hz: f32,
    /// What is known of the mechanism.
    pub mechanism: Mechanism,
    /// How long a position is on its way to this program, us.
    pub position_delay_us: u32,
    /// How long a force is on its way from this program to the hand, us.
    pub force_delay_us: u32,
    /// Encoder counts to metres and newtons to torques, for a driver that must do it itself: that of the device link.
    pub capstan: Option<Capstan>,
    /// Where the handle can go, device frame, round the mapping's device origin.
    pub reach: Reach,
    /// Where that lies in the model.
    pub workspace: Workspace,
    /// What was found by trying on the device itself.
    pub calibration: Calibration,
    /// What the simulation assumes where nothing is known.
    pub assumed: Assumed,
}

/// What differs from one device of a kind to the next, found at its first power-up (docs/devices.md).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// Counts of each motor to one N m at its crank, with their sign. Of a Falcon.
    pub counts_per_n_m: [f32; 3],
    /// Force along the device's +y that carries the weight of the handle, N.
    pub gravity_n: f32,
}

impl Default for Calibration {
    fn default() -> Self {
        // Nobody has calibrated anything; libnifalcon's figure.
        Self { counts_per_n_m: [-10_000.0; 3], gravity_n: 0.0 }
    }
}

/// What is known of a mechanism; `None` is not known.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mechanism {
    /// Effective mass at the handle, kg.
    pub mass_kg: Option<f32>,
    /// Viscous damping at the handle.
    pub damping: Option<Damping>,
    /// Coulomb friction at the handle, N.
    pub coulomb_n: Option<f32>,
    /// Step of the position at the handle, the coarsest, m.
    pub encoder_quantum_m: Option<f32>,
    /// Step of the force at the handle, N.
    pub motor_quantum_n: Option<f32>,
}

/// Damping that the cap on the stiffness may stand on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Damping {
    /// N s/m.
    pub n_s_m: f32,
    /// Measured; otherwise a conservative figure.
    pub measured: bool,
}

/// Figures for the simulation only.
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
        // A light mechanism that takes no energy away: nothing shakes more easily.
        Self { mass_kg: 0.1, damping_n_s_m: 0.0, coulomb_n: 0.0 }
    }
}

impl Profile {
    /// The bundled profile of that name, or the one in a file whose name ends in `.toml`.
    pub fn load(name_or_file: &str) -> Result<Self, ProfileError> {
        if name_or_file.ends_with(".toml") {
            return file::read(Path::new(name_or_file));
        }
        Self::bundled(name_or_file).ok_or_else(|| {
            let names: Vec<&str> = Self::names().collect();
            ProfileError {
                file: name_or_file.into(),
                line: None,
                what: "no device profile of this name".into(),
                mend: format!("choose {}, or give a file that ends in .toml", names.join(", ")),
            }
        })
    }

    /// A profile that comes with Palpate.
    #[must_use]
    pub fn bundled(name: &str) -> Option<Self> {
        let (name, text) = bundled::PROFILES.into_iter().find(|(known, _)| *known == name)?;
        // A test reads them all.
        Some(file::parse(Path::new(name), text).expect("bundled profiles are sound"))
    }

    /// Names of those.
    pub fn names() -> impl Iterator<Item = &'static str> {
        bundled::PROFILES.into_iter().map(|(name, _)| name)
    }

    /// Reads a profile from text; `path` is where messages say it stands.
    pub fn parse(path: &Path, text: &str) -> Result<Self, ProfileError> {
        file::parse(path, text)
    }

    /// Time between two cycles, us.
    #[must_use]
    pub fn period_us(&self) -> u32 {
        (1e6 / f64::from(self.rate_hz)).round().max(1.0) as u32
    }

    /// The same device in a loop with another period: the cap, the simulation and the verdict are then about that.
    #[must_use]
    pub fn at_period(self, period_us: u32) -> Self {
        Self { rate_hz: (1e6 / f64::from(period_us.max(1))) as f32, ..self }
    }

    /// Largest stiffness of the MODEL that may be rendered, N/m: the cap, divided by the metres of the model to one of the device.
    #[must_use]
    pub fn max_model_stiffness_n_m(&self) -> f32 {
        self.cap().n_m / self.workspace.scale
    }

    /// Force that carries the weight of the handle, model frame, N.
    #[must_use]
    pub fn carried_n(&self) -> Vec3 {
        // The model's axes in device coordinates: what of each is up.
        self.workspace.axes.map(|axis| axis[1] * self.calibration.gravity_n)
    }

    /// Tightens limits to what the device can do; none is ever loosened.
    pub fn tighten(&self, limits: &mut LimitConfig) {
        limits.max_force_n = limits.max_force_n.min(self.max_force_n);
        limits.max_stiffness_n_m = limits.max_stiffness_n_m.min(self.max_model_stiffness_n_m());
    }

    /// Half-width of the box round the model's origin that holds every place the handle can be at, m.
    ///
    /// With a tenth of the workspace's size to spare, because a mechanism goes a little beyond what is listed.
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
    fn every_bundled_profile_is_sound_and_says_what_is_listed() {
        // Force and stiffness as CHAI3D lists them, in newtons and newtons a metre.
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
            let profile = Profile::load(name).expect("sound");
            let cap = profile.cap();
            assert!(cap.n_m <= HARD_CAP_N_M.min(profile.max_stiffness_n_m), "{name}: {cap:?}");
            if profile.mechanism.damping.is_none() {
                assert!(cap.n_m <= DEFAULT_CAP_N_M, "{name} states no damping: {cap:?}");
            }
            assert_eq!(profile.period_us(), 1_000, "{name}");
        }
        assert!(Profile::names().is_sorted(), "as `--profile` lists them");
        for name in ["falcon", "polhem", "link", "touch", "omni"] {
            // Nobody has measured it here; who writes a figure in must change this line, and the comment in the profile.
            assert_eq!(Profile::bundled(name).expect("bundled").mechanism.damping, None, "{name}");
        }
    }

    #[test]
    fn limits_are_tightened_and_never_loosened() {
        let falcon = Profile::bundled("falcon").expect("bundled");
        let mut limits = LimitConfig::default();
        falcon.tighten(&mut limits);
        assert_eq!(limits.max_force_n, 8.0);
        // Three metres of the model to one of the hand: a third of the 1000 N/m that the hand may feel.
        assert!((limits.max_stiffness_n_m - 1000.0 / 3.0).abs() < 1e-3);
        let before = limits;
        Profile::bundled("delta.3").expect("bundled").tighten(&mut limits);
        assert_eq!(limits, before);
        // 40 mm, three times, and a tenth.
        assert!((falcon.largest_position_m() - 0.132).abs() < 1e-6);
    }

    #[test]
    fn an_unknown_name_lists_the_known() {
        let refused = Profile::load("falcom").expect_err("no such profile").to_string();
        assert!(refused.contains("falcon") && refused.contains(".toml"), "{refused}");
    }
}
