//! The device of a session, as `--device` names it. The text is parsed here and nowhere else.

use core::fmt;
use core::str::FromStr;
use std::path::PathBuf;

use palpate_host::device::maker::{Family, haply};

/// Speed of a serial line if the command line gives none.
pub(crate) const LINK_BAUD: u32 = 1_000_000;

/// A device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum DeviceSpec {
    /// `sim`, `sim:random:SEED` or `sim:FILE.csv`
    Simulated(Motion),
    /// `mouse`
    Mouse,
    /// `replay:FILE.mcap`
    Replay {
        /// The recording.
        file: PathBuf,
    },
    /// A device with motors.
    Hardware(Hardware),
}

/// How a simulated hand moves.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Motion {
    /// The tour.
    Tour,
    /// Random palpation with this seed.
    Random(u64),
    /// Along the way of a table.
    Way(PathBuf),
}

/// A device with motors.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Hardware {
    /// `polhem:PORT`
    Polhem {
        /// The serial port.
        port: String,
    },
    /// `falcon` or `falcon:FIRMWARE`
    Falcon {
        /// The firmware file.
        firmware: Option<PathBuf>,
    },
    /// `link:PORT` or `link:PORT@BAUD`
    Link {
        /// The serial port.
        port: String,
        /// Speed of the serial line.
        baud: u32,
    },
    /// `touch` or `touch:LIBRARY`
    Touch {
        /// The file of its maker's library.
        library: Option<PathBuf>,
    },
    /// `omega`, `delta`, `sigma`, `lambda` or `dhd-falcon`, each with `:LIBRARY` or without
    ForceDimension {
        /// Which of them.
        family: Family,
        /// The file of its maker's library.
        library: Option<PathBuf>,
    },
    /// `haply` or `haply:HOST:PORT`
    Haply {
        /// Address of its maker's service.
        address: Option<String>,
    },
}

impl DeviceSpec {
    /// The device with motors; `None` for any other.
    pub(crate) const fn hardware(&self) -> Option<&Hardware> {
        match self {
            Self::Hardware(hardware) => Some(hardware),
            Self::Simulated(_) | Self::Mouse | Self::Replay { .. } => None,
        }
    }

    /// The file that it reads.
    pub(crate) const fn file(&self) -> Option<&PathBuf> {
        match self {
            Self::Simulated(Motion::Way(file))
            | Self::Replay { file }
            | Self::Hardware(
                Hardware::Falcon { firmware: Some(file) }
                | Hardware::Touch { library: Some(file) }
                | Hardware::ForceDimension { library: Some(file), .. },
            ) => Some(file),
            _ => None,
        }
    }
}

impl Hardware {
    /// The name of its bundled profile.
    pub(crate) const fn own_profile(&self) -> &'static str {
        match self {
            Self::Polhem { .. } => "polhem",
            Self::Falcon { .. } => "falcon",
            Self::Link { .. } => "link",
            Self::Touch { .. } => "touch",
            Self::ForceDimension { family, .. } => family.profile(),
            Self::Haply { .. } => "haply",
        }
    }
}

/// A text that names no device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct NoDevice(String);

impl fmt::Display for NoDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "no device `{}`; choose sim, sim:random:SEED, sim:FILE.csv, mouse, polhem:PORT, falcon[:FIRMWARE], touch[:LIBRARY], omega, delta, sigma, lambda or dhd-falcon[:LIBRARY], haply[:HOST:PORT], link:PORT[@BAUD] or replay:FILE.mcap",
            self.0
        )
    }
}

impl core::error::Error for NoDevice {}

impl FromStr for DeviceSpec {
    type Err = NoDevice;

