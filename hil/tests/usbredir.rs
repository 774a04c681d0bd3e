//! The bench on its sockets, with a peer that sends usb-redir bytes as QEMU does, without a virtual machine.

use palpate_hil::bench::{BenchCommand, Options, Reply, Report, serve};
use palpate_hil::usbredir::packet::{self, kind};
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

fn connect(path: &Path) -> UnixStream {
    let until = Instant::now() + Duration::from_secs(20);
    loop {
        match UnixStream::connect(path) {
            Ok(stream) => return stream,
            Err(error) => assert!(Instant::now() < until, "{error}"),
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// The next packet: its type, id and body.
fn next(bus: &mut UnixStream) -> (u32, u64, Vec<u8>) {
    let mut header = [0; 16];
    bus.read_exact(&mut header).expect("a packet");
    let word = |at: usize| u32::from_le_bytes(header[at..at + 4].try_into().expect("four"));
    let mut body = vec![0; word(4) as usize];
    bus.read_exact(&mut body).expect("a body");
    (word(0), u64::from(word(8)), body)
}

fn order(control: &mut UnixStream, line: &str) -> Reply {
    control.write_all(format!("{line}\n").as_bytes()).expect("open");
    let (mut answer, mut byte) = (Vec::new(), [0]);
    while byte != *b"\n" {
        control.read_exact(&mut byte).expect("open");
        answer.push(byte[0]);
    }
    serde_json::from_slice(&answer).expect("a reply")
}

fn command(control: &mut UnixStream, command: BenchCommand) -> Reply {
    order(control, &serde_json::to_string(&command).expect("plain data"))
}

fn report(control: &mut UnixStream) -> Report {
    match command(control, BenchCommand::Report) {
        Reply::Report(report) => report,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_peer_sees_the_falcon_connect_answer_and_disconnect() {
    let folder = std::env::temp_dir().join(format!("palpate-usbredir-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let path = |name: &str| -> PathBuf { folder.join(name) };
    let options =
        Options { usbredir: path("usb"), control: Some(path("control")), longest: Duration::from_secs(60) };
    let server = std::thread::spawn(move || {
        let mut log = Vec::new();
        serve(&options, &mut log).map(|traffic| (traffic, String::from_utf8(log).expect("text")))
    });
    let (mut bus, mut control) = (connect(&path("usb")), connect(&path("control")));
    let mut hello = [0; 80];
    bus.read_exact(&mut hello).expect("a hello");
    assert_eq!(hello, *packet::hello());
    bus.write_all(&packet::hello()).expect("open");
    // The cable is still out.
    assert!(!report(&mut control).plugged);
    assert_eq!(command(&mut control, BenchCommand::Plug { seed: 3 }), Reply::Ok);
    let kinds = [0; 3].map(|_: u32| next(&mut bus).0);
    assert_eq!(kinds, [kind::INTERFACE_INFO, kind::EP_INFO, kind::DEVICE_CONNECT]);

    let vendor = |request: u8, value: u16| {
        let [low, high] = value.to_le_bytes();
        [0, request, 0x40, 0, low, high, 0, 0, 0, 0]
    };
    for (id, (request, value)) in [(9, 1), (3, 2), (0, 1)].into_iter().enumerate() {
        bus.write_all(&packet::packet(kind::CONTROL, id as u64, &vendor(request, value))).expect("open");
        let answer = next(&mut bus);
        assert_eq!((answer.0, answer.1, answer.2[3]), (kind::CONTROL, id as u64, 0));
    }
    // An idle chip sends two status bytes each time its 1 ms timer expires.
    for id in 10..20 {
        bus.write_all(&packet::packet(kind::BULK, id, &[0x81, 0, 0, 1, 0, 0, 0, 0, 0, 0])).expect("open");
        let answer = next(&mut bus);
        assert_eq!((answer.0, answer.1, &answer.2[..4]), (kind::BULK, id, &[0x81, 0, 2, 0][..]));
    }

    let report = report(&mut control);
    assert!(report.plugged && !report.homed && report.loads == 0 && report.zero_ms.is_none());
    assert_eq!(order(&mut control, "fly"), Reply::Unknown);
    assert_eq!(command(&mut control, BenchCommand::Plug { seed: 4 }), Reply::Ok);
    let kinds = [0; 4].map(|_: u32| next(&mut bus).0);
    assert_eq!(kinds, [kind::DEVICE_DISCONNECT, kind::INTERFACE_INFO, kind::EP_INFO, kind::DEVICE_CONNECT]);
    assert_eq!(order(&mut control, "\"end\""), Reply::Ok);
    let (traffic, log) = server.join().expect("no panic").expect("no error");
    assert_eq!((traffic.control, traffic.bulk_in, traffic.stalled), (3, 10, 0));
    assert!(log.contains("the cable is out") && log.contains(r#"{"plug":{"seed":4}}: Ok"#), "{log}");
    std::fs::remove_dir_all(folder).expect("ours");
}
