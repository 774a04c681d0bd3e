//! A USB device at the far end of a usb-redir socket, as QEMU's `usb-redir` shows it to a guest: the guest's own USB stack enumerates it.
//!
//! ```text
//! guest's driver <-> guest's kernel <-> QEMU's host controller <-> socket <-> Session <-> UsbDevice
//! ```
//!
//! In: bytes of the peer. Out: bytes for it. No socket and no clock in here: a transfer that waits is looked at again by [`Session::poll`].
//!
//! Invariants: each transfer is answered once, with its id; a transfer in is answered when a short packet ends it, when it is full, or when it
//! is cancelled; what a cancelled one had the next one gets; a device that was taken away has nothing waiting.

pub mod packet;

use crate::falcon::descriptors::PACKET_LEN;
use crate::falcon::{Setup, Stall};
use packet::{Bulk, ENDPOINTS, Message, ProtocolError, Reader, Status, kind};
use std::collections::VecDeque;

/// What USB carries to and from a device with one bulk pipe each way.
pub trait UsbDevice {
    /// A control transfer: data for the host, none for a request out.
    fn control(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall>;

    /// Data for the device: how many bytes there was room for. The rest is offered again, as a bus does after a NAK.
    fn bulk_out(&mut self, bytes: &[u8]) -> Result<usize, Stall>;

    /// Packets that are ready now, at most `max` bytes; `None` if there are none.
    fn bulk_in(&mut self, max: usize) -> Result<Option<Vec<u8>>, Stall>;
}

const GET_DESCRIPTOR: u8 = 6;
const SET_CONFIGURATION: u8 = 9;
const DEVICE: u16 = 0x0100;
const CONFIGURATION: u16 = 0x0200;
const TYPE_INTERFACE: u8 = 4;
const TYPE_ENDPOINT: u8 = 5;
/// Types of endpoints in ep_info.
const CONTROL_PIPE: u8 = 0;
const NO_PIPE: u8 = 255;
const FULL_SPEED: u8 = 1;
const DIRECTION_IN: u8 = 0x80;
/// bmRequestType, bRequest and wValue of CLEAR_FEATURE(ENDPOINT_HALT).
const CLEAR_HALT: (u8, u8, u16) = (0x02, 1, 0);

/// A transfer that has not ended.
#[derive(Debug, Clone)]
struct Waiting {
    id: u64,
    bulk: Bulk,
}

/// Counts of what went over the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Traffic {
    /// Control transfers.
    pub control: u64,
    /// Bulk transfers to the device.
    pub bulk_out: u64,
    /// Bulk transfers to the host that brought something.
    pub bulk_in: u64,
    /// Transfers the host wanted no more.
    pub cancelled: u64,
    /// Transfers that were stalled.
    pub stalled: u64,
}

/// One peer on one socket.
#[derive(Debug, Clone)]
pub struct Session {
    reader: Reader,
    greeted: bool,
    connected: bool,
    configuration: u8,
    outs: VecDeque<Waiting>,
    ins: VecDeque<Waiting>,
    /// What the first of the transfers in has so far.
    gathered: Vec<u8>,
    /// The last transfer in that was answered, with what it brought.
    last_in: Option<(u64, Vec<u8>)>,
    /// What it brought, if the peer had cancelled it before that arrived.
    returned: Vec<u8>,
    /// Pipes that a stall has halted, out and in: nothing passes until the host clears them.
    halted: [bool; 2],
    output: Vec<u8>,
    traffic: Traffic,
}

impl Default for Session {
    fn default() -> Self {
        Self::new()
    }
}

impl Session {
    /// A session that says hello.
    #[must_use]
    pub fn new() -> Self {
        Self {
            reader: Reader::default(),
            greeted: false,
            connected: false,
            configuration: 0,
            outs: VecDeque::new(),
            ins: VecDeque::new(),
            gathered: Vec::new(),
            last_in: None,
            returned: Vec::new(),
            halted: [false; 2],
            output: packet::hello(),
            traffic: Traffic::default(),
        }
    }

    /// Whether the peer has said hello: before, nothing can be plugged in.
    #[must_use]
    pub const fn is_greeted(&self) -> bool {
        self.greeted
    }

    /// Whether the peer sees a device.
    #[must_use]
    pub const fn is_connected(&self) -> bool {
        self.connected
    }

    /// Whether a transfer to the host waits: then everything the device had was taken, and the one before was dealt with.
    #[must_use]
    pub fn is_read(&self) -> bool {
        !self.ins.is_empty()
    }

    /// What went over the bus so far.
    #[must_use]
    pub const fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// Bytes for the peer; they are its own from here on.
    pub fn take_output(&mut self) -> Vec<u8> {
        core::mem::take(&mut self.output)
    }

