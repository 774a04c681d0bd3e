//! Measurements of a force field besides its accuracy: work around closed loops, jumps at cell faces,
//! rounding, and query time.

use std::hint::black_box;
use std::time::Instant;

use palpate_core::{Method, Space, vec3};
use serde::{Deserialize, Serialize};

use super::branch_jump::has_branch_jump;
use super::{MAX_SEPARATE_NODES, reference};
use crate::num::sequence::{on_sphere, r3};
use crate::num::vector::{cross, distance, dot, norm, unit};

/// Results of the measurements.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Probe {
    /// Circles away from branch jumps.
    pub work: Work,
    /// Circles that touch a cell with a branch jump.
    #[serde(alias = "work_folded")]
    pub work_at_branch_jumps: Work,
    /// Largest jump of the force across a cell face or the rim of the ball, N.
    pub seam_n: f64,
    /// Largest difference of the core's f32 arithmetic from f64, N.
    pub rounding_n: f64,
    /// Assumed bound of that difference, N: twice the largest observed value.
    pub rounding_bound_n: f64,
    /// Median time of a query, ns, on the machine that packed the blob.
    pub nanoseconds: f64,
}

/// Work around circles of radius r_G / 4, as a share of the energy exchanged along the circle.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Work {
    /// Number of circles.
    pub circles: usize,
    /// Mean share.
    pub mean: f64,
    /// Largest share.
    pub max: f64,
}

/// Number of circles per space.
const CIRCLES: u32 = 200;
const STEPS: u32 = 720;
/// Number of crossings of cell faces and of the rim per space.
const CROSSINGS: u32 = 20_000;
/// Number of points for the estimate of a volume share.
const VOLUME_POINTS: u32 = 20_000;
const QUERIES: usize = 4_000;
const REPEATS: usize = 15;

/// Largest divisor of the numbers of circles, crossings and points in a blob of many spaces.
const MAX_DIVISOR: u32 = 16;

/// Divisor of these numbers for a blob of `spaces` spaces, which are certified together if they are many.
pub(super) fn divisor(spaces: usize) -> u32 {
    let many = u32::try_from(spaces / MAX_SEPARATE_NODES).unwrap_or(u32::MAX);
    many.clamp(1, MAX_DIVISOR)
}

/// Runs all measurements, each at 1 / `divisor` of the usual number of places. The time is measured as in
/// [`nanoseconds`].
pub(super) fn probe(space: &Space<'_>, method: Method, visited: &[[f32; 3]], divisor: u32) -> Probe {
    let (work, work_at_branch_jumps) = work(space, method, CIRCLES / divisor);
    let queries = QUERIES as u32 / divisor;
    let points: Vec<[f32; 3]> = (0..queries).map(|n| in_ball(space.lattice().radius_m(), n)).collect();
    let rounding_n = points.iter().map(|&at| rounding_n(space, method, at)).fold(0.0, f64::max);
    Probe {
        work,
        work_at_branch_jumps,
        seam_n: seam_n(space, method, CROSSINGS / divisor),
        rounding_n,
        rounding_bound_n: 2.0 * rounding_n,
        nanoseconds: nanoseconds(space, method, visited),
    }
}

/// Share of a part of the ball where `is` holds; zero for an empty part.
pub(crate) fn share_of_part(
    space: &Space<'_>,
    part: impl Fn([f32; 3]) -> bool,
    is: impl Fn([f32; 3]) -> bool,
) -> f64 {
    let inside: Vec<[f32; 3]> =
        (0..VOLUME_POINTS).map(|n| in_ball(space.lattice().radius_m(), n)).filter(|&at| part(at)).collect();
    let hits = inside.iter().filter(|&&at| is(at)).count();
    hits as f64 / inside.len().max(1) as f64
}

/// Point `n` of a uniform distribution in the ball.
fn in_ball(radius_m: f32, n: u32) -> [f32; 3] {
    let [r, z, angle] = r3(n + 1, 0.0);
    let (r, z) = (f64::from(radius_m) * libm::cbrt(r) * 0.9999, 2.0 * z - 1.0);
    direction(z, angle).map(|x| (r * x) as f32)
}

fn direction(z: f64, turns: f64) -> [f64; 3] {
    on_sphere(z, libm::sincos(std::f64::consts::TAU * turns))
}

fn force_n(space: &Space<'_>, method: Method, at: [f64; 3]) -> [f64; 3] {
    let found = space.force(method, at.map(|x| x as f32));
    found.map_or([0.0; 3], |sample| sample.force_n.map(f64::from))
}

