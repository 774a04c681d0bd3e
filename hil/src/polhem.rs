//! Emulated firmware of a Polhem / WoodenHaptics: 64-byte text lines, one reply to each valid request.
//!
//! Request: seven decimal i16, `fx fy fz command a0 a1 a2`, forces in mN. Reply: `x y z` in mm (%8.3f), four
//! angles in rad (%7.4f), an info word; padded with spaces, newline as byte 63. Other lines are discarded
//! without a reply. There is no watchdog: the motors keep the last valid force.

use crate::mechanism::Handle;
use crate::transport::Transport;
use palpate_core::{Vec3, vec3};
use std::io;

const LINE_LEN: usize = 64;
/// Command word that applies the forces to the motors.
const NORMAL_OPERATION: i16 = 2;

/// The device with its handle.
#[derive(Debug, Clone)]
pub struct EmulatedPolhem {
    handle: Handle,
    line: Vec<u8>,
    info: i16,
    /// Encoder step at the handle, m; 0 for the protocol's resolution of one micrometre.
    step_m: f32,
    /// Position reported at power-up, m.
    power_up_m: Vec3,
    /// Miscount of the encoders, m.
    miscount_m: Vec3,
    requests: u64,
    refused: u64,
}

impl EmulatedPolhem {
    /// A device that was just plugged in.
    #[must_use]
    pub const fn new(handle: Handle) -> Self {
        Self {
            handle,
            line: Vec::new(),
            info: 0,
            step_m: 0.0,
            power_up_m: vec3::ZERO,
            miscount_m: vec3::ZERO,
            requests: 0,
            refused: 0,
        }
    }

    /// Sets the encoder step at the handle, m.
    #[must_use]
    pub const fn with_step_m(mut self, step_m: f32) -> Self {
        self.step_m = step_m;
        self
    }

    /// Sets the position reported at power-up, m: where the arm rests without power, and where it was this
    /// time.
    #[must_use]
    pub const fn with_power_up_position(mut self, power_up_m: Vec3) -> Self {
        self.power_up_m = power_up_m;
        self
    }

    /// The handle with the hand on it.
    #[must_use]
    pub const fn handle(&self) -> &Handle {
        &self.handle
    }

    /// The handle with the hand on it.
    pub const fn handle_mut(&mut self) -> &mut Handle {
        &mut self.handle
    }

    /// Adds a miscount to the encoders, m.
    pub fn jump(&mut self, by_m: Vec3) {
        self.miscount_m = vec3::add(self.miscount_m, by_m);
    }

    /// Power cycle: no force, an empty line buffer, and counters that restart at the present position.
    /// Replies do not reveal it.
    pub fn power_cycle(&mut self) {
        self.line.clear();
        self.handle.release();
        self.miscount_m = vec3::sub(self.power_up_m, self.handle.position_m());
    }

    /// Force on the motors now, N.
    #[must_use]
    pub const fn force_n(&self) -> Vec3 {
        self.handle.force_record().force_n
    }

    /// Position of the handle, m.
    #[must_use]
    pub const fn position_m(&self) -> Vec3 {
        self.handle.position_m()
    }

    /// Valid requests so far.
    #[must_use]
    pub const fn requests(&self) -> u64 {
        self.requests
    }

    /// Discarded lines so far.
    #[must_use]
    pub const fn refused(&self) -> u64 {
        self.refused
    }

    /// Sets the info word of the replies.
    pub const fn set_info(&mut self, info: i16) {
        self.info = info;
    }

    /// Serves all input up to `now_us`.
    pub fn poll(&mut self, now_us: u64, link: &mut (impl Transport + ?Sized)) -> io::Result<()> {
        self.handle.advance(now_us);
        let mut buffer = [0; 256];
        loop {
            let count = link.receive(now_us, &mut buffer)?;
            if count == 0 {
                return Ok(());
            }
            for byte in &buffer[..count] {
                if let Some(reply) = self.take(*byte) {
                    link.send(now_us, reply.as_bytes())?;
                }
            }
        }
    }

