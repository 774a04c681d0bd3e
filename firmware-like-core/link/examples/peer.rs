//! The host's end of the device link, tested against a firmware behind a socket: all requests of a session.
//!
//! `cargo run --release -p palpate-link --example peer -- SOCKET` waits at the socket for QEMU's serial
//! port. The first violation of the protocol ends it with one line and exit code 1.
//!
//! The firmware's clock must be that of the emulator (`-icount`). Its watchdog then measures executed
//! instructions, and load on the PC cannot trigger it. No check waits for a timeout: after a message that
//! must not be answered, the next answer must belong to the next request.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use palpate_link::message::{CLAMPED, ENABLED, HOMED, HOMING, REFUSED};
use palpate_link::{DeviceFault, DeviceMessage, FrameReader, HostMessage, MAX_FRAME, VERSION, encode};

/// Number of consecutive commands that must have an effect.
const COMMANDS: u32 = 1000;
/// Timeout of every answer, in real time: the machine may be busy.
const PATIENCE: Duration = Duration::from_secs(60);

type Outcome<T> = Result<T, String>;

/// The answer to a request.
enum Answer {
    State { seq_echo: u32, encoders: [i32; 3], flags: u8 },
    Ack { session: u32, nonce: u32 },
    Fault(DeviceFault),
}

struct Peer {
    line: UnixStream,
    reader: FrameReader<DeviceMessage>,
    start: Instant,
    session: u32,
    seq: u32,
    requests: u32,
}

impl Peer {
    fn send(&mut self, message: &HostMessage) -> Outcome<()> {
        let mut frame = [0; MAX_FRAME];
        let bytes = encode(message, &mut frame).map_err(|error| error.to_string())?;
        self.line.write_all(bytes).map_err(|error| format!("the line: {error}"))
    }

    /// Receives the next answer.
    fn receive(&mut self) -> Outcome<Answer> {
        let until = Instant::now() + PATIENCE;
        let mut byte = [0];
        while Instant::now() < until {
            match self.line.read(&mut byte) {
                Ok(0) => return Err("the firmware has closed the connection".into()),
                Ok(_) => {}
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => continue,
                Err(error) => return Err(format!("the line: {error}")),
            }
            match self.reader.push(byte[0]) {
                None => {}
                Some(Err(error)) => return Err(format!("bad frame from the firmware: {error}")),
                Some(Ok(DeviceMessage::State { seq_echo, encoders, flags, .. })) => {
                    return Ok(Answer::State { seq_echo, encoders, flags });
                }
                Some(Ok(DeviceMessage::HelloAck { version, session, nonce, info })) => {
                    info.check().map_err(|error| error.to_string())?;
                    expect(version == VERSION, "version")?;
                    return Ok(Answer::Ack { session, nonce });
                }
                Some(Ok(DeviceMessage::Fault { code })) => return Ok(Answer::Fault(code)),
            }
        }
        Err("no answer".into())
    }

    fn ask(&mut self, message: &HostMessage) -> Outcome<Answer> {
        self.requests += 1;
        self.send(message)?;
        self.receive().map_err(|error| format!("{error}, after {message:?}"))
    }

    /// Sends a request; returns the encoders and flags of the state. A fault is an error.
    fn state(&mut self, message: &HostMessage) -> Outcome<([i32; 3], u8)> {
        match self.ask(message)? {
            Answer::State { encoders, flags, seq_echo } if seq_echo == self.seq => Ok((encoders, flags)),
            Answer::State { seq_echo, .. } => {
                Err(format!("the answer has number {seq_echo}, not {}", self.seq))
            }
            Answer::Fault(code) => Err(format!("fault {} after {message:?}", code.name())),
            Answer::Ack { .. } => Err(format!("HelloAck as the answer to {message:?}")),
        }
    }

    fn hello(&mut self) -> Outcome<()> {
        let nonce = 0xabcd_0000 + self.requests;
        match self.ask(&HostMessage::Hello { version: VERSION, nonce })? {
            Answer::Ack { session, nonce: echo } => {
                expect(
                    echo == nonce && session != 0 && session != self.session,
                    "Hello opens a new session",
                )?;
                (self.session, self.seq) = (session, 0);
                Ok(())
            }
            Answer::State { .. } | Answer::Fault(_) => Err("Hello was not answered with HelloAck".into()),
        }
    }

    fn command(&mut self, torque_unm: [i32; 3]) -> HostMessage {
        self.seq += 1;
        let t_host_us = self.start.elapsed().as_micros() as u32;
        HostMessage::Command {
            session: self.session,
            seq: self.seq,
            t_host_us,
            torque_unm,
            valid_for_us: 15_000,
        }
    }

    fn enable(&mut self) -> HostMessage {
        self.seq += 1;
        HostMessage::Enable { session: self.session, seq: self.seq }
    }
}

fn expect(is: bool, what: &str) -> Outcome<()> {
    if is { Ok(()) } else { Err(format!("violated: {what}")) }
}

