//! The driver on a line in memory, cycle by cycle.

use super::driver::Driver;
use super::error::HaplyError;
use super::line::{Closed, Line};
use super::protocol::{ForceKey, Message, force_command};
use super::service::Version;
use crate::device::DeviceState;
use crate::device::maker::cycles::Cycle;
use crate::device::maker::exchange::Exchange;
use crate::device::maker::page::{Force, Page, SessionEnd};
use core::time::Duration;
use palpate_core::{Vec3, vec3};
use palpate_link::DeviceFault;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard};

const MS: u64 = 1_000_000;

const READY: &str =
    r#""status":{"calibrated":true,"in_use":false,"power_supply":true,"ready":true,"started":true}"#;

/// The service at the other end.
#[derive(Debug)]
struct Fake {
    /// Texts that the driver reads.
    replies: VecDeque<String>,
    /// Forces that were sent, N.
    sent_n: Vec<[f64; 3]>,
    /// Replies to each command.
    answers: u32,
    /// What a reply has beside the force.
    device: String,
    /// Whether forces are applied.
    applies: bool,
    is_shut: bool,
    is_gone: bool,
    now_ns: Arc<AtomicU64>,
}

#[derive(Debug, Clone)]
struct FakeLine(Arc<Mutex<Fake>>);

impl FakeLine {
    fn fake(&self) -> MutexGuard<'_, Fake> {
        self.0.lock().expect("no panic")
    }
}

impl Line for FakeLine {
    fn send(&mut self, text: String) -> Result<(), Closed> {
        let mut fake = self.fake();
        assert!(!fake.is_shut, "a command on a shut line");
        let command: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let device = &command["inverse3"][0];
        assert_eq!(device["device_id"], "049D");
        let vector = &device["commands"]["set_cursor_force"]["vector"];
        let force_n = ["x", "y", "z"].map(|axis| vector[axis].as_f64().expect("a number"));
        fake.sent_n.push(force_n);
        let [x, y, z] = if fake.applies { force_n } else { [0.0; 3] };
        let reply = format!(
            r#"{{"inverse3":[{{"device_id":"0000"}},{{"device_id":"049D","state":{{"cursor_position":{{"x":0.01,"y":-0.02,"z":0.03}},"current_cursor_force":{{"x":{x},"y":{y},"z":{z}}}}},{}}}]}}"#,
            fake.device
        );
        (0..fake.answers).for_each(|_| fake.replies.push_back(reply.clone()));
        if fake.is_gone { Err(Closed) } else { Ok(()) }
    }

    fn receive(&mut self, wait: Duration) -> Result<Option<String>, Closed> {
        let mut fake = self.fake();
        let reply = fake.replies.pop_front();
        if reply.is_none() {
            fake.now_ns.fetch_add(wait.as_nanos() as u64, Ordering::Relaxed);
        }
        if fake.is_gone { Err(Closed) } else { Ok(reply) }
    }

    fn shut(&mut self) {
        self.fake().is_shut = true;
    }
}

struct Bench {
    driver: Driver,
    session: SessionEnd,
    line: FakeLine,
    events: FakeLine,
    news: Receiver<String>,
    now_ns: Arc<AtomicU64>,
}

