//! The cycle of a run: one exchange between driver and device per tick.

/// Time between two exchanges, us.
pub const TICK_US: u64 = 1_000;
