//! The events of the service: which of them take the force away.

use super::line::Line;
use core::time::Duration;
use palpate_link::DeviceFault;
use serde::Deserialize;

/// Most events that are read in a cycle.
const MOST_EVENTS: usize = 8;

/// An event.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Event {
    name: String,
    level: String,
    data: Data,
    message: Option<String>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Data {
    device_id: Option<String>,
    safety_type: Option<String>,
}

/// What an event means for the device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Meaning {
    /// The fault, if it is one of this device.
    pub(super) fault: Option<DeviceFault>,
    /// The line for the user.
    pub(super) line: String,
}

/// The connection for events.
pub(super) struct Events {
    line: Box<dyn Line>,
    device_id: String,
}

impl Events {
    /// Events on an open connection.
    pub(super) fn new(line: Box<dyn Line>, device_id: &str) -> Self {
        Self { line, device_id: device_id.into() }
    }

    /// The events since the last call that concern the user; `None` once the connection has ended.
    pub(super) fn read(&mut self) -> Option<Vec<Meaning>> {
        let mut found = Vec::new();
        for _ in 0..MOST_EVENTS {
            match self.line.receive(Duration::ZERO) {
                Ok(Some(text)) => found.extend(meaning(&text, &self.device_id)),
                Ok(None) => break,
                Err(_) => return None,
            }
        }
        Some(found)
    }

    /// Ends the connection.
    pub(super) fn shut(&mut self) {
        self.line.shut();
    }
}

/// What an event means; `None` of one that concerns neither the device nor the commands.
fn meaning(text: &str, device_id: &str) -> Option<Meaning> {
    let Event { name, level, data, message } = serde_json::from_str(text).ok()?;
    // An event without a device may be about this one.
    if data.device_id.as_deref().is_some_and(|of| !of.is_empty() && of != device_id) {
        return None;
    }
    let is_grave = matches!(level.as_str(), "error" | "critical" | "panic");
    let fault = match name.as_str() {
        // The end of a fault.
        "device-safety-triggered" if data.safety_type.as_deref() == Some("ebrake_released") => None,
        "device-safety-triggered" => Some(DeviceFault::Hardware),
        "device-disconnected" | "device-calibration-failed" | "device-sleep" => Some(DeviceFault::HomeLost),
        _ if is_grave && name.starts_with("device-") => Some(DeviceFault::Hardware),
        _ => None,
    };
    let is_told = fault.is_some() || is_grave || level == "warning";
    let message = message.unwrap_or_default();
    is_told.then(|| Meaning { fault, line: format!("{name}: {message}").trim_end_matches(": ").into() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_of_the_device_are_faults_or_lines() {
        let event = |name: &str, level: &str, data: &str| {
            meaning(
                &format!(
                    r#"{{"name":"{name}","category":"device","level":"{level}","data":{data},"message":"m"}}"#
                ),
                "049D",
            )
        };
        let ours = r#"{"device_family":"inverse","device_id":"049D"}"#;
        for (name, level, data, fault) in [
            ("device-safety-triggered", "warning", ours, Some(DeviceFault::Hardware)),
            ("device-safety-triggered", "warning", "{}", Some(DeviceFault::Hardware)),
            ("device-disconnected", "notice", ours, Some(DeviceFault::HomeLost)),
            ("device-calibration-failed", "error", ours, Some(DeviceFault::HomeLost)),
            ("device-unheard-of", "critical", ours, Some(DeviceFault::Hardware)),
            ("invalid-value", "warning", r#"{"field":"vector"}"#, None),
        ] {
            let found = event(name, level, data).expect("told");
            assert_eq!((found.fault, found.line), (fault, format!("{name}: m")));
        }
        let released = r#"{"device_id":"049D","safety_type":"ebrake_released"}"#;
        assert_eq!(event("device-safety-triggered", "warning", released).expect("told").fault, None);
        assert_eq!(event("device-safety-triggered", "warning", r#"{"device_id":"1111"}"#), None, "another's");
        assert_eq!(event("system-rate-report", "info", r#"{"min":1}"#), None);
        assert_eq!(meaning("no json", "049D"), None);
    }
}
