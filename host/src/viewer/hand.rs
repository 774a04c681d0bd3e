//! The mouse as the hand: where the cursor wants the tool.
//!
//! ```text
//! hover: over the organ, a little above the surface under the cursor
//!   left button on the organ -> approach: over the nearest active node -> hold: pushed in or grasped, dragged in the picture's plane
//!   left button up           -> hover
//! ```

use super::camera::Projection;
use super::navigation::Pointer;
use super::pick::{self, Hit};
use super::viewpoint;
use crate::deformation::Deformation;
use crate::device::mouse::{MouseHandle, MouseTarget};
use crate::rt::TickRecord;
use glam::{Vec2, Vec3};
use palpate_core::{Organ, Space};

/// Height of a hovering tool over the surface, in radii of the organ.
const CLEARANCE: f32 = 0.12;
/// How far a press goes in at once, before any drag, m: enough to be felt.
const FIRST_PRESS_M: f32 = 3.0e-3;
/// Height over the node at which a grasp closes, m.
const GRASP_HEIGHT_M: f32 = 1.0e-3;
/// How near the tool must have come to where it was sent, m.
const ARRIVED_M: f32 = 1.5e-3;
/// Depth a step of the wheel, m.
const DEPTH_PER_STEP_M: f32 = 1.5e-3;
/// Depth a frame with W or S held, m: 30 mm/s.
const DEPTH_PER_FRAME_M: f32 = 1.0e-3;
/// Furthest that a node is dragged, in radii of its lattice: beyond 1 the force is only continued.
const FURTHEST: f32 = 1.2;
/// Furthest that a hovering tool goes from the middle of the organ, in radii of the organ.
const ROAM: f32 = 1.6;
/// The bit of the button that grasps, as in `ContactConfig::default`.
const GRASP: u32 = 1;

/// What the hand is doing.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage {
    Hover,
    /// On the way to a node that was clicked on.
    Approach {
        space: usize,
        from_px: Vec2,
        grasps: bool,
    },
    /// Holding it.
    Hold {
        space: usize,
        from_px: Vec2,
        depth_m: f32,
        grasps: bool,
    },
}

/// What the eye sees, for the cursor to point at.
#[derive(Debug)]
pub(super) struct Seen<'a> {
    /// The camera of the picture.
    pub(super) projection: Projection,
    /// The surface in it.
    pub(super) surface: &'a Deformation,
}

/// From the cursor to the tool.
#[derive(Debug)]
pub(super) struct ScreenHand {
    handle: MouseHandle,
    stage: Stage,
    left_before: bool,
    /// Where the tool hovered last, m.
    hover_m: Option<Vec3>,
}

impl ScreenHand {
    pub(super) const fn new(handle: MouseHandle) -> Self {
        Self { handle, stage: Stage::Hover, left_before: false, hover_m: None }
    }

    /// Takes one frame's mouse. True while the organ is held: then the camera stays.
    pub(super) fn update<const N: usize>(
        &mut self,
        seen: &Seen<'_>,
        organ: &Organ<'_, N>,
        pointer: &Pointer,
        record: &TickRecord,
    ) -> bool {
        let pressed_now = pointer.left && !self.left_before;
        self.left_before = pointer.left;
        let under = pointer.at_px.and_then(|at_px| self.under(seen, organ, at_px));
        self.stage = match (self.stage, pointer.at_px) {
            _ if !pointer.left => Stage::Hover,
            (Stage::Hover, Some(from_px)) if pressed_now && under.is_some() && !pointer.shift => {
                match nearest_node(seen, organ, from_px) {
                    Some(space) => Stage::Approach { space, from_px, grasps: pointer.grasp },
                    None => Stage::Hover,
                }
            }
            (stage, _) => stage,
        };
        let hip_m = Vec3::from_array(record.hip_m);
        let (target_m, buttons) = match self.stage {
            Stage::Hover => (self.hover(seen, pointer, under), 0),
            Stage::Approach { space: index, from_px, grasps } => {
                let Some(space) = organ.spaces.get(index) else { return false };
                let height_m = if grasps { GRASP_HEIGHT_M } else { clearance_m(seen).min(6.0e-3) };
                let over_m = place(space, height_m);
                if hip_m.distance(over_m) < ARRIVED_M {
                    self.stage = Stage::Hold { space: index, from_px, depth_m: 0.0, grasps };
                }
                (Some(over_m), 0)
            }
            Stage::Hold { space: index, from_px, mut depth_m, mut grasps } => {
                let Some(space) = organ.spaces.get(index) else { return false };
                depth_m += DEPTH_PER_STEP_M * pointer.wheel.clamp(-5.0, 5.0);
                depth_m += DEPTH_PER_FRAME_M * pointer.deeper;
                // Once grasped, until the mouse button is let go.
                grasps |= pointer.grasp;
                self.stage = Stage::Hold { space: index, from_px, depth_m, grasps };
                let from_m = place(space, if grasps { GRASP_HEIGHT_M } else { -FIRST_PRESS_M });
                let at_px = pointer.at_px.unwrap_or(from_px);
                let dragged_m = dragged(&seen.projection, from_m, (from_px, at_px), depth_m);
                let most_m = FURTHEST * space.lattice.radius_m();
                (Some(from_m + dragged_m.clamp_length_max(most_m)), if grasps { GRASP } else { 0 })
            }
        };
        if let Some(target_m) = target_m {
            self.handle.set(MouseTarget { position_m: target_m.to_array(), buttons });
        }
        self.stage != Stage::Hover
    }