    fn from_str(text: &str) -> Result<Self, NoDevice> {
        let (kind, rest) = text.split_once(':').map_or((text, None), |(kind, rest)| (kind, Some(rest)));
        let unknown = || NoDevice(text.into());
        match (kind, rest) {
            ("sim", None) => Ok(Self::Simulated(Motion::Tour)),
            ("sim", Some(rest)) => {
                let motion = match rest.strip_prefix("random:") {
                    Some(seed) => Motion::Random(seed.parse().map_err(|_| unknown())?),
                    None if rest.ends_with(".csv") => Motion::Way(rest.into()),
                    None => return Err(unknown()),
                };
                Ok(Self::Simulated(motion))
            }
            ("mouse", None) => Ok(Self::Mouse),
            ("replay", Some(file)) if !file.is_empty() => Ok(Self::Replay { file: file.into() }),
            ("polhem", Some(port)) if !port.is_empty() => {
                Ok(Self::Hardware(Hardware::Polhem { port: port.into() }))
            }
            ("falcon", firmware) => {
                Ok(Self::Hardware(Hardware::Falcon { firmware: firmware.map(PathBuf::from) }))
            }
            ("touch", library) if library != Some("") => {
                Ok(Self::Hardware(Hardware::Touch { library: library.map(PathBuf::from) }))
            }
            ("haply", None) => Ok(Self::Hardware(Hardware::Haply { address: None })),
            ("haply", Some(address)) if address.parse::<haply::Address>().is_ok() => {
                Ok(Self::Hardware(Hardware::Haply { address: Some(address.into()) }))
            }
            ("link", Some(place)) if !place.is_empty() => {
                // The name of a port may contain an @.
                let with_baud =
                    place.rsplit_once('@').and_then(|(port, baud)| Some((port, baud.parse().ok()?)));
                let (port, baud) = with_baud.filter(|(_, baud)| *baud > 0).unwrap_or((place, LINK_BAUD));
                Ok(Self::Hardware(Hardware::Link { port: port.into(), baud }))
            }
            (kind, library) => {
                let is_named = |family: &Family| family.name() == kind && library != Some("");
                let family = Family::ALL.into_iter().find(is_named);
                let library = library.map(PathBuf::from);
                let of = |family| Self::Hardware(Hardware::ForceDimension { family, library });
                family.map(of).ok_or_else(unknown)
            }
        }
    }
}

impl Hardware {
    /// Whether a process of its own holds its maker's library or service.
    pub(crate) const fn has_proxy(&self) -> bool {
        matches!(self, Self::Touch { .. } | Self::ForceDimension { .. } | Self::Haply { .. })
    }

    /// Whether both are one device: a serial port by any of its names, or a device of the same maker.
    pub(crate) fn is_same_device(&self, other: &Self) -> bool {
        match (self.port(), other.port()) {
            (None, None) => core::mem::discriminant(self) == core::mem::discriminant(other),
            (Some(one), Some(other)) => one == other,
            _ => false,
        }
    }

    /// The serial port behind all links to it, or its name if it is not there.
    fn port(&self) -> Option<PathBuf> {
        match self {
            Self::Polhem { port } | Self::Link { port, .. } => {
                Some(std::fs::canonicalize(port).unwrap_or_else(|_| port.into()))
            }
            Self::Falcon { .. } | Self::Touch { .. } | Self::ForceDimension { .. } | Self::Haply { .. } => {
                None
            }
        }
    }
}

