//! The device of a scene: a force limit, or a profile that contains one.
//!
//! Only the force limit of a profile is read here; the host reads and checks the rest.

use std::path::{Path, PathBuf};

use toml::Spanned;

use super::file::DeviceTable;
use super::place::{Place, positive};
use crate::error::{InputError, nearest_word};

/// The part of a profile that is read here.
#[derive(Debug, serde::Deserialize)]
struct ProfileFile {
    limits: LimitsTable,
}

#[derive(Debug, serde::Deserialize)]
struct LimitsTable {
    max_force_n: Spanned<f64>,
}

/// Force limit, N: configurations with a larger force are terminating. Infinite without a device.
pub(super) fn max_force_n(place: &Place, device: Option<&Spanned<DeviceTable>>) -> Result<f64, InputError> {
    let Some(device) = device else { return Ok(f64::INFINITY) };
    let DeviceTable { max_force_n, profile } = device.get_ref();
    let named = profile.as_ref().map(|name| of_profile(place, name).map(|force_n| (name, force_n)));
    match (max_force_n, named.transpose()?) {
        (None, None) => {
            let fix = "add `max_force_n`, or the `profile` of a device";
            Err(place.error(device.span(), "`max_force_n` is missing", fix))
        }
        (None, Some((_, force_n))) => Ok(force_n),
        (Some(given), named) => {
            let given_n = positive(place, "max_force_n", given)?;
            match named {
                Some((name, force_n)) if given_n > force_n => {
                    let what = format!(
                        "`max_force_n` = {given_n} is beyond the {force_n} N of \"{}\"",
                        name.get_ref()
                    );
                    let fix = format!("give {force_n} or less, or leave it out");
                    Err(place.error(given.span(), what, fix))
                }
                _ => Ok(given_n),
            }
        }
    }
}

/// Path of the profile's file; `None` for a bundled profile.
pub(super) fn profile_file(place: &Place, name: &Spanned<String>) -> Option<PathBuf> {
    name.get_ref().ends_with(".toml").then(|| place.relative(name.get_ref()))
}

/// The force limit of a bundled profile, or of a file in the scene's folder.
fn of_profile(place: &Place, name: &Spanned<String>) -> Result<f64, InputError> {
    let word = name.get_ref();
    if let Some(path) = profile_file(place, name) {
        let text = std::fs::read_to_string(&path).map_err(|error| {
            let mut unreadable = InputError::unreadable(&path, &error);
            if error.kind() == std::io::ErrorKind::NotFound {
                unreadable.fix.push_str(" (it is relative to the scene file)");
            }
            unreadable
        })?;
        return force_in(Place { path, text });
    }
    let bundled = palpate_devices::PROFILES.into_iter().find(|(known, _)| known == word);
    let Some((_, text)) = bundled else {
        let names = palpate_devices::PROFILES.map(|(known, _)| known);
        let guess = nearest_word(word, names).map(|guess| format!("did you mean \"{guess}\"? "));
        let fix =
            format!("{}({}, or a file that ends in .toml)", guess.unwrap_or_default(), names.join(", "));
        return Err(place.error(name.span(), format!("no device profile \"{word}\""), fix));
    };
    force_in(Place { path: Path::new(word).to_path_buf(), text: text.to_owned() })
}

fn force_in(profile: Place) -> Result<f64, InputError> {
    let file: ProfileFile = toml::from_str(&profile.text).map_err(|error| profile.explain(&error))?;
    positive(&profile, "max_force_n", &file.limits.max_force_n)
}
