//! The host's end of the device link against a firmware at the far end of a socket: the whole life of a session.
//!
//! `cargo run --release -p palpate-core --example link_peer -- SOCKET` waits there for QEMU's serial port. What is wrong ends it with a
//! line and 1. Time in an emulator is not real: where the watchdog bites because this machine was busy, the session is begun again, as a
//! driver would.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use palpate_core::link::message::{CLAMPED, ENABLED, HOMED, REFUSED};
use palpate_core::link::{DeviceFault, DeviceMessage, FrameReader, HostMessage, MAX_FRAME, VERSION, encode};

/// Commands in a row that must be obeyed.
const COMMANDS: u32 = 1000;

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

    /// The next answer; `None` after a fifth of a second without.
    fn hear(&mut self) -> Outcome<Option<Answer>> {
        let until = Instant::now() + Duration::from_millis(200);
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
                    return Ok(Some(Answer::State { seq_echo, encoders, flags }));
                }
                Some(Ok(DeviceMessage::HelloAck { version, session, nonce, info })) => {
                    info.check().map_err(|error| error.to_string())?;
                    expect(version == VERSION, "version")?;
                    return Ok(Some(Answer::Ack { session, nonce }));
                }
                Some(Ok(DeviceMessage::Fault { code })) => return Ok(Some(Answer::Fault(code))),
            }
        }
        Ok(None)
    }

    fn ask(&mut self, message: &HostMessage) -> Outcome<Answer> {
        self.requests += 1;
        self.send(message)?;
        self.hear()?.ok_or_else(|| format!("no answer to {message:?}"))
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
    // Noise first, and a frame cut short: neither is answered, and a 00 ends both.
    peer.line.write_all(&[7, 0, 1, 2, 3, 0xff, 0, 9, 9]).map_err(|error| error.to_string())?;
    expect(peer.hear()?.is_none(), "noise is not answered")?;
    peer.line.write_all(&[0]).map_err(|error| error.to_string())?;

    peer.hello()?;
    let early = peer.enable();
    let (_, flags) = peer.state(&early)?;
    expect(flags & REFUSED != 0 && flags & ENABLED == 0, "not enabled before it is homed")?;
    peer.seq += 1;
    let home = HostMessage::Home { session: peer.session, seq: peer.seq };
    peer.state(&home)?;
    let homing = Instant::now();
    loop {
        let poll = peer.command([50_000; 3]);
        let (encoders, flags) = peer.state(&poll)?;
        expect(flags & ENABLED == 0 && encoders == [0; 3], "nothing moves before it is enabled")?;
        if flags & HOMED != 0 {
            break;
        }
        expect(homing.elapsed() < Duration::from_secs(20), "homed in time")?;
    }

    let mut begun = 0;
    let (turned, round_trip) = loop {
        begun += 1;
        expect(begun < 50, "a thousand commands in a row within 50 sessions")?;
        if let Some(done) = obeyed(peer)? {
            break done;
        }
        peer.hello()?;
    };
    expect(turned[0] > 0 && turned[1] < 0 && turned[2] == 0, "each axis turns with its torque")?;

    let beyond = peer.command([i32::MAX, 0, 0]);
    if let Answer::State { flags, .. } = peer.ask(&beyond)? {
        expect(flags & CLAMPED != 0, "a torque beyond the limit is shortened")?;
        if let Answer::State { flags, .. } = peer.ask(&beyond)? {
            expect(flags & REFUSED != 0, "the same number acts once")?;
        }
    }

    // Silence: the watchdog bites, and nothing but a new session and a new Enable goes on.
    std::thread::sleep(Duration::from_millis(300));
    for message in [peer.command([1; 3]), peer.enable(), peer.command([1; 3])] {
        match peer.ask(&message)? {
            Answer::Fault(DeviceFault::Watchdog) => {}
            _ => return Err(format!("the watchdog's fault is latched: not after {message:?}")),
        }
    }
    let stale = peer.command([1; 3]);
    peer.hello()?;
    peer.send(&stale)?;
    expect(peer.hear()?.is_none(), "an old session is not answered")?;
    let unarmed = peer.command([1; 3]);
    let (_, flags) = peer.state(&unarmed)?;
    expect(flags & ENABLED == 0 && flags & REFUSED != 0, "nothing resumes by itself")?;
    Ok(format!(
        "{} requests, {COMMANDS} commands in a row obeyed in session {begun}, {:.2} ms each; the axes turned by {turned:?} counts",
        peer.requests,
        1e3 * round_trip.as_secs_f64()
    ))
}

/// Enables and commands; the counts turned and the mean time of a cycle, or `None` if the watchdog bit.
fn obeyed(peer: &mut Peer) -> Outcome<Option<([i32; 3], Duration)>> {
    let (mut first, mut last) = (None, [0; 3]);
    let start = Instant::now();
    let enable = peer.enable();
    for number in 0..=COMMANDS {
        let message = if number == 0 { enable } else { peer.command([2_000, -2_000, 0]) };
        match peer.ask(&message)? {
            Answer::State { flags, encoders, seq_echo } => {
                expect(seq_echo == peer.seq && flags & ENABLED != 0, "enabled")?;
                first.get_or_insert(encoders);
                last = encoders;
            }
            Answer::Fault(DeviceFault::Watchdog) => return Ok(None),
            Answer::Fault(code) => return Err(format!("fault {}", code.name())),
            Answer::Ack { .. } => return Err("an acknowledgement of a command".into()),
        }
    }
    let first = first.unwrap_or_default();
    let turned = std::array::from_fn(|axis| last[axis] - first[axis]);
    Ok(Some((turned, start.elapsed() / COMMANDS)))
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
