//! The exchange with the service: one force, then one state, and never a second command before the state has come.
//!
//! A reply that is 10 ms late latches a fault. If the command before it had a force, no zero can follow it, so the connection
//! is shut 2 ms later: with it ends the session at the service, and its force. Without a force, a late reply is waited for.

use super::error::HaplyError;
use super::events::Events;
use super::grip::Gripped;
use super::line::{Closed, Line, Socket};
use super::protocol::{ForceKey, Inverse, Message, Obstacle, Status, force_command};
use super::rendered::Comparison;
use super::service::{Address, Version};
use crate::device::DeviceState;
use crate::device::maker::cycles::Cycle;
use crate::device::maker::driven::Opened;
use crate::device::maker::exchange::{Exchange, SILENT_NS};
use crate::device::maker::page::Measured;
use crate::device::maker::proxied::Clock;
use core::fmt;
use core::time::Duration;
use palpate_core::{Vec3, vec3};
use palpate_link::DeviceFault;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// Longest wait for a reply in one cycle: a late one comes in a later cycle.
const WAIT: Duration = Duration::from_millis(1);
/// Age of a command with a force from which on the connection is shut, if it has no reply, ns.
const SHUT_NS: u64 = SILENT_NS + 2_000_000;
/// As [`SHUT_NS`], of a command without a force.
const GIVE_UP_NS: u64 = 500_000_000;
/// Longest wait for each of the last two replies.
const CLOSE_WAIT: Duration = Duration::from_millis(10);
/// Most texts that are read before a command.
const MOST_UNASKED: u32 = 16;
/// Lines that wait for the user.
const NEWS: usize = 32;

/// A command whose reply has not come.
#[derive(Debug, Clone, Copy)]
struct Sent {
    t_ns: u64,
    force_n: Vec3,
}

/// What the service is told to move.
#[derive(Debug, Clone)]
pub(super) struct Target {
    pub(super) device_id: String,
    pub(super) force_key: ForceKey,
}

/// The exchange with an Inverse3.
pub struct Driver {
    line: Box<dyn Line>,
    /// `None` without events.
    events: Option<Events>,
    target: Target,
    exchange: Exchange,
    clock: Clock,
    status: Status,
    grip: Gripped,
    comparison: Comparison,
    /// The command in flight.
    sent: Option<Sent>,
    is_closed: bool,
    /// Whether forces are possible.
    is_ready: bool,
    /// The last line about the exchange, which is not repeated.
    told: String,
    news: SyncSender<String>,
    round_trip_ns: Option<u64>,
}

impl fmt::Debug for Driver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Driver")
            .field("target", &self.target)
            .field("sent", &self.sent)
            .finish_non_exhaustive()
    }
}

/// The device of an inventory, and what its messages update.
fn choose(inventory: &Message) -> Result<(&Inverse, String, Status), HaplyError> {
    let devices = inventory.inverse3.as_deref().unwrap_or_default();
    let first = devices.iter().find_map(|device| Some((device, device.device_id.clone()?)));
    let (device, device_id) = first.ok_or(HaplyError::NoDevice)?;
    let status = device.status();
    match status.obstacle(true) {
        None => Ok((device, device_id, status)),
        Some(obstacle) => {
            Err(HaplyError::NotReady { device: format!("the {} {device_id}", device.model()), obstacle })
        }
    }
}

/// A connection to the service, and the inventory that it sends unasked.
pub(super) fn inventory(address: &Address) -> Result<(Socket, Message), HaplyError> {
    let other = |why: String| HaplyError::NotTheService { address: address.to_string(), why };
    let mut socket = Socket::connect(address).map_err(|error| other(error.to_string()))?;
    let text = socket.first().ok_or_else(|| other("it sends no inventory".into()))?;
    let inventory = serde_json::from_str(&text);
    Ok((socket, inventory.map_err(|error| other(format!("its inventory cannot be read: {error}")))?))
}

