//! The unit quaternion of a rotation matrix.

use palpate_core::Orientation;

/// The rotation with these rows: from the largest of the squares of w, x, y, z.
#[must_use]
pub(super) fn orientation_of([[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]]: [[f64; 3]; 3]) -> Orientation {
    let squares = [1.0 + xx + yy + zz, 1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz];
    let largest = (0..4).max_by(|a, b| squares[*a].total_cmp(&squares[*b])).unwrap_or(0);
    let (a, b, c) = (zy - yz, xz - zx, yx - xy);
    let (d, e, f) = (xy + yx, xz + zx, yz + zy);
    let four = match largest {
        0 => [squares[0], a, b, c],
        1 => [a, squares[1], d, e],
        2 => [b, d, squares[2], f],
        _ => [c, e, f, squares[3]],
    };
    let length = four.iter().map(|x| x * x).sum::<f64>().sqrt();
    let [w, x, y, z] = four.map(|x| (x / length) as f32);
    Orientation { w, xyz: [x, y, z] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_core::vec3;

    /// The columns of the matrix are the turned axes.
    #[test]
    fn every_axis_and_half_turn_is_right() {
        for axis in [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [-0.48, 0.64, 0.6]]
        {
            for angle in [0.0_f32, 0.4, 1.6, 3.0, core::f32::consts::PI] {
                let expected = Orientation::of_vector(vec3::scale(axis, angle));
                let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|e| expected.turn(e));
                let rows = [0, 1, 2].map(|row| columns.map(|column| f64::from(column[row])));
                let found = orientation_of(rows);
                let dot = found.w * expected.w + vec3::dot(found.xyz, expected.xyz);
                assert!(dot.abs() > 1.0 - 1e-5, "{axis:?} {angle}: {found:?}, {expected:?}");
            }
        }
    }
}
