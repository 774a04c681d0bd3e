//! Kinematics of the Falcon's delta mechanism: encoder counts to position and back, and the Jacobian.
//!
//! Three legs round the z axis, at 105, -15 and -135 degrees. In the plane of a leg
//!
//! ```text
//! u =  x cos(phi) + y sin(phi) + U      v = -x sin(phi) + y cos(phi) + V      w = z
//! crank e^(i theta) + L e^(i theta2) = u + i w,      L = gap + sqrt(rod^2 - v^2)
//! ```
//!
//! Position and crank angle theta of each leg satisfy
//!
//! g = (u - crank cos theta)^2 + (w - crank sin theta)^2 - L^2 = 0
//!
//! The gap makes L depend on the position, so the closed form of the intersection of three spheres does not
//! apply. Newton's method solves the three equations from the last position. x is to the right, y up, z
//! towards the user; metres and radians.
//! Source of the dimensions: libnifalcon (after R. E. Stamper, 1997). Deviation: solved to 1e-9 m instead of
//! 0.01 rad of a joint, which is 0.6 mm.

/// Length of the driven crank, m.
const CRANK_M: f64 = 0.060;
/// Length of the parallelogram's rods, m.
const ROD_M: f64 = 0.1025;
/// Length that the joints at both ends add to the rods in the leg's plane, m.
const GAP_M: f64 = 0.01125 + 0.01125;
/// Radial offset of the handle's joint from that of the base, m.
const U_OFFSET_M: f64 = 0.01443 - 0.0400;
/// Sideways offset of the handle's joint, m.
const V_OFFSET_M: f64 = -0.025 + 0.02309;
/// Direction of each leg, degrees.
const LEGS_DEG: [f64; 3] = [105.0, -15.0, -135.0];

/// Encoder counts per degree of a crank: a disc of 320 slots with fourfold counting, on a shaft of 14.25 mm
/// that a cable drives from the crank's drum of 110 mm.
pub const COUNTS_PER_DEGREE: f64 = 320.0 * 4.0 * (0.110 / 0.01425) / 360.0;
/// Angle of the cranks at count 0, degrees.
const ZERO_DEG: f64 = 35.0;

/// Middle of the workspace, m: the initial guess of the first solution.
pub const CENTRE_M: [f64; 3] = [0.0, 0.0, 0.12];

/// Largest number of Newton steps.
pub const MAX_ITERATIONS: u32 = 10;
/// Newton ends after a step below this, m: the error after it is the square of the step divided by a few
/// centimetres.
const STEP_TOLERANCE_M: f64 = 1e-6;
/// Longest Newton step, m: beyond it the equations are far from linear.
const MAX_STEP_M: f64 = 0.03;
/// Largest distance of the handle from the centre in any direction, m: a root beyond it belongs to another
/// configuration.
const MAX_REACH_M: f64 = 0.1;
/// Smallest volume spanned by the three rows of dg/dp, scaled to unit length. The legs are arranged
/// clockwise, so the sign is reversed. The volume is 0.34 to 0.89 over the workspace and zero at a
/// singularity; a negative value means the mirrored configuration.
const MIN_VOLUME: f64 = 0.05;

/// Direction of one leg.
#[derive(Debug, Clone, Copy)]
struct Leg {
    cos: f64,
    sin: f64,
}

/// The leg's equation at a position.
#[derive(Debug, Clone, Copy)]
struct Equation {
    /// g, m^2.
    g: f64,
    /// dg/dp, m.
    gradient: [f64; 3],
    /// dg/dtheta, m^2. Negative for the configuration in which the leg is built.
    by_angle: f64,
}

impl Leg {
    /// Position of the handle's joint in the leg's frame.
    fn uv(self, p: [f64; 3]) -> (f64, f64) {
        let Self { cos, sin } = self;
        (p[0] * cos + p[1] * sin + U_OFFSET_M, p[1] * cos - p[0] * sin + V_OFFSET_M)
    }

    /// Crank angle, the smaller of two solutions; `None` if the position is out of reach.
    fn angle(self, p: [f64; 3]) -> Option<f64> {
        let (u, v) = self.uv(p);
        let rod = ROD_M * ROD_M - v * v;
        if rod < 0.0 {
            return None;
        }
        let length = GAP_M + rod.sqrt();
        let away2 = u * u + p[2] * p[2];
        let cos = (CRANK_M * CRANK_M + away2 - length * length) / (2.0 * CRANK_M * away2.sqrt());
        (cos.abs() <= 1.0).then(|| p[2].atan2(u) - cos.acos())
    }