impl Driver {
    /// Connects to the service and chooses its first Inverse3; also what that is, and the lines for the user.
    pub fn open(
        address: &Address,
        exchange: impl FnOnce(f32) -> Exchange,
        clock: Clock,
    ) -> Result<(Self, Opened, Receiver<String>), HaplyError> {
        let version = address.version()?;
        let (socket, inventory) = inventory(address)?;
        let (news, receiver) = sync_channel(NEWS);
        let events = Socket::connect(&address.events());
        if let Err(error) = &events {
            let text =
                format!("no events of the Haply Inverse Service ({error}): its safety stops are not seen");
            let _ = news.try_send(text);
        }
        let events = events.ok().map(|socket| Box::new(socket) as Box<dyn Line>);
        let (driver, opened) =
            Self::on(Box::new(socket), events, (&inventory, &version), exchange, clock, news)?;
        Ok((driver, opened, receiver))
    }

    /// As [`Driver::open`], on connections whose inventory has been read.
    pub(super) fn on(
        line: Box<dyn Line>,
        events: Option<Box<dyn Line>>,
        (inventory, version): (&Message, &Version),
        exchange: impl FnOnce(f32) -> Exchange,
        clock: Clock,
        news: SyncSender<String>,
    ) -> Result<(Self, Opened), HaplyError> {
        let (device, device_id, status) = choose(inventory)?;
        let opened = Opened {
            name: format!("Haply {} {device_id} (Inverse Service {})", device.model(), version.text),
            max_force_n: 0.0,
            max_stiffness_n_m: 0.0,
        };
        let mut grip = Gripped::default();
        grip.update(inventory);
        let driver = Self {
            line,
            events: events.map(|line| Events::new(line, &device_id)),
            target: Target { device_id, force_key: version.force_key() },
            exchange: exchange(opened.max_force_n),
            clock,
            status,
            grip,
            comparison: Comparison::default(),
            sent: None,
            is_closed: false,
            is_ready: false,
            told: String::new(),
            news,
            round_trip_ns: None,
        };
        Ok((driver, opened))
    }

    /// Time from the last command to its reply, ns; `None` before the first, and while one is late.
    #[must_use]
    pub const fn round_trip_ns(&self) -> Option<u64> {
        self.round_trip_ns
    }

    /// Whether the connection has ended.
    #[must_use]
    pub const fn is_closed(&self) -> bool {
        self.is_closed
    }

    /// Tells the user, unless the last line was the same.
    fn tell(&mut self, line: String) {
        if line != self.told {
            let _ = self.news.try_send(line.clone());
            self.told = line;
        }
    }

    /// Ends the connection: the emergency stop.
    fn shut(&mut self, now_ns: u64, why: &str) {
        self.line.shut();
        if let Some(events) = &mut self.events {
            events.shut();
        }
        self.is_closed = true;
        self.exchange.latch(now_ns, DeviceFault::Hardware);
        self.exchange.set_state(DeviceState::Disconnected);
        self.tell(format!("the connection to the Haply Inverse Service has ended ({why}); start again"));
    }

    fn read_events(&mut self, now_ns: u64) {
        let Some(events) = &mut self.events else { return };
        let Some(found) = events.read() else {
            self.events = None;
            self.tell(
                "the events of the Haply Inverse Service have ended: its safety stops are not seen".into(),
            );
            return;
        };
        for meaning in found {
            if let Some(fault) = meaning.fault {
                self.exchange.latch(now_ns, fault);
            }
            let _ = self.news.try_send(format!("Haply {}", meaning.line));
        }
    }

    /// Sends the force of this cycle. Texts that have come unasked are read first: as the reply to this command they would be
    /// older than it.
    fn send(&mut self) -> Result<(), Closed> {
        for _ in 0..MOST_UNASKED {
            let Some(text) = self.line.receive(Duration::ZERO)? else { break };
            self.take((self.clock)(), &text, None);
            self.tell("the Haply Inverse Service has sent a state unasked".into());
        }
        let now_ns = (self.clock)();
        let force_n = self.exchange.force_n(now_ns);
        self.sent = Some(Sent { t_ns: now_ns, force_n });
        self.line.send(force_command(&self.target.device_id, self.target.force_key, force_n))
    }