    fn under<const N: usize>(&self, seen: &Seen<'_>, organ: &Organ<'_, N>, at_px: Vec2) -> Option<Hit> {
        // While it holds, nobody asks.
        let free = self.stage == Stage::Hover;
        free.then(|| {
            pick::hit(seen.surface.position_m(), organ.surface.triangles, seen.projection.ray(at_px))
        })?
    }

    /// Over the surface under the cursor; beside the organ, in the plane it hovered in last.
    fn hover(&mut self, seen: &Seen<'_>, pointer: &Pointer, under: Option<Hit>) -> Option<Vec3> {
        let at_px = pointer.at_px?;
        let (centre_m, radius_m) = viewpoint::bounds(seen.surface);
        let beside = || {
            let plane_m = self.hover_m.unwrap_or(centre_m);
            let at_m = on_plane(&seen.projection, at_px, plane_m)?;
            Some(centre_m + (at_m - centre_m).clamp_length_max(ROAM * radius_m))
        };
        let over = under.map(|hit| hit.point_m + hit.normal * clearance_m(seen));
        self.hover_m = over.or_else(beside);
        self.hover_m
    }
}

fn clearance_m(seen: &Seen<'_>) -> f32 {
    CLEARANCE * viewpoint::bounds(seen.surface).1
}

/// Above (or below) an active node at rest, along its normal.
fn place(space: &Space<'_>, height_m: f32) -> Vec3 {
    Vec3::from_array(space.rest_position_m) + Vec3::from_array(space.outward_normal) * height_m
}

/// Where the ray through a pixel meets the plane through a place that faces the camera.
fn on_plane(projection: &Projection, at_px: Vec2, plane_m: Vec3) -> Option<Vec3> {
    let (origin_m, direction) = projection.ray(at_px);
    let backward = projection.to_eye.row(2);
    let along_m = (plane_m - origin_m).dot(backward) / direction.dot(backward);
    (along_m > 0.0).then(|| origin_m + direction * along_m)
}

/// A drag between two pixels in the plane through a place that faces the camera, and a depth away from the eye.
fn dragged(projection: &Projection, plane_m: Vec3, (from_px, to_px): (Vec2, Vec2), depth_m: f32) -> Vec3 {
    let places = [from_px, to_px].map(|pixel| on_plane(projection, pixel, plane_m));
    let along = match places {
        [Some(from_m), Some(to_m)] => to_m - from_m,
        _ => Vec3::ZERO,
    };
    along - projection.to_eye.row(2) * depth_m
}