impl fmt::Display for Hardware {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Polhem { port } => write!(f, "polhem:{port}"),
            Self::Falcon { firmware: None } => f.write_str("falcon"),
            Self::Falcon { firmware: Some(file) } => write!(f, "falcon:{}", file.display()),
            Self::Touch { library: None } => f.write_str("touch"),
            Self::Touch { library: Some(file) } => write!(f, "touch:{}", file.display()),
            Self::ForceDimension { family, library: None } => f.write_str(family.name()),
            Self::ForceDimension { family, library: Some(file) } => {
                write!(f, "{}:{}", family.name(), file.display())
            }
            Self::Haply { address: None } => f.write_str("haply"),
            Self::Haply { address: Some(address) } => write!(f, "haply:{address}"),
            Self::Link { port, baud } if *baud == LINK_BAUD => write!(f, "link:{port}"),
            Self::Link { port, baud } => write!(f, "link:{port}@{baud}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_is_parsed() {
        let link = |port: &str, baud| Hardware::Link { port: port.into(), baud };
        for (text, expected) in [
            ("link:/dev/ttyACM0", link("/dev/ttyACM0", LINK_BAUD)),
            ("link:/dev/ttyUSB0@3000000", link("/dev/ttyUSB0", 3_000_000)),
            ("link:/dev/a@b", link("/dev/a@b", LINK_BAUD)),
            ("link:/dev/a@0", link("/dev/a@0", LINK_BAUD)),
            ("polhem:/dev/ttyACM1", Hardware::Polhem { port: "/dev/ttyACM1".into() }),
            ("falcon", Hardware::Falcon { firmware: None }),
            ("falcon:a:b.bin", Hardware::Falcon { firmware: Some("a:b.bin".into()) }),
            ("touch", Hardware::Touch { library: None }),
            ("haply", Hardware::Haply { address: None }),
            ("haply:lab-pc:10001", Hardware::Haply { address: Some("lab-pc:10001".into()) }),
            ("touch:/opt/libHD.so", Hardware::Touch { library: Some("/opt/libHD.so".into()) }),
            ("sigma", Hardware::ForceDimension { family: Family::Sigma, library: None }),
            (
                "omega:/opt/libdrd.so.3",
                Hardware::ForceDimension { family: Family::Omega, library: Some("/opt/libdrd.so.3".into()) },
            ),
        ] {
            let spec: DeviceSpec = text.parse().expect("a device");
            assert_eq!(spec.hardware(), Some(&expected), "{text}");
            assert_eq!(expected.to_string().parse(), Ok(spec), "{text}");
        }
        assert_eq!("sim".parse(), Ok(DeviceSpec::Simulated(Motion::Tour)));
        assert_eq!("sim:random:7".parse(), Ok(DeviceSpec::Simulated(Motion::Random(7))));
        assert_eq!("sim:a/b.csv".parse(), Ok(DeviceSpec::Simulated(Motion::Way("a/b.csv".into()))));
        assert_eq!("mouse".parse(), Ok(DeviceSpec::Mouse));
        assert_eq!("replay:a.mcap".parse(), Ok(DeviceSpec::Replay { file: "a.mcap".into() }));
    }

    #[test]
    fn a_text_that_names_no_device_is_refused_with_the_list() {
        for text in [
            "",
            "simm",
            "sim:",
            "sim:random:x",
            "sim:random:-1",
            "polhem",
            "polhem:",
            "link",
            "replay:",
            "mouse:2",
            "haply:",
            "omega:",
            "touch:",
            "haply:lab-pc",
        ] {
            let refused = text.parse::<DeviceSpec>().expect_err(text).to_string();
            assert!(refused.starts_with(&format!("no device `{text}`")) && refused.contains("link:PORT"));
        }
    }
    #[test]
    fn a_serial_port_is_one_device_under_all_its_names() {
        let folder = tempfile::tempdir().expect("a folder");
        let [port, alias] = ["ttyACM0", "by-id"].map(|name| folder.path().join(name));
        std::fs::write(&port, "").expect("written");
        std::os::unix::fs::symlink(&port, &alias).expect("a link");
        let hardware = |text: String| match text.parse::<DeviceSpec>() {
            Ok(DeviceSpec::Hardware(hardware)) => hardware,
            other => panic!("{other:?}"),
        };
        let one = hardware(format!("polhem:{}", port.display()));
        for same in ["polhem:", "link:"].map(|kind| hardware(format!("{kind}{}", alias.display()))) {
            assert!(one.is_same_device(&same) && same.is_same_device(&one), "{same}");
        }
        let falcon = hardware("falcon".into());
        assert!(!one.is_same_device(&falcon) && !one.is_same_device(&hardware("polhem:/dev/ttyACM7".into())));
        assert!(falcon.is_same_device(&hardware("falcon:a.bin".into())));
        let touch = hardware("touch".into());
        assert!(touch.is_same_device(&hardware("touch:a.so".into())) && !touch.is_same_device(&falcon));
        assert!(!touch.is_same_device(&hardware("haply".into())));
    }
}
