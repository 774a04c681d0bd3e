//! Haply Inverse3 and its grips through the maker's Inverse Service, over WebSocket.
//!
//! ```text
//! Exchange <-> Driver (a cycle) <-> Line (WebSocket) <-> service <-> device
//!                  ^--- Events (a second WebSocket)
//! ```

pub mod driver;
mod error;
mod events;
mod grip;
mod line;
mod protocol;
mod rendered;
mod service;
#[cfg(test)]
mod tests;

pub use driver::Driver;
pub use error::HaplyError;
pub use service::Address;

use super::cycles::Cycles;
use super::driven::{Driven, Opened};
use super::exchange::Exchange;
use super::proxied::Clock;
use std::sync::mpsc::Receiver;

/// What a service has, without a command to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// Version of the service.
    pub version: String,
    /// Its devices: what each is, and what prevents a force, with the fix.
    pub devices: Vec<(String, Option<String>)>,
}

/// Asks a service for its version and reads its inventory.
pub fn look(address: &Address) -> Result<Found, HaplyError> {
    let version = address.version()?;
    let inventory = driver::inventory(address)?.1;
    let devices = inventory.inverse3.iter().flatten().map(|device| {
        let name = format!("{} {}", device.model(), device.device_id.as_deref().unwrap_or("?"));
        (name, device.status().obstacle(true).map(|obstacle| obstacle.to_string()))
    });
    Ok(Found { version: version.text, devices: devices.collect() })
}

/// The open device.
#[derive(Debug)]
pub struct Haply {
    opened: Opened,
    news: Receiver<String>,
    _cycles: Cycles,
}

impl Haply {
    /// Connects to the service and starts the exchanges with its first Inverse3. There is no force before the loop sends one.
    ///
    /// `exchange` gets the largest force that the device states, N: 0, because the service states none.
    pub fn start(
        address: &Address,
        exchange: impl FnOnce(f32) -> Exchange,
        clock: Clock,
        fifo_priority: Option<i32>,
    ) -> Result<Self, HaplyError> {
        let (driver, opened, news) = Driver::open(address, exchange, clock)?;
        let cycles = Cycles::start(Box::new(driver), fifo_priority).map_err(HaplyError::Thread)?;
        Ok(Self { opened, news, _cycles: cycles })
    }
}

impl Driven for Haply {
    fn opened(&self) -> &Opened {
        &self.opened
    }

    fn news(&mut self) -> Option<String> {
        self.news.try_recv().ok()
    }
}
