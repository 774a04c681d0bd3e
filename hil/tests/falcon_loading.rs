//! The Falcon's driver loads the firmware of the emulated device.

use crate::falcon_board::Board;
use palpate_hil::falcon::LoaderFault;
use palpate_host::device::falcon::Image;
use palpate_host::device::falcon::loader::{LoadError, load, probe, set_normal};
use palpate_host::{DeviceError, DeviceErrorKind};

/// Calls and loads until the driver gives up.
const MAX_CALLS: u32 = 100;
const MAX_LOADS: u32 = 20;

#[test]
fn running_firmware_is_detected_without_force() {
    let chip = Board::running();
    set_normal(&chip).expect("a link");
    assert!(probe(&chip).expect("a link").is_some());
    let request = chip.last();
    assert_eq!((request.motors, request.homing), ([0; 3], false));
    let silent = Board::silent(None);
    set_normal(&silent).expect("a link");
    assert_eq!(probe(&silent), Ok(None));
}

#[test]
fn an_image_is_loaded_byte_for_byte_and_answers() {
    // It answers the fourth call.
    let (chip, image) = (Board::silent(Some((LoaderFault::Silent, 3))), Image::synthetic(500));
    assert!(load(&chip, &image).is_ok());
    chip.with(|script| {
        let is_sent =
            |bytes: &[u8]| script.written.windows(bytes.len()).filter(|part| *part == bytes).count();
        assert_eq!(is_sent(&[b"A", image.bytes()].concat()), 1);
        let settings =
            [(0, 1), (0, 2), (9, 16), (3, 0x4138), (4, 8), (2, 0), (1, 0x200), (1, 0x100), (1, 0x101)];
        assert_eq!(script.settings[..9], settings);
        assert_eq!(script.settings[9..11], [(1, 0x100), (3, 0x15)]);
        let normal = [(9, 1), (2, 0), (4, 8), (3, 0x2), (6, 0x013E), (0, 1), (0, 2)];
        assert_eq!(script.settings[11..], normal);
    });
    assert_eq!(chip.loads(), 4);
    assert_eq!(chip.falcon(|falcon| falcon.image().map(|image| image.words)), Some(500));
}

#[test]
fn a_wrong_echo_restarts_the_load() {
    let fault = LoaderFault::WrongEcho { at: 130 };
    let (chip, image) = (Board::silent(Some((fault, 3))), Image::synthetic(200));
    load(&chip, &image).expect("loaded in the fourth attempt");
    assert_eq!(chip.loads(), 4);
}

#[test]
fn a_permanently_wrong_echo_is_an_error_with_its_position() {
    let fault = LoaderFault::WrongEcho { at: 130 };
    let (chip, image) = (Board::silent(Some((fault, 1_000))), Image::synthetic(200));
    assert_eq!(load(&chip, &image), Err(LoadError::Echo { at: Some(130) }));
    assert_eq!(chip.loads(), MAX_LOADS);
}

#[test]
fn a_missing_loader_and_an_unplugged_cable_are_distinguished() {
    let (chip, image) = (Board::silent(Some((LoaderFault::Silent, 1_000))), Image::synthetic(2));
    assert_eq!(load(&chip, &image), Err(LoadError::NoLoader));
    assert_eq!(chip.loads(), MAX_CALLS);
    chip.unplug();
    let disconnected = DeviceError::new(DeviceErrorKind::Disconnected);
    assert_eq!(load(&chip, &image), Err(LoadError::Device(disconnected)));
}
