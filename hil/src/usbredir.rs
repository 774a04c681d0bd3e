//! A USB device on a usb-redir socket. QEMU's `usb-redir` shows it to a guest, whose USB stack enumerates it.
//!
//! ```text
//! guest's driver <-> guest's kernel <-> QEMU's host controller <-> socket <-> Session <-> UsbDevice
//! ```
//!
//! Input: bytes from the peer. Output: bytes for the peer. The session has no socket and no clock;
//! [`Session::poll`] retries pending transfers.
//!
//! Invariants: each transfer is answered once, with its id. A transfer in is answered when a short packet
//! ends it, when it is full, or when it is cancelled. The data of a cancelled transfer goes to the next one.
//! A disconnected device has no pending transfers.

pub mod packet;

use crate::falcon::descriptors::PACKET_LEN;
use crate::falcon::{Setup, Stall};
use packet::{Bulk, ENDPOINTS, Message, ProtocolError, Reader, Status, kind};
use std::collections::VecDeque;

/// A USB device with one bulk pipe in each direction.
pub trait UsbDevice {
    /// Handles a control transfer. Returns the data for the host, empty for a request out.
    fn control(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall>;

    /// Data for the device. Returns the number of bytes taken; the rest is offered again, as after a NAK.
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
/// Endpoint types in ep_info.
const CONTROL_PIPE: u8 = 0;
const NO_PIPE: u8 = 255;
const FULL_SPEED: u8 = 1;
const DIRECTION_IN: u8 = 0x80;
/// bmRequestType, bRequest and wValue of CLEAR_FEATURE(ENDPOINT_HALT).
const CLEAR_HALT: (u8, u8, u16) = (0x02, 1, 0);

/// A transfer that is not complete.
#[derive(Debug, Clone)]
struct PendingTransfer {
    id: u64,
    bulk: Bulk,
}

/// Counts of the traffic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Traffic {
    /// Control transfers.
    pub control: u64,
    /// Bulk transfers to the device.
    pub bulk_out: u64,
    /// Bulk transfers to the host with data.
    pub bulk_in: u64,
    /// Transfers that the host cancelled.
    pub cancelled: u64,
    /// Stalled transfers.
    pub stalled: u64,
}

/// A session with one peer.
#[derive(Debug, Clone)]
pub struct Session {
    reader: Reader,
    handshake_done: bool,
    connected: bool,
    configuration: u8,
    pending_out: VecDeque<PendingTransfer>,
    pending_in: VecDeque<PendingTransfer>,
    /// Data gathered for the first pending transfer in.
    partial_in: Vec<u8>,
    /// Id and data of the last completed transfer in.
    last_in: Option<(u64, Vec<u8>)>,
    /// Data of a completed transfer that the peer cancelled before it arrived.
    cancelled_data: Vec<u8>,
    /// Pipes halted by a stall, out and in. The host must clear them.
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
    /// A new session, whose output starts with the hello.
    #[must_use]
    pub fn new() -> Self {
        Self {
            reader: Reader::default(),
            handshake_done: false,
            connected: false,
            configuration: 0,
            pending_out: VecDeque::new(),
            pending_in: VecDeque::new(),
            partial_in: Vec::new(),
            last_in: None,
            cancelled_data: Vec::new(),
            halted: [false; 2],
            output: packet::hello(),
            traffic: Traffic::default(),
        }
    }

    /// Whether the peer's hello has arrived. A device can be connected only after it.
    #[must_use]
    pub const fn is_handshake_done(&self) -> bool {
        self.handshake_done
    }

    /// Whether the peer sees a device.
    #[must_use]
    pub const fn is_connected(&self) -> bool {
        self.connected
    }

    /// Counts of the traffic so far.
    #[must_use]
    pub const fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// Takes the bytes for the peer.
    pub fn take_output(&mut self) -> Vec<u8> {
        core::mem::take(&mut self.output)
    }

    /// Connects the device with its descriptors.
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
        let (interfaces, endpoints) = describe_endpoints(&configuration);
        self.clear_transfers();
        self.output.extend(packet::packet(kind::INTERFACE_INFO, 0, &interfaces));
        self.output.extend(packet::packet(kind::EP_INFO, 0, &endpoints));
        // Speed; class, subclass and protocol; vendor, product and release, copied from the descriptor.
        let connect = [&[FULL_SPEED], &about[4..7], &about[8..14]].concat();
        self.output.extend(packet::packet(kind::DEVICE_CONNECT, 0, &connect));
        self.connected = true;
    }

    /// Disconnects the device and drops its pending transfers.
    pub fn disconnect(&mut self) {
        self.clear_transfers();
        self.output.extend(packet::packet(kind::DEVICE_DISCONNECT, 0, &[]));
        self.connected = false;
    }

    fn clear_transfers(&mut self) {
        self.pending_out.clear();
        self.pending_in.clear();
        self.partial_in.clear();
        self.cancelled_data.clear();
        self.last_in = None;
        self.configuration = 0;
    }

    /// Takes bytes of the peer and handles their messages.
    pub fn receive(&mut self, bytes: &[u8], device: &mut impl UsbDevice) -> Result<(), ProtocolError> {
        self.reader.push(bytes);
        while let Some((id, message)) = self.reader.next_message()? {
            if let Message::Hello { .. } = message {
                self.handshake_done = true;
            } else if self.connected {
                self.handle_message(id, message, device);
            }
            // A message to a disconnected device is not answered; the peer expects that.
        }
        Ok(())
    }