    /// Shows the device, as its descriptors have it.
    ///
    /// # Panics
    ///
    /// If the device has no descriptors.
    pub fn connect(&mut self, device: &mut impl UsbDevice) {
        let mut get = |value| {
            let setup = Setup {
                request_type: DIRECTION_IN,
                request: GET_DESCRIPTOR,
                value,
                index: 0,
                length: u16::MAX,
            };
            device.control(setup, &[]).expect("every device has this descriptor")
        };
        let (about, configuration) = (get(DEVICE), get(CONFIGURATION));
        let (interfaces, endpoints) = describe(&configuration);
        self.forget();
        self.output.extend(packet::packet(kind::INTERFACE_INFO, 0, &interfaces));
        self.output.extend(packet::packet(kind::EP_INFO, 0, &endpoints));
        // Speed; class, subclass, protocol; vendor, product and release as they stand in the descriptor.
        let connect = [&[FULL_SPEED], &about[4..7], &about[8..14]].concat();
        self.output.extend(packet::packet(kind::DEVICE_CONNECT, 0, &connect));
        self.connected = true;
    }

    /// Takes the device away; what waited waits no more.
    pub fn disconnect(&mut self) {
        self.forget();
        self.output.extend(packet::packet(kind::DEVICE_DISCONNECT, 0, &[]));
        self.connected = false;
    }

    fn forget(&mut self) {
        self.outs.clear();
        self.ins.clear();
        self.gathered.clear();
        self.returned.clear();
        self.last_in = None;
        self.configuration = 0;
    }

    /// Takes bytes of the peer, and does what they ask for.
    pub fn receive(&mut self, bytes: &[u8], device: &mut impl UsbDevice) -> Result<(), ProtocolError> {
        self.reader.push(bytes);
        while let Some((id, message)) = self.reader.next_message()? {
            if let Message::Hello { .. } = message {
                self.greeted = true;
            } else if self.connected {
                self.obey(id, message, device);
            }
            // What was under way when the device was taken away has nobody to answer it, and the peer knows.
        }
        Ok(())
    }

    fn obey(&mut self, id: u64, message: Message, device: &mut impl UsbDevice) {
        match message {
            Message::Hello { .. } | Message::Other(_) => {}
            Message::Reset => {
                while let Some(waiting) = self.outs.pop_front().or_else(|| self.ins.pop_front()) {
                    self.cancelled(&waiting);
                }
                self.forget();
                let _ = device.control(configure(0), &[]);
            }
            Message::SetConfiguration(configuration) => {
                let status = match device.control(configure(configuration), &[]) {
                    Ok(_) => Status::Success,
                    Err(Stall) => Status::Stall,
                };
                if status == Status::Success {
                    self.configuration = configuration;
                }
                self.say(kind::CONFIGURATION_STATUS, id, &[status as u8, self.configuration]);
            }
            Message::GetConfiguration => {
                self.say(kind::CONFIGURATION_STATUS, id, &[Status::Success as u8, self.configuration]);
            }
            Message::SetAlternate { interface, alternate } => {
                // There is one setting.
                let status = if alternate == 0 { Status::Success } else { Status::Stall };
                self.say(kind::ALT_SETTING_STATUS, id, &[status as u8, interface, 0]);
            }
            Message::GetAlternate { interface } => {
                self.say(kind::ALT_SETTING_STATUS, id, &[Status::Success as u8, interface, 0]);
            }
            Message::Cancel => self.cancel(id),
            Message::Control { endpoint, setup, data } => {
                self.traffic.control += 1;
                if (setup.request_type, setup.request, setup.value) == CLEAR_HALT {
                    self.halted[usize::from(setup.index & u16::from(DIRECTION_IN) != 0)] = false;
                }
                let answer = device.control(setup, &data);
                let (status, answer) = match answer {
                    Ok(answer) => (Status::Success, answer),
                    Err(Stall) => (Status::Stall, Vec::new()),
                };
                self.traffic.stalled += u64::from(status == Status::Stall);
                let is_in = setup.request_type & DIRECTION_IN != 0;
                let len = match status {
                    Status::Success if !is_in => usize::from(setup.length),
                    _ => answer.len(),
                };
                self.output.extend(packet::control(id, endpoint, setup, status, len, &answer));
            }
            Message::Bulk(bulk) => {
                let waiting = Waiting { id, bulk };
                if waiting.bulk.endpoint & DIRECTION_IN == 0 {
                    self.outs.push_back(waiting);
                } else if waiting.bulk.len < PACKET_LEN {
                    // A packet may not fit.
                    self.end(&waiting, Status::Invalid, 0, &[]);
                } else {
                    self.ins.push_back(waiting);
                }
                self.poll(device);
            }
        }
    }

    fn say(&mut self, kind: u32, id: u64, body: &[u8]) {
        self.output.extend(packet::packet(kind, id, body));
    }

    fn cancel(&mut self, id: u64) {
        let found = [&mut self.outs, &mut self.ins].into_iter().find_map(|queue| {
            let at = queue.iter().position(|waiting| waiting.id == id)?;
            queue.remove(at)
        });
        if let Some(waiting) = found {
            self.cancelled(&waiting);
        } else if let Some((_, data)) = self.last_in.take_if(|(last, _)| *last == id) {
            // The answer and the cancellation have met on their ways: the peer throws the answer away, where a bus would not have carried
            // it. The next transfer gets it.
            self.traffic.cancelled += 1;
            self.returned.extend(data);
        }
    }