    /// Takes one byte. Returns the reply after a valid request or a wake-up newline.
    fn take(&mut self, byte: u8) -> Option<String> {
        if byte != b'\n' {
            // One byte beyond a line is enough to detect that it is too long.
            if self.line.len() < LINE_LEN {
                self.line.push(byte);
            }
            return None;
        }
        let line = std::mem::take(&mut self.line);
        if line.is_empty() {
            return Some(self.reply());
        }
        match parse(&line) {
            Some(motors) => {
                self.handle.command(motors.map(|milli_newtons| f32::from(milli_newtons) / 1000.0), motors);
                self.requests += 1;
                Some(self.reply())
            }
            None => {
                self.refused += 1;
                None
            }
        }
    }

    /// Position reported by the encoders: rounded to their step, with their miscounts.
    #[must_use]
    pub fn reported_m(&self) -> Vec3 {
        let at_m = vec3::add(self.handle.position_m(), self.miscount_m);
        if self.step_m > 0.0 { at_m.map(|metres| (metres / self.step_m).round() * self.step_m) } else { at_m }
    }

    fn reply(&self) -> String {
        let [x, y, z] = self.reported_m().map(|metres| metres * 1e3);
        let angles = format!("{:7.4} {:7.4} {:7.4} {:7.4}", 0.1, -0.2, 0.3, 0.0);
        let text = format!("{x:8.3} {y:8.3} {z:8.3} {angles} {}", self.info);
        format!("{text:<63}\n")
    }
}

/// Forces of a request in mN. `None` for an invalid line, zero for a command other than normal operation.
fn parse(line: &[u8]) -> Option<[i16; 3]> {
    if line.len() + 1 != LINE_LEN {
        return None;
    }
    let text = core::str::from_utf8(line).ok()?;
    let numbers: Vec<i16> = text.split_whitespace().map(str::parse).collect::<Result<_, _>>().ok()?;
    let [x, y, z, command, ..] = *<&[i16; 7]>::try_from(&numbers[..]).ok()?;
    Some(if command == NORMAL_OPERATION { [x, y, z] } else { [0; 3] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::MemoryTransport;

    fn talk(device: &mut EmulatedPolhem, bytes: &[u8]) -> String {
        let (mut device_end, mut driver_end) = MemoryTransport::pair();
        driver_end.send(0, bytes).expect("memory");
        device.poll(0, &mut device_end).expect("memory");
        let mut buffer = [0; 4096];
        let count = driver_end.receive(0, &mut buffer).expect("memory");
        String::from_utf8(buffer[..count].to_vec()).expect("text")
    }

    fn device() -> EmulatedPolhem {
        let at = crate::mechanism::Waypoint { t_us: 0, position_m: [0.0125, -0.1, 0.0001] };
        EmulatedPolhem::new(Handle::new(vec![at]))
    }

    #[test]
    fn a_newline_and_a_request_are_answered_by_64_bytes() {
        let mut device = device();
        let reply = talk(&mut device, b"\n");
        assert_eq!(reply.len(), LINE_LEN);
        assert!(reply.starts_with("  12.500 -100.000    0.100 "), "{reply}");
        let request = format!("{:<63}\n", "1500 -250 0 2 0 0 0");
        assert_eq!(talk(&mut device, request.as_bytes()).len(), LINE_LEN);
        assert_eq!(device.force_n(), [1.5, -0.25, 0.0]);
        let other_command = format!("{:<63}\n", "1500 0 0 1 0 0 0");
        talk(&mut device, other_command.as_bytes());
        assert_eq!(device.force_n(), vec3::ZERO);
    }

    #[test]
    fn invalid_lines_are_discarded_and_keep_the_force() {
        let mut device = device();
        talk(&mut device, format!("{:<63}\n", "1000 0 0 2 0 0 0").as_bytes());
        for bad in ["1 2 3 2 0 0", "1 2 3 2 0 0 0 0", "40000 0 0 2 0 0 0", "x 2 3 2 0 0 0"] {
            assert_eq!(talk(&mut device, format!("{bad:<63}\n").as_bytes()), "", "{bad}");
        }
        assert_eq!(talk(&mut device, b"0 0 0 2 0 0 0\n"), "", "too short");
        assert_eq!(talk(&mut device, format!("{:<90}\n", "0 0 0 2 0 0 0").as_bytes()), "", "too long");
        assert_eq!((device.force_n(), device.refused()), ([1.0, 0.0, 0.0], 6));
    }
}
