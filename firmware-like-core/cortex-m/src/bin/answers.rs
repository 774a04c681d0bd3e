//! Reads the golden blob from flash, evaluates every method, and reports bits, instructions and stack.
//!
//! In QEMU with `-icount shift=6` an instruction takes 64 ns and SysTick counts 40 ns: instructions = ticks *
//! 5 / 8.
#![no_std]
#![no_main]

use core::panic::PanicInfo;

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::entry;
use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS};
use cortex_m_semihosting::hio::{self, HostStream};
use palpate_cortex_m::comparison::{self, Bench, Failed, Line};
use palpate_cortex_m::{GOLDEN, stack};

#[entry]
fn main() -> ! {
    let status = match (cortex_m::Peripherals::take(), hio::hstdout()) {
        (Some(peripherals), Ok(out)) => run(peripherals.SYST, out),
        _ => Err(Failed),
    };
    loop {
        debug::exit(if status.is_ok() { EXIT_SUCCESS } else { EXIT_FAILURE });
    }
}

fn run(mut clock: SYST, out: HostStream) -> Result<(), Failed> {
    clock.set_clock_source(SystClkSource::Core);
    clock.set_reload(0x00ff_ffff);
    clock.clear_current();
    clock.enable_counter();
    let mut bench = Machine(out);
    comparison::run(&mut bench, GOLDEN)?;
    bench.say(Line::new("stack").number(stack::high_water_bytes()))
}

struct Machine(HostStream);

impl Bench for Machine {
    fn say(&mut self, mut line: Line) -> Result<(), Failed> {
        self.0.write_all(line.text()).map_err(|()| Failed)
    }

    fn clock(&self) -> u32 {
        // SysTick counts down.
        0_u32.wrapping_sub(SYST::get_current())
    }
}

/// Never called: `check-cortex-m` searches the linked firmware for panics.
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {
        debug::exit(EXIT_FAILURE);
    }
}
