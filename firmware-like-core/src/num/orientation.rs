//! Rotations of the grip as quaternions.

use super::vec3::{self, Vec3};

/// The rotation of the grip from the frame of the tool into the model frame: a unit quaternion w + x i + y j + z k.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Orientation {
    /// The real part: the cosine of half the angle.
    pub w: f32,
    /// The imaginary part: the axis, times the sine of half the angle.
    pub xyz: Vec3,
}

/// How far |q|^2 of a reading may be from 1.
const TOLERANCE: f32 = 0.01;

impl Orientation {
    /// No rotation: also the orientation of a device that measures none.
    pub const IDENTITY: Self = Self { w: 1.0, xyz: vec3::ZERO };

    /// The rotation by a vector: along its axis, by its length, radians.
    ///
    /// q = cos(t/2) + (v / t) sin(t/2),   t = |v|
    pub fn of_vector(vector_rad: Vec3) -> Self {
        let half = 0.5 * vec3::norm(vector_rad);
        let axis = vec3::normalize_or_zero(vector_rad);
        Self { w: libm::cosf(half), xyz: vec3::scale(axis, libm::sinf(half)) }
    }

    /// Whether it is a rotation: finite, and of length 1.
    pub fn is_rotation(&self) -> bool {
        (self.w * self.w + vec3::norm_squared(self.xyz) - 1.0).abs() <= TOLERANCE
    }

    /// The vector v after the rotation.
    ///
    /// v' = v + w t + x cross t,   t = 2 x cross v
    pub fn turn(&self, v: Vec3) -> Vec3 {
        let twice = vec3::scale(vec3::cross(self.xyz, v), 2.0);
        vec3::add(v, vec3::add(vec3::scale(twice, self.w), vec3::cross(self.xyz, twice)))
    }
}

impl Default for Orientation {
    fn default() -> Self {
        Self::IDENTITY
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rotation_turns_vectors_by_its_angle() {
        let quarter = Orientation::of_vector([0.0, 0.0, core::f32::consts::FRAC_PI_2]);
        assert!(vec3::distance(quarter.turn([1.0, 0.0, 2.0]), [0.0, 1.0, 2.0]) < 1e-6);
        let third =
            Orientation::of_vector(vec3::scale([1.0; 3], 2.0 * core::f32::consts::PI / 27_f32.sqrt()));
        assert!(vec3::distance(third.turn([1.0, 2.0, 3.0]), [3.0, 1.0, 2.0]) < 1e-5, "x to y to z");
        assert_eq!(Orientation::default().turn([1.0, -2.0, 3.0]), [1.0, -2.0, 3.0]);
        assert_eq!(Orientation::of_vector(vec3::ZERO), Orientation::IDENTITY);
    }

    #[test]
    fn only_unit_quaternions_are_rotations() {
        assert!(Orientation::of_vector([0.3, -2.0, 1.0]).is_rotation());
        let of = |w: f32, x: f32| Orientation { w, xyz: [x, 0.0, 0.0] };
        for bad in [of(0.0, 0.0), of(1.0, 0.2), of(f32::NAN, 0.0), of(1.0, f32::INFINITY)] {
            assert!(!bad.is_rotation(), "{bad:?}");
        }
    }
}
