//! How much of everything a build of the core holds: the one place where capacities are fixed.
//!
//! Tables are read where they lie, so nothing here costs memory but the number of spaces; the rest bounds the time of a tick, of a
//! picture and of the check at the start. A blob that needs more is refused by name ([`crate::BlobError::Capacity`]).

use crate::blob::Organ;

/// Largest sizes of the tables of one space, and of the surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Slots of the box round the grid, ghosts included.
    pub slots: usize,
    /// Centres of a set of radial basis functions, padding included: each costs time in every tick.
    pub centres: usize,
    /// Vertices of the surface.
    pub vertices: usize,
    /// Modes of the surface's displacement.
    pub modes: usize,
}

impl Limits {
    /// A real-time PC: the largest sets that are fitted, twice the paper's finest grid (14,146 points); 50 times the bundled surface.
    pub const PC: Self = Self { slots: 255 * 255 * 255, centres: 32_768, vertices: 100_000, modes: 1_024 };

    /// A microcontroller: grids of up to 5 cells (the paper's coarsest: 514 points, 1,015 with the corners that complete the cells at the rim and rest), forces only; the surface may lie in flash unused.
    pub const MICROCONTROLLER: Self = Self { slots: 13 * 13 * 13, centres: 1_024, vertices: 2_000, modes: 0 };
}

/// Active nodes on a PC: every surface node of an organ that is touched anywhere.
pub const PC_SPACES: usize = 512;

/// Active nodes on a microcontroller.
pub const MICROCONTROLLER_SPACES: usize = 4;

/// An organ on a PC.
pub type PcOrgan<'a> = Organ<'a, PC_SPACES>;

/// An organ on a microcontroller. Read it with [`Organ::read_within`] and [`Limits::MICROCONTROLLER`].
pub type MicrocontrollerOrgan<'a> = Organ<'a, MICROCONTROLLER_SPACES>;
