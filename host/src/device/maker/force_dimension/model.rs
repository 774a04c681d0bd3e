//! Families of devices, by the type that the library gives.

use serde::{Deserialize, Serialize};

/// A family of devices with one profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Family {
    /// omega.3, omega.6, omega.7
    Omega,
    /// delta.3, delta.6
    Delta,
    /// sigma.3, sigma.7
    Sigma,
    /// lambda.3, lambda.6, lambda.7
    Lambda,
    /// Novint Falcon
    Falcon,
}

impl Family {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Omega, Self::Delta, Self::Sigma, Self::Lambda, Self::Falcon];

    /// Its name after `--device`; `falcon` is the driver of this project.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Omega => "omega",
            Self::Delta => "delta",
            Self::Sigma => "sigma",
            Self::Lambda => "lambda",
            Self::Falcon => "dhd-falcon",
        }
    }

    /// Its bundled profile.
    #[must_use]
    pub const fn profile(self) -> &'static str {
        match self {
            Self::Omega => "omega",
            Self::Delta => "delta.3",
            Self::Sigma => "sigma.7",
            Self::Lambda => "lambda.7",
            Self::Falcon => "dhd-falcon",
        }
    }

    /// The family of a type of the library. Source: the constants of dhdc.h, SDK 3.10 and 3.16.
    #[must_use]
    pub const fn of_type(number: i32) -> Option<Self> {
        match number {
            33..=37 => Some(Self::Omega),
            63 | 64 => Some(Self::Delta),
            104 | 105 | 206 => Some(Self::Sigma),
            108 | 109 | 131 | 132 | 203 => Some(Self::Lambda),
            60 => Some(Self::Falcon),
            _ => None,
        }
    }
}
