//! A haptic device on a microcontroller: the device link over a UART, three motors with encoders.
//!
//! ```text
//! UART -> FrameReader -> Device::receive -> encode -> UART
//! encoders, buttons   -> Device::step    -> torque -> motors, every millisecond
//! ```
//!
//! `palpate-link` defines the protocol and the safety rules. This file adds the parts of a specific firmware:
//! a clock, a port, and the mechanism, here three simulated motors.
#![no_std]
#![no_main]

use core::panic::PanicInfo;

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::entry;
use palpate_cortex_m::uart::Uart;
use palpate_link::{
    Device, DeviceInfo, DeviceProfile, FrameReader, HostMessage, Inputs, MAX_FRAME, Outputs, encode,
};

const PROFILE: DeviceProfile = DeviceProfile {
    info: DeviceInfo {
        dof: 3,
        counts_per_turn: [8192; 3],
        torque_limit_unm: [100_000; 3],
        watchdog_us: 20_000,
        serial: 1,
        firmware: 1,
    },
    max_speed_counts_per_s: 200_000,
    boot: 1,
};

/// Control period, microseconds.
const PERIOD_US: u64 = 1_000;

#[entry]
fn main() -> ! {
    if let (Some(peripherals), Ok(device)) = (cortex_m::Peripherals::take(), Device::new(PROFILE)) {
        let uart = Uart::new(&peripherals);
        serve(uart, Clock::new(peripherals.SYST), device);
    }
    // Without its peripherals or a valid profile the device does nothing.
    loop {
        cortex_m::asm::wfi();
    }
}

fn serve(mut uart: Uart, mut clock: Clock, mut device: Device) -> ! {
    let mut reader = FrameReader::<HostMessage>::new();
    let mut motors = [Motor::AT_REST; 3];
    let (mut homing_us, mut looking) = (None::<u64>, false);
    let (mut frame, mut sent, mut len) = ([0; MAX_FRAME], 0, 0);
    let mut next_us = 0;
    loop {
        let now_us = clock.now_us();
        // One answer at a time; bytes that arrive meanwhile wait in the port.
        if sent < len {
            sent += usize::from(frame.get(sent).is_none_or(|&byte| uart.write(byte)));
        } else if let Some(Ok(message)) = uart.read().and_then(|byte| reader.push(byte)) {
            let answer = device.receive(now_us, &message);
            len = answer.and_then(|answer| Some(encode(&answer, &mut frame).ok()?.len())).unwrap_or(0);
            sent = 0;
        }
        if now_us >= next_us {
            // A late period is not compensated.
            next_us = now_us + PERIOD_US;
            let homed = homing_us.is_some_and(|until_us| now_us >= until_us);
            let inputs = Inputs { encoders: motors.map(Motor::counts), buttons: 0, homed, fault: false };
            let Outputs { torque_unm, home } = device.step(now_us, &inputs);
            if home && !looking {
                // Every homing procedure takes 0.1 s, whatever the result of an earlier one.
                homing_us = Some(now_us + 100_000);
            }
            looking = home;
            for (motor, torque_unm) in motors.iter_mut().zip(torque_unm) {
                motor.turn(torque_unm);
            }
        }
    }
}

/// Time since the start, from a 24-bit counter that must be read at least once per period of 0.67 s.
struct Clock {
    last: u32,
    cycles: u64,
}

impl Clock {
    const CYCLES_PER_US: u64 = 25;

    fn new(mut counter: SYST) -> Self {
        counter.set_clock_source(SystClkSource::Core);
        counter.set_reload(0x00ff_ffff);
        counter.clear_current();
        counter.enable_counter();
        Self { last: SYST::get_current(), cycles: 0 }
    }

    fn now_us(&mut self) -> u64 {
        // SysTick counts down.
        let count = SYST::get_current();
        self.cycles += u64::from(self.last.wrapping_sub(count) & 0x00ff_ffff);
        self.last = count;
        self.cycles / Self::CYCLES_PER_US
    }
}

/// A motor with a damped rotor, and its encoder.
#[derive(Clone, Copy)]
struct Motor {
    turns: f32,
    turns_per_s: f32,
}

impl Motor {
    const AT_REST: Self = Self { turns: 0.0, turns_per_s: 0.0 };

    /// One millisecond; inertia 1e-4 kg m^2, damping 1e-3 N m s/rad.
    fn turn(&mut self, torque_unm: i32) {
        let radians_per_s = 6.283_185_5 * self.turns_per_s;
        let torque_nm = torque_unm as f32 * 1e-6 - 1e-3 * radians_per_s;
        self.turns_per_s += torque_nm / 1e-4 * 1e-3 / 6.283_185_5;
        self.turns += self.turns_per_s * 1e-3;
    }

    fn counts(self) -> i32 {
        (self.turns * 8192.0) as i32
    }
}

/// Never called: `check-cortex-m` searches the linked firmware for panics.
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}
