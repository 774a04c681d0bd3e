//! Capacities of a build of the core: the one place where they are defined.
//!
//! Tables are used in place, so memory depends only on the number of spaces; the other limits bound the time
//! of a tick, of a picture and of the check at the start. A blob that exceeds a limit is refused with
//! [`crate::BlobError::Capacity`].

/// Largest number of spaces, and largest sizes of the surface and of the tables of one space.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Active nodes. An [`crate::Organ`] that holds fewer has a smaller limit.
    pub spaces: usize,
    /// Slots of the box of the grid.
    pub slots: usize,
    /// Centres of a set of radial basis functions, padding included: each costs time in every tick.
    pub centres: usize,
    /// Vertices of the surface.
    pub vertices: usize,
    /// Triangles of the surface.
    pub triangles: usize,
    /// Modes of the displacements of the surface.
    pub modes: usize,
}

impl Limits {
    /// A real-time PC: every surface node of an organ that is touched anywhere, the largest sets that are
    /// fitted, twice the paper's finest grid (14,146 points), and 50 times the bundled surface.
    pub const PC: Self = Self {
        spaces: 512,
        slots: 255 * 255 * 255,
        centres: 32_768,
        vertices: 100_000,
        triangles: 200_000,
        modes: 1_024,
    };

    /// A live session on a PC: every free vertex of the skin is a space, without tables.
    pub const LIVE: Self = Self { spaces: 4_096, ..Self::PC };

    /// A microcontroller: four nodes, grids of up to 5 cells and forces only; the surface may lie in flash,
    /// unused. The paper's coarsest grid has 5 cells: 514 points, 1,015 with rest and the corners that
    /// complete the cells at the rim.
    pub const MICROCONTROLLER: Self =
        Self { spaces: 4, slots: 13 * 13 * 13, centres: 1_024, vertices: 2_000, triangles: 4_000, modes: 0 };
}
