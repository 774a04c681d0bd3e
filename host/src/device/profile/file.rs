//! The file format of a profile. Unknown keys are errors, and every error names file, line and fix.

use super::{Assumed, Buttons, Calibration, Damping, Mechanism, Profile};
use crate::device::capstan::Capstan;
use crate::device::workspace::{Reach, Workspace};
use core::fmt;
use core::ops::{Range, RangeInclusive};
use palpate_core::{Vec3, vec3};
use std::path::{Path, PathBuf};
use toml::Spanned;

/// Error in a profile, its position and its fix.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProfileError {
    /// The file, or the name of a profile.
    pub file: PathBuf,
    /// 1-based line, if the error has a position.
    pub line: Option<usize>,
    /// What is wrong.
    pub what: String,
    /// How to fix it.
    pub fix: String,
}

impl fmt::Display for ProfileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line = self.line.map_or_else(String::new, |line| format!(":{line}"));
        let text = format!("{}{line}: {}; {}", self.file.display(), self.what, self.fix);
        // One line, whatever the parts contain: scripts read errors line by line.
        f.write_str(&text.replace(['\n', '\r'], " "))
    }
}

impl core::error::Error for ProfileError {}

type Number = Spanned<f64>;
type Numbers = Spanned<Three<f64>>;

/// A list of three. As an array, serde would accept a longer one and leave out the rest.
#[derive(serde::Deserialize)]
#[serde(try_from = "Vec<T>")]
struct Three<T>([T; 3]);

impl<T> TryFrom<Vec<T>> for Three<T> {
    type Error = String;

    fn try_from(all: Vec<T>) -> Result<Self, String> {
        let wrong = |all: Vec<T>| format!("invalid length {}, expected an array of length 3", all.len());
        all.try_into().map(Self).map_err(wrong)
    }
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct ProfileFile {
    name: Spanned<String>,
    limits: LimitsTable,
    #[serde(default)]
    mechanism: MechanismTable,
    #[serde(default)]
    link: LinkTable,
    capstan: Option<CapstanTable>,
    workspace: Spanned<WorkspaceTable>,
    #[serde(default)]
    mapping: MappingTable,
    #[serde(default)]
    calibration: CalibrationTable,
    #[serde(default)]
    buttons: ButtonsTable,
    #[serde(default)]
    simulation: SimulationTable,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct LimitsTable {
    max_force_n: Number,
    max_stiffness_n_m: Number,
    rate_hz: Number,
}

#[derive(Default, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct MechanismTable {
    mass_kg: Option<Number>,
    damping: Option<DampingTable>,
    coulomb_n: Option<Number>,
    encoder_quantum_m: Option<Number>,
    motor_quantum_n: Option<Number>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct DampingTable {
    n_s_m: Number,
    measured: bool,
}

#[derive(Default, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct LinkTable {
    position_delay_us: Option<Spanned<i64>>,
    force_delay_us: Option<Spanned<i64>>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct CapstanTable {
    metres_per_turn: Numbers,
    origin_m: Numbers,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct WorkspaceTable {
    radius_m: Option<Number>,
    half_m: Option<Numbers>,
}

#[derive(Default, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct MappingTable {
    axes: Option<Spanned<Three<Three<f64>>>>,
    scale: Option<Number>,
    device_origin_m: Option<Numbers>,
    model_origin_m: Option<Numbers>,
}

#[derive(Default, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct CalibrationTable {
    counts_per_n_m: Option<Numbers>,
    gravity_n: Option<Number>,
}

#[derive(Default, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct ButtonsTable {
    arm: Option<Spanned<i64>>,
    grasp: Option<Spanned<i64>>,
}

#[derive(Default, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct SimulationTable {
    mass_kg: Option<Number>,
    damping_n_s_m: Option<Number>,
    coulomb_n: Option<Number>,
}

/// Range of the rate, Hz. Below it one or two samples would reach the age of a fault; above it the threads of
/// this program cannot wake in time.
const RATES_HZ: Range<f64> = 400.0..10_000.0;

