//! USB descriptors of the chip: 0403:CB48, full speed, one interface with one bulk pipe in each direction.

/// Vendor id: FTDI.
pub const VENDOR_ID: u16 = 0x0403;
/// Product id of a Novint Falcon.
pub const PRODUCT_ID: u16 = 0xcb48;
/// Address of the bulk pipe to the host.
pub const ENDPOINT_IN: u8 = 0x81;
/// Address of the bulk pipe from the host.
pub const ENDPOINT_OUT: u8 = 0x02;
/// Size of a bulk packet in either direction.
pub const PACKET_LEN: usize = 64;

const DEVICE: u8 = 1;
const CONFIGURATION: u8 = 2;
const STRING: u8 = 3;

/// Packet size of endpoint 0 of an FT232R.
const CONTROL_PACKET_LEN: u8 = 8;
/// Release number that identifies an FT232R.
const RELEASE: u16 = 0x0600;
/// American English, the only language.
const LANGUAGE: u16 = 0x0409;
/// Strings 1 to 3.
const STRINGS: [&str; 3] = ["Novint", "FALCON", "PALPATE1"];

const VENDOR: [u8; 2] = VENDOR_ID.to_le_bytes();
const PRODUCT: [u8; 2] = PRODUCT_ID.to_le_bytes();
const VERSION: [u8; 2] = RELEASE.to_le_bytes();

#[rustfmt::skip]
const DEVICE_DESCRIPTOR: [u8; 18] = [
    18, DEVICE, 0x00, 0x02,       // USB 2.0
    0, 0, 0, CONTROL_PACKET_LEN,  // class given by the interface
    VENDOR[0], VENDOR[1], PRODUCT[0], PRODUCT[1], VERSION[0], VERSION[1],
    1, 2, 3,                      // strings
    1,                            // configuration
];

#[rustfmt::skip]
const CONFIGURATION_DESCRIPTOR: [u8; 32] = [
    9, CONFIGURATION, 32, 0, 1, 1, 0, 0xa0, 45,    // 32 bytes in total, one interface, bus powered, 90 mA
    9, 4, 0, 0, 2, 0xff, 0xff, 0xff, 2,            // interface 0, two endpoints, vendor-specific class
    7, 5, ENDPOINT_IN, 2, PACKET_LEN as u8, 0, 0,  // bulk
    7, 5, ENDPOINT_OUT, 2, PACKET_LEN as u8, 0, 0,
];

/// The descriptor that GET_DESCRIPTOR requests with this value: type in the high byte, index in the low one.
///
/// `None` stalls the request, for example for the device qualifier, which a single-speed device does not
/// have.
#[must_use]
pub fn descriptor(value: u16) -> Option<Vec<u8>> {
    let [index, kind] = value.to_le_bytes();
    match (kind, index) {
        (DEVICE, 0) => Some(DEVICE_DESCRIPTOR.to_vec()),
        (CONFIGURATION, 0) => Some(CONFIGURATION_DESCRIPTOR.to_vec()),
        (STRING, 0) => Some(string([LANGUAGE])),
        (STRING, index) => Some(string(STRINGS.get(usize::from(index) - 1)?.encode_utf16())),
        _ => None,
    }
}

fn string(units: impl IntoIterator<Item = u16>) -> Vec<u8> {
    let mut bytes = vec![0, STRING];
    bytes.extend(units.into_iter().flat_map(u16::to_le_bytes));
    bytes[0] = bytes.len() as u8;
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_and_pipes_are_at_their_usb_offsets() {
        let device = descriptor(0x0100).expect("a device");
        assert_eq!((device.len(), device[0], device[1]), (18, 18, 1));
        assert_eq!(device[8..12], [0x03, 0x04, 0x48, 0xcb]);
        let configuration = descriptor(0x0200).expect("a configuration");
        assert_eq!(usize::from(configuration[2]), configuration.len());
        // Parsed by the lengths, as a host does.
        let (mut kinds, mut at) = (Vec::new(), 0);
        while let Some(&[len, kind]) = configuration.get(at..at + 2) {
            kinds.push(kind);
            if kind == 5 {
                assert_eq!(configuration[at + 3..at + 6], [2, 64, 0]);
            }
            at += usize::from(len);
        }
        assert_eq!((kinds, at), (vec![2, 4, 5, 5], 32));
    }

    #[test]
    fn strings_are_utf16_and_unknown_descriptors_stall() {
        assert_eq!(descriptor(0x0300), Some(vec![4, 3, 0x09, 0x04]));
        assert_eq!(descriptor(0x0301).expect("the vendor")[2..6], [b'N', 0, b'o', 0]);
        assert_eq!((descriptor(0x0304), descriptor(0x0600), descriptor(0x0101)), (None, None, None));
    }
}
