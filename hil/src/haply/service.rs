//! The sockets of the service: messages and HTTP on one port, events on another.

use super::LOOK;
use super::split::Split;
use super::world::{Reply, World};
use palpate_host::sys::{RtRequest, enter_real_time};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tungstenite::protocol::frame::Frame;
use tungstenite::protocol::frame::coding::{Data, OpCode};
use tungstenite::{Error, Message, WebSocket};

/// From the service's port to that of its events.
const TO_EVENTS: u16 = 19;
/// Real-time priority of a session, if the system gives it: above that of the loop and the proxy.
const PRIORITY: i32 = 80;
/// Time between two looks for a message that comes before its reply.
const EARLY_LOOK: Duration = Duration::from_micros(200);

#[derive(Debug, Default)]
struct Shared {
    world: Mutex<World>,
    ends: AtomicBool,
    /// Readers of events.
    readers: Mutex<Vec<WebSocket<TcpStream>>>,
}

impl Shared {
    fn with<T>(&self, change: impl FnOnce(&mut World) -> T) -> T {
        change(&mut self.world.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn ends(&self) -> bool {
        self.ends.load(Ordering::Relaxed)
    }
}

/// The running service. Its sockets are closed when this is dropped.
#[derive(Debug)]
pub struct Service {
    shared: Arc<Shared>,
    port: u16,
    threads: Vec<JoinHandle<()>>,
}

impl Service {
    /// Starts the service on free ports of this machine.
    pub fn start(world: World) -> io::Result<Self> {
        let (listener, events) = free_ports()?;
        let port = listener.local_addr()?.port();
        let shared = Arc::new(Shared { world: Mutex::new(world), ..Shared::default() });
        let (messages, readers) = (shared.clone(), shared.clone());
        let threads = vec![
            accept(listener, shared.clone(), move |stream| converse(stream, &messages)),
            accept(events, shared.clone(), move |stream| {
                if let Ok(reader) = tungstenite::accept(stream) {
                    readers.readers.lock().unwrap_or_else(PoisonError::into_inner).push(reader);
                }
            }),
        ];
        Ok(Self { shared, port, threads })
    }

    /// HOST:PORT, as `--device haply:` takes it.
    #[must_use]
    pub fn address(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    /// Changes the device or its faults, or looks at them.
    pub fn with<T>(&self, change: impl FnOnce(&mut World) -> T) -> T {
        self.shared.with(change)
    }

    /// Sends an event to all readers.
    pub fn event(&self, name: &str, level: &str, message: &str) {
        let device_id = self.with(|world| world.device_id.clone());
        let event = serde_json::json!({
            "name": name, "category": "device", "level": level, "message": message,
            "data": { "device_family": "inverse", "device_id": device_id },
        });
        let mut readers = self.shared.readers.lock().unwrap_or_else(PoisonError::into_inner);
        readers.retain_mut(|reader| reader.send(Message::text(event.to_string())).is_ok());
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Two ports as far apart as those of the service.
fn free_ports() -> io::Result<(TcpListener, TcpListener)> {
    let mut last = io::Error::from(ErrorKind::AddrInUse);
    for _ in 0..50 {
        let first = TcpListener::bind("127.0.0.1:0")?;
        let port = first.local_addr()?.port().checked_add(TO_EVENTS);
        match port.map(|port| TcpListener::bind(("127.0.0.1", port))) {
            Some(Ok(second)) => return Ok((first, second)),
            Some(Err(error)) => last = error,
            None => {}
        }
    }
    Err(last)
}

/// A thread for each connection, until the service ends.
fn accept(
    listener: TcpListener,
    shared: Arc<Shared>,
    serve: impl Fn(TcpStream) + Send + Clone + 'static,
) -> JoinHandle<()> {
    std::thread::spawn(move || {
        let mut connections = Vec::new();
        if listener.set_nonblocking(true).is_err() {
            return;
        }
        while !shared.ends() {
            match listener.accept() {
                Ok((stream, _))
                    if stream.set_nonblocking(false).is_ok() && stream.set_nodelay(true).is_ok() =>
                {
                    let serve = serve.clone();
                    connections.push(std::thread::spawn(move || serve(stream)));
                }
                Ok(_) => {}
                // Sessions are opened seldom.
                Err(_) => std::thread::sleep(Duration::from_millis(2)),
            }
        }
        for connection in connections {
            let _ = connection.join();
        }
    })
}

/// HTTP or WebSocket: both are on one port.
fn converse(mut stream: TcpStream, shared: &Arc<Shared>) {
    let mut head = [0; 12];
    if stream.set_read_timeout(Some(LOOK)).is_err() {
        return;
    }
    while !shared.ends() {
        match stream.peek(&mut head) {
            Ok(count) if count == head.len() => break,
            Ok(0) => return,
            _ => {}
        }
    }
    if &head == b"GET /version" {
        let _ = stream.read(&mut [0; 1_024]);
        let _ = stream.write_all(shared.with(|world| world.version_answer()).as_bytes());
        return;
    }
    let (raw, is_split) = (stream.try_clone(), Arc::new(AtomicBool::new(false)));
    let (Ok(raw), Ok(mut socket)) = (raw, tungstenite::accept(Split { stream, is_split: is_split.clone() }))
    else {
        return;
    };
    // The firmware behind a real service does not wait for the loop of this machine.
    let (_, _held) = enter_real_time(&RtRequest { fifo_priority: Some(PRIORITY), ..RtRequest::none() });
    let inventory = shared.with(|world| world.state(true));
    if socket.send(Message::text(inventory)).is_ok() {
        session(&mut socket, &raw, &is_split, shared);
    }
    shared.with(World::release);
    let _ = raw.shutdown(Shutdown::Both);
}

/// One state for each message, until the connection ends.
fn session(socket: &mut WebSocket<Split>, raw: &TcpStream, is_split: &AtomicBool, shared: &Arc<Shared>) {
    while !shared.ends() {
        let text = match socket.read() {
            Ok(Message::Text(text)) => text,
            Ok(_) => continue,
            Err(Error::Io(error)) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                continue;
            }
            Err(_) => return,
        };
        let (reply, splits) = shared.with(|world| {
            world.take(text.as_str());
            (world.reply, world.is_split)
        });
        is_split.store(splits, Ordering::Relaxed);
        let count = match reply {
            Reply::Never => 0,
            Reply::Close => return,
            Reply::Twice => 2,
            Reply::Late(ms) => {
                if !wait(ms, raw, shared) {
                    return;
                }
                1
            }
            Reply::Ping => {
                let _ = socket.send(Message::Ping(b"still there?".to_vec().into()));
                1
            }
            Reply::Once | Reply::NoLane | Reply::Fragmented | Reply::Long => 1,
        };
        for _ in 0..count {
            let state = shared.with(|world| world.state(false));
            if frames(state, reply == Reply::Fragmented).into_iter().any(|frame| socket.send(frame).is_err())
            {
                return;
            }
        }
    }
}

/// A text as one message, or as a message in two frames.
fn frames(text: String, is_fragmented: bool) -> Vec<Message> {
    if !is_fragmented {
        return vec![Message::text(text)];
    }
    let (first, rest) = text.as_bytes().split_at(text.len() / 2);
    let frame = |part: &[u8], kind, is_last| {
        Message::Frame(Frame::message(part.to_vec(), OpCode::Data(kind), is_last))
    };
    vec![frame(first, Data::Text, false), frame(rest, Data::Continue, true)]
}

/// Waits before a reply, and counts messages that come before it. False if the connection ends.
fn wait(ms: u64, raw: &TcpStream, shared: &Arc<Shared>) -> bool {
    let until = Instant::now() + Duration::from_millis(ms);
    let (mut is_early, mut is_open) = (false, true);
    // A read timeout is rounded up to kernel ticks of 4 ms.
    let _ = raw.set_nonblocking(true);
    while is_open && Instant::now() < until && !shared.ends() {
        match raw.peek(&mut [0]) {
            Ok(0) => is_open = false,
            Ok(_) => is_early = true,
            Err(_) => {}
        }
        std::thread::sleep(EARLY_LOOK);
    }
    let _ = raw.set_nonblocking(false);
    if is_early {
        shared.with(|world| world.pipelined += 1);
    }
    is_open
}