/// Range of a motor's scale, counts per N m: a tenth to ten times the uncalibrated value. A value outside is
/// a mistake.
const COUNTS_PER_N_M: RangeInclusive<f64> = 1e3..=1e5;
/// Range of a handle's path per turn of a drum, m: from a screw thread to a drum of arm's width.
const METRES_PER_TURN: Range<f64> = 1e-4..1.0;

/// Longest delay of a link, us. A delay of ten milliseconds is a fault of the controller.
const MAX_DELAY_US: i64 = 9_000;

/// Reads a profile from a file.
pub(super) fn read(path: &Path) -> Result<Profile, ProfileError> {
    let text = std::fs::read_to_string(path).map_err(|error| ProfileError {
        file: path.into(),
        line: None,
        what: format!("cannot read the device profile ({error})"),
        fix: "check the path".into(),
    })?;
    parse(path, &text)
}

/// Reads a profile from text.
pub(super) fn parse(path: &Path, text: &str) -> Result<Profile, ProfileError> {
    let place = Place { path, text };
    let file: ProfileFile = toml::from_str(text).map_err(|error| place.explain(&error))?;
    let ProfileFile {
        name,
        limits,
        mechanism,
        link,
        capstan,
        workspace,
        mapping,
        calibration,
        buttons,
        simulation,
    } = file;
    if name.get_ref().is_empty() {
        return Err(place.error(name.span(), "the name is empty", "name the device"));
    }
    let rate_hz = place.positive("rate_hz", &limits.rate_hz)?;
    if !RATES_HZ.contains(&f64::from(rate_hz)) {
        let fix = format!("give {} to {} Hz", RATES_HZ.start, RATES_HZ.end);
        return Err(place.error(limits.rate_hz.span(), format!("`rate_hz` = {rate_hz}"), fix));
    }
    let twice = [
        (&mechanism.mass_kg, &simulation.mass_kg, "mass_kg"),
        (&mechanism.coulomb_n, &simulation.coulomb_n, "coulomb_n"),
        (&mechanism.damping.as_ref().map(|d| d.n_s_m.clone()), &simulation.damping_n_s_m, "damping_n_s_m"),
    ];
    for (known, assumed, key) in twice {
        if let (Some(_), Some(assumed)) = (known, assumed) {
            let what = format!("`{key}` is assumed under [simulation] but [mechanism] states it");
            return Err(place.error(assumed.span(), what, "remove it there"));
        }
    }
    let default = Assumed::default();
    Ok(Profile {
        name: name.into_inner(),
        max_force_n: place.positive("max_force_n", &limits.max_force_n)?,
        max_stiffness_n_m: place.positive("max_stiffness_n_m", &limits.max_stiffness_n_m)?,
        rate_hz,
        position_delay_us: place.delay_us("position_delay_us", link.position_delay_us.as_ref())?,
        force_delay_us: place.delay_us("force_delay_us", link.force_delay_us.as_ref())?,
        reach: place.reach(&workspace)?,
        workspace: place.mapping(&mapping)?,
        calibration: place.calibration(&calibration, *limits.max_force_n.get_ref())?,
        capstan: capstan.map(|table| place.capstan(&table)).transpose()?,
        buttons: Buttons {
            arm: place.button("arm", buttons.arm.as_ref())?,
            grasp: place.button("grasp", buttons.grasp.as_ref())?,
        },
        assumed: Assumed {
            mass_kg: place.optional("mass_kg", simulation.mass_kg.as_ref())?.unwrap_or(default.mass_kg),
            damping_n_s_m: place
                .optional("damping_n_s_m", simulation.damping_n_s_m.as_ref())?
                .unwrap_or(default.damping_n_s_m),
            coulomb_n: place
                .optional("coulomb_n", simulation.coulomb_n.as_ref())?
                .unwrap_or(default.coulomb_n),
        },
        mechanism: place.mechanism(mechanism)?,
    })
}

/// Converts byte spans to lines of a file.
struct Place<'t> {
    path: &'t Path,
    text: &'t str,
}

