//! A stream whose writes may arrive in two segments.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Time between the segments.
const PAUSE: Duration = Duration::from_micros(300);

/// The stream of a connection.
#[derive(Debug)]
pub(super) struct Split {
    pub(super) stream: TcpStream,
    pub(super) is_split: Arc<AtomicBool>,
}

impl Read for Split {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        self.stream.read(to)
    }
}

impl Write for Split {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let half = bytes.len() / 2;
        if !self.is_split.load(Ordering::Relaxed) || half == 0 {
            return self.stream.write(bytes);
        }
        self.stream.write_all(&bytes[..half])?;
        std::thread::sleep(PAUSE);
        self.stream.write_all(&bytes[half..])?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.stream.flush()
    }
}
