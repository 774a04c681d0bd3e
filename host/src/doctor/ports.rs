//! Checks of haptic devices on USB and serial ports: permission to open them, and latency of replies.

use super::Check;
use super::Verdict::{Bad, Better, Good};
use super::probe::Probe;

/// USB devices that this program or a maker's library opens, by vendor and product; any product if it is empty.
const KNOWN: [(&str, &str, &str); 2] =
    [("0403", "cb48", "Novint Falcon"), ("1451", "", "Force Dimension device")];

/// The group that may open haptic devices.
const GROUP: &str = "palpate";

const JOIN: [&str; 2] = ["$ groupadd -f palpate && usermod -aG palpate USER", "then log in again"];
const RULES: [&str; 2] =
    ["$ cp host/deploy/72-palpate.rules /etc/udev/rules.d/ && udevadm control --reload", "$ udevadm trigger"];

/// Whether this user is in the group of the haptic devices.
pub(super) fn group(probe: &Probe) -> Check {
    const NAME: &str = "group";
    match probe.is_in_group(GROUP) {
        None => Check::unknown(NAME, "/etc/group"),
        Some(true) => Check::new(NAME, Good, "palpate: this user may open haptic devices"),
        Some(false) => {
            Check::new(NAME, Better, "this user is not in the group palpate, which opens haptic devices")
                .fix(JOIN)
        }
    }
}

/// One check per known device, or one that reports that there is none.
pub(super) fn usb(probe: &Probe) -> Vec<Check> {
    const NAME: &str = "usb";
    const BASE: &str = "/sys/bus/usb/devices";
    let mut checks = Vec::new();
    for device in probe.list(BASE) {
        let of = |file: &str| probe.read(&format!("{BASE}/{device}/{file}"));
        let (vendor, product) = (of("idVendor").unwrap_or_default(), of("idProduct").unwrap_or_default());
        let known = KNOWN.iter().find(|(v, p, _)| {
            v.eq_ignore_ascii_case(&vendor) && (p.is_empty() || p.eq_ignore_ascii_case(&product))
        });
        let Some((_, _, name)) = known else { continue };
        let number = |file: &str| of(file).and_then(|text| text.parse::<u32>().ok()).unwrap_or(0);
        let node = format!("/dev/bus/usb/{:03}/{:03}", number("busnum"), number("devnum"));
        let sleeps = of("power/control").as_deref() == Some("auto");
        checks.push(match probe.may_write(&node) {
            Some(false) => Check::new(NAME, Bad, format!("{name} at {node}, which this user may not open"))
                .fix(RULES)
                .fix(JOIN),
            None => Check::unknown(NAME, &node),
            Some(true) if probe.is_open_to_others(&node) => {
                Check::new(NAME, Bad, format!("{name} at {node}: any user may move its motors")).fix(RULES)
            }
            Some(true) if sleeps => {
                Check::new(NAME, Better, format!("{name} at {node} may be suspended (autosuspend)"))
                    .fix([&format!("$ echo on > {BASE}/{device}/power/control"), "or permanently:"])
                    .fix(RULES)
            }
            Some(true) => Check::new(NAME, Good, format!("{name} at {node}")),
        });
    }
    if checks.is_empty() {
        let found = if probe.is_there(BASE) { "no known haptic device" } else { "no USB on this PC" };
        checks.push(Check::new(NAME, Good, found));
    }
    checks
}

/// One check per USB serial port, or one that reports that there is none.
pub(super) fn serial(probe: &Probe) -> Vec<Check> {
    const NAME: &str = "serial";
    let ports = probe.list("/sys/class/tty").into_iter();
    let mut checks: Vec<Check> = ports
        .filter(|port| port.starts_with("ttyUSB") || port.starts_with("ttyACM"))
        .map(|port| {
            let node = format!("/dev/{port}");
            let timer = format!("/sys/bus/usb-serial/devices/{port}/latency_timer");
            match (probe.may_write(&node), probe.number::<u32>(&timer)) {
                (None, _) => Check::unknown(NAME, &node),
                (Some(false), _) => Check::new(NAME, Bad, format!("{node}, which this user may not open"))
                    .fix(["a haptic device belongs to the group palpate:"])
                    .fix(RULES)
                    .fix(JOIN),
                (Some(true), Some(ms)) if ms > 1 => {
                    Check::new(NAME, Bad, format!("{node}: its FTDI chip delays replies by {ms} ms"))
                        .fix([&format!("$ echo 1 > {timer}"), "or permanently:"])
                        .fix(RULES)
                }
                (Some(true), Some(ms)) => {
                    Check::new(NAME, Good, format!("{node}, FTDI latency timer {ms} ms"))
                }
                (Some(true), None) => Check::new(NAME, Good, node),
            }
        })
        .collect();
    if checks.is_empty() {
        checks.push(Check::new(NAME, Good, "no USB serial port"));
    }
    checks
}
