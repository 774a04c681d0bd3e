//! Checks the files of `host/deploy`: systemd, udev and PAM skip an unknown key with only a warning in a log.

use palpate_host::sys::DEFAULT_FIFO_PRIORITY;
use std::collections::BTreeMap;

const SERVICE: &str = include_str!("../deploy/palpate@.service");
const RULES: &str = include_str!("../deploy/72-palpate.rules");
const LIMITS: &str = include_str!("../deploy/palpate-limits.conf");

/// Keys of the service and their only value.
const VALUES: [(&str, &str); 16] = [
    ("User", "palpate"),
    ("Group", "palpate"),
    ("SupplementaryGroups", "realtime"),
    ("UMask", "0077"),
    ("RuntimeDirectoryMode", "0750"),
    ("CapabilityBoundingSet", ""),
    ("AmbientCapabilities", ""),
    ("ProtectSystem", "strict"),
    ("ProtectProc", "invisible"),
    ("RestrictAddressFamilies", "AF_UNIX AF_NETLINK"),
    ("IPAddressDeny", "any"),
    ("SystemCallArchitectures", "native"),
    // SIGSYS would kill the session.
    ("SystemCallErrorNumber", "EPERM"),
    ("SystemCallFilter", "@system-service | ~@privileged @resources | sched_setscheduler sched_setaffinity"),
    ("DevicePolicy", "closed"),
    ("DeviceAllow", "char-usb_device rw | char-ttyACM rw | char-ttyUSB rw | /dev/cpu_dma_latency rw"),
];

/// Keys of the service that are `yes`.
const YES: &str = "NoNewPrivileges ProtectHome ProtectClock ProtectHostname ProtectKernelLogs ProtectKernelModules \
     ProtectKernelTunables ProtectControlGroups PrivateTmp PrivateIPC PrivateNetwork PrivateMounts RestrictNamespaces \
     RestrictSUIDSGID RemoveIPC LockPersonality MemoryDenyWriteExecute";

/// Its other keys, from systemd.service(5), systemd.exec(5), systemd.kill(5) and systemd.resource-control(5).
const OTHERS: &str = "Type WorkingDirectory StateDirectory StateDirectoryMode RuntimeDirectory Environment \
     EnvironmentFile ExecStartPre ExecStart KillMode KillSignal TimeoutStopSec Restart LimitRTPRIO LimitMEMLOCK \
     LimitCORE CPUAffinity Nice OOMScoreAdjust";

/// Whether a section may have a key; `None` for an unknown section.
fn is_known(section: &str, key: &str) -> Option<bool> {
    let is_in = |keys: &str| keys.split_whitespace().any(|known| known == key);
    match section {
        "Unit" => Some(is_in("Description Documentation After AssertPathExists")),
        "Service" => Some(is_in(YES) || is_in(OTHERS) || VALUES.iter().any(|(known, _)| *known == key)),
        "Install" => Some(key == "WantedBy"),
        _ => None,
    }
}

/// Parses keys and values by section; an error names the invalid line.
fn unit(text: &str) -> Result<BTreeMap<(String, String), Vec<String>>, String> {
    let mut section = String::new();
    let mut entries: BTreeMap<_, Vec<String>> = BTreeMap::new();
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#')) {
        if let Some(name) = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            section = name.into();
            continue;
        }
        let (key, value) = line.split_once('=').ok_or_else(|| format!("no key: {line}"))?;
        let known = is_known(&section, key).ok_or_else(|| format!("no section [{section}]"))?;
        // An empty set of capabilities is the strictest.
        let may_be_empty = ["CapabilityBoundingSet", "AmbientCapabilities"].contains(&key);
        if !known || (value.is_empty() && !may_be_empty) {
            return Err(format!("[{section}] {line}"));
        }
        entries.entry((section.clone(), key.into())).or_default().push(value.into());
    }
    Ok(entries)
}

#[test]
fn the_service_has_the_rights_for_loop_and_watchdog_and_does_not_restart() {
    let entries = unit(SERVICE).expect("every line is known");
    let one = |key: &str| entries[&("Service".to_string(), key.to_string())].join(" ");
    assert!(entries.contains_key(&("Unit".to_string(), "AssertPathExists".to_string())));
    assert_eq!((one("Restart").as_str(), one("KillSignal").as_str()), ("no", "SIGINT"));
    let priority: i32 = one("LimitRTPRIO").parse().expect("a number");
    assert!(
        priority > DEFAULT_FIFO_PRIORITY
            && one("Environment").contains(&format!("FIFO={DEFAULT_FIFO_PRIORITY}"))
    );
    assert_eq!(one("LimitMEMLOCK"), "infinity");
    // Unused pictures would fill the disk.
    assert!(one("ExecStart").contains("--headless --frame-rate 0 "));
    // All options exist on the command line.
    for command in [one("ExecStart"), one("ExecStartPre")] {
        for option in command.split_whitespace().filter(|word| word.starts_with("--")) {
            assert!(
                ["--headless", "--frame-rate", "--control", "--device", "--cpu", "--fifo", "--measure"]
                    .contains(&option),
                "{option} of {command}"
            );
        }
    }
    assert!(unit(&SERVICE.replace("LimitRTPRIO", "LimitRTPrio")).is_err());
    assert!(unit(&SERVICE.replace("[Service]", "[Services]")).is_err());
}

