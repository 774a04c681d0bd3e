//! The mouse device's tool: converts cursor and buttons to the target of the tool.
//!
//! ```text
//! hover: above the surface under the cursor
//!   left button on the organ -> approach: above the nearest active node -> hold: pushed or grasped, dragged
//!   left button up           -> hover
//! ```

use super::camera::Projection;
use super::navigation::Pointer;
use super::pick::{self, Hit};
use super::viewpoint;
use crate::deformation::Deformation;
use glam::{Vec2, Vec3};
use palpate_core::{Organ, Space};
use palpate_host::device::mouse::{MouseHandle, MouseTarget};
use palpate_host::rt::TickRecord;

/// Height of a hovering tool above the surface, in radii of the organ.
const CLEARANCE: f32 = 0.12;
/// Initial depth of a press before any drag, m: enough to be perceived.
const FIRST_PRESS_M: f32 = 3.0e-3;
/// Height above the node at which a grasp closes, m.
const GRASP_HEIGHT_M: f32 = 1.0e-3;
/// Distance from the target below which the tool has arrived, m.
const ARRIVAL_TOLERANCE_M: f32 = 1.5e-3;
/// Depth per step of the wheel, m.
const DEPTH_PER_STEP_M: f32 = 1.5e-3;
/// Depth per frame while W or S is held, m: 30 mm/s.
const DEPTH_PER_FRAME_M: f32 = 1.0e-3;
/// Largest drag of a node, in radii of its lattice: beyond 1 the force is extrapolated.
const MAX_DRAG: f32 = 1.2;
/// Largest distance of a hovering tool from the middle of the organ, in radii of the organ.
const MAX_HOVER: f32 = 1.6;
/// Bit of the grasp button, as in `ContactConfig::default`.
const GRASP: u32 = 1;

/// State of the interaction.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage {
    Hover,
    /// Moving to a clicked node.
    Approach {
        space: usize,
        from_px: Vec2,
        grasps: bool,
    },
    /// Holding the node.
    Hold {
        space: usize,
        from_px: Vec2,
        depth_m: f32,
        grasps: bool,
    },
}

/// The displayed scene, for picking with the cursor.
#[derive(Debug)]
pub(super) struct PickView<'a> {
    /// The camera of the picture.
    pub(super) projection: Projection,
    /// The deformed surface.
    pub(super) surface: &'a Deformation,
}

/// Converts the cursor to the target of the tool.
#[derive(Debug)]
pub(super) struct MouseTool {
    handle: MouseHandle,
    stage: Stage,
    left_before: bool,
    /// Last hover position, m.
    hover_m: Option<Vec3>,
}

impl MouseTool {
    pub(super) const fn new(handle: MouseHandle) -> Self {
        Self { handle, stage: Stage::Hover, left_before: false, hover_m: None }
    }

    /// Processes the mouse state of one frame. True while the organ is held: then the camera does not move.
    pub(super) fn update<const N: usize>(
        &mut self,
        view: &PickView<'_>,
        organ: &Organ<'_, N>,
        pointer: &Pointer,
        record: &TickRecord,
    ) -> bool {
        let pressed_now = pointer.left && !self.left_before;
        self.left_before = pointer.left;
        let under = pointer.at_px.and_then(|at_px| self.under(view, organ, at_px));
        self.stage = match (self.stage, pointer.at_px) {
            _ if !pointer.left => Stage::Hover,
            (Stage::Hover, Some(from_px)) if pressed_now && under.is_some() && !pointer.shift => {
                match nearest_node(view, organ, from_px) {
                    Some(space) => Stage::Approach { space, from_px, grasps: pointer.grasp },
                    None => Stage::Hover,
                }
            }
            (stage, _) => stage,
        };
        let hip_m = Vec3::from_array(record.hip_m);
        let (target_m, buttons) = match self.stage {
            Stage::Hover => (self.hover(view, pointer, under), 0),
            Stage::Approach { space: index, from_px, grasps } => {
                let Some(space) = organ.spaces.get(index) else { return false };
                let height_m = if grasps { GRASP_HEIGHT_M } else { clearance_m(view).min(6.0e-3) };
                let over_m = above_node(space, height_m);
                if hip_m.distance(over_m) < ARRIVAL_TOLERANCE_M {
                    self.stage = Stage::Hold { space: index, from_px, depth_m: 0.0, grasps };
                }
                (Some(over_m), 0)
            }
            Stage::Hold { space: index, from_px, mut depth_m, mut grasps } => {
                let Some(space) = organ.spaces.get(index) else { return false };
                depth_m += DEPTH_PER_STEP_M * pointer.wheel.clamp(-5.0, 5.0);
                depth_m += DEPTH_PER_FRAME_M * pointer.deeper;
                // A grasp lasts until the mouse button is released.
                grasps |= pointer.grasp;
                self.stage = Stage::Hold { space: index, from_px, depth_m, grasps };
                let from_m = above_node(space, if grasps { GRASP_HEIGHT_M } else { -FIRST_PRESS_M });
                let at_px = pointer.at_px.unwrap_or(from_px);
                let dragged_m = dragged(&view.projection, from_m, (from_px, at_px), depth_m);
                let max_m = MAX_DRAG * space.lattice().radius_m();
                (Some(from_m + dragged_m.clamp_length_max(max_m)), if grasps { GRASP } else { 0 })
            }
        };
        if let Some(target_m) = target_m {
            self.handle.set(MouseTarget { position_m: target_m.to_array(), buttons });
        }
        self.stage != Stage::Hover
    }