    /// The equation and its derivatives; `None` if the rods do not reach.
    fn equation(self, p: [f64; 3], (sin_t, cos_t): (f64, f64)) -> Option<Equation> {
        let (u, v) = self.uv(p);
        let rod2 = ROD_M * ROD_M - v * v;
        if rod2 <= 0.0 {
            return None;
        }
        let rod = rod2.sqrt();
        let length = GAP_M + rod;
        let (du, dw) = (u - CRANK_M * cos_t, p[2] - CRANK_M * sin_t);
        // dL/dv = -v / rod.
        let by_v = 2.0 * length * v / rod;
        Some(Equation {
            g: du * du + dw * dw - length * length,
            gradient: [
                2.0 * du * self.cos - by_v * self.sin,
                2.0 * du * self.sin + by_v * self.cos,
                2.0 * dw,
            ],
            by_angle: 2.0 * CRANK_M * (u * sin_t - p[2] * cos_t),
        })
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Adjugate of the matrix with these rows, as columns, and the determinant.
fn adjugate([a, b, c]: [[f64; 3]; 3]) -> ([[f64; 3]; 3], f64) {
    let columns = [cross(b, c), cross(c, a), cross(a, b)];
    (columns, dot(a, columns[0]))
}

/// Crank angle at an encoder count, rad.
#[must_use]
pub fn angle_of(count: f64) -> f64 {
    (ZERO_DEG + count / COUNTS_PER_DEGREE).to_radians()
}

/// Encoder count at a crank angle, not rounded.
#[must_use]
pub fn count_of(angle_rad: f64) -> f64 {
    (angle_rad.to_degrees() - ZERO_DEG) * COUNTS_PER_DEGREE
}

/// Position of the handle and its Jacobian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Position, m.
    pub position_m: [f64; 3],
    /// J = d(position)/d(theta), m/rad: one row per axis, one column per crank.
    pub jacobian: [[f64; 3]; 3],
}

impl Pose {
    /// Crank torques that exert a force on the hand, N m.
    ///
    /// tau = J^T F: the power is the same on both sides, F . dp = tau . dtheta.
    #[must_use]
    pub fn torques_n_m(&self, force_n: [f64; 3]) -> [f64; 3] {
        let j = &self.jacobian;
        core::array::from_fn(|crank| (0..3).map(|axis| j[axis][crank] * force_n[axis]).sum())
    }

    /// Force on the hand by crank torques, N: F = J^-T tau. Not finite at a singularity.
    #[must_use]
    pub fn force_n(&self, torques_n_m: [f64; 3]) -> [f64; 3] {
        let j = &self.jacobian;
        let by_crank = core::array::from_fn(|crank| core::array::from_fn(|axis| j[axis][crank]));
        let (columns, volume) = adjugate(by_crank);
        core::array::from_fn(|axis| {
            (0..3).map(|crank| columns[crank][axis] * torques_n_m[crank]).sum::<f64>() / volume
        })
    }
}

/// Result of the solution for one set of counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Solution {
    /// Solved: the pose belongs to these counts.
    Solved {
        /// Number of Newton steps.
        iterations: u32,
    },
    /// No pose has these counts, or none was found: the last valid pose is kept.
    Kept,
}

/// The mechanism with its last pose.
#[derive(Debug, Clone, Copy)]
pub struct Kinematics {
    legs: [Leg; 3],
    pose: Pose,
}

impl Default for Kinematics {
    fn default() -> Self {
        let legs = LEGS_DEG.map(|degrees| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            Leg { cos, sin }
        });
        let mut mechanism = Self { legs, pose: Pose { position_m: CENTRE_M, jacobian: [[0.0; 3]; 3] } };
        let angles = mechanism.angles_rad(CENTRE_M).expect("the centre can be reached");
        mechanism.pose = mechanism.newton(angles).expect("and solved for").0;
        mechanism
    }
}