    /// Waits for the reply to the command in flight, and sees how late it is.
    fn receive(&mut self, sent: Sent) -> Result<(), Closed> {
        let text = self.line.receive(WAIT)?;
        let now_ns = (self.clock)();
        let age_ns = now_ns.saturating_sub(sent.t_ns);
        self.round_trip_ns = text.is_some().then_some(age_ns);
        if let Some(text) = text {
            self.sent = None;
            self.take(now_ns, &text, Some(sent));
        } else if age_ns >= SILENT_NS {
            self.exchange.latch(now_ns, DeviceFault::Watchdog);
            self.tell("the Haply Inverse Service does not reply".into());
            let has_force = sent.force_n != vec3::ZERO;
            if has_force && age_ns >= SHUT_NS || age_ns >= GIVE_UP_NS {
                self.shut(now_ns, "shut by us, as no reply came");
            }
        }
        Ok(())
    }

    /// Takes over a state, which is the reply to `sent`.
    fn take(&mut self, now_ns: u64, text: &str, sent: Option<Sent>) {
        let Ok(message) = serde_json::from_str::<Message>(text) else {
            self.exchange.latch(now_ns, DeviceFault::Hardware);
            self.tell("a state of the Haply Inverse Service cannot be read; update the service".into());
            return;
        };
        self.grip.update(&message);
        // Absent lanes say nothing of their devices.
        let Some(devices) = &message.inverse3 else { return };
        let is_ours = |device: &&Inverse| device.device_id.as_deref() == Some(&self.target.device_id);
        let Some(device) = devices.iter().find(is_ours) else {
            self.set_obstacle(now_ns, Some(Obstacle::Vanished));
            return;
        };
        self.status.update(device.status());
        self.set_obstacle(now_ns, self.status.obstacle(false));
        let Some(sent) = sent else { return };
        let rendered_n = device.rendered_n();
        if let Some(position_m) = device.position_m() {
            self.exchange.publish(&Measured {
                t_ns: sent.t_ns,
                position_m,
                orientation: self.grip.orientation,
                buttons: self.grip.buttons,
                rendered_n,
            });
        }
        if let Some(wrong) = rendered_n.and_then(|n| self.comparison.judge(now_ns, sent.force_n, n)) {
            self.exchange.latch(now_ns, DeviceFault::Hardware);
            self.tell(format!(
                "the service does not apply the force (commanded {:.1} N, reported {:.1} N); update it, and look at its force scale",
                wrong.commanded_n, wrong.reported_n
            ));
        }
    }

    /// Readiness. A device that loses it is latched: a loop that looks less often could miss it.
    fn set_obstacle(&mut self, now_ns: u64, obstacle: Option<Obstacle>) {
        let was_ready = core::mem::replace(&mut self.is_ready, obstacle.is_none());
        self.exchange.set_state(match obstacle {
            None => DeviceState::Homed,
            Some(_) => DeviceState::Unhomed,
        });
        if let Some(obstacle) = obstacle {
            if was_ready {
                self.exchange.latch(now_ns, DeviceFault::HomeLost);
            }
            self.tell(format!("the Inverse3 {} {obstacle}", self.target.device_id));
        }
    }
}

impl Cycle for Driver {
    fn run(&mut self) {
        let now_ns = (self.clock)();
        if !self.is_closed {
            self.read_events(now_ns);
            let sent = if self.sent.is_none() { self.send() } else { Ok(()) };
            let received = sent.and_then(|()| self.sent.map_or(Ok(()), |sent| self.receive(sent)));
            if received.is_err() {
                self.shut((self.clock)(), "by the service");
            }
        }
        // Publishes state and fault with this cycle's measurement.
        self.exchange.check_loop((self.clock)());
    }

    /// A last zero, and its reply: a socket that is shut with an unread reply would drop what was sent before.
    fn close(&mut self) {
        if self.is_closed {
            return;
        }
        let is_free = self.sent.is_none() || matches!(self.line.receive(CLOSE_WAIT), Ok(Some(_)));
        let zero = force_command(&self.target.device_id, self.target.force_key, vec3::ZERO);
        if is_free && self.line.send(zero).is_ok() {
            let _ = self.line.receive(CLOSE_WAIT);
        }
        self.line.shut();
        if let Some(events) = &mut self.events {
            events.shut();
        }
        self.is_closed = true;
    }
}