    fn under<const N: usize>(&self, view: &PickView<'_>, organ: &Organ<'_, N>, at_px: Vec2) -> Option<Hit> {
        // Not needed while a node is held.
        let free = self.stage == Stage::Hover;
        free.then(|| {
            pick::hit(view.surface.position_m(), organ.surface.triangles, view.projection.ray(at_px))
        })?
    }

    /// Hover position: above the surface under the cursor; beside the organ, in the plane of the last
    /// position.
    fn hover(&mut self, view: &PickView<'_>, pointer: &Pointer, under: Option<Hit>) -> Option<Vec3> {
        let at_px = pointer.at_px?;
        let (centre_m, radius_m) = viewpoint::bounds(view.surface);
        let beside = || {
            let plane_m = self.hover_m.unwrap_or(centre_m);
            let at_m = on_plane(&view.projection, at_px, plane_m)?;
            Some(centre_m + (at_m - centre_m).clamp_length_max(MAX_HOVER * radius_m))
        };
        let over = under.map(|hit| hit.point_m + hit.normal * clearance_m(view));
        self.hover_m = over.or_else(beside);
        self.hover_m
    }
}

fn clearance_m(view: &PickView<'_>) -> f32 {
    CLEARANCE * viewpoint::bounds(view.surface).1
}

/// Point above (or below) an active node at rest, along its normal.
fn above_node(space: &Space<'_>, height_m: f32) -> Vec3 {
    Vec3::from_array(space.active.rest_position_m) + Vec3::from_array(space.active.outward_normal) * height_m
}

/// Intersection of the ray through a pixel with the camera-facing plane through a point.
fn on_plane(projection: &Projection, at_px: Vec2, plane_m: Vec3) -> Option<Vec3> {
    let (origin_m, direction) = projection.ray(at_px);
    let backward = projection.to_eye.row(2);
    let along_m = (plane_m - origin_m).dot(backward) / direction.dot(backward);
    (along_m > 0.0).then(|| origin_m + direction * along_m)
}

/// A drag between two pixels in the camera-facing plane through a point, plus a depth away from the eye.
fn dragged(projection: &Projection, plane_m: Vec3, (from_px, to_px): (Vec2, Vec2), depth_m: f32) -> Vec3 {
    let places = [from_px, to_px].map(|pixel| on_plane(projection, pixel, plane_m));
    let along = match places {
        [Some(from_m), Some(to_m)] => to_m - from_m,
        _ => Vec3::ZERO,
    };
    along - projection.to_eye.row(2) * depth_m
}

