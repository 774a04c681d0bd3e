//! The reachable region of an active node: the boundary of its solved configurations, drawn as rings.

use super::camera::Projection;
use super::image::{Image, StrokeMask};
use super::raster::Raster;
use glam::Vec3;
use palpate_core::{Space, flags};

/// Colour of the rings.
const COLOUR: u32 = 0x9f_e0b4;
/// Points per ring.
const POINTS: usize = 64;
/// Rings of constant angle from the outward normal, rad.
const PARALLELS: [f32; 5] = [0.52, 1.05, 1.57, 2.09, 2.62];
/// Number of half circles from pole to pole.
const MERIDIANS: usize = 8;

/// The rings of one active node.
#[derive(Debug, Clone, Default)]
pub(super) struct Reach {
    /// Index of the space that the rings belong to.
    space: Option<usize>,
    rings: Vec<Vec<Vec3>>,
    mask: StrokeMask,
}

impl Reach {
    /// Draws the rings of a space, and recomputes them when the space changes.
    pub(super) fn draw(
        &mut self,
        (index, space): (usize, &Space<'_>),
        (raster, projection): (&Raster, &Projection),
        image: &mut Image,
    ) {
        if self.space != Some(index) {
            self.space = Some(index);
            self.rings = rings(space);
        }
        let line = (image.height() as f32 / 720.0).max(0.6);
        self.mask.reset(0, 0, image.width(), image.height());
        for ring in &self.rings {
            for pair in ring.windows(2) {
                let (Some((from, near_from)), Some((to, near_to))) =
                    (projection.project(pair[0]), projection.project(pair[1]))
                else {
                    continue;
                };
                self.mask.segment_where(from.to_array(), to.to_array(), 0.4 * line, |x, y, t| {
                    let inverse_depth = near_from + (near_to - near_from) * t;
                    if raster.inverse_depth_at(x, y) > inverse_depth { 0.35 } else { 1.0 }
                });
            }
        }
        self.mask.paint(image, COLOUR, 0.55);
    }
}

/// Closed polylines round the rest position, m.
fn rings(space: &Space<'_>) -> Vec<Vec<Vec3>> {
    let rest = Vec3::from_array(space.active.rest_position_m);
    let axis = Vec3::from_array(space.active.outward_normal).normalize_or(Vec3::Z);
    let (side, other) = axis.any_orthonormal_pair();
    let point = |polar: f32, around: f32| {
        let direction = axis * polar.cos() + (side * around.cos() + other * around.sin()) * polar.sin();
        rest + direction * reach_m(space, direction)
    };
    let turn = |i: usize, of: usize| core::f32::consts::TAU * i as f32 / of as f32;
    let parallels =
        PARALLELS.map(|polar| (0..=POINTS).map(|i| point(polar, turn(i, POINTS))).collect::<Vec<Vec3>>());
    let meridians = (0..MERIDIANS).map(|meridian| {
        (0..=POINTS / 2).map(|i| point(turn(i, POINTS), turn(meridian, MERIDIANS))).collect()
    });
    parallels.into_iter().chain(meridians).collect()
}

/// Distance to the boundary of the solved configurations in a direction, m: where the weighted share of
/// solved corners falls below one half; at most the radius of the ball.
fn reach_m(space: &Space<'_>, direction: Vec3) -> f32 {
    let lattice = &space.lattice();
    let step_m = lattice.spacing_m() / 8.0;
    let steps = (lattice.radius_m() / step_m).ceil() as usize;
    let out = (1..=steps).find(|i| solved_share(space, direction * (*i as f32 * step_m)) < 0.5);
    out.map_or(lattice.radius_m(), |i| ((i as f32 - 0.5) * step_m).min(lattice.radius_m()))
}

/// Tri-linear share of solved corners of the cell at a displacement. Corners outside the ball are not
/// counted, because they are not failures of the solver.
fn solved_share(space: &Space<'_>, displacement_m: Vec3) -> f32 {
    let at = space.lattice().locate(displacement_m.to_array());
    let (low, t) = (space.lattice().ijk(at.slot), at.t);
    let (mut solved, mut all) = (0.0, 0.0);
    for corner in 0..8_usize {
        let bits = [corner >> 2 & 1, corner >> 1 & 1, corner & 1];
        let ijk = core::array::from_fn(|axis| low[axis] + bits[axis] as i32);
        let weight: f32 = (0..3).map(|axis| if bits[axis] == 1 { t[axis] } else { 1.0 - t[axis] }).product();
        if space.lattice().contains(ijk) {
            all += weight;
            let slot = space.lattice().slot(ijk).and_then(|slot| space.planes().flags.get(slot));
            solved += if slot.is_some_and(|flag| flag & flags::SOLVED != 0) { weight } else { 0.0 };
        }
    }
    if all > 0.0 { solved / all } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{self, Shape};
    use palpate_core::{Organ, SpacePlanes};

    #[test]
    fn the_boundary_is_the_ball_with_dents_at_unsolved_configurations() {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let space = &organ.spaces[0];
        let radius_m = space.lattice().radius_m();
        for ring in rings(space) {
            for point in ring {
                let reach = point.distance(Vec3::from_array(space.active.rest_position_m));
                assert!((reach - radius_m).abs() < 1e-5, "{reach}");
            }
        }
        // No solved configurations beyond one and a half cells along +x.
        let mut cut: Vec<u8> = (0..space.planes().flags.len())
            .map(|slot| if space.lattice().ijk(slot)[0] >= 2 { 0 } else { space.planes().flags[slot] })
            .collect();
        flags::derive(space.lattice(), &mut cut);
        let planes = SpacePlanes { flags: &cut, ..space.planes() };
        let vertices = organ.surface.node.len();
        let space =
            Space::new(space.active.clone(), *space.lattice(), planes, vertices).expect("valid flags");
        let (towards, away) = (reach_m(&space, Vec3::X), reach_m(&space, -Vec3::X));
        let spacing_m = space.lattice().spacing_m();
        assert!((towards - 1.5 * spacing_m).abs() < 0.2 * spacing_m, "{towards}");
        assert!((away - radius_m).abs() < 1e-6, "{away}");
    }
}
