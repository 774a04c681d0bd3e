//! Placement of the device's workspace in the model (rotation, scale, two origins), and the reach of the
//! handle.

use palpate_core::{Vec3, vec3};

/// Rigid map with one scale from device coordinates to model coordinates.
///
/// p_model = model_origin + scale * R (p_device - device_origin);   F_device = R^T F_model
///
/// The force is rotated, not scaled. With a scale s above 1 the hand therefore feels s times the model's
/// stiffness.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Workspace {
    /// Rows of R: the model's axes in device coordinates, orthonormal.
    pub axes: [Vec3; 3],
    /// Model metres per device metre.
    pub scale: f32,
    /// Centre of the device's workspace, device frame, m.
    pub device_origin_m: Vec3,
    /// Position of that centre in the model, m.
    pub model_origin_m: Vec3,
}

impl Default for Workspace {
    fn default() -> Self {
        Self {
            axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            scale: 1.0,
            device_origin_m: vec3::ZERO,
            model_origin_m: vec3::ZERO,
        }
    }
}

impl Workspace {
    /// Maps a position to the model frame.
    #[must_use]
    pub fn to_model_m(&self, device_m: Vec3) -> Vec3 {
        let offset = vec3::scale(vec3::sub(device_m, self.device_origin_m), self.scale);
        vec3::add(self.model_origin_m, self.axes.map(|axis| vec3::dot(axis, offset)))
    }

    /// Maps a position to the device frame; the inverse.
    #[must_use]
    pub fn to_device_m(&self, model_m: Vec3) -> Vec3 {
        let offset = vec3::scale(vec3::sub(model_m, self.model_origin_m), self.scale.recip());
        vec3::add(self.device_origin_m, self.to_device_n(offset))
    }

    /// Maps a force to the device frame.
    #[must_use]
    pub fn to_device_n(&self, model_n: Vec3) -> Vec3 {
        let [x, y, z] = self.axes;
        vec3::add(
            vec3::scale(x, model_n[0]),
            vec3::add(vec3::scale(y, model_n[1]), vec3::scale(z, model_n[2])),
        )
    }
}

/// Range of a handle round the middle of its workspace.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reach {
    /// The same distance in every direction.
    Ball {
        /// Radius, m.
        radius_m: f32,
    },
    /// A distance along each axis of the device.
    Box {
        /// Half-widths, m.
        half_m: Vec3,
    },
}

impl Reach {
    /// Largest distance from the middle, m.
    #[must_use]
    pub fn farthest_m(&self) -> f32 {
        match *self {
            Self::Ball { radius_m } => radius_m,
            Self::Box { half_m } => vec3::norm(half_m),
        }
    }

    /// The point within reach that is nearest to `from_middle_m`; that point itself if it is within reach.
    #[must_use]
    pub fn nearest_m(&self, from_middle_m: Vec3) -> Vec3 {
        match *self {
            Self::Ball { radius_m } => {
                let away_m = vec3::norm(from_middle_m);
                if away_m > radius_m { vec3::scale(from_middle_m, radius_m / away_m) } else { from_middle_m }
            }
            Self::Box { half_m } => core::array::from_fn(|i| from_middle_m[i].clamp(-half_m[i], half_m[i])),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The power at the device equals the power in the model times 1 / scale: the map creates no energy.
    #[test]
    fn power_is_equal_on_both_sides_up_to_the_scale() {
        let (sin, cos) = 0.6_f32.sin_cos();
        let workspace = Workspace {
            axes: [[cos, -sin, 0.0], [0.0, 0.0, 1.0], [-sin, -cos, 0.0]],
            scale: 2.0,
            device_origin_m: [0.01, 0.02, 0.12],
            model_origin_m: [0.1, 0.0, 0.05],
        };
        let (from, step, force) = ([0.02, -0.01, 0.1], [1e-3, 2e-3, -1e-3], [1.0, -2.0, 0.5]);
        let moved_m = vec3::sub(workspace.to_model_m(vec3::add(from, step)), workspace.to_model_m(from));
        let (in_model, in_device) =
            (vec3::dot(force, moved_m), vec3::dot(workspace.to_device_n(force), step));
        assert!((in_model - 2.0 * in_device).abs() < 1e-7, "{in_model} {in_device}");
        assert_eq!(workspace.to_model_m(workspace.device_origin_m), workspace.model_origin_m);
        let back_m = workspace.to_device_m(workspace.to_model_m(from));
        assert!(vec3::distance(back_m, from) < 1e-7, "{back_m:?}");
    }

    #[test]
    fn a_handle_stops_at_its_reach() {
        let ball = Reach::Ball { radius_m: 0.1 };
        assert_eq!(ball.nearest_m([0.03, -0.04, 0.05]), [0.03, -0.04, 0.05]);
        let held_m = ball.nearest_m([0.3, 0.0, 0.4]);
        assert!(vec3::distance(held_m, [0.06, 0.0, 0.08]) < 1e-7, "{held_m:?}");
        let cuboid = Reach::Box { half_m: [0.1, 0.2, 0.3] };
        assert_eq!(cuboid.nearest_m([0.5, -0.1, -0.4]), [0.1, -0.1, -0.3]);
        assert!((cuboid.farthest_m() - 0.14_f32.sqrt()).abs() < 1e-6);
    }
}