fn run_session(peer: &mut Peer) -> Outcome<String> {
    // Noise and a truncated frame, each ended by a 00. Neither is answered: the first answer is the one to
    // Hello.
    peer.line.write_all(&[7, 0, 1, 2, 3, 0xff, 0, 9, 9, 0]).map_err(|error| error.to_string())?;
    peer.hello()?;
    let early = peer.enable();
    let (_, flags) = peer.state(&early)?;
    expect(flags & REFUSED != 0 && flags & ENABLED == 0, "Enable is refused before homing")?;
    home(peer)?;
    // A second Home starts a new homing procedure.
    home(peer)?;

    let turned = send_commands(peer)?;
    expect(
        turned[0] > 0 && turned[1] < 0 && turned[2] == 0,
        "each axis turns in the direction of its torque",
    )?;

    let beyond = peer.command([i32::MAX, 0, 0]);
    let (_, flags) = peer.state(&beyond)?;
    expect(flags & CLAMPED != 0, "a torque beyond the limit is reduced")?;

    // A repeated sequence number has no effect and does not reset the watchdog, so the watchdog fires.
    // Afterwards only a new session and Enable permit torque.
    let asked = Instant::now();
    let code = loop {
        match peer.ask(&beyond)? {
            Answer::State { flags, .. } => expect(flags & REFUSED != 0, "a repeated command is refused")?,
            Answer::Fault(code) => break code,
            Answer::Ack { .. } => return Err("HelloAck as the answer to a command".into()),
        }
        expect(asked.elapsed() < PATIENCE, "the watchdog fires in time")?;
    };
    expect(code == DeviceFault::Watchdog, "the fault is that of the watchdog")?;
    for message in [peer.command([1; 3]), peer.enable(), peer.command([1; 3])] {
        match peer.ask(&message)? {
            Answer::Fault(DeviceFault::Watchdog) => {}
            _ => return Err(format!("violated: the watchdog fault is latched after {message:?}")),
        }
    }
    let stale = peer.command([1; 3]);
    peer.hello()?;
    // A message of an old session is not answered: the next answer belongs to the next request.
    peer.send(&stale)?;
    let unarmed = peer.command([1; 3]);
    let (_, flags) = peer.state(&unarmed)?;
    expect(flags & ENABLED == 0 && flags & REFUSED != 0, "a new session is not enabled by itself")?;
    Ok(format!(
        "{} requests, {COMMANDS} consecutive commands with effect; the axes turned by {turned:?} counts",
        peer.requests
    ))
}

/// Homes the device; homing must take more than one poll, and no axis may move.
fn home(peer: &mut Peer) -> Outcome<()> {
    peer.seq += 1;
    let home = HostMessage::Home { session: peer.session, seq: peer.seq };
    peer.state(&home)?;
    let (start, mut looks) = (Instant::now(), 0);
    loop {
        let poll = peer.command([50_000; 3]);
        let (encoders, flags) = peer.state(&poll)?;
        expect(flags & ENABLED == 0 && encoders == [0; 3], "no axis moves before Enable")?;
        if flags & HOMING == 0 {
            expect(flags & HOMED != 0 && looks > 0, "Home starts a new homing procedure")?;
            return Ok(());
        }
        looks += 1;
        expect(start.elapsed() < PATIENCE, "homing ends in time")?;
    }
}

/// Enables the device and sends commands; returns the counts by which each axis turned.
fn send_commands(peer: &mut Peer) -> Outcome<[i32; 3]> {
    let enable = peer.enable();
    let (first, _) = peer.state(&enable)?;
    let mut last = first;
    for _ in 0..COMMANDS {
        let message = peer.command([20_000, -20_000, 0]);
        let (encoders, flags) = peer.state(&message)?;
        expect(flags & (ENABLED | REFUSED) == ENABLED, "a command has an effect")?;
        last = encoders;
    }
    Ok(std::array::from_fn(|axis| last[axis] - first[axis]))
}

fn run(path: &str) -> Outcome<String> {
    let listener = UnixListener::bind(path).map_err(|error| format!("{path}: {error}"))?;
    let (line, _) = listener.accept().map_err(|error| format!("{path}: {error}"))?;
    line.set_read_timeout(Some(Duration::from_millis(20))).map_err(|error| error.to_string())?;
    let (reader, start) = (FrameReader::new(), Instant::now());
    run_session(&mut Peer { line, reader, start, session: 0, seq: 0, requests: 0 })
}

fn main() -> ExitCode {
    let Some(path) = std::env::args().nth(1) else {
        eprintln!("usage: peer SOCKET");
        return ExitCode::from(2);
    };
    match run(&path) {
        Ok(report) => {
            println!("{report}");
            ExitCode::SUCCESS
        }
        Err(message) => {
            eprintln!("peer: {message}");
            ExitCode::FAILURE
        }
    }
}
