//! The makers' devices: a Touch on libHD, an omega on libdhd, an Inverse3 on its service.

use super::OpenError;
use super::maker::MakerDevice;
use crate::haply::{Reply, Service, World};
use palpate_core::Vec3;
use palpate_host::device::maker::cycles::Cycle;
use palpate_host::device::maker::force_dimension::{Dhd, Exchanging, Family};
use palpate_host::device::maker::haply;
use palpate_host::device::maker::touch::{Hd, Touch};
use palpate_host::device::maker::{Clock, Driven, Opened, ProxyPart};
use palpate_maker_stub::{Field, Stub};

/// Calibration of a Touch by hand is due.
const NEEDS_HAND: u64 = 0x5002;
/// An error of a frame that damages its values.
const FRAME_ERROR: u64 = 0x402;
/// An error of the connection.
const COMM_ERROR: u64 = 0x302;
/// No such device: of libdhd.
const NO_DEVICE: u64 = 5;
/// Longest real time that a reply of the service is waited for, in waits of the driver.
const MOST_WAITS: u32 = 500;

fn place(stub: &Stub, now_ns: u64, position: Vec3, unit_m: f64) {
    stub.cable.set_whole(Field::Now, now_ns);
    for (axis, m) in (0..).zip(position) {
        stub.cable.set_quantity(Field::Position(axis), f64::from(m) / unit_m);
    }
}

fn felt(stub: &Stub) -> (u64, Vec3) {
    let force_n = core::array::from_fn(|axis| stub.cable.quantity(Field::Force(axis as u64)) as f32);
    (stub.cable.whole(Field::Frames), force_n)
}

/// Adds one to a number of the cable.
fn count(stub: &Stub, field: Field) {
    stub.cable.set_whole(field, stub.cable.whole(field) + 1);
}

/// A Touch on libHD: the library's scheduler calls the driver's cycle.
#[derive(Debug)]
pub struct TouchDevice {
    /// Dropped before its library, which another rig uses then.
    driver: Option<Touch>,
    stub: Stub,
}

impl MakerDevice for TouchDevice {
    const NAME: &'static str = "Touch on libHD";
    const PROFILE: &'static str = "touch";
    const CYCLES_US: (u64, u64) = (1_000, 500);
    const HOMES: bool = true;

    fn new() -> Result<Self, OpenError> {
        Ok(Self { driver: None, stub: Stub::new()? })
    }

    fn open(&mut self, _: f32, part: ProxyPart, clock: Clock) -> Result<Opened, OpenError> {
        let (hd, _) = Hd::load(Some(&self.stub.library()))?;
        let driver = self.driver.insert(Touch::start(hd, None, part, clock)?);
        Ok(driver.opened().clone())
    }

    fn close(&mut self) {
        self.driver = None;
    }

    fn place(&mut self, now_ns: u64, position_m: Vec3) {
        place(&self.stub, now_ns, position_m, 1e-3);
    }

    fn cycle(&mut self, is_measured: bool) {
        let cable = &self.stub.cable;
        match (cable.whole(Field::Failing), is_measured) {
            (0, false) => cable.set_whole(Field::Failing, FRAME_ERROR),
            (FRAME_ERROR, true) => cable.set_whole(Field::Failing, 0),
            _ => {}
        }
        self.stub.step();
    }

    fn felt(&self) -> (u64, Vec3) {
        felt(&self.stub)
    }

    fn press(&mut self, buttons: u8) {
        self.stub.cable.set_whole(Field::Buttons, buttons.into());
    }

    fn set_homed(&mut self, is_homed: bool) {
        self.stub.cable.set_whole(Field::Calibration, if is_homed { 0 } else { NEEDS_HAND });
    }

    fn set_plugged(&mut self, is_plugged: bool) {
        self.stub.cable.set_whole(Field::Failing, if is_plugged { 0 } else { COMM_ERROR });
    }

    fn switch_off(&mut self, draw: u64) {
        self.stub.cable.set_whole(Field::Error, 0x200 + draw % 5);
        count(&self.stub, Field::Errors);
    }

    /// The library calibrates it again by itself.
    fn lose_homing(&mut self) -> bool {
        false
    }
}

/// An omega on libdhd.
#[derive(Debug)]
pub struct OmegaDevice {
    driver: Option<Exchanging>,
    stub: Stub,
}

impl MakerDevice for OmegaDevice {
    const NAME: &'static str = "omega on libdhd";
    const PROFILE: &'static str = "omega";
    const CYCLES_US: (u64, u64) = (500, 250);
    const HOMES: bool = false;