/// Work around circles inside the ball: those away from branch jumps, and those that touch one.
fn work(space: &Space<'_>, method: Method, circles: u32) -> (Work, Work) {
    let radius_m = f64::from(space.lattice().radius_m());
    let mut all = [Work::default(); 2];
    for n in 0..circles {
        let ([share, z, angle], [az, aturn, _]) = (r3(n + 1, 0.0), r3(n + 1, 0.5));
        let centre = direction(2.0 * z - 1.0, angle).map(|x| 0.74 * radius_m * libm::cbrt(share) * x);
        let axis = direction(2.0 * az - 1.0, aturn);
        let least = (0..3).min_by(|&a, &b| axis[a].abs().total_cmp(&axis[b].abs())).unwrap_or(0);
        let mut u: [f64; 3] =
            std::array::from_fn(|i| f64::from(u8::from(i == least)) - axis[least] * axis[i]);
        u = unit(u);
        let v = cross(axis, u);
        let (mut net, mut exchanged, mut at_jump) = (0.0, 0.0, false);
        for step in 0..STEPS {
            let (s, c) = libm::sincos(std::f64::consts::TAU * f64::from(step) / f64::from(STEPS));
            let r = 0.25 * radius_m;
            let at: [f64; 3] = std::array::from_fn(|i| centre[i] + r * (c * u[i] + s * v[i]));
            let along: [f64; 3] = std::array::from_fn(|i| r * (c * v[i] - s * u[i]));
            let power = dot(force_n(space, method, at), along);
            net += power;
            exchanged += power.abs();
            at_jump |= has_branch_jump(space, at.map(|x| x as f32));
        }
        let share = net.abs() / f64::max(exchanged, f64::MIN_POSITIVE);
        let of = &mut all[usize::from(at_jump)];
        of.circles += 1;
        of.mean += share;
        of.max = of.max.max(share);
    }
    let [clear, at_jumps] = all.map(|w| Work { mean: w.mean / w.circles.max(1) as f64, ..w });
    (clear, at_jumps)
}

/// [`largest_jump_n`] of a method.
fn seam_n(space: &Space<'_>, method: Method, crossings: u32) -> f64 {
    // Radial basis functions have no cell faces, and with thousands of centres their queries are slow.
    let crossings =
        if matches!(method, Method::RbfLinear | Method::RbfCubic) { crossings / 100 } else { crossings };
    let field = |at, moved| force_and_change_n(space, method, at, moved);
    largest_jump_n((space.lattice().spacing_m(), space.lattice().radius_m()), crossings, field)
}

/// Largest jump of a force field across a cell face, across the rim, or outside the ball across the radial
/// continuation of a face, minus the change that the gradients on both sides predict. `field` is as
/// [`force_and_change_n`].
fn largest_jump_n(
    (spacing_m, radius_m): (f32, f32),
    crossings: u32,
    field: impl Fn([f32; 3], [f64; 3]) -> Option<([f64; 3], [f64; 3])>,
) -> f64 {
    let mut worst = 0.0f64;
    for n in 0..crossings {
        let mut at = in_ball(radius_m, n);
        let axis = n as usize % 3;
        let mut along: [f32; 3] = std::array::from_fn(|i| f32::from(u8::from(i == axis)));
        match n % 8 {
            7 => {
                along = vec3::normalize_or_zero(at);
                at = vec3::scale(along, radius_m);
            }
            // A point where a face meets the rim, moved outwards along its ray by up to two cells.
            5 | 6 => {
                at = vec3::scale(vec3::normalize_or_zero(at), radius_m);
                at[axis] = (at[axis] / spacing_m).round() * spacing_m;
                let others: f32 = (0..3).filter(|i| *i != axis).map(|i| at[i] * at[i]).sum();
                let stretch = ((radius_m * radius_m - at[axis] * at[axis]) / others.max(f32::MIN_POSITIVE))
                    .max(0.0)
                    .sqrt();
                let further = 1.0 + 2.0 * (n % 64) as f32 / 64.0 * spacing_m / radius_m;
                at = std::array::from_fn(|i| further * at[i] * if i == axis { 1.0 } else { stretch });
            }
            _ => {
                at[axis] = (at[axis] / spacing_m).round() * spacing_m;
                if vec3::norm(at) > 1.0001 * radius_m {
                    continue;
                }
            }
        }
        let gap = (2e-6 * spacing_m).max(4e-7 * vec3::max_abs(at));
        let [low, high] = [-gap, gap].map(|step| vec3::add(at, vec3::scale(along, step)));
        let moved: [f64; 3] = std::array::from_fn(|i| f64::from(high[i]) - f64::from(low[i]));
        let sides = [low, high].map(|at| field(at, moved));
        let [Some((low_n, low_change_n)), Some((high_n, high_change_n))] = sides else { continue };
        let jump: [f64; 3] =
            std::array::from_fn(|i| high_n[i] - low_n[i] - 0.5 * (low_change_n[i] + high_change_n[i]));
        worst = worst.max(norm(jump));
    }
    worst
}

