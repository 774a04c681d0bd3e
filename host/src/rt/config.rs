//! Settings of the loop.

/// Timing and arming of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LoopConfig {
    /// Time between deadlines, us.
    pub period_us: u32,
    /// Last part of the wait, which is a busy wait, us.
    pub spin_us: u32,
    /// Device buttons that arm a disarmed controller when pressed; 0 for none.
    pub arm_button: u32,
}

impl Default for LoopConfig {
    fn default() -> Self {
        Self { period_us: 1_000, spin_us: 100, arm_button: 0 }
    }
}