/// `systemd-analyze security --offline=yes` rates the unit 0.8 with these lines, 6.1 without.
#[test]
fn the_service_has_no_more_rights_than_session_and_guard_need() {
    let entries = unit(SERVICE).expect("every line is known");
    let all = |key: &str| entries[&("Service".to_string(), key.to_string())].join(" | ");
    for (key, value) in VALUES {
        assert_eq!(all(key), value, "{key}");
    }
    for key in YES.split_whitespace() {
        assert_eq!(all(key), "yes", "{key}");
    }
    assert!(all("ExecStart").contains("--control %t/palpate/%i/control "));
    assert_eq!(all("RuntimeDirectory"), "palpate/%i");
    // The guard repeats its last zero for 10 s, and the session waits 2 s for it. With KillMode=mixed systemd kills
    // it as soon as the session has ended.
    assert_eq!(all("KillMode"), "control-group");
    assert!(all("TimeoutStopSec").parse::<u32>().expect("seconds") >= 15);
}

/// Key, operator and value.
type Token<'t> = (&'t str, &'t str, &'t str);

/// Parses one `KEY{attribute}operator"value"` of a rule; an error names the invalid token.
fn token(text: &str) -> Result<Token<'_>, String> {
    let wrong = || format!("no match or assignment: {text}");
    let at = text.find(['=', '!', '+', '-', ':']).ok_or_else(wrong)?;
    let (key, rest) = text.split_at(at);
    let (operator, value) = rest.split_at(rest.find('"').ok_or_else(wrong)?);
    let value = value.strip_prefix('"').and_then(|v| v.strip_suffix('"')).ok_or_else(wrong)?;
    let (name, attribute) = key.split_once('{').unwrap_or((key, "}"));
    let matches = ["ACTION", "SUBSYSTEM", "KERNEL", "DRIVER", "ATTRS"];
    let assigned = ["GROUP", "MODE", "TAG", "SYMLINK"];
    let allowed: &[&str] = match name {
        _ if matches.contains(&name) => &["==", "!="],
        _ if assigned.contains(&name) => &["=", "+=", "-=", ":="],
        "ATTR" | "ENV" => &["==", "!=", "="],
        _ => return Err(format!("no key {name}")),
    };
    let bare = ["ACTION", "SUBSYSTEM", "KERNEL", "DRIVER", "GROUP", "MODE", "TAG", "SYMLINK"].contains(&name);
    if !allowed.contains(&operator) || bare == key.contains('{') || !attribute.ends_with('}') {
        return Err(wrong());
    }
    Ok((key, operator, value))
}

fn rules(text: &str) -> Result<Vec<Vec<Token<'_>>>, String> {
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    lines.map(|line| line.split(", ").map(token).collect()).collect()
}

#[test]
fn every_rule_has_a_match_and_an_assignment() {
    let rules_read = rules(RULES).expect("every token is known");
    assert_eq!(rules_read.len(), 8);
    for rule in &rules_read {
        assert!(rule.contains(&("ACTION", "!=", "remove")), "{rule:?}");
        assert!(rule.iter().filter(|(_, operator, _)| *operator == "==").count() >= 2, "{rule:?}");
        assert!(rule.iter().any(|(_, operator, _)| matches!(*operator, "=" | "+=" | ":=")), "{rule:?}");
    }
    for (from, to) in
        [("SUBSYSTEM==", "SUBSYSTEMX=="), ("MODE:=\"0660\"", "MODE:=0660"), ("GROUP=", "GROUP==")]
    {
        assert!(rules(&RULES.replace(from, to)).is_err(), "{to}");
    }
}

/// Only its group may open a device: neither the user at the screen nor a rule of another package.
#[test]
fn every_haptic_device_belongs_to_its_group_alone() {
    // With the rule for a user's own device, which is a comment.
    let text = RULES.replace("#ACTION", "ACTION");
    let all = rules(&text).expect("every token is known");
    let has = |rule: &[Token<'_>], name: &str| rule.iter().any(|(key, ..)| key.ends_with(name));
    let devices: Vec<_> = all.iter().filter(|rule| has(rule, "{idVendor}")).collect();
    let names =
        "Falcon and Teensy on USB and as ports, Force Dimension on USB, the Touch's port, and a user's own";
    assert_eq!(devices.len(), 7, "{names}");
    for rule in devices {
        for token in [("GROUP", ":=", "palpate"), ("MODE", ":=", "0660"), ("TAG", "-=", "uaccess")] {
            assert!(rule.contains(&token), "{rule:?}");
        }
        assert!(!rule.contains(&("TAG", "+=", "uaccess")), "{rule:?}");
        // ModemManager opens every port that it does not know.
        let has_no_port = rule.contains(&("ATTR{idProduct}", "==", "cb48"))
            || rule.contains(&("ATTR{idVendor}", "==", "1451"));
        assert!(has_no_port || has(rule, "{ID_MM_DEVICE_IGNORE}"), "{rule:?}");
    }
    assert!(!RULES.contains("plugdev") && !RULES.contains("dialout") && !SERVICE.contains("dialout"));
}

#[test]
fn the_limits_have_four_columns_and_include_the_watchdog_priority() {
    let lines: Vec<Vec<&str>> = LIMITS
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| line.split_whitespace().collect())
        .collect();
    for line in &lines {
        assert!(line.len() == 4 && line[0] == "@realtime" && line[1] == "-", "{line:?}");
    }
    let value = |item: &str| lines.iter().find(|line| line[2] == item).map(|line| line[3]).expect(item);
    assert!(value("rtprio").parse::<i32>().expect("a number") > DEFAULT_FIFO_PRIORITY);
    assert_eq!(value("memlock"), "unlimited");
}
