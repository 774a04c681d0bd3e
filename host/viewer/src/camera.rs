//! Orbit camera: a target, two angles and a distance.

use glam::{Mat3, Vec2, Vec3};

/// Largest elevation; at the pole the up direction would be undefined.
const MAX_ELEVATION_RAD: f32 = 1.5;

/// Perspective camera directed at its target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrbitCamera {
    /// Point in the middle of the picture, m.
    pub target_m: Vec3,
    /// Unit vector that points up in the picture.
    pub up: Vec3,
    /// Angle round the up axis, rad.
    pub azimuth_rad: f32,
    /// Angle above the horizon, rad.
    pub elevation_rad: f32,
    /// Eye to target, m.
    pub distance_m: f32,
    /// Full vertical field of view, rad.
    pub field_of_view_rad: f32,
}

impl OrbitCamera {
    /// Frames a sphere, seen from `direction` (from the sphere towards the eye).
    #[must_use]
    pub fn framing(centre_m: Vec3, radius_m: f32, direction: Vec3, up: Vec3) -> Self {
        let up = up.try_normalize().unwrap_or(Vec3::Z);
        let front = up.any_orthonormal_vector();
        let direction = direction.try_normalize().unwrap_or(front);
        let field_of_view_rad: f32 = 0.5;
        Self {
            target_m: centre_m,
            up,
            azimuth_rad: direction.dot(up.cross(front)).atan2(direction.dot(front)),
            elevation_rad: direction
                .dot(up)
                .clamp(-1.0, 1.0)
                .asin()
                .clamp(-MAX_ELEVATION_RAD, MAX_ELEVATION_RAD),
            distance_m: radius_m.max(1e-6) / (0.5 * field_of_view_rad).sin(),
            field_of_view_rad,
        }
    }

    /// Rotates by a mouse drag.
    pub fn orbit(&mut self, azimuth_rad: f32, elevation_rad: f32) {
        self.azimuth_rad += azimuth_rad;
        self.elevation_rad =
            (self.elevation_rad + elevation_rad).clamp(-MAX_ELEVATION_RAD, MAX_ELEVATION_RAD);
    }

    /// Shifts the picture by pixels of a picture of `height_px`: points at the target's depth follow the
    /// cursor.
    pub fn pan(&mut self, by_px: Vec2, height_px: usize) {
        let projection = self.projection(height_px, height_px);
        let metres_per_px = self.distance_m / projection.focal_px;
        let (right, up) = (projection.to_eye.row(0), projection.to_eye.row(1));
        self.target_m += (up * by_px.y - right * by_px.x) * metres_per_px;
    }

    /// Moves nearer (factor < 1) or away.
    pub fn zoom(&mut self, factor: f32) {
        self.distance_m *= factor.clamp(0.2, 5.0);
    }

    /// The projection for the rasteriser, for a picture of this size.
    #[must_use]
    pub fn projection(&self, width: usize, height: usize) -> Projection {
        let (sin_azimuth, cos_azimuth) = self.azimuth_rad.sin_cos();
        let (sin_elevation, cos_elevation) = self.elevation_rad.sin_cos();
        let front = self.up.any_orthonormal_vector();
        let side = self.up.cross(front);
        let level = front * cos_azimuth + side * sin_azimuth;
        let backward = level * cos_elevation + self.up * sin_elevation;
        let right = side * cos_azimuth - front * sin_azimuth;
        let up = backward.cross(right);
        let focal_px = 0.5 * height as f32 / (0.5 * self.field_of_view_rad).tan();
        Projection {
            eye_m: self.target_m + backward * self.distance_m,
            // Rows of the matrix are the axes of the eye's frame.
            to_eye: Mat3::from_cols(right, up, backward).transpose(),
            up: self.up,
            focal_px,
            centre_px: Vec2::new(0.5 * width as f32, 0.5 * height as f32),
            near_m: self.distance_m * 0.02,
        }
    }
}

/// Pin-hole projection: eye frame with x right, y up, z towards the viewer; pixels with y down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Position of the eye, m.
    pub eye_m: Vec3,
    /// Rotation from the model frame to the eye frame.
    pub to_eye: Mat3,
    /// Up direction in the model frame, for the sky light.
    pub up: Vec3,
    /// Focal length, pixels.
    pub focal_px: f32,
    /// Principal point, pixels.
    pub centre_px: Vec2,
    /// Points nearer than this are not drawn, m.
    pub near_m: f32,
}