/// The visible active node nearest to a pixel.
fn nearest_node<const N: usize>(view: &PickView<'_>, organ: &Organ<'_, N>, at_px: Vec2) -> Option<usize> {
    let mut near: Vec<(f32, usize, Vec2, Vec3)> = organ
        .spaces
        .iter()
        .enumerate()
        .filter_map(|(index, space)| {
            let node_m = above_node(space, 0.0);
            let (pixel, _) = view.projection.project(node_m)?;
            Some((pixel.distance_squared(at_px), index, pixel, node_m))
        })
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (_, radius_m) = viewpoint::bounds(view.surface);
    let is_seen = |pixel: Vec2, node_m: Vec3| {
        let hit = pick::hit(view.surface.position_m(), organ.surface.triangles, view.projection.ray(pixel));
        // Visible if no surface is in front of it. The ray may miss a node on the rim.
        hit.is_none_or(|hit| view.projection.eye_m.distance(node_m) < hit.distance_m + 0.05 * radius_m)
    };
    near.into_iter().find(|(_, _, pixel, node_m)| is_seen(*pixel, *node_m)).map(|(_, index, ..)| index)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::OrbitCamera;
    use crate::synthetic::{self, Shape};
    use palpate_core::{Config, Controller, Method, Phase, State, vec3};
    use palpate_host::device::Device;
    use palpate_host::device::mouse::{MouseConfig, mouse};

    const PIXELS: (usize, usize) = (1280, 720);

    fn camera() -> OrbitCamera {
        OrbitCamera::framing(Vec3::ZERO, 0.12, Vec3::new(0.2, -0.8, 0.7), Vec3::Z)
    }

    /// The chain from cursor to force: mouse tool, mouse device and the real controller, with one frame per
    /// 33 ticks.
    struct Fixture<'o, 'a> {
        organ: &'o Organ<'a>,
        hand: MouseTool,
        device: palpate_host::device::mouse::Mouse,
        controller: Controller<'o, 'a>,
        state: State,
        surface: Deformation,
        record: TickRecord,
        tick: u64,
        peak_n: f32,
        peak_m: f32,
    }

    impl<'o, 'a> Fixture<'o, 'a> {
        fn new(organ: &'o Organ<'a>) -> Self {
            let (handle, device) = mouse([0.0, -0.2, 0.0], MouseConfig::default());
            let controller = Controller::new(organ, Config::new(Method::Tricubic)).expect("has the method");
            let mut state = State::new();
            state.arm();
            Self {
                organ,
                hand: MouseTool::new(handle),
                device,
                controller,
                state,
                surface: Deformation::at_rest(organ),
                record: TickRecord::EMPTY,
                tick: 0,
                peak_n: 0.0,
                peak_m: 0.0,
            }
        }

        // Runs `count` frames with this pointer; returns whether the organ is held at the end.
        fn frames(&mut self, count: u32, pointer: Pointer) -> bool {
            let projection = camera().projection(PIXELS.0, PIXELS.1);
            let mut held = false;
            for _ in 0..count {
                self.surface.update(self.organ, &self.record.shares, self.record.displacement_m);
                let view = PickView { projection, surface: &self.surface };
                held = self.hand.update(&view, self.organ, &pointer, &self.record);
                for _ in 0..33 {
                    self.tick();
                }
            }
            held
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
            projection.project(above_node(&self.organ.spaces[space], 0.0)).expect("in front").0
        }
    }

    fn with_fixture(test: impl FnOnce(&mut Fixture<'_, '_>)) {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        test(&mut Fixture::new(&organ));
    }

    #[test]
    fn hovering_follows_the_cursor_without_contact() {
        with_fixture(|fixture| {
            for offset in [Vec2::ZERO, Vec2::new(30.0, 10.0), Vec2::new(-40.0, 20.0)] {
                let at_px = fixture.node_px(0) + offset;
                assert!(!fixture.frames(40, Pointer { at_px: Some(at_px), ..Pointer::default() }));
                assert_eq!(fixture.record.engaged, None);
                let hip = Vec3::from_array(fixture.record.hip_m);
                let projection = camera().projection(PIXELS.0, PIXELS.1);
                let (pixel, _) = projection.project(hip).expect("in front");
                // The tool is above the surface along the normal, so not exactly under the cursor.
                assert!((pixel - at_px).length() < 60.0, "{pixel} {at_px}");
            }
            // Beside the organ too, and within reach.
            fixture.frames(60, Pointer { at_px: Some(Vec2::new(2.0, 2.0)), ..Pointer::default() });
            assert!(vec3::norm(fixture.record.hip_m) < 0.25 && fixture.peak_n == 0.0);
        });
    }

    #[test]
    fn a_press_on_a_node_pushes_it_in_and_the_wheel_pushes_deeper() {
        with_fixture(|fixture| {
            let hover = Pointer { at_px: Some(fixture.node_px(0)), ..Pointer::default() };
            fixture.frames(40, hover);
            let press = Pointer { left: true, ..hover };
            assert!(fixture.frames(40, press), "it holds");
            assert_eq!(fixture.record.engaged, Some(0));
            let light_n = vec3::norm(fixture.record.hand_force_n);
            assert!(light_n > 0.2, "{light_n}");
            fixture.frames(10, Pointer { wheel: 1.0, ..press });
            fixture.frames(20, press);
            let deep_n = vec3::norm(fixture.record.hand_force_n);
            assert!(deep_n > light_n + 0.5 && deep_n <= 8.0, "{light_n} {deep_n}");
            // The organ's stiffness keeps the tool away from its target of 3 mm + 15 mm.
            let depth_m = vec3::norm(fixture.record.displacement_m);
            assert!(depth_m > 0.006 && depth_m < 0.016, "{depth_m}");
            assert!(!fixture.frames(60, hover));
            assert_eq!((fixture.record.engaged, fixture.record.hand_force_n), (None, vec3::ZERO));
        });
    }

    #[test]
    fn a_drag_with_control_grasps_and_pulls() {
        with_fixture(|fixture| {
            let start = fixture.node_px(0);
            let hover = Pointer { at_px: Some(start), ..Pointer::default() };
            fixture.frames(40, hover);
            let grasp = Pointer { left: true, grasp: true, ..hover };
            fixture.frames(60, grasp);
            assert_eq!(fixture.record.engaged, Some(0));
            for step in 1..=20 {
                let at_px = Some(start + Vec2::new(2.5, 1.5) * step as f32);
                fixture.frames(2, Pointer { at_px, grasp: false, ..grasp });
            }
            fixture.frames(30, Pointer { at_px: Some(start + Vec2::new(50.0, 30.0)), grasp: false, ..grasp });
            assert!(fixture.peak_n > 0.5 && fixture.peak_n <= 8.0, "{}", fixture.peak_n);
            assert_eq!(fixture.record.engaged, Some(0), "held after control is released");
            // Right and down in the picture.
            let projection = camera().projection(PIXELS.0, PIXELS.1);
            let moved = projection.to_eye * Vec3::from_array(fixture.record.displacement_m);
            assert!(moved.x > 3e-3 && moved.y < -1.5e-3 && moved.z.abs() < 2e-3, "{moved}");
            fixture.frames(60, hover);
            assert_eq!(fixture.record.engaged, None, "released");
            // Beyond the device's force limit the grasp slips off, and it does not close again by itself.
            fixture.frames(60, grasp);
            assert_eq!(fixture.record.engaged, Some(0));
            fixture.frames(60, Pointer { at_px: Some(start + Vec2::new(150.0, 90.0)), ..grasp });
            assert_eq!(fixture.record.engaged, None, "slipped off");
        });
    }

    #[test]
    fn a_press_beside_the_organ_or_with_shift_moves_the_camera() {
        with_fixture(|fixture| {
            let beside = Pointer { left: true, at_px: Some(Vec2::new(5.0, 5.0)), ..Pointer::default() };
            assert!(!fixture.frames(5, beside));
            // Moving onto the organ with the button down does not grasp it.
            assert!(!fixture.frames(5, Pointer { at_px: Some(fixture.node_px(0)), ..beside }));
            fixture.frames(1, Pointer::default());
            let shifted = Pointer { at_px: Some(fixture.node_px(0)), shift: true, ..beside };
            assert!(!fixture.frames(5, shifted));
        });
    }

    #[test]
    fn the_nearest_visible_node_is_picked() {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let surface = Deformation::at_rest(&organ);
        let pick = |direction: Vec3, space: usize| {
            let camera = OrbitCamera::framing(Vec3::ZERO, 0.12, direction, Vec3::Z);
            let projection = camera.projection(PIXELS.0, PIXELS.1);
            let (pixel, _) = projection.project(above_node(&organ.spaces[space], 0.0)).expect("in front");
            nearest_node(&PickView { projection, surface: &surface }, &organ, pixel + Vec2::new(6.0, -4.0))
        };
        for space in 0..3 {
            let towards = Vec3::from_array(organ.spaces[space].active.outward_normal);
            assert_eq!(pick(towards, space), Some(space));
            assert_ne!(pick(-towards, space), Some(space), "it is behind the organ");
        }
    }
}