    fn cancelled(&mut self, waiting: &Waiting) {
        self.traffic.cancelled += 1;
        self.end(waiting, Status::Cancelled, 0, &[]);
    }

    fn end(&mut self, waiting: &Waiting, status: Status, len: usize, data: &[u8]) {
        let Waiting { id, bulk } = waiting;
        self.traffic.stalled += u64::from(status == Status::Stall);
        self.output.extend(packet::bulk(*id, bulk.endpoint, bulk.stream, status, len, data));
    }

    /// Looks whether transfers that wait can go on.
    pub fn poll(&mut self, device: &mut impl UsbDevice) {
        while let Some(waiting) = self.outs.front_mut() {
            let taken = if self.halted[0] { Err(Stall) } else { device.bulk_out(&waiting.bulk.data) };
            self.halted[0] = taken.is_err();
            if let Ok(count) = taken {
                waiting.bulk.data.drain(..count);
                if !waiting.bulk.data.is_empty() {
                    break;
                }
            }
            let Some(waiting) = self.outs.pop_front() else { break };
            self.traffic.bulk_out += 1;
            match taken {
                Ok(_) => self.end(&waiting, Status::Success, waiting.bulk.len, &[]),
                Err(Stall) => self.end(&waiting, Status::Stall, 0, &[]),
            }
        }
        while !self.returned.is_empty()
            && let Some(waiting) = self.ins.pop_front()
        {
            let data: Vec<u8> = self.returned.drain(..waiting.bulk.len.min(self.returned.len())).collect();
            self.brought(&waiting, Status::Success, data);
        }
        while let Some(waiting) = self.ins.front() {
            // Whole packets only, as on a wire.
            let room = waiting.bulk.len.saturating_sub(self.gathered.len()) / PACKET_LEN * PACKET_LEN;
            // What a cancelled transfer has left may fill this one.
            let packets = match room {
                _ if self.halted[1] => Err(Stall),
                0 => Ok(Some(Vec::new())),
                _ => device.bulk_in(room),
            };
            self.halted[1] = packets.is_err();
            let (status, ended) = match packets {
                Ok(Some(packets)) => {
                    self.gathered.extend(&packets);
                    (Status::Success, packets.len() % PACKET_LEN != 0 || packets.len() == room)
                }
                Ok(None) => (Status::Success, false),
                Err(Stall) => (Status::Stall, true),
            };
            if !ended {
                break;
            }
            let Some(waiting) = self.ins.pop_front() else { break };
            let data: Vec<u8> = self.gathered.drain(..waiting.bulk.len.min(self.gathered.len())).collect();
            self.brought(&waiting, status, data);
        }
    }

    fn brought(&mut self, waiting: &Waiting, status: Status, data: Vec<u8>) {
        self.traffic.bulk_in += 1;
        self.end(waiting, status, data.len(), &data);
        self.last_in = Some((waiting.id, data));
    }
}

const fn configure(configuration: u8) -> Setup {
    Setup { request_type: 0, request: SET_CONFIGURATION, value: configuration as u16, index: 0, length: 0 }
}

/// Bodies of interface_info and ep_info, by a walk through a configuration descriptor.
fn describe(configuration: &[u8]) -> (Vec<u8>, Vec<u8>) {
    let (mut count, mut numbers, mut classes) = (0_u32, [0; ENDPOINTS], [[0; ENDPOINTS]; 3]);
    let (mut kinds, mut intervals, mut owners) = ([NO_PIPE; ENDPOINTS], [0; ENDPOINTS], [0; ENDPOINTS]);
    let mut sizes = [0_u16; ENDPOINTS];
    (kinds[0], kinds[ENDPOINTS / 2]) = (CONTROL_PIPE, CONTROL_PIPE);
    let mut rest = configuration;
    while let [len, kind, fields @ ..] = rest {
        match (*kind, fields) {
            (TYPE_INTERFACE, [number, _alternate, _endpoints, class, subclass, protocol, ..]) => {
                let at = count as usize % ENDPOINTS;
                numbers[at] = *number;
                for (classes, class) in classes.iter_mut().zip([class, subclass, protocol]) {
                    classes[at] = *class;
                }
                count += 1;
            }
            (TYPE_ENDPOINT, [address, attributes, low, high, interval, ..]) => {
                let at =
                    usize::from(address & 0x0f) + if address & DIRECTION_IN == 0 { 0 } else { ENDPOINTS / 2 };
                (kinds[at], intervals[at]) = (attributes & 3, *interval);
                sizes[at] = u16::from_le_bytes([*low, *high]);
                owners[at] = numbers[(count as usize).saturating_sub(1) % ENDPOINTS];
            }
            _ => {}
        }
        // A length that leads nowhere ends the walk.
        rest = rest.get(usize::from(*len).max(2)..).unwrap_or_default();
    }
    let interfaces = [&count.to_le_bytes()[..], &numbers, &classes[0], &classes[1], &classes[2]].concat();
    let sizes = sizes.map(u16::to_le_bytes).concat();
    (interfaces, [&kinds[..], &intervals, &owners, &sizes].concat())
}

#[cfg(test)]
mod tests;