impl Kinematics {
    /// The last valid pose; initially the centre.
    #[must_use]
    pub const fn pose(&self) -> &Pose {
        &self.pose
    }

    /// Discards the last pose: the next solution starts from the centre.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Crank angles at a position, rad; `None` if it is out of reach.
    #[must_use]
    pub fn angles_rad(&self, position_m: [f64; 3]) -> Option<[f64; 3]> {
        let [a, b, c] = self.legs.map(|leg| leg.angle(position_m));
        Some([a?, b?, c?])
    }

    /// Encoder counts at a position, as the device would report them.
    #[must_use]
    pub fn counts(&self, position_m: [f64; 3]) -> Option<[i16; 3]> {
        // The angles within one turn are a few thousand counts.
        Some(self.angles_rad(position_m)?.map(|angle| count_of(angle).round() as i16))
    }

    /// The pose at a position; `None` if it is out of reach.
    ///
    /// Cost: one arc cosine per leg and a 3 x 3 inverse; no iteration.
    #[must_use]
    pub fn pose_with(&self, position_m: [f64; 3]) -> Option<Pose> {
        self.pose_at(position_m, self.angles_rad(position_m)?.map(f64::sin_cos))
    }

    /// Solves for the pose of encoder counts, starting from the last pose.
    pub fn solve(&mut self, counts: [i16; 3]) -> Solution {
        self.solve_angles(counts.map(|count| angle_of(f64::from(count))))
    }

    /// Solves for the pose of crank angles, rad, starting from the last pose.
    ///
    /// Newton: p -= (dg/dp)^-1 g, and J = -(dg/dp)^-1 diag(dg/dtheta) at the end.
    /// Cost: 3 or 4 steps with three square roots and a 3 x 3 inverse each; no allocation.
    pub fn solve_angles(&mut self, angles_rad: [f64; 3]) -> Solution {
        match self.newton(angles_rad) {
            Some((pose, iterations)) => {
                self.pose = pose;
                Solution::Solved { iterations }
            }
            None => Solution::Kept,
        }
    }

    fn equations(&self, p: [f64; 3], angles: [(f64, f64); 3]) -> Option<[Equation; 3]> {
        let [a, b, c] = core::array::from_fn(|i| self.legs[i].equation(p, angles[i]));
        Some([a?, b?, c?])
    }

    fn newton(&self, angles_rad: [f64; 3]) -> Option<(Pose, u32)> {
        let angles = angles_rad.map(f64::sin_cos);
        let mut p = self.pose.position_m;
        for iterations in 1..=MAX_ITERATIONS {
            let equations = self.equations(p, angles)?;
            let (columns, volume) = adjugate(equations.map(|e| e.gradient));
            let step: [f64; 3] = core::array::from_fn(|axis| {
                -(0..3).map(|leg| columns[leg][axis] * equations[leg].g).sum::<f64>() / volume
            });
            let length = dot(step, step).sqrt();
            if length.is_nan() || length > 1.0 {
                return None;
            }
            let scale = if length > MAX_STEP_M { MAX_STEP_M / length } else { 1.0 };
            p = core::array::from_fn(|axis| p[axis] + scale * step[axis]);
            if length < STEP_TOLERANCE_M {
                return Some((self.pose_at(p, angles)?, iterations));
            }
        }
        None
    }

    /// The pose at a root, if it belongs to the configuration in which the mechanism is built.
    fn pose_at(&self, p: [f64; 3], angles: [(f64, f64); 3]) -> Option<Pose> {
        let equations = self.equations(p, angles)?;
        let gradients = equations.map(|e| e.gradient);
        let (columns, volume) = adjugate(gradients);
        let lengths: f64 = gradients.iter().map(|g| dot(*g, *g).sqrt()).product();
        let away = core::array::from_fn(|axis| p[axis] - CENTRE_M[axis]);
        let is_built_so = equations.iter().all(|e| e.by_angle < 0.0)
            && -volume > MIN_VOLUME * lengths
            && dot(away, away) < MAX_REACH_M * MAX_REACH_M;
        is_built_so.then(|| Pose {
            position_m: p,
            jacobian: core::array::from_fn(|axis| {
                core::array::from_fn(|leg| -columns[leg][axis] * equations[leg].by_angle / volume)
            }),
        })
    }
}

#[cfg(test)]
mod tests;