fn inventory(devices: &str) -> Message {
    serde_json::from_str(&format!(r#"{{"session_id":7,"inverse3":[{devices}],"verse_grip":[]}}"#))
        .expect("JSON")
}

fn open(devices: &str) -> Result<Bench, HaplyError> {
    let now_ns = Arc::new(AtomicU64::new(MS));
    let line = || {
        FakeLine(Arc::new(Mutex::new(Fake {
            replies: VecDeque::new(),
            sent_n: Vec::new(),
            answers: 1,
            device: READY.into(),
            applies: true,
            is_shut: false,
            is_gone: false,
            now_ns: now_ns.clone(),
        })))
    };
    let (line, events) = (line(), line());
    let page = Page::local();
    let proxy = page.clone().proxy();
    let clock = {
        let now_ns = now_ns.clone();
        Box::new(move || now_ns.load(Ordering::Relaxed))
    };
    let version = Version::of_answer("HTTP/1.1 200 OK\r\n\r\n{\"project_version\":\"3.5.1\"}").expect("one");
    let (news, receiver) = sync_channel(8);
    let (driver, opened) = Driver::on(
        Box::new(line.clone()),
        Some(Box::new(events.clone())),
        (&inventory(devices), &version),
        |stated_n| {
            assert_eq!(stated_n, 0.0);
            Exchange::new(proxy, 5.0)
        },
        clock,
        news,
    )?;
    assert!(opened.name.contains("inverse3x 049D (Inverse Service 3.5.1)"), "{opened:?}");
    Ok(Bench { driver, session: page.session(), line, events, news: receiver, now_ns })
}

fn ours() -> String {
    format!(r#"{{"device_id":"049D","config":{{"type":"inverse3x","mount":{{}}}},{READY}}}"#)
}

impl Bench {
    fn ready() -> Self {
        let mut bench = open(&ours()).expect("it opens");
        bench.after(1, vec3::ZERO);
        assert_eq!(bench.session.health().state, DeviceState::Homed);
        bench
    }

    fn fake(&self) -> MutexGuard<'_, Fake> {
        self.line.fake()
    }

    /// A tick of the loop and a cycle, `ms` after the last ones; the newest force that was sent.
    fn after(&mut self, ms: u64, force_n: Vec3) -> [f64; 3] {
        let now_ns = self.now_ns.fetch_add(ms * MS, Ordering::Relaxed) + ms * MS;
        self.session.send(Force { t_ns: now_ns, force_n, is_armed: true });
        self.driver.run();
        self.fake().sent_n.last().copied().unwrap_or_default()
    }

    fn news(&self) -> String {
        self.news.try_iter().collect::<Vec<_>>().join("\n")
    }

    /// There is no force, whatever the loop wants, and the fault is latched.
    fn assert_latched(&mut self, fault: DeviceFault) {
        for _ in 0..20 {
            assert_eq!(self.after(1, [1.0, 0.0, 0.0]), [0.0; 3], "{fault:?}");
        }
        assert_eq!(self.session.health().fault, Some(fault));
    }

    /// After the user's reset a new force is sent.
    fn assert_resets(&mut self) {
        self.session.reset(self.session.health().latch);
        self.after(1, [1.0, 0.0, 0.0]);
        assert_eq!(self.after(1, [1.0, 0.0, 0.0]), [1.0, 0.0, 0.0]);
        assert_eq!(self.session.health().fault, None);
    }
}

#[test]
fn a_force_is_named_as_the_version_knows_it() {
    for (key, name) in [(ForceKey::Vector, "vector"), (ForceKey::Values, "values")] {
        let expected = format!(
            r#"{{"inverse3":[{{"device_id":"049D","commands":{{"set_cursor_force":{{"{name}":{{"x":0.0,"y":-1.5,"z":0.25}}}}}}}}]}}"#
        );
        assert_eq!(force_command("049D", key, [0.0, -1.5, 0.25]), expected);
    }
}

#[test]
fn a_cycle_sends_the_force_and_publishes_the_state() {
    let mut bench = Bench::ready();
    assert_eq!(bench.after(1, [1.0, -0.5, 0.25]), [1.0, -0.5, 0.25]);
    let measured = bench.session.measured();
    assert_eq!(measured.t_ns, bench.now_ns.load(Ordering::Relaxed), "the time of the command");
    assert_eq!(measured.position_m, [0.01, -0.02, 0.03]);
    assert_eq!(measured.rendered_n, Some([1.0, -0.5, 0.25]));
    let [x, ..] = bench.after(1, [50.0, 0.0, 0.0]);
    assert!(x <= 5.0 && x > 4.99, "the limit: {x}");
    let sent = bench.fake().sent_n.len();
    bench.driver.close();
    let fake = bench.fake();
    assert!(fake.is_shut && fake.sent_n.len() == sent + 1 && fake.sent_n[sent] == [0.0; 3], "{fake:?}");
}

/// The reply to a command without a force comes 50 ms late: one command in flight, and the sample is as old as that.
#[test]
fn a_late_reply_stays_in_flight_and_is_latched() {
    let mut bench = Bench::ready();
    bench.fake().answers = 0;
    let count = bench.fake().sent_n.len();
    bench.after(1, vec3::ZERO);
    let sent_ns = bench.session.measured().t_ns + MS;
    for _ in 0..24 {
        bench.after(1, [1.0, 0.0, 0.0]);
    }
    assert_eq!(bench.fake().sent_n.len(), count + 1, "one in flight");
    assert_eq!(bench.session.health().fault, Some(DeviceFault::Watchdog));
    assert!(bench.news().contains("does not reply"));
    let reply = format!(
        r#"{{"inverse3":[{{"device_id":"049D","state":{{"cursor_position":{{"x":1,"y":0,"z":0}}}},{READY}}}]}}"#
    );
    (bench.fake().answers, bench.fake().replies) = (1, [reply].into());
    bench.after(1, [1.0, 0.0, 0.0]);
    let measured = bench.session.measured();
    assert_eq!((measured.t_ns, measured.position_m, measured.rendered_n), (sent_ns, [1.0, 0.0, 0.0], None));
    bench.assert_latched(DeviceFault::Watchdog);
    bench.assert_resets();
}

/// With a force in flight no zero can follow, so the session is ended: within 2 ms of the fault.
#[test]
fn a_missing_reply_to_a_force_shuts_the_connection() {
    let mut bench = Bench::ready();
    bench.fake().answers = 0;
    bench.after(1, [1.0, 0.0, 0.0]);
    let sent_ns = bench.now_ns.load(Ordering::Relaxed) - MS;
    while !bench.fake().is_shut {
        bench.after(0, [1.0, 0.0, 0.0]);
        let age_ms = (bench.now_ns.load(Ordering::Relaxed) - sent_ns) / MS;
        assert!(age_ms <= 12, "still open");
        assert_eq!(bench.session.health().fault.is_some(), age_ms >= 10, "{age_ms} ms");
    }
    assert!(bench.events.fake().is_shut && bench.news().contains("start again"));
    bench.after(1, [1.0, 0.0, 0.0]);
    assert_eq!(bench.session.health().state, DeviceState::Disconnected);
    // Without a force a reply is waited for, but not for ever.
    let mut bench = Bench::ready();
    bench.fake().answers = 0;
    bench.after(1, vec3::ZERO);
    (0..240).for_each(|_| _ = bench.after(1, vec3::ZERO));
    assert!(!bench.fake().is_shut);
    (0..20).for_each(|_| _ = bench.after(1, vec3::ZERO));
    assert!(bench.fake().is_shut);
}

#[test]
fn two_replies_do_not_put_a_second_command_in_flight() {
    let mut bench = Bench::ready();
    bench.fake().answers = 2;
    for count in 0..10 {
        let before = bench.fake().sent_n.len();
        bench.after(1, [1.0, 0.0, 0.0]);
        assert_eq!(bench.fake().sent_n.len(), before + 1, "{count}");
        assert!(bench.fake().replies.len() <= 1, "they do not add up");
        assert_eq!(bench.session.measured().t_ns, bench.now_ns.load(Ordering::Relaxed));
    }
    assert!(bench.news().contains("unasked"));
}

/// Also of one state only, which the loop may not see; and nothing resumes before the reset.
#[test]
fn lost_readiness_is_latched() {
    let is_not = |flag: &str| READY.replace(&format!("\"{flag}\":true"), &format!("\"{flag}\":false"));
    for (device, fix) in [
        (is_not("ready"), "is not ready"),
        (is_not("calibrated"), "calibrate it"),
        (is_not("power_supply"), "power supply"),
        (is_not("started"), "not started"),
    ] {
        let mut bench = Bench::ready();
        bench.after(1, [1.0, 0.0, 0.0]);
        bench.fake().device = device;
        bench.after(1, [1.0, 0.0, 0.0]);
        assert_eq!(bench.after(1, [1.0, 0.0, 0.0]), [0.0; 3]);
        assert_eq!(bench.session.health().state, DeviceState::Unhomed);
        assert!(bench.news().contains(fix), "{fix}");
        bench.fake().device = READY.into();
        bench.assert_latched(DeviceFault::HomeLost);
        bench.assert_resets();
    }
}

#[test]
fn an_absent_lane_is_no_absent_device_but_a_lane_without_it_is() {
    let mut bench = Bench::ready();
    bench.after(1, [1.0, 0.0, 0.0]);
    bench.fake().answers = 0;
    bench.fake().replies.push_back(r#"{"session_id":7}"#.into());
    assert_eq!(bench.after(1, [1.0, 0.0, 0.0]), [1.0, 0.0, 0.0]);
    assert_eq!(bench.session.health().state, DeviceState::Homed);
    let mut bench = Bench::ready();
    bench.fake().device = format!("{READY}}},{{\"device_id\":\"0001\"");
    assert_eq!(bench.after(1, [1.0, 0.0, 0.0]), [1.0, 0.0, 0.0], "another device beside it");
    for (text, fault) in [
        (r#"{"inverse3":[{"device_id":"0001"}]}"#, DeviceFault::HomeLost),
        (r#"{"inverse3":[]}"#, DeviceFault::HomeLost),
        (r#"{"inverse3":"#, DeviceFault::Hardware),
    ] {
        let mut bench = Bench::ready();
        bench.fake().answers = 0;
        bench.fake().replies.push_back(text.into());
        // The reply of this text is read before the next command.
        bench.after(1, [1.0, 0.0, 0.0]);
        bench.fake().replies.push_back(format!(r#"{{"inverse3":[{{"device_id":"049D",{READY}}}]}}"#));
        bench.after(0, [1.0, 0.0, 0.0]);
        bench.fake().answers = 1;
        bench.assert_latched(fault);
    }
}

#[test]
fn a_force_that_the_service_ignores_is_latched() {
    let mut bench = Bench::ready();
    bench.fake().applies = false;
    let ignored = (0..200).find(|_| bench.after(1, [1.0, 0.0, 0.0]) == [0.0; 3]).expect("found");
    assert!((50..56).contains(&ignored), "{ignored} ms");
    let news = bench.news();
    assert!(news.contains("does not apply the force (commanded 1.0 N, reported 0.0 N)"), "{news}");
    bench.assert_latched(DeviceFault::Hardware);
    bench.fake().applies = true;
    bench.assert_resets();
}

#[test]
fn a_safety_event_is_latched_and_an_end_of_the_events_is_told() {
    let mut bench = Bench::ready();
    bench.after(1, [1.0, 0.0, 0.0]);
    let event = r#"{"name":"device-safety-triggered","level":"warning","data":{"device_id":"049D"},"message":"FOD stage changed"}"#;
    bench.events.fake().replies.push_back(event.into());
    assert_eq!(bench.after(1, [1.0, 0.0, 0.0]), [0.0; 3], "in the same cycle");
    assert!(bench.news().contains("Haply device-safety-triggered: FOD stage changed"));
    bench.assert_latched(DeviceFault::Hardware);
    bench.assert_resets();
    bench.events.fake().is_gone = true;
    assert_eq!(bench.after(1, [1.0, 0.0, 0.0]), [1.0, 0.0, 0.0]);
    assert!(bench.news().contains("safety stops are not seen"));
}

#[test]
fn a_service_that_closes_is_a_lost_device() {
    let mut bench = Bench::ready();
    bench.fake().is_gone = true;
    bench.after(1, [1.0, 0.0, 0.0]);
    let health = bench.session.health();
    assert_eq!((health.state, health.fault), (DeviceState::Disconnected, Some(DeviceFault::Hardware)));
    bench.after(1, [1.0, 0.0, 0.0]);
    assert!(bench.news().contains("by the service"));
}

#[test]
fn a_device_that_cannot_be_used_is_one_line_with_the_fix() {
    let with = |from: &str, to: &str| ours().replace(from, to);
    for (devices, fix) in [
        (String::new(), "check cable and power"),
        (r#"{"state":{}}"#.into(), "check cable and power"),
        (with("\"in_use\":false", "\"in_use\":true"), "end the other program"),
        (with("\"power_supply\":true", "\"power_supply\":false"), "switch on its power supply"),
        (with("\"calibrated\":true,", ""), "calibrate it in the Haply Hub"),
        (with("\"ready\":true", "\"ready\":null"), "is not ready"),
        (with("\"started\":true", "\"started\":false"), "start it in the Haply Hub"),
    ] {
        let line = open(&devices).err().expect("refused").to_string();
        assert!(line.contains(fix) && !line.contains('\n'), "{line}");
    }
}
