//! Tests on emulated devices behind real and simulated transports.

mod closed_loop;
mod contract;
mod emulate;
mod falcon;
mod falcon_board;
mod falcon_driver;
mod falcon_exchange;
mod falcon_loading;
mod falcon_threads;
mod guard;
mod link;
mod matrix;
mod polhem;
mod power_cycle;
#[cfg(target_os = "linux")]
mod serial_writes;
mod usbredir;