impl Projection {
    /// Point in the eye frame, m.
    #[must_use]
    pub fn eye_point(&self, point_m: Vec3) -> Vec3 {
        self.to_eye * (point_m - self.eye_m)
    }

    /// Pixel position and inverse depth (1/m, larger is nearer); `None` for a point at or behind the near
    /// plane.
    #[must_use]
    pub fn project(&self, point_m: Vec3) -> Option<(Vec2, f32)> {
        self.project_eye(self.eye_point(point_m))
    }

    /// As [`Self::project`] for a point in the eye frame.
    #[must_use]
    pub fn project_eye(&self, eye: Vec3) -> Option<(Vec2, f32)> {
        let depth_m = -eye.z;
        if depth_m.is_nan() || depth_m <= self.near_m {
            return None;
        }
        let inverse_depth = depth_m.recip();
        let pixel = self.centre_px + Vec2::new(eye.x, -eye.y) * (self.focal_px * inverse_depth);
        Some((pixel, inverse_depth))
    }

    /// Origin, m, and unit direction of the ray through a pixel.
    #[must_use]
    pub fn ray(&self, pixel: Vec2) -> (Vec3, Vec3) {
        let across = (pixel - self.centre_px) / self.focal_px;
        (self.eye_m, self.to_eye.transpose() * Vec3::new(across.x, -across.y, -1.0).normalize())
    }

    /// The same camera for a picture with `factor` times the resolution.
    #[must_use]
    pub fn refined(&self, factor: usize) -> Self {
        let factor = factor as f32;
        Self { focal_px: self.focal_px * factor, centre_px: self.centre_px * factor, ..*self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> OrbitCamera {
        OrbitCamera::framing(Vec3::new(0.1, -0.2, 0.3), 0.1, Vec3::new(1.0, 0.4, 0.5), Vec3::Z)
    }

    #[test]
    fn the_target_is_in_the_middle_and_up_is_up() {
        let camera = camera();
        let projection = camera.projection(640, 480);
        let (pixel, inverse_depth) = projection.project(camera.target_m).expect("in front");
        assert!((pixel - Vec2::new(320.0, 240.0)).length() < 1e-2, "{pixel}");
        assert!((inverse_depth.recip() - camera.distance_m).abs() < 1e-4);
        let (above, _) = projection.project(camera.target_m + Vec3::Z * 0.05).expect("in front");
        assert!(above.y < pixel.y && (above.x - pixel.x).abs() < 1e-2);
    }

    #[test]
    fn a_framed_ball_fits_and_fills_the_height() {
        let camera = camera();
        let projection = camera.projection(640, 480);
        // The cone tangent to the sphere has a half angle whose sine is radius / distance.
        let edge_px = projection.focal_px * (0.1 / camera.distance_m).asin().tan();
        assert!((edge_px - 240.0).abs() < 1.0, "{edge_px}");
    }

    #[test]
    fn points_on_the_ray_of_a_pixel_project_to_it() {
        let projection = camera().projection(640, 480);
        for pixel in [Vec2::new(320.0, 240.0), Vec2::new(11.0, 470.0), Vec2::new(600.5, 3.25)] {
            let (origin_m, direction) = projection.ray(pixel);
            for along_m in [0.1, 0.5, 2.0] {
                let (back, _) = projection.project(origin_m + direction * along_m).expect("in front");
                assert!((back - pixel).length() < 0.01, "{pixel} {back}");
            }
        }
    }

    #[test]
    fn points_behind_the_eye_are_not_projected() {
        let camera = camera();
        let projection = camera.projection(640, 480);
        let behind = projection.eye_m + (projection.eye_m - camera.target_m);
        assert_eq!(projection.project(behind), None);
        assert_eq!(projection.project(Vec3::NAN), None);
    }

    #[test]
    fn the_elevation_stays_below_the_pole() {
        let mut camera = camera();
        camera.orbit(0.0, 100.0);
        assert!(camera.projection(10, 10).to_eye.is_finite() && camera.elevation_rad < 1.55);
    }
}