impl Place<'_> {
    fn error(&self, span: Range<usize>, what: impl Into<String>, fix: impl Into<String>) -> ProfileError {
        let before = self.text.as_bytes().iter().take(span.start);
        ProfileError {
            file: self.path.into(),
            line: Some(1 + before.filter(|&&byte| byte == b'\n').count()),
            what: what.into(),
            fix: fix.into(),
        }
    }

    /// Rephrases an error of the parser.
    fn explain(&self, error: &toml::de::Error) -> ProfileError {
        let message = error.message();
        let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
        let (what, fix) = match (message.split(' ').next(), quoted.split_first()) {
            (Some("unknown"), Some((key, allowed))) => {
                (format!("unknown key `{key}`"), format!("remove it (allowed here: {})", allowed.join(", ")))
            }
            (Some("missing"), Some((key, _))) => {
                (format!("`{key}` is missing"), format!("add `{key}` (docs/devices.md, Profiles)"))
            }
            (Some("invalid"), _) => (message.to_owned(), "write a value of the expected type".into()),
            _ => (format!("not valid TOML ({message})"), "correct the syntax".into()),
        };
        self.error(error.span().unwrap_or(0..0), what, fix)
    }

    fn positive(&self, key: &str, value: &Number) -> Result<f32, ProfileError> {
        let number = *value.get_ref() as f32;
        if number.is_normal() && number > 0.0 {
            return Ok(number);
        }
        Err(self.error(
            value.span(),
            format!("`{key}` = {}", value.get_ref()),
            "give a finite number above zero, or omit an unknown value",
        ))
    }

    fn optional(&self, key: &str, value: Option<&Number>) -> Result<Option<f32>, ProfileError> {
        value.map(|value| self.positive(key, value)).transpose()
    }

    fn mechanism(&self, table: MechanismTable) -> Result<Mechanism, ProfileError> {
        let damping = table.damping.map(|DampingTable { n_s_m, measured }| {
            self.positive("n_s_m", &n_s_m).map(|n_s_m| Damping { n_s_m, measured })
        });
        Ok(Mechanism {
            mass_kg: self.optional("mass_kg", table.mass_kg.as_ref())?,
            damping: damping.transpose()?,
            coulomb_n: self.optional("coulomb_n", table.coulomb_n.as_ref())?,
            encoder_quantum_m: self.optional("encoder_quantum_m", table.encoder_quantum_m.as_ref())?,
            motor_quantum_n: self.optional("motor_quantum_n", table.motor_quantum_n.as_ref())?,
        })
    }

    fn delay_us(&self, key: &str, value: Option<&Spanned<i64>>) -> Result<u32, ProfileError> {
        let Some(value) = value else { return Ok(0) };
        let known = u32::try_from(*value.get_ref()).ok().filter(|us| i64::from(*us) <= MAX_DELAY_US);
        known.ok_or_else(|| {
            let what = format!("`{key}` = {}", value.get_ref());
            self.error(value.span(), what, format!("give 0 to {MAX_DELAY_US} us"))
        })
    }

    /// The bit of a button, which is numbered from 1; the first if none is given.
    fn button(&self, key: &str, value: Option<&Spanned<i64>>) -> Result<u32, ProfileError> {
        let Some(value) = value else { return Ok(1) };
        let number = u32::try_from(*value.get_ref()).ok().filter(|number| (1..=u32::BITS).contains(number));
        number.map(|number| 1 << (number - 1)).ok_or_else(|| {
            let what = format!("`{key}` = {}", value.get_ref());
            self.error(value.span(), what, format!("give the number of a button, 1 to {}", u32::BITS))
        })
    }

    fn calibration(&self, table: &CalibrationTable, max_force_n: f64) -> Result<Calibration, ProfileError> {
        let mut calibration = Calibration::default();
        if let Some(given) = &table.counts_per_n_m {
            if !given.get_ref().0.iter().all(|counts| COUNTS_PER_N_M.contains(&counts.abs())) {
                let what = format!("`counts_per_n_m` = {:?}", given.get_ref().0);
                let fix = "give each motor 1000 to 100000 counts per N m, with its sign (-10000 is the uncalibrated default)";
                return Err(self.error(given.span(), what, fix));
            }
            calibration.counts_per_n_m = given.get_ref().0.map(|counts| counts as f32);
        }
        if let Some(given) = &table.gravity_n {
            // A larger compensation would leave too little of the motors' force for rendering.
            if !(0.0..=0.5 * max_force_n).contains(given.get_ref()) {
                let what = format!("`gravity_n` = {}", given.get_ref());
                return Err(self.error(
                    given.span(),
                    what,
                    "give 0 to half of `max_force_n`: it acts upwards",
                ));
            }
            calibration.gravity_n = *given.get_ref() as f32;
        }
        Ok(calibration)
    }

    fn capstan(&self, table: &CapstanTable) -> Result<Capstan, ProfileError> {
        let (metres_per_turn, origin_m) = (table.metres_per_turn.get_ref().0, table.origin_m.get_ref().0);
        if !metres_per_turn.iter().all(|metres| METRES_PER_TURN.contains(&metres.abs())) {
            let fix = format!(
                "give {} to {} m per axis, negative if the handle moves down as the counts increase",
                METRES_PER_TURN.start, METRES_PER_TURN.end
            );
            let what = format!("`metres_per_turn` = {metres_per_turn:?}");
            return Err(self.error(table.metres_per_turn.span(), what, fix));
        }
        if !origin_m.iter().all(|metres| metres.is_finite()) {
            return Err(self.error(
                table.origin_m.span(),
                "`origin_m` is not finite",
                "give three finite numbers",
            ));
        }
        Ok(Capstan { metres_per_turn, origin_m })
    }

    fn reach(&self, table: &Spanned<WorkspaceTable>) -> Result<Reach, ProfileError> {
        match table.get_ref() {
            WorkspaceTable { radius_m: Some(radius), half_m: None } => {
                Ok(Reach::Ball { radius_m: self.positive("radius_m", radius)? })
            }
            WorkspaceTable { radius_m: None, half_m: Some(half) } => {
                let half_m = half.get_ref().0.map(|metres| metres as f32);
                if half_m.iter().all(|metres| metres.is_normal() && *metres > 0.0) {
                    return Ok(Reach::Box { half_m });
                }
                Err(self.error(half.span(), "`half_m` has no volume", "give three finite numbers above zero"))
            }
            _ => Err(self.error(
                table.span(),
                "[workspace] does not define one workspace",
                "give `radius_m`, or `half_m`",
            )),
        }
    }

    fn mapping(&self, table: &MappingTable) -> Result<Workspace, ProfileError> {
        let default = Workspace::default();
        let origin = |key: &str, given: &Option<Numbers>| -> Result<Vec3, ProfileError> {
            let Some(given) = given else { return Ok(vec3::ZERO) };
            let metres = given.get_ref().0.map(|metres| metres as f32);
            if vec3::is_finite(metres) {
                return Ok(metres);
            }
            Err(self.error(given.span(), format!("`{key}` is not finite"), "give three finite numbers"))
        };
        let axes = match &table.axes {
            None => default.axes,
            Some(given) => {
                let axes = given.get_ref().0.each_ref().map(|Three(axis)| axis.map(|x| x as f32));
                if !is_rotation(&axes) {
                    return Err(self.error(
                        given.span(),
                        "`axes` is not a rotation",
                        "give the model's x, y and z axes in device coordinates: of unit length, orthogonal, right-handed",
                    ));
                }
                axes
            }
        };
        Ok(Workspace {
            axes,
            scale: self.optional("scale", table.scale.as_ref())?.unwrap_or(default.scale),
            device_origin_m: origin("device_origin_m", &table.device_origin_m)?,
            model_origin_m: origin("model_origin_m", &table.model_origin_m)?,
        })
    }
}

/// Orthonormal and right-handed: with a reflection the hand would feel forces mirrored.
fn is_rotation(axes: &[Vec3; 3]) -> bool {
    const ROUNDING: f32 = 1e-3;
    let [x, y, z] = *axes;
    let unit = axes.iter().all(|axis| (vec3::norm(*axis) - 1.0).abs() < ROUNDING);
    unit && vec3::dot(x, y).abs() < ROUNDING && vec3::distance(vec3::cross(x, y), z) < ROUNDING
}

#[cfg(test)]
mod tests;
