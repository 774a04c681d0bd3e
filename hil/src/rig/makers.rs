//! The makers' devices: a Touch on libHD and an omega on libdhd.

use super::OpenError;
use super::maker::{MakerDevice, MakerDriver};
use palpate_host::device::maker::cycles::Cycle;
use palpate_host::device::maker::force_dimension::{Dhd, Exchanging, Family};
use palpate_host::device::maker::touch::{Hd, Touch};
use palpate_host::device::maker::{Driven, Opened, ProxyPart};
use palpate_maker_stub::{Cable, Field};
use std::path::Path;

/// Calibration of a Touch by hand is due.
const NEEDS_HAND: u64 = 0x5002;
/// An error of a frame that damages its values.
const FRAME_ERROR: u64 = 0x402;
/// An error of the connection.
const COMM_ERROR: u64 = 0x302;
/// No such device: of libdhd.
const NO_DEVICE: u64 = 5;

/// A Touch on libHD: the library's scheduler calls the driver's cycle.
#[derive(Debug)]
pub struct TouchDevice;

impl MakerDriver for Touch {
    fn opened(&self) -> &Opened {
        Driven::opened(self)
    }

    fn cycle(&mut self) {}
}

/// Every frame has this error until it is 0.
fn set_error(cable: &Cable, code: u64) {
    cable.set_whole(Field::Failing, code);
}

impl MakerDevice for TouchDevice {
    const NAME: &'static str = "Touch on libHD";
    const PROFILE: &'static str = "touch";
    const CYCLES_US: (u64, u64) = (1_000, 500);
    const UNIT_M: f64 = 1e-3;
    const HOMES: bool = true;

    fn open(
        library: &Path,
        _max_force_n: f32,
        part: ProxyPart,
        clock: Box<dyn Fn() -> u64 + Send>,
    ) -> Result<Box<dyn MakerDriver>, OpenError> {
        let (hd, _) = Hd::load(Some(library))?;
        Ok(Box::new(Touch::start(hd, None, part, clock)?))
    }

    fn set_homed(cable: &Cable, is_homed: bool) {
        cable.set_whole(Field::Calibration, if is_homed { 0 } else { NEEDS_HAND });
    }

    fn set_plugged(cable: &Cable, is_plugged: bool) {
        set_error(cable, if is_plugged { 0 } else { COMM_ERROR });
    }

    fn set_measured(cable: &Cable, is_measured: bool) {
        match (cable.whole(Field::Failing), is_measured) {
            (0, false) => set_error(cable, FRAME_ERROR),
            (FRAME_ERROR, true) => set_error(cable, 0),
            _ => {}
        }
    }

    fn switch_off(cable: &Cable, draw: u64) {
        cable.set_whole(Field::Error, 0x200 + draw % 5);
        cable.set_whole(Field::Errors, cable.whole(Field::Errors) + 1);
    }

    /// The library calibrates it again by itself.
    fn lose_homing(_: &Cable) -> bool {
        false
    }
}

/// An omega on libdhd.
#[derive(Debug)]
pub struct OmegaDevice;

struct Stepped {
    exchange: Exchanging,
    opened: Opened,
}

impl MakerDriver for Stepped {
    fn opened(&self) -> &Opened {
        &self.opened
    }

    fn cycle(&mut self) {
        self.exchange.run();
    }
}

impl Drop for Stepped {
    fn drop(&mut self) {
        self.exchange.close();
    }
}

impl MakerDevice for OmegaDevice {
    const NAME: &'static str = "omega on libdhd";
    const PROFILE: &'static str = "omega";
    const CYCLES_US: (u64, u64) = (500, 250);
    const UNIT_M: f64 = 1.0;
    const HOMES: bool = false;

    fn open(
        library: &Path,
        max_force_n: f32,
        part: ProxyPart,
        clock: Box<dyn Fn() -> u64 + Send>,
    ) -> Result<Box<dyn MakerDriver>, OpenError> {
        let (dhd, _) = Dhd::load(Some(library))?;
        let (exchange, opened) = Exchanging::open(dhd, (Family::Omega, false), max_force_n, part, clock)?;
        Ok(Box::new(Stepped { exchange, opened }))
    }

    fn set_homed(cable: &Cable, is_homed: bool) {
        cable.set_whole(Field::Uninitialized, u64::from(!is_homed));
    }

    fn set_plugged(cable: &Cable, is_plugged: bool) {
        cable.set_whole(Field::Failing, if is_plugged { 0 } else { NO_DEVICE });
    }

    fn set_measured(cable: &Cable, is_measured: bool) {
        cable.set_whole(Field::Cached, u64::from(!is_measured));
    }

    fn switch_off(cable: &Cable, draw: u64) {
        // Not a lost connection, which is a cable that is pulled.
        cable.set_whole(Field::OffCause, [1, 2, 3, 4, 6][(draw % 5) as usize]);
        cable.set_whole(Field::Offs, cable.whole(Field::Offs) + 1);
    }

    fn lose_homing(cable: &Cable) -> bool {
        cable.set_whole(Field::Uninitialized, 1);
        true
    }
}
