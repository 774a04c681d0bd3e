//! The real-time side: clock, 1 kHz loop, its thread and its timing statistics.

pub mod clock;
pub mod config;
pub mod controls;
pub mod haptic_loop;
pub mod histogram;
pub mod latency;
pub mod periodic;
pub mod record;
pub mod state;
pub mod thread;

pub use clock::{Clock, MonotonicClock, VirtualClock};
pub use config::LoopConfig;
pub use controls::Controls;
pub use haptic_loop::{HapticLoop, LoopEnd, LoopOutcome, Outputs};
pub use histogram::{HistogramRow, Histograms, Quantity, TickTimes};
pub use latency::{LatencyRecorder, LatencyReport, Miss, Percentiles};
pub use periodic::{PeriodicEnd, PeriodicTask, run_periodic};
pub use record::{Applied, TickRecord};
pub use state::SessionState;
