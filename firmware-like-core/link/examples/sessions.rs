//! Random sessions for the comparison of another implementation of the device with this crate.
//!
//! `cargo run --release -p palpate-link --example sessions -- SCRIPT EXPECTED`
//!
//! SCRIPT has the readings of the hardware and the bytes of the host, EXPECTED the torques and answers of
//! [`Device`], line by line. `hil/bridges/check` plays SCRIPT to the device in C++.

use std::fmt::Write as _;
use std::process::ExitCode;

use palpate_link::{
    Device, DeviceInfo, DeviceMessage, DeviceProfile, FrameReader, HostMessage, Inputs, MAX_FRAME, Phase,
    VERSION, encode,
};

const EVENTS: u32 = 200_000;

/// A linear congruential generator: the script is the same on every machine.
struct Random(u64);

impl Random {
    fn below(&mut self, end: u32) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as u32) % end
    }

    fn one_in(&mut self, count: u32) -> bool {
        self.below(count) == 0
    }

    fn torque_unm(&mut self) -> i32 {
        // Mostly near the limits, sometimes anything.
        match self.below(8) {
            0 => i32::MIN,
            1 => self.below(u32::MAX) as i32,
            _ => self.below(1_200_000) as i32 - 600_000,
        }
    }
}

struct Play {
    random: Random,
    device: Device,
    reader: FrameReader<HostMessage>,
    now_us: u64,
    inputs: Inputs,
    session: u32,
    seq: u32,
    torques: u32,
    faults: u32,
    script: String,
    expected: String,
}

impl Play {
    fn step(&mut self) {
        let random = &mut self.random;
        if random.one_in(2_000) {
            self.now_us -= 1;
        } else {
            self.now_us += u64::from(random.below(900));
        }
        self.inputs.homed = !random.one_in(200);
        self.inputs.fault = random.one_in(1_000);
        self.inputs.buttons = random.below(4) as u8;
        for count in &mut self.inputs.encoders {
            let fastest = if random.one_in(300) { 60 } else { 5 };
            *count = count.wrapping_add(random.below(2 * fastest + 1) as i32 - fastest as i32);
        }
        let before = self.device.phase();
        let torque = self.device.step(self.now_us, &self.inputs).torque_unm;
        let after = self.device.phase();
        self.torques += u32::from(torque != [0; 3]);
        self.faults += u32::from(after != before && matches!(after, Phase::Faulted(_)));
        let ([x, y, z], Inputs { buttons, homed, fault, .. }) = (self.inputs.encoders, self.inputs);
        let flags = (u8::from(homed), u8::from(fault));
        let _ = writeln!(self.script, "step {} {x} {y} {z} {buttons} {} {}", self.now_us, flags.0, flags.1);
        let _ = writeln!(self.expected, "torque {} {} {}", torque[0], torque[1], torque[2]);
    }

    /// The next request: mostly the one that leads to a torque.
    fn request(&mut self) -> HostMessage {
        let random = &mut self.random;
        let faulted = matches!(self.device.phase(), Phase::Faulted(_) | Phase::Idle);
        if random.one_in(if faulted { 4 } else { 800 }) {
            let version = if random.one_in(10) { 2 } else { VERSION };
            return HostMessage::Hello { version, nonce: random.below(u32::MAX) };
        }
        let session = if random.one_in(100) { random.below(3) } else { self.session };
        let seq = if random.one_in(50) { self.seq.wrapping_sub(random.below(3)) } else { self.seq + 1 };
        self.seq = self.seq.max(seq);
        match random.below(200) {
            0 => HostMessage::Disable { session, seq },
            1 => HostMessage::Home { session, seq },
            2..12 => HostMessage::Enable { session, seq },
            _ if self.device.phase() == Phase::Linked => HostMessage::Enable { session, seq },
            _ => {
                let late_us = if random.one_in(20) { random.below(9_000) } else { random.below(300) };
                HostMessage::Command {
                    session,
                    seq,
                    t_host_us: (self.now_us as u32).wrapping_sub(late_us),
                    torque_unm: std::array::from_fn(|_| random.torque_unm()),
                    valid_for_us: random.below(9_000) as u16,
                }
            }
        }
    }

    fn exchange(&mut self) {
        let message = self.request();
        let mut frame = [0; MAX_FRAME];
        let mut bytes = encode(&message, &mut frame).expect("every message fits").to_vec();
        if self.random.one_in(30) {
            let at = self.random.below(bytes.len() as u32) as usize;
            match self.random.below(4) {
                0 => bytes[at] ^= 1 << self.random.below(8),
                1 => drop(bytes.remove(at)),
                2 => bytes.insert(at, 0),
                _ => bytes.extend(std::iter::repeat_n(7, 80)),
            }
        }
        let mut answers = Vec::new();
        for &byte in &bytes {
            let Some(Ok(message)) = self.reader.push(byte) else { continue };
            let Some(answer) = self.device.receive(self.now_us, &message) else { continue };
            if let DeviceMessage::HelloAck { session, .. } = answer {
                (self.session, self.seq) = (session, 0);
            }
            let mut frame = [0; MAX_FRAME];
            answers.extend_from_slice(encode(&answer, &mut frame).expect("every message fits"));
        }
        let hex = |bytes: &[u8]| bytes.iter().fold(String::new(), |text, byte| format!("{text}{byte:02x}"));
        let _ = writeln!(self.script, "read {} {}", self.now_us, hex(&bytes));
        let _ = writeln!(self.expected, "answer {}", hex(&answers));
    }
}

fn main() -> ExitCode {
    let paths: Vec<String> = std::env::args().skip(1).collect();
    let [script, expected] = &paths[..] else {
        eprintln!("usage: sessions SCRIPT EXPECTED");
        return ExitCode::from(2);
    };
    // As in `hil/bridges/link_replay.cpp`.
    let info = DeviceInfo {
        dof: 3,
        counts_per_turn: [4096; 3],
        torque_limit_unm: [500_000, 400_000, 250_000],
        watchdog_us: 10_000,
        serial: 17,
        firmware: 1,
    };
    let device = Device::new(DeviceProfile { info, max_speed_counts_per_s: 20_000, boot: 3 });
    let mut play = Play {
        random: Random(1),
        device: device.expect("the figures are valid"),
        reader: FrameReader::new(),
        // Both clocks wrap within the script.
        now_us: u64::from(u32::MAX) - 10_000_000,
        inputs: Inputs { encoders: [i32::MAX - 20, i32::MIN + 20, 0], ..Inputs::default() },
        session: 0,
        seq: 0,
        torques: 0,
        faults: 0,
        script: String::new(),
        expected: String::new(),
    };
    for _ in 0..EVENTS {
        if play.random.one_in(2) { play.step() } else { play.exchange() }
    }
    println!("{EVENTS} events: {} readings with a torque, {} faults", play.torques, play.faults);
    if play.torques < 10_000 || play.faults < 100 {
        eprintln!("sessions: too few torques or faults to prove anything");
        return ExitCode::FAILURE;
    }
    for (path, text) in [(script, &play.script), (expected, &play.expected)] {
        if let Err(error) = std::fs::write(path, text) {
            eprintln!("sessions: {path}: {error}");
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}