    fn new() -> Result<Self, OpenError> {
        Ok(Self { driver: None, stub: Stub::new()? })
    }

    fn open(&mut self, max_force_n: f32, part: ProxyPart, clock: Clock) -> Result<Opened, OpenError> {
        let (dhd, _) = Dhd::load(Some(&self.stub.library()))?;
        let (driver, opened) = Exchanging::open(dhd, (Family::Omega, false), max_force_n, part, clock)?;
        self.driver = Some(driver);
        Ok(opened)
    }

    fn close(&mut self) {
        if let Some(mut driver) = self.driver.take() {
            driver.close();
        }
    }

    fn place(&mut self, now_ns: u64, position_m: Vec3) {
        place(&self.stub, now_ns, position_m, 1.0);
    }

    fn cycle(&mut self, is_measured: bool) {
        self.stub.cable.set_whole(Field::Cached, u64::from(!is_measured));
        if let Some(driver) = &mut self.driver {
            driver.run();
        }
    }

    fn firmware(&mut self) {
        self.stub.step();
    }

    fn felt(&self) -> (u64, Vec3) {
        felt(&self.stub)
    }

    fn press(&mut self, buttons: u8) {
        self.stub.cable.set_whole(Field::Buttons, buttons.into());
    }

    fn set_homed(&mut self, is_homed: bool) {
        self.stub.cable.set_whole(Field::Uninitialized, u64::from(!is_homed));
    }

    fn set_plugged(&mut self, is_plugged: bool) {
        self.stub.cable.set_whole(Field::Failing, if is_plugged { 0 } else { NO_DEVICE });
    }

    fn switch_off(&mut self, draw: u64) {
        // Not a lost connection, which is a cable that is pulled.
        self.stub.cable.set_whole(Field::OffCause, [1, 2, 3, 4, 6][(draw % 5) as usize]);
        count(&self.stub, Field::Offs);
    }

    fn lose_homing(&mut self) -> bool {
        self.set_homed(false);
        true
    }
}

/// An Inverse3 on its service, which answers on threads of its own: each cycle waits for its reply.
#[derive(Debug)]
pub struct InverseDevice {
    driver: Option<haply::Driver>,
    service: Service,
}

impl MakerDevice for InverseDevice {
    const NAME: &'static str = "Inverse3 on its service";
    const PROFILE: &'static str = "haply";
    const CYCLES_US: (u64, u64) = (500, 250);
    const HOMES: bool = false;

    fn new() -> Result<Self, OpenError> {
        Ok(Self { driver: None, service: Service::start(World::default())? })
    }

    fn open(&mut self, _: f32, part: ProxyPart, clock: Clock) -> Result<Opened, OpenError> {
        let (driver, opened, _) = haply::Driver::open(&self.service.address().parse()?, part, clock)?;
        self.driver = Some(driver);
        Ok(opened)
    }

    fn close(&mut self) {
        if let Some(mut driver) = self.driver.take() {
            driver.close();
        }
    }

    fn place(&mut self, _: u64, position_m: Vec3) {
        self.service.with(|world| world.position_m = position_m.map(f64::from));
    }

    fn cycle(&mut self, is_measured: bool) {
        self.service.with(|world| match (world.reply, is_measured) {
            (Reply::Once, false) => world.reply = Reply::NoLane,
            (Reply::NoLane, true) => world.reply = Reply::Once,
            _ => {}
        });
        let Some(driver) = &mut self.driver else { return };
        driver.run();
        for _ in 0..MOST_WAITS {
            if driver.round_trip_ns().is_some() || driver.is_closed() {
                break;
            }
            driver.run();
        }
    }

    fn felt(&self) -> (u64, Vec3) {
        self.service.with(|world| (world.messages, world.set.force_n.map(|n| n as f32)))
    }

    fn press(&mut self, buttons: u8) {
        self.service.with(|world| world.button = buttons & 1 != 0);
    }

    fn set_homed(&mut self, is_homed: bool) {
        self.service.with(|world| world.flags.calibrated = is_homed);
    }

    /// The service ends, and is started again.
    fn set_plugged(&mut self, is_plugged: bool) {
        self.service.with(|world| world.reply = if is_plugged { Reply::Once } else { Reply::Close });
    }

    fn switch_off(&mut self, _: u64) {
        self.service.event("device-safety-triggered", "warning", "FOD stage changed: guard -> hard");
    }

    fn lose_homing(&mut self) -> bool {
        self.set_homed(false);
        true
    }
}
