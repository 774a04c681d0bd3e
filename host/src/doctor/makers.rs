//! Checks of the makers' libraries and services, and of their devices on USB. No device is opened.

use super::Check;
use super::Verdict::{Bad, Better, Good};
use super::probe::Probe;
use crate::device::maker::LibraryError;
use crate::device::maker::force_dimension::Dhd;
use crate::device::maker::haply::{Address, Found, HaplyError, look};
use crate::device::maker::touch::Hd;
use std::path::Path;

/// A maker.
struct Maker {
    /// Name of the check.
    name: &'static str,
    /// The library.
    library: &'static str,
    /// What it is for.
    devices: &'static str,
    /// Vendor of its devices on USB.
    vendor: &'static str,
    /// Loads the installed library, or this file; the answer is its file and what it says of itself.
    load: fn(Option<&Path>) -> Result<String, LibraryError>,
}

const MAKERS: [Maker; 2] = [
    Maker {
        name: "openhaptics",
        library: "OpenHaptics (libHD)",
        devices: "--device touch (3D Systems Touch, Phantom)",
        vendor: "2988",
        load: |given| Hd::load(given).map(|(_, file)| file.display().to_string()),
    },
    Maker {
        name: "libdhd",
        library: "Force Dimension's SDK (libdrd, libdhd)",
        devices: "--device omega, delta, sigma, lambda, dhd-falcon",
        vendor: "1451",
        load: |given| {
            let (dhd, file) = Dhd::load(given)?;
            let (connected, free) = dhd.counts();
            Ok(format!(
                "{} {}: it sees {connected} device(s), {free} of them free",
                file.display(),
                dhd.version()
            ))
        },
    },
];

impl Maker {
    /// Devices of this vendor on USB, whether or not a library is there.
    fn connected(&self, probe: &Probe) -> usize {
        const BASE: &str = "/sys/bus/usb/devices";
        let vendor = |device: &String| probe.read(&format!("{BASE}/{device}/idVendor"));
        probe.list(BASE).iter().filter_map(vendor).filter(|found| found == self.vendor).count()
    }

    fn check(&self, probe: &Probe, given: Option<&Path>) -> Check {
        let Self { name, library, devices, .. } = *self;
        match ((self.load)(given), self.connected(probe)) {
            (Ok(found), 0) => Check::new(name, Good, format!("{found}; for {devices}")),
            (Ok(found), count) => Check::new(name, Good, format!("{found}; {count} on USB; for {devices}")),
            (Err(LibraryError::Missing { .. }), 0) => {
                Check::new(name, Good, format!("{library} is not installed: only {devices} needs it"))
            }
            (Err(LibraryError::Missing { .. }), _) => {
                Check::new(name, Better, format!("a device is on USB, and {library} is not installed"))
                    .fix([&format!("install it from its maker, for {devices}")])
            }
            (Err(error), _) => {
                let found = error.to_string();
                let (found, fix) = found.split_once("; ").unwrap_or((&found, ""));
                Check::new(name, Bad, found).fix([fix])
            }
        }
    }
}

/// The service of Haply, which has its devices.
fn haply(found: Result<Found, HaplyError>) -> Check {
    const NAME: &str = "haply";
    match found {
        Ok(Found { version, devices }) => {
            let about = format!("Inverse Service {version}, for --device haply: ");
            let blocked = devices.iter().find_map(|(name, why)| Some((name, why.as_ref()?)));
            match (devices.first(), blocked) {
                (None, _) => Check::new(NAME, Good, about + "it has no Inverse3"),
                (Some(_), Some((name, why))) => {
                    let (why, fix) = why.split_once("; ").unwrap_or((why, ""));
                    Check::new(NAME, Better, format!("{about}{name} {why}")).fix([fix])
                }
                (Some((name, _)), None) => Check::new(NAME, Good, format!("{about}{name} is ready")),
            }
        }
        Err(HaplyError::NoService { .. }) => {
            Check::new(NAME, Good, "no Inverse Service runs: only --device haply (Inverse3) needs it")
        }
        Err(error) => {
            let found = error.to_string();
            let (found, fix) = found.split_once("; ").unwrap_or((&found, ""));
            Check::new(NAME, Bad, found).fix([fix])
        }
    }
}

/// One check for each maker whose library or service this program uses.
#[must_use]
pub fn makers(probe: &Probe) -> Vec<Check> {
    let libraries = MAKERS.iter().map(|maker| maker.check(probe, None));
    libraries.chain([haply(look(&Address::default()))]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pc(vendors: &[&str]) -> (tempfile::TempDir, Probe) {
        let root = tempfile::tempdir().expect("a folder");
        for (at, vendor) in vendors.iter().enumerate() {
            let device = root.path().join(format!("sys/bus/usb/devices/1-{at}"));
            std::fs::create_dir_all(&device).expect("a folder");
            std::fs::write(device.join("idVendor"), format!("{vendor}\n")).expect("a file");
        }
        let probe = Probe::with_root(root.path().into(), None);
        (root, probe)
    }

    #[test]
    fn a_device_without_its_library_is_told_with_the_fix() {
        let missing = |_: Option<&Path>| {
            Err(LibraryError::Missing { what: "a library", why: "libnone.so: No such file".into() })
        };
        let (_root, probe) = pc(&["1d6b", "1451"]);
        let [hd, dhd] = MAKERS.map(|maker| Maker { load: missing, ..maker }.check(&probe, None));
        assert!(hd.verdict == Good && hd.found.contains("only --device touch"), "{hd:?}");
        assert!(dhd.verdict == Better && dhd.found.contains("a device is on USB"), "{dhd:?}");
        assert!(dhd.fix.iter().any(|fix| fix.contains("install it from its maker")), "{dhd:?}");
    }

    #[test]
    fn a_service_is_told_with_what_its_device_lacks() {
        let with = |why: Option<&str>| {
            let devices = vec![("inverse3 049D".into(), why.map(Into::into))];
            haply(Ok(Found { version: "3.5.1".into(), devices }))
        };
        let ready = with(None);
        assert!(ready.verdict == Good && ready.found.ends_with("inverse3 049D is ready"), "{ready:?}");
        let off = with(Some("has no power; switch it on"));
        assert!(off.verdict == Better && off.found.ends_with("has no power"), "{off:?}");
        assert_eq!(off.fix, ["switch it on"]);
        let old = haply(Err(HaplyError::OldVersion("2.9".into())));
        assert!(old.verdict == Bad && old.fix == ["install 3.0 or newer"], "{old:?}");
    }

    #[test]
    fn a_library_that_cannot_be_loaded_is_told() {
        let (root, probe) = pc(&["2988"]);
        let file = root.path().join("libHD.so");
        std::fs::write(&file, "no library").expect("written");
        let check = MAKERS[0].check(&probe, Some(&file));
        assert!(check.verdict == Bad && check.found.contains("cannot be loaded"), "{check:?}");
        let found = Maker { load: |_| Ok("libHD.so.3.4".into()), ..MAKERS[0] }.check(&probe, None);
        assert!(found.verdict == Good && found.found.contains("libHD.so.3.4; 1 on USB"), "{found:?}");
    }
}
