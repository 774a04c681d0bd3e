//! The host's end of the device link against a firmware at the far end of a socket: the whole life of a session.
//!
//! `cargo run --release -p palpate-core --example link_peer -- SOCKET` waits there for QEMU's serial port. What is wrong ends it with a
//! line and 1.
//!
//! The firmware's time is to be the emulator's (`-icount`): then its watchdog counts what the firmware has done, and a busy machine cannot
//! trip it. Nothing here waits for silence: what must not be answered is followed by what must.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use palpate_link::message::{CLAMPED, ENABLED, HOMED, HOMING, REFUSED};
use palpate_link::{DeviceFault, DeviceMessage, FrameReader, HostMessage, MAX_FRAME, VERSION, encode};

/// Commands in a row that must be obeyed.
const COMMANDS: u32 = 1000;
/// For anything that must come; real time, and the machine may be busy.
const PATIENCE: Duration = Duration::from_secs(60);

type Outcome<T> = Result<T, String>;

/// What a request came to.
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

    /// The next answer.
    fn hear(&mut self) -> Outcome<Answer> {
        let until = Instant::now() + PATIENCE;
        let mut byte = [0];
        while Instant::now() < until {
            match self.line.read(&mut byte) {
                Ok(0) => return Err("the firmware is gone".into()),
                Ok(_) => {}
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => continue,
                Err(error) => return Err(format!("the line: {error}")),
            }
            match self.reader.push(byte[0]) {
                None => {}
                Some(Err(error)) => return Err(format!("a bad frame from the firmware: {error}")),
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
        self.hear().map_err(|error| format!("{error} to {message:?}"))
    }

    /// The state after a request that must not meet a fault.
    fn state(&mut self, message: &HostMessage) -> Outcome<([i32; 3], u8)> {
        match self.ask(message)? {
            Answer::State { encoders, flags, seq_echo } if seq_echo == self.seq => Ok((encoders, flags)),
            Answer::State { seq_echo, .. } => Err(format!("number {seq_echo} for {}", self.seq)),
            Answer::Fault(code) => Err(format!("fault {} after {message:?}", code.name())),
            Answer::Ack { .. } => Err(format!("an acknowledgement of {message:?}")),
        }
    }

    fn hello(&mut self) -> Outcome<()> {
        let nonce = 0xabcd_0000 + self.requests;
        match self.ask(&HostMessage::Hello { version: VERSION, nonce })? {
            Answer::Ack { session, nonce: echo } => {
                expect(echo == nonce && session != 0 && session != self.session, "a new session")?;
                (self.session, self.seq) = (session, 0);
                Ok(())
            }
            Answer::State { .. } | Answer::Fault(_) => Err("no acknowledgement of Hello".into()),
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
    if is { Ok(()) } else { Err(format!("{what}: not so")) }
}

fn life(peer: &mut Peer) -> Outcome<String> {
    // Noise first, and a frame cut short: neither is answered, or the answer to Hello would not be the first. A 00 ends both.
    peer.line.write_all(&[7, 0, 1, 2, 3, 0xff, 0, 9, 9, 0]).map_err(|error| error.to_string())?;
    peer.hello()?;
    let early = peer.enable();
    let (_, flags) = peer.state(&early)?;
    expect(flags & REFUSED != 0 && flags & ENABLED == 0, "not enabled before it is homed")?;
    home(peer)?;
    // A second search is a new one.
    home(peer)?;

    let turned = obeyed(peer)?;
    expect(turned[0] > 0 && turned[1] < 0 && turned[2] == 0, "each axis turns with its torque")?;

    let beyond = peer.command([i32::MAX, 0, 0]);
    let (_, flags) = peer.state(&beyond)?;
    expect(flags & CLAMPED != 0, "a torque beyond the limit is shortened")?;

    // The same number acts once; nor does it feed the watchdog, which bites. Then nothing but a new session and Enable goes on.
    let asked = Instant::now();
    let code = loop {
        match peer.ask(&beyond)? {
            Answer::State { flags, .. } => expect(flags & REFUSED != 0, "the same number acts once")?,
            Answer::Fault(code) => break code,
            Answer::Ack { .. } => return Err("an acknowledgement of a command".into()),
        }
        expect(asked.elapsed() < PATIENCE, "the watchdog bites")?;
    };
    expect(code == DeviceFault::Watchdog, "it is the watchdog")?;
    for message in [peer.command([1; 3]), peer.enable(), peer.command([1; 3])] {
        match peer.ask(&message)? {
            Answer::Fault(DeviceFault::Watchdog) => {}
            _ => return Err(format!("the watchdog's fault is latched: not after {message:?}")),
        }
    }
    let stale = peer.command([1; 3]);
    peer.hello()?;
    // Of an old session: not answered, or the next answer would not be to the next request.
    peer.send(&stale)?;
    let unarmed = peer.command([1; 3]);
    let (_, flags) = peer.state(&unarmed)?;
    expect(flags & ENABLED == 0 && flags & REFUSED != 0, "nothing resumes by itself")?;
    Ok(format!(
        "{} requests, {COMMANDS} commands in a row obeyed; the axes turned by {turned:?} counts",
        peer.requests
    ))
}

/// Searches for home, which must take more than one look, and moves nothing.
fn home(peer: &mut Peer) -> Outcome<()> {
    peer.seq += 1;
    let home = HostMessage::Home { session: peer.session, seq: peer.seq };
    peer.state(&home)?;
    let (start, mut looks) = (Instant::now(), 0);
    loop {
        let poll = peer.command([50_000; 3]);
        let (encoders, flags) = peer.state(&poll)?;
        expect(flags & ENABLED == 0 && encoders == [0; 3], "nothing moves before it is enabled")?;
        if flags & HOMING == 0 {
            expect(flags & HOMED != 0 && looks > 0, "home is searched for, not remembered")?;
            return Ok(());
        }
        looks += 1;
        expect(start.elapsed() < PATIENCE, "homed in time")?;
    }
}

/// Enables and commands; the counts turned.
fn obeyed(peer: &mut Peer) -> Outcome<[i32; 3]> {
    let enable = peer.enable();
    let (first, _) = peer.state(&enable)?;
    let mut last = first;
    for _ in 0..COMMANDS {
        let message = peer.command([20_000, -20_000, 0]);
        let (encoders, flags) = peer.state(&message)?;
        expect(flags & (ENABLED | REFUSED) == ENABLED, "a command is obeyed")?;
        last = encoders;
    }
    Ok(std::array::from_fn(|axis| last[axis] - first[axis]))
}

fn run(path: &str) -> Outcome<String> {
    let listener = UnixListener::bind(path).map_err(|error| format!("{path}: {error}"))?;
    let (line, _) = listener.accept().map_err(|error| format!("{path}: {error}"))?;
    line.set_read_timeout(Some(Duration::from_millis(20))).map_err(|error| error.to_string())?;
    let (reader, start) = (FrameReader::new(), Instant::now());
    life(&mut Peer { line, reader, start, session: 0, seq: 0, requests: 0 })
}

fn main() -> ExitCode {
    let Some(path) = std::env::args().nth(1) else {
        eprintln!("usage: link_peer SOCKET");
        return ExitCode::from(2);
    };
    match run(&path) {
        Ok(told) => {
            println!("{told}");
            ExitCode::SUCCESS
        }
        Err(message) => {
            eprintln!("link_peer: {message}");
            ExitCode::FAILURE
        }
    }
}