/// The active node nearest to a pixel among those that nothing hides.
fn nearest_node<const N: usize>(seen: &Seen<'_>, organ: &Organ<'_, N>, at_px: Vec2) -> Option<usize> {
    let mut near: Vec<(f32, usize, Vec2, Vec3)> = organ
        .spaces
        .iter()
        .enumerate()
        .filter_map(|(index, space)| {
            let node_m = place(space, 0.0);
            let (pixel, _) = seen.projection.project(node_m)?;
            Some((pixel.distance_squared(at_px), index, pixel, node_m))
        })
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (_, radius_m) = viewpoint::bounds(seen.surface);
    let is_seen = |pixel: Vec2, node_m: Vec3| {
        let hit = pick::hit(seen.surface.position_m(), organ.surface.triangles, seen.projection.ray(pixel));
        // Nothing in front of it; a node on the rim may be missed by the ray.
        hit.is_none_or(|hit| seen.projection.eye_m.distance(node_m) < hit.distance_m + 0.05 * radius_m)
    };
    near.into_iter().find(|(_, _, pixel, node_m)| is_seen(*pixel, *node_m)).map(|(_, index, ..)| index)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::Device;
    use crate::device::mouse::{MouseConfig, mouse};
    use crate::synthetic::{self, Shape};
    use crate::viewer::camera::OrbitCamera;
    use palpate_core::{Config, Controller, Method, Phase, State, vec3};

    const PIXELS: (usize, usize) = (1280, 720);

    fn camera() -> OrbitCamera {
        OrbitCamera::framing(Vec3::ZERO, 0.12, Vec3::new(0.2, -0.8, 0.7), Vec3::Z)
    }

    /// The whole way from the cursor to the force: hand, mouse device and the real controller, a frame each 33 ticks.
    struct Desk<'o, 'a> {
        organ: &'o Organ<'a>,
        hand: ScreenHand,
        device: crate::device::mouse::Mouse,
        controller: Controller<'o, 'a>,
        state: State,
        surface: Deformation,
        record: TickRecord,
        tick: u64,
        peak_n: f32,
        peak_m: f32,
    }

    impl<'o, 'a> Desk<'o, 'a> {
        fn new(organ: &'o Organ<'a>) -> Self {
            let (handle, device) = mouse([0.0, -0.2, 0.0], MouseConfig::default());
            let controller = Controller::new(organ, Config::new(Method::Tricubic)).expect("has the method");
            let mut state = State::new();
            state.arm();
            Self {
                organ,
                hand: ScreenHand::new(handle),
                device,
                controller,
                state,
                surface: Deformation::at_rest(organ),
                record: TickRecord::NOTHING,
                tick: 0,
                peak_n: 0.0,
                peak_m: 0.0,
            }
        }

        /// So many frames with this mouse; returns whether the organ is held at the end.
        fn frames(&mut self, count: u32, pointer: Pointer) -> bool {
            let projection = camera().projection(PIXELS.0, PIXELS.1);
            let mut taken = false;
            for _ in 0..count {
                self.surface.update(self.organ, &self.record.shares, self.record.displacement_m);
                let seen = Seen { projection, surface: &self.surface };
                taken = self.hand.update(&seen, self.organ, &pointer, &self.record);
                for _ in 0..33 {
                    self.tick();
                }
            }
            taken
        }

        fn tick(&mut self) {
            self.tick += 1;
            let now_us = 1_000 * self.tick;
            let sample = self.device.exchange(now_us, self.record.hand_force_n).expect("never fails");
            let command = self.controller.tick(&mut self.state, now_us, sample.as_ref());
            assert_eq!(command.phase, Phase::Active, "tick {}", self.tick);
            assert!(vec3::is_finite(command.hand_force_n) && vec3::is_finite(command.hip_m));
            self.peak_n = self.peak_n.max(vec3::norm(command.hand_force_n));
            self.peak_m = self.peak_m.max(vec3::norm(command.displacement_m));
            self.record = TickRecord { tick: self.tick, t_us: now_us, sample, ..TickRecord::of(&command) };
        }

        /// Pixel of an active node.
        fn node_px(&self, space: usize) -> Vec2 {
            let projection = camera().projection(PIXELS.0, PIXELS.1);
            projection.project(place(&self.organ.spaces[space], 0.0)).expect("in front").0
        }
    }

    fn with_desk(test: impl FnOnce(&mut Desk<'_, '_>)) {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(bytemuck::cast_slice(&blob)).expect("a sound blob");
        test(&mut Desk::new(&organ));
    }

    #[test]
    fn hovering_touches_nothing_and_follows_the_cursor() {
        with_desk(|desk| {
            for offset in [Vec2::ZERO, Vec2::new(30.0, 10.0), Vec2::new(-40.0, 20.0)] {
                let at_px = desk.node_px(0) + offset;
                assert!(!desk.frames(40, Pointer { at_px: Some(at_px), ..Pointer::default() }));
                assert_eq!(desk.record.engaged, None);
                let hip = Vec3::from_array(desk.record.hip_m);
                let projection = camera().projection(PIXELS.0, PIXELS.1);
                let (pixel, _) = projection.project(hip).expect("in front");
                // It stands above the surface along the normal, so not quite under the cursor.
                assert!((pixel - at_px).length() < 60.0, "{pixel} {at_px}");
            }
            // Beside the organ too, and never out of reach.
            desk.frames(60, Pointer { at_px: Some(Vec2::new(2.0, 2.0)), ..Pointer::default() });
            assert!(vec3::norm(desk.record.hip_m) < 0.25 && desk.peak_n == 0.0);
        });
    }

    #[test]
    fn a_press_on_a_node_pushes_it_in_and_the_wheel_pushes_deeper() {
        with_desk(|desk| {
            let hover = Pointer { at_px: Some(desk.node_px(0)), ..Pointer::default() };
            desk.frames(40, hover);
            let press = Pointer { left: true, ..hover };
            assert!(desk.frames(40, press), "it holds");
            assert_eq!(desk.record.engaged, Some(0));
            let light_n = vec3::norm(desk.record.hand_force_n);
            assert!(light_n > 0.2, "{light_n}");
            desk.frames(10, Pointer { wheel: 1.0, ..press });
            desk.frames(20, press);
            let deep_n = vec3::norm(desk.record.hand_force_n);
            assert!(deep_n > light_n + 0.5 && deep_n <= 8.0, "{light_n} {deep_n}");
            // The organ's spring holds the tool back from where the cursor wants it: 3 mm + 15 mm.
            let depth_m = vec3::norm(desk.record.displacement_m);
            assert!(depth_m > 0.006 && depth_m < 0.016, "{depth_m}");
            assert!(!desk.frames(60, hover));
            assert_eq!((desk.record.engaged, desk.record.hand_force_n), (None, vec3::ZERO));
        });
    }

    #[test]
    fn a_drag_with_control_grasps_and_pulls() {
        with_desk(|desk| {
            let start = desk.node_px(0);
            let hover = Pointer { at_px: Some(start), ..Pointer::default() };
            desk.frames(40, hover);
            let grasp = Pointer { left: true, grasp: true, ..hover };
            desk.frames(60, grasp);
            assert_eq!(desk.record.engaged, Some(0));
            for step in 1..=20 {
                let at_px = Some(start + Vec2::new(2.5, 1.5) * step as f32);
                desk.frames(2, Pointer { at_px, grasp: false, ..grasp });
            }
            desk.frames(30, Pointer { at_px: Some(start + Vec2::new(50.0, 30.0)), grasp: false, ..grasp });
            assert!(desk.peak_n > 0.5 && desk.peak_n <= 8.0, "{}", desk.peak_n);
            assert_eq!(desk.record.engaged, Some(0), "held though control is up");
            // Right and down in the picture.
            let projection = camera().projection(PIXELS.0, PIXELS.1);
            let moved = projection.to_eye * Vec3::from_array(desk.record.displacement_m);
            assert!(moved.x > 3e-3 && moved.y < -1.5e-3 && moved.z.abs() < 2e-3, "{moved}");
            desk.frames(60, hover);
            assert_eq!(desk.record.engaged, None, "let go");
            // Far beyond what the device can hold it slips off, and does not take hold again by itself.
            desk.frames(60, grasp);
            assert_eq!(desk.record.engaged, Some(0));
            desk.frames(60, Pointer { at_px: Some(start + Vec2::new(150.0, 90.0)), ..grasp });
            assert_eq!(desk.record.engaged, None, "slipped off");
        });
    }

    #[test]
    fn a_press_beside_the_organ_or_with_shift_is_the_cameras() {
        with_desk(|desk| {
            let beside = Pointer { left: true, at_px: Some(Vec2::new(5.0, 5.0)), ..Pointer::default() };
            assert!(!desk.frames(5, beside));
            // Moving onto the organ with the button down does not grab it.
            assert!(!desk.frames(5, Pointer { at_px: Some(desk.node_px(0)), ..beside }));
            desk.frames(1, Pointer::default());
            let shifted = Pointer { at_px: Some(desk.node_px(0)), shift: true, ..beside };
            assert!(!desk.frames(5, shifted));
        });
    }

    #[test]
    fn the_nearest_node_in_the_picture_is_picked_and_never_a_hidden_one() {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(bytemuck::cast_slice(&blob)).expect("a sound blob");
        let surface = Deformation::at_rest(&organ);
        let pick = |direction: Vec3, space: usize| {
            let camera = OrbitCamera::framing(Vec3::ZERO, 0.12, direction, Vec3::Z);
            let projection = camera.projection(PIXELS.0, PIXELS.1);
            let (pixel, _) = projection.project(place(&organ.spaces[space], 0.0)).expect("in front");
            nearest_node(&Seen { projection, surface: &surface }, &organ, pixel + Vec2::new(6.0, -4.0))
        };
        for space in 0..3 {
            let towards = Vec3::from_array(organ.spaces[space].outward_normal);
            assert_eq!(pick(towards, space), Some(space));
            assert_ne!(pick(-towards, space), Some(space), "it is behind the organ");
        }
    }
}
