//! The device behind the stand-in: numbers in a file.

use nix::time::{ClockId, clock_gettime};
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Environment variable with the name of the file.
pub const VARIABLE: &str = "PALPATE_FAKE_DEVICE";

/// A number of the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Field {
    /// Position along an axis: mm of a Touch, m of a Force Dimension device.
    Position(u64),
    /// Bits of the buttons.
    Buttons,
    /// State of the calibration; 0 for good.
    Calibration,
    /// Error that the next frames find, and how often it was set.
    Error,
    /// See [`Field::Error`].
    Errors,
    /// Whether the scheduler stands still.
    Stalled,
    /// Error of the opening; 0 for none.
    Refused,
    /// Force of the last frame along an axis, N.
    Force(u64),
    /// Number of frames.
    Frames,
    /// Time of the last frame with a force, ns.
    Forced,
    /// Whether the time is that of [`Field::Now`], and [`crate::Stub::step`] takes the place of the library's threads.
    Stepped,
    /// Time of a device that is stepped, ns.
    Now,
    /// Type of a Force Dimension device; an omega.3 if it is 0.
    Kind,
    /// It has no power.
    Unpowered,
    /// Its position is not initialised.
    Uninitialized,
    /// Motions of the arm by itself.
    Motions,
    /// Why its motors go off, and how often that was set.
    OffCause,
    /// See [`Field::OffCause`].
    Offs,
    /// Positions come from the library's memory.
    Cached,
    /// Error of every call, or of every frame of a Touch, from now on; 0 for none.
    Failing,
    /// Its firmware has no watchdog.
    Unwatched,
    /// How the grip is turned about z, rad.
    Turn,
    /// Whether the motors are on.
    MotorsOn,
    /// Largest force that the library lets through, N.
    MaxForce,
    /// Its watchdog cannot be set: the steps that it keeps.
    FixedWatchdog,
    /// Its brake at high speed is off.
    Unbraked,
    /// Time of the last command to the firmware, ns.
    Commanded,
    /// The watchdog of the firmware, in steps of 125 us; 0 if it is off.
    Watchdog,
}

impl Field {
    const fn place(self) -> u64 {
        8 * match self {
            Self::Position(axis) => axis,
            Self::Buttons => 3,
            Self::Calibration => 4,
            Self::Error => 5,
            Self::Errors => 6,
            Self::Stalled => 7,
            Self::Refused => 8,
            Self::Force(axis) => 9 + axis,
            Self::Frames => 12,
            Self::Forced => 13,
            Self::Stepped => 14,
            Self::Now => 15,
            Self::Kind => 16,
            Self::Unpowered => 17,
            Self::Uninitialized => 18,
            Self::Motions => 19,
            Self::OffCause => 20,
            Self::Offs => 21,
            Self::Cached => 22,
            Self::Failing => 23,
            Self::Unwatched => 24,
            Self::Turn => 25,
            Self::Commanded => 26,
            Self::Watchdog => 27,
            Self::MotorsOn => 28,
            Self::FixedWatchdog => 29,
            Self::Unbraked => 30,
            Self::MaxForce => 31,
        }
    }
}

/// Either end of the cable.
#[derive(Debug)]
pub struct Cable(File);

impl Cable {
    /// A new device whose numbers are zero.
    pub fn create(file: &Path) -> io::Result<Self> {
        let device = File::options().read(true).write(true).create_new(true).open(file)?;
        device.set_len(512)?;
        Ok(Self(device))
    }

    /// The same for a file that is there: its numbers are zero again, and it is stepped.
    pub fn renew(file: &Path) -> io::Result<Self> {
        let cable = Self::open(file)?;
        cable.0.set_len(0)?;
        cable.0.set_len(512)?;
        cable.set_whole(Field::Stepped, 1);
        Ok(cable)
    }

    /// The library's end.
    pub fn open(file: &Path) -> io::Result<Self> {
        File::options().read(true).write(true).open(file).map(Self)
    }

    /// A whole number; zero if the cable is cut.
    #[must_use]
    pub fn whole(&self, field: Field) -> u64 {
        let mut bytes = [0; 8];
        match self.0.read_exact_at(&mut bytes, field.place()) {
            Ok(()) => u64::from_le_bytes(bytes),
            Err(_) => 0,
        }
    }

    /// Sets a whole number.
    pub fn set_whole(&self, field: Field, number: u64) {
        let _ = self.0.write_all_at(&number.to_le_bytes(), field.place());
    }

    /// A quantity.
    #[must_use]
    pub fn quantity(&self, field: Field) -> f64 {
        f64::from_bits(self.whole(field))
    }

    /// Sets a quantity.
    pub fn set_quantity(&self, field: Field, number: f64) {
        self.set_whole(field, number.to_bits());
    }

    /// Time of the device, ns.
    #[must_use]
    pub fn time_ns(&self) -> u64 {
        if self.whole(Field::Stepped) == 0 { Self::now_ns() } else { self.whole(Field::Now) }
    }

    /// What the firmware of a Force Dimension device does by itself, whether or not the library still runs: without a command for
    /// the time of its watchdog there is no force. Returns whether that is so.
    #[must_use]
    pub fn is_watched_off(&self) -> bool {
        const STEP_NS: u64 = 125_000;
        let (now_ns, limit_ns) = (self.time_ns(), STEP_NS * self.whole(Field::Watchdog));
        if limit_ns == 0 || (0..3).all(|axis| self.quantity(Field::Force(axis)) == 0.0) {
            return false;
        }
        let is_silent = now_ns.saturating_sub(self.whole(Field::Commanded)) > limit_ns;
        if is_silent {
            (0..3).for_each(|axis| self.set_quantity(Field::Force(axis), 0.0));
        } else {
            self.set_whole(Field::Forced, now_ns);
        }
        is_silent
    }

    /// The cable that the environment names.
    #[must_use]
    pub fn of_environment() -> Option<Self> {
        std::env::var_os(VARIABLE).and_then(|file| Self::open(Path::new(&file)).ok())
    }

    /// Time of all processes, ns.
    #[must_use]
    pub fn now_ns() -> u64 {
        let time = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("it has one");
        time.tv_sec() as u64 * 1_000_000_000 + time.tv_nsec() as u64
    }
}