/// The force at a position, and its change over the vector `moved` by the gradient there.
///
/// Outside the ball `Space::estimate` takes central differences along three axes. Here one along `moved`,
/// with the same step, is enough and cheaper.
fn force_and_change_n(
    space: &Space<'_>,
    method: Method,
    at: [f32; 3],
    moved: [f64; 3],
) -> Option<([f64; 3], [f64; 3])> {
    if method == Method::Kernel || space.lattice().locate(at).inside {
        let estimate = space.estimate(method, at)?;
        let change_n = estimate.stiffness_n_m.map(|row| dot(row.map(f64::from), moved));
        return Some((estimate.force_n.map(f64::from), change_n));
    }
    let found_n = space.force(method, at)?.force_n.map(f64::from);
    let length_m = norm(moved);
    let step_m = 2e-3 * f64::from(space.lattice().spacing_m());
    let beside_n = |sign: f64| {
        let along = |i: usize| f64::from(at[i]) + sign * step_m * moved[i] / length_m;
        force_n(space, method, std::array::from_fn(along))
    };
    let (after_n, before_n) = (beside_n(1.0), beside_n(-1.0));
    let change_n = std::array::from_fn(|i| (after_n[i] - before_n[i]) * 0.5 / step_m * length_m);
    Some((found_n, change_n))
}

fn rounding_n(space: &Space<'_>, method: Method, at: [f32; 3]) -> f64 {
    let Some(exact) = reference::force_n(space, method, at) else { return 0.0 };
    distance(exact, force_n(space, method, at.map(f64::from)))
}

/// Median time of a query, ns, at `visited`, or at points of the ball if those are fewer than a hundred.
pub fn nanoseconds(space: &Space<'_>, method: Method, visited: &[[f32; 3]]) -> f64 {
    let queries: Vec<[f32; 3]> = if visited.len() < 100 {
        (0..QUERIES as u32).map(|n| in_ball(space.lattice().radius_m(), n)).collect()
    } else {
        visited.iter().copied().cycle().take(QUERIES).collect()
    };
    let radial = matches!(method, Method::RbfLinear | Method::RbfCubic);
    let queries = if radial { &queries[..queries.len() / 20] } else { &queries[..] };
    let mut times: Vec<f64> = (0..REPEATS)
        .map(|_| {
            let start = Instant::now();
            for &at in queries {
                black_box(black_box(space).force(method, black_box(at)));
            }
            start.elapsed().as_nanos() as f64 / queries.len().max(1) as f64
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[REPEATS / 2]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A linear force, whose change the gradients predict exactly, plus 1 mN per component where `is_beyond`.
    fn largest_n(is_beyond: impl Fn([f32; 3]) -> bool) -> f64 {
        let field = |at: [f32; 3], moved: [f64; 3]| {
            let stiffness_n_m = |x: f64, axis: usize| 100.0 * (axis + 1) as f64 * x;
            let step_n = if is_beyond(at) { 1e-3 } else { 0.0 };
            let force_n = std::array::from_fn(|i| stiffness_n_m(f64::from(at[i]), i) + step_n);
            Some((force_n, std::array::from_fn(|i| stiffness_n_m(moved[i], i))))
        };
        largest_jump_n((0.01, 0.05), 2_000, field)
    }

    #[test]
    fn a_jump_at_a_face_at_the_rim_or_outside_is_found() {
        let step_n = 3.0f64.sqrt() * 1e-3;
        assert!(largest_n(|_| false) < 1e-12);
        for (name, found_n) in [
            ("face", largest_n(|at| at[1] > 0.02)),
            ("rim", largest_n(|at| vec3::norm(at) > 0.05)),
            (
                "face, continued outside",
                largest_n(|at| vec3::norm(at) > 0.0501 && 0.05 * at[0] / vec3::norm(at) > -0.01),
            ),
        ] {
            assert!((found_n - step_n).abs() < 1e-9, "{name}: {found_n}");
        }
    }
}
