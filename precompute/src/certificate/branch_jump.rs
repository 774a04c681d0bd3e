//! Where a packed space has branch jumps.

use palpate_core::Space;
use palpate_core::flags::SMOOTH;

/// Whether the cell of the position, or an adjacent one, contains a branch jump.
pub(super) fn has_branch_jump(space: &Space<'_>, displacement_m: [f32; 3]) -> bool {
    let at = space.lattice().locate(displacement_m);
    let (corners, flags) = (space.lattice().corners(at.slot), space.planes().flags);
    corners.iter().any(|slot| flags.get(*slot).is_none_or(|bits| bits & SMOOTH == 0))
}
