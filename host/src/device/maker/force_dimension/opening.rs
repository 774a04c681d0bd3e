//! Opening a device: found, of the right family, with power and an initialised position, and with its limits set.

use super::api::{Dhd, DhdError, Id};
use super::model::Family;
use core::fmt;

/// The watchdog of the firmware in steps of 125 us: 10 ms.
pub(super) const WATCHDOG_STEPS: u8 = 80;

/// Why a device cannot be opened, in one line with the fix.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum OpenError {
    /// No device is connected.
    NoDevice,
    /// Another program has every device.
    InUse,
    /// It is of another family.
    Other {
        /// The library's name of it.
        name: String,
        /// Its family; `None` of an unknown type.
        family: Option<Family>,
    },
    /// It has no power.
    NoPower(String),
    /// Its position is not initialised, which moves the arm.
    MovesArm(String),
    /// Its position is not initialised, and this library cannot do it.
    Uninitialized(String),
    /// Its firmware does not take the watchdog over.
    Watchdog {
        /// Its name.
        name: String,
        /// What it has instead, in steps of 125 us.
        steps: u8,
    },
    /// A call failed.
    Failed {
        /// What was done.
        what: &'static str,
        /// The library's error.
        error: DhdError,
    },
}

impl fmt::Display for OpenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoDevice => f.write_str(
                "no Force Dimension device is connected; check cable and power, and the udev rule of its USB vendor 1451",
            ),
            Self::InUse => f.write_str("another program has the device; end it"),
            Self::Other { name, family: Some(family) } => {
                write!(f, "the device is a {name}; use --device {}", family.name())
            }
            Self::Other { name, family: None } => {
                write!(f, "the device is of a type that is not known here ({name}); report it")
            }
            Self::NoPower(name) => write!(f, "{name} has no power; switch it on"),
            Self::MovesArm(name) => write!(
                f,
                "{name} has not found its position, for which it moves its arm by itself; run its maker's initialisation, or start this on a terminal and consent"
            ),
            Self::Uninitialized(name) => {
                write!(f, "{name} has not found its position; run its maker's initialisation")
            }
            Self::Watchdog { name, steps } => write!(
                f,
                "{name} keeps its watchdog at {:.1} ms instead of 10 ms; update its firmware",
                f64::from(*steps) * 0.125
            ),
            Self::Failed { what, error: DhdError { code, text } } => {
                write!(f, "{what} fails ({text}, error {code}); {}", fix(*code))
            }
        }
    }
}

impl core::error::Error for OpenError {}

/// What to do about an error of the library.
const fn fix(code: i32) -> &'static str {
    match code {
        2 | 7 => "check the cable",
        3 | 20 => "end the other program that uses it",
        4 => "install the driver of its maker",
        10 => "its firmware or library is too old: update them",
        _ => "switch the device off and on",
    }
}

/// An opened device.
#[derive(Debug)]
pub(super) struct Found {
    pub(super) id: Id,
    /// Its name and the library's version.
    pub(super) name: String,
    /// What the user has to know of its safety functions.
    pub(super) remarks: Vec<String>,
}

/// Opens the first device that is free. Its arm moves by itself only if `may_move`.
pub(super) fn open(dhd: &Dhd, family: Family, may_move: bool, max_force_n: f32) -> Result<Found, OpenError> {
    let (connected, free) = dhd.counts();
    match (connected, free) {
        (0, _) => return Err(OpenError::NoDevice),
        (_, 0) => return Err(OpenError::InUse),
        _ => {}
    }
    let mut opened = Err(OpenError::InUse);
    for number in 0..connected {
        opened = dhd.open(number).map_err(|error| OpenError::Failed { what: "opening the device", error });
        if opened.is_ok() {
            break;
        }
    }
    let id = opened?;
    prepare(dhd, id, family, may_move, max_force_n).inspect_err(|_| dhd.close(id))
}

fn prepare(dhd: &Dhd, id: Id, family: Family, may_move: bool, max_force_n: f32) -> Result<Found, OpenError> {
    let of = |what: &'static str| move |error: DhdError| OpenError::Failed { what, error };
    let (number, name) = dhd.model(id);
    let found = Family::of_type(number);
    if found != Some(family) {
        return Err(OpenError::Other { name, family: found });
    }
    let status = dhd.status(id).map_err(of("reading its state"))?;
    if !status.has_power || !status.is_connected {
        return Err(OpenError::NoPower(name));
    }
    let mut remarks = Vec::new();
    // First of all: while the arm moves by itself, it is the firmware that stops it if this process ends.
    match dhd.set_watchdog(id, WATCHDOG_STEPS) {
        Ok(WATCHDOG_STEPS) => {}
        Ok(steps) => return Err(OpenError::Watchdog { name, steps }),
        Err(_) => remarks.push(format!(
            "{name}: its firmware has no watchdog: if this computer stops, its last force stays"
        )),
    }
    if !dhd.is_initialized(id) {
        match (dhd.can_move(), may_move) {
            (false, _) => return Err(OpenError::Uninitialized(name)),
            (true, false) => return Err(OpenError::MovesArm(name)),
            (true, true) => dhd.initialize_by_moving(id).map_err(of("initialising its position"))?,
        }
    }
    // Its unit and its factory setting are the device's own, so it is not set here.
    if dhd.velocity_threshold(id) == Ok(0) {
        remarks.push(format!(
            "{name}: another program has switched off its brake at high speed; switch the device off and on"
        ));
    }
    dhd.configure(id, f64::from(max_force_n)).map_err(of("setting its limits"))?;
    dhd.set_force(id, [0.0; 3]).map_err(of("sending a zero force"))?;
    Ok(Found { id, name: format!("{name} (Force Dimension {})", dhd.version()), remarks })
}
