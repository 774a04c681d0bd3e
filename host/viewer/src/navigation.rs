//! Camera navigation: rotation, panning and zooming with mouse and keys.

use super::camera::OrbitCamera;
use glam::Vec2;

/// Rotation per pixel of mouse drag, rad.
const ORBIT_RAD_PER_PX: f32 = 0.006;
/// Zoom factor per step of the wheel.
const ZOOM_PER_STEP: f32 = 0.93;

/// State of mouse and held keys in one frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pointer {
    /// Position of the cursor, pixels; `None` outside the window.
    pub at_px: Option<Vec2>,
    /// Left button.
    pub left: bool,
    /// Right or middle button.
    pub other: bool,
    /// Shift.
    pub shift: bool,
    /// Control, or E.
    pub grasp: bool,
    /// Steps of the wheel since the last frame, positive away from the user.
    pub wheel: f32,
    /// 1 for W, -1 for S.
    pub deeper: f32,
}

/// Kind of a drag, decided at its start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Drag {
    #[default]
    None,
    Orbit,
    Pan,
}

/// State of the camera navigation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Navigation {
    drag: Drag,
    from_px: Option<Vec2>,
}

impl Navigation {
    /// Moves the camera of a picture of this height. A pointer that is `taken` holds the organ and does not
    /// move the camera.
    pub fn update(&mut self, pointer: &Pointer, taken: bool, camera: &mut OrbitCamera, height_px: usize) {
        let drag = match (pointer.left, pointer.other) {
            (false, false) => Drag::None,
            (true, _) if taken => Drag::None,
            (_, true) => Drag::Pan,
            (true, false) if pointer.shift => Drag::Pan,
            (true, false) => Drag::Orbit,
        };
        if drag == Drag::None {
            *self = Self::default();
        } else if self.drag == Drag::None {
            *self = Self { drag, from_px: pointer.at_px };
        }
        if let (Some(from), Some(to)) = (self.from_px, pointer.at_px) {
            let moved = to - from;
            match self.drag {
                Drag::None => {}
                Drag::Orbit => camera.orbit(-moved.x * ORBIT_RAD_PER_PX, moved.y * ORBIT_RAD_PER_PX),
                Drag::Pan => camera.pan(moved, height_px),
            }
            self.from_px = Some(to);
        }
        if pointer.wheel != 0.0 && !taken {
            camera.zoom(ZOOM_PER_STEP.powf(pointer.wheel.clamp(-5.0, 5.0)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn camera() -> OrbitCamera {
        OrbitCamera::framing(Vec3::ZERO, 0.1, Vec3::new(1.0, 0.4, 0.5), Vec3::Z)
    }

    /// The camera after a drag from (300, 200) to (340, 220) with these buttons.
    fn dragged(buttons: Pointer, taken: bool) -> OrbitCamera {
        let (mut navigation, mut camera) = (Navigation::default(), camera());
        for at in [Vec2::new(300.0, 200.0), Vec2::new(320.0, 210.0), Vec2::new(340.0, 220.0)] {
            navigation.update(&Pointer { at_px: Some(at), ..buttons }, taken, &mut camera, 480);
        }
        camera
    }

    #[test]
    fn each_button_moves_the_camera_in_its_way() {
        let left = Pointer { left: true, ..Pointer::default() };
        let turned = dragged(left, false);
        assert!((turned.azimuth_rad - camera().azimuth_rad + 40.0 * ORBIT_RAD_PER_PX).abs() < 1e-5);
        assert!((turned.elevation_rad - camera().elevation_rad - 20.0 * ORBIT_RAD_PER_PX).abs() < 1e-5);
        assert_eq!(turned.target_m, camera().target_m);
        for pan in [Pointer { other: true, ..Pointer::default() }, Pointer { shift: true, ..left }] {
            let moved = dragged(pan, false);
            assert_eq!(moved.azimuth_rad, camera().azimuth_rad);
            // The picture follows the cursor: the old target is now 40 px to the right and 20 px down.
            let (pixel, _) = moved.projection(640, 480).project(Vec3::ZERO).expect("in front");
            assert!((pixel - Vec2::new(360.0, 260.0)).length() < 0.1, "{pixel}");
        }
        assert_eq!(dragged(left, true), camera());
        assert_eq!(dragged(Pointer::default(), false), camera());
    }

    #[test]
    fn a_drag_keeps_its_kind_and_a_press_alone_moves_nothing() {
        let (mut navigation, mut camera) = (Navigation::default(), camera());
        let before = camera;
        let press = Pointer { left: true, at_px: Some(Vec2::new(10.0, 10.0)), ..Pointer::default() };
        navigation.update(&press, false, &mut camera, 480);
        assert_eq!(camera, before);
        // Pressing shift later does not turn the drag into panning.
        let later = Pointer { at_px: Some(Vec2::new(30.0, 10.0)), shift: true, ..press };
        navigation.update(&later, false, &mut camera, 480);
        assert!(camera.azimuth_rad != before.azimuth_rad && camera.target_m == before.target_m);
        // A new drag elsewhere starts without a jump.
        navigation.update(&Pointer::default(), false, &mut camera, 480);
        let (mut again, held) = (camera, Pointer { at_px: Some(Vec2::new(400.0, 90.0)), ..press });
        navigation.update(&held, false, &mut again, 480);
        assert_eq!(again, camera);
    }

    #[test]
    fn the_wheel_zooms_unless_the_tool_uses_it() {
        let wheel = Pointer { wheel: 2.0, ..Pointer::default() };
        let (mut near, mut held) = (camera(), camera());
        Navigation::default().update(&wheel, false, &mut near, 480);
        Navigation::default().update(&wheel, true, &mut held, 480);
        assert!(near.distance_m < camera().distance_m && held == camera());
    }
}