    fn handle_message(&mut self, id: u64, message: Message, device: &mut impl UsbDevice) {
        match message {
            Message::Hello { .. } | Message::Other(_) => {}
            Message::Reset => {
                while let Some(transfer) =
                    self.pending_out.pop_front().or_else(|| self.pending_in.pop_front())
                {
                    self.cancelled(&transfer);
                }
                self.clear_transfers();
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
                self.send(kind::CONFIGURATION_STATUS, id, &[status as u8, self.configuration]);
            }
            Message::GetConfiguration => {
                self.send(kind::CONFIGURATION_STATUS, id, &[Status::Success as u8, self.configuration]);
            }
            Message::SetAlternate { interface, alternate } => {
                // There is one alternate setting.
                let status = if alternate == 0 { Status::Success } else { Status::Stall };
                self.send(kind::ALT_SETTING_STATUS, id, &[status as u8, interface, 0]);
            }
            Message::GetAlternate { interface } => {
                self.send(kind::ALT_SETTING_STATUS, id, &[Status::Success as u8, interface, 0]);
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
                let transfer = PendingTransfer { id, bulk };
                if transfer.bulk.endpoint & DIRECTION_IN == 0 {
                    self.pending_out.push_back(transfer);
                } else if transfer.bulk.len < PACKET_LEN {
                    // A packet may not fit.
                    self.end(&transfer, Status::Invalid, 0, &[]);
                } else {
                    self.pending_in.push_back(transfer);
                }
                self.poll(device);
            }
        }
    }

    fn send(&mut self, kind: u32, id: u64, body: &[u8]) {
        self.output.extend(packet::packet(kind, id, body));
    }

    fn cancel(&mut self, id: u64) {
        let found = [&mut self.pending_out, &mut self.pending_in].into_iter().find_map(|queue| {
            let at = queue.iter().position(|transfer| transfer.id == id)?;
            queue.remove(at)
        });
        if let Some(transfer) = found {
            self.cancelled(&transfer);
        } else if let Some((_, data)) = self.last_in.take_if(|(last, _)| *last == id) {
            // The answer and the cancellation have crossed. The peer discards the answer, so the next
            // transfer gets its data.
            self.traffic.cancelled += 1;
            self.cancelled_data.extend(data);
        }
    }

    fn cancelled(&mut self, transfer: &PendingTransfer) {
        self.traffic.cancelled += 1;
        self.end(transfer, Status::Cancelled, 0, &[]);
    }

    fn end(&mut self, transfer: &PendingTransfer, status: Status, len: usize, data: &[u8]) {
        let PendingTransfer { id, bulk } = transfer;
        self.traffic.stalled += u64::from(status == Status::Stall);
        self.output.extend(packet::bulk(*id, bulk.endpoint, bulk.stream, status, len, data));
    }

    /// Retries the pending transfers.
    pub fn poll(&mut self, device: &mut impl UsbDevice) {
        while let Some(transfer) = self.pending_out.front_mut() {
            let taken = if self.halted[0] { Err(Stall) } else { device.bulk_out(&transfer.bulk.data) };
            self.halted[0] = taken.is_err();
            if let Ok(count) = taken {
                transfer.bulk.data.drain(..count);
                if !transfer.bulk.data.is_empty() {
                    break;
                }
            }
            let Some(transfer) = self.pending_out.pop_front() else { break };
            self.traffic.bulk_out += 1;
            match taken {
                Ok(_) => self.end(&transfer, Status::Success, transfer.bulk.len, &[]),
                Err(Stall) => self.end(&transfer, Status::Stall, 0, &[]),
            }
        }
        while !self.cancelled_data.is_empty()
            && let Some(transfer) = self.pending_in.pop_front()
        {
            let data: Vec<u8> =
                self.cancelled_data.drain(..transfer.bulk.len.min(self.cancelled_data.len())).collect();
            self.complete_in(&transfer, Status::Success, data);
        }
        while let Some(transfer) = self.pending_in.front() {
            // Only whole packets fit, as on the wire.
            let room = transfer.bulk.len.saturating_sub(self.partial_in.len()) / PACKET_LEN * PACKET_LEN;
            // Data of a cancelled transfer may fill this one.
            let packets = match room {
                _ if self.halted[1] => Err(Stall),
                0 => Ok(Some(Vec::new())),
                _ => device.bulk_in(room),
            };
            self.halted[1] = packets.is_err();
            let (status, ended) = match packets {
                Ok(Some(packets)) => {
                    self.partial_in.extend(&packets);
                    (Status::Success, packets.len() % PACKET_LEN != 0 || packets.len() == room)
                }
                Ok(None) => (Status::Success, false),
                Err(Stall) => (Status::Stall, true),
            };
            if !ended {
                break;
            }
            let Some(transfer) = self.pending_in.pop_front() else { break };
            let data: Vec<u8> =
                self.partial_in.drain(..transfer.bulk.len.min(self.partial_in.len())).collect();
            self.complete_in(&transfer, status, data);
        }
    }

    fn complete_in(&mut self, transfer: &PendingTransfer, status: Status, data: Vec<u8>) {
        self.traffic.bulk_in += 1;
        self.end(transfer, status, data.len(), &data);
        self.last_in = Some((transfer.id, data));
    }
}

const fn configure(configuration: u8) -> Setup {
    Setup { request_type: 0, request: SET_CONFIGURATION, value: configuration as u16, index: 0, length: 0 }
}

/// Bodies of interface_info and ep_info from a configuration descriptor.
fn describe_endpoints(configuration: &[u8]) -> (Vec<u8>, Vec<u8>) {
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
        // An invalid length ends the loop.
        rest = rest.get(usize::from(*len).max(2)..).unwrap_or_default();
    }
    let interfaces = [&count.to_le_bytes()[..], &numbers, &classes[0], &classes[1], &classes[2]].concat();
    let sizes = sizes.map(u16::to_le_bytes).concat();
    (interfaces, [&kinds[..], &intervals, &owners, &sizes].concat())
}

#[cfg(test)]
mod tests;
