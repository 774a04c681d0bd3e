//! Positions of the held-out solves: pure functions of a seed, the name of the active node and a number.

use serde::{Deserialize, Serialize};

use super::HeldOutError;
use crate::num::vector::{dot, norm, unit};
use crate::space::{Kind, Store, StoreError};
use crate::spec::{SpaceGrid, neighbours};

/// Definition of a draw. The numbers of walks can grow later. The serialised fields cannot change, because a
/// store keeps one draw.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Draw {
    /// Number of steps of a random path.
    pub random_steps: u32,
    /// Seed of the random paths and uniform positions.
    pub seed: u64,
    /// Step length of a path, m.
    pub step_m: f64,
    /// Length of the 26 regular paths, m; `None` for no regular paths.
    #[serde(skip)]
    pub regular_m: Option<f64>,
    /// Number of random paths per active node.
    #[serde(skip)]
    pub random: u32,
    /// Number of reachable uniform positions per active node.
    #[serde(skip)]
    pub uniform: u32,
}

impl Draw {
    /// The draw of the paper: steps of 1 mm, regular paths of 10 cm and random paths of 200 steps. With it,
    /// 299 uniform positions: without an exceedance they certify 99 % at 95 % confidence.
    pub const PAPER: Self =
        Self { seed: 1, step_m: 1e-3, regular_m: Some(0.1), random: 20, random_steps: 200, uniform: 299 };

    /// Step length of the paths in a ball of this radius if nothing else is requested: that of the paper, and
    /// a tenth of the radius in a ball of less than 1 cm.
    pub fn default_step_m(radius_m: f64) -> f64 {
        Self::PAPER.step_m.min(LONGEST_STEP * radius_m)
    }

    /// Checks that the steps are short enough for the paths in a ball of this radius.
    pub fn check(&self, radius_m: f64) -> Result<(), HeldOutError> {
        let random = (self.random > 0).then_some((Kind::Random, radius_m, LONGEST_STEP * radius_m));
        let regular = self.regular_m.map(|length_m| (Kind::Regular, length_m, length_m));
        for (paths, of_m, limit_m) in random.into_iter().chain(regular) {
            // A limit in other units can differ in its last digit.
            if self.step_m > limit_m * (1.0 + 1e-9) {
                return Err(HeldOutError::LongStep { paths, step_m: self.step_m, of_m, limit_m });
            }
        }
        Ok(())
    }

    /// The fields that must not change within one store, as JSON.
    pub fn identity(&self) -> String {
        serde_json::to_string(self).expect("numbers are valid JSON")
    }

    /// The draw of a store with all numbers of walks zero; `None` if nothing is drawn yet.
    pub(crate) fn of(store: &Store) -> Result<Option<Self>, StoreError> {
        let Some(stored) = store.draw_identity()? else { return Ok(None) };
        let unreadable = |_| store.corrupt(format!("its draw of held-out truth is `{stored}`"));
        serde_json::from_str(&stored).map(Some).map_err(unreadable)
    }
}

/// The 26 directions to the neighbours of a lattice point, in a fixed order.
pub fn regular_directions() -> impl Iterator<Item = [f64; 3]> {
    neighbours().map(|offset| unit(offset.map(f64::from)))
}

/// Positions of a regular path, without rest.
pub(crate) fn regular_path(direction: [f64; 3], length_m: f64, step_m: f64) -> Vec<[f64; 3]> {
    let steps = (length_m / step_m).round().max(1.0) as u32;
    (1..=steps).map(|n| direction.map(|x| x * f64::from(n) * step_m)).collect()
}

/// Correlation length of a random path's direction, in grid radii.
const PERSISTENCE: f64 = 4.0;
/// Radius at which random paths are reflected, as a share of the grid radius.
const TURNS_AT: f64 = 0.9;

/// Longest step of a random path, in grid radii. Longer steps could leave the ball in spite of the
/// reflections.
const LONGEST_STEP: f64 = 0.1;

/// Positions of random path `number`, without rest. It starts in a random direction and turns slowly. The
/// correlation length of the direction is 4 r_G, so that nearly every path of length 2 r_G reaches the
/// reflecting sphere at 0.9 r_G.
pub(crate) fn random_path(draw: &Draw, active: &str, number: u32, radius_m: f64) -> Vec<[f64; 3]> {
    let mut stream = Stream::new(draw.seed, active, Kind::Random, number);
    // One step adds a vector uniform in a ball of radius s: <1 - cos> = s^2 / 5 to leading order.
    let turn = (5.0 * draw.step_m / (PERSISTENCE * radius_m)).sqrt();
    let (mut at, mut direction) = ([0.0; 3], unit(stream.in_unit_ball()));
    let mut path = Vec::with_capacity(draw.random_steps as usize);
    for _ in 0..draw.random_steps {
        let push = stream.in_unit_ball();
        direction = unit(std::array::from_fn(|i| direction[i] + turn * push[i]));
        let ahead = std::array::from_fn(|i| at[i] + draw.step_m * direction[i]);
        if norm(ahead) > TURNS_AT * radius_m {
            let out = unit(at);
            let outwards = dot(direction, out).max(0.0);
            direction = std::array::from_fn(|i| direction[i] - 2.0 * outwards * out[i]);
        }
        at = std::array::from_fn(|i| at[i] + draw.step_m * direction[i]);
        path.push(at);
    }
    path
}

/// Uniform position `number` in the ball of the grid.
pub(crate) fn uniform_position(draw: &Draw, active: &str, number: u32, radius_m: f64) -> [f64; 3] {
    Stream::new(draw.seed, active, Kind::Uniform, number).in_unit_ball().map(|x| x * radius_m)
}

/// Three numbers in 0 .. 1 that choose the place of uniform position `number` between contact points.
pub(super) fn place_numbers(draw: &Draw, active: &str, number: u32) -> [f64; 3] {
    let mut stream = Stream::new(draw.seed, active, Kind::Uniform, number);
    let _displacement = stream.in_unit_ball();
    [(); 3].map(|()| 0.5 * (stream.next() + 1.0))
}

/// Whether a fit may use this position: a grid point or, if transitions have `increments` equal parts, a
/// possible end of such a part. Errors are measured at other positions.
pub fn is_on_training_lattice(grid: &SpaceGrid, increments: Option<u32>, displacement_m: [f64; 3]) -> bool {
    let parts = f64::from(increments.unwrap_or(1));
    displacement_m.iter().all(|x| {
        let cells = x / grid.spacing_m * parts;
        (cells - cells.round()).abs() < 1e-6
    })
}

/// Numbers that depend on their key alone, on every machine: the extended output of BLAKE3.
struct Stream(blake3::OutputReader);

impl Stream {
    fn new(seed: u64, active: &str, kind: Kind, number: u32) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key("palpate held-out truth 1");
        hasher.update(&seed.to_le_bytes()).update(kind.name().as_bytes());
        hasher.update(&number.to_le_bytes()).update(active.as_bytes());
        Self(hasher.finalize_xof())
    }

    /// Uniform in -1 .. 1.
    fn next(&mut self) -> f64 {
        let mut bytes = [0; 8];
        self.0.fill(&mut bytes);
        (u64::from_le_bytes(bytes) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    /// Uniform in the unit ball without the centre.
    fn in_unit_ball(&mut self) -> [f64; 3] {
        loop {
            let point = [self.next(), self.next(), self.next()];
            if (1e-6..=1.0).contains(&dot(point, point)) {
                return point;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RADIUS_M: f64 = 0.1;

    #[test]
    fn regular_directions_are_the_26_and_their_paths_have_equal_steps() {
        let all: Vec<[f64; 3]> = regular_directions().collect();
        assert_eq!(all.len(), 26);
        for (n, a) in all.iter().enumerate() {
            assert!((norm(*a) - 1.0).abs() < 1e-15);
            assert!(all[..n].iter().all(|b| dot(*a, *b) < 0.9), "{a:?} is there twice");
        }
        let path = regular_path(all[0], RADIUS_M, 1e-3);
        assert_eq!(path.len(), 100);
        assert!((norm(path[99]) - RADIUS_M).abs() < 1e-15 && (norm(path[0]) - 1e-3).abs() < 1e-17);
    }

    #[test]
    fn random_paths_have_equal_steps_reach_the_rim_and_stay_inside() {
        let (mut reached, mut straight) = (0, 0.0);
        for number in 0..200 {
            let path = random_path(&Draw::PAPER, "A1", number, RADIUS_M);
            let mut before = [0.0; 3];
            let mut direction = path[0].map(|x| x / 1e-3);
            for &at in &path {
                let step: [f64; 3] = std::array::from_fn(|i| at[i] - before[i]);
                assert!((norm(step) - 1e-3).abs() < 1e-15);
                assert!(norm(at) <= 0.9 * RADIUS_M + 1e-12, "{at:?} is outside");
                straight += dot(direction, unit(step)) / (200.0 * 200.0);
                direction = unit(step);
                before = at;
            }
            reached += usize::from(path.iter().any(|&at| norm(at) > 0.89 * RADIUS_M));
        }
        assert!(reached >= 190, "{reached} of 200 reached 0.9 r_G");
        // The mean cosine is 1 - s^2/5 = 0.9975 per step; the reflections reduce it.
        assert!(straight > 0.98 && straight < 0.9995, "mean cosine of a turn {straight}");
    }

    #[test]
    fn random_paths_of_the_longest_steps_stay_in_a_small_ball() {
        let radius_m = 8e-4;
        let draw = Draw { step_m: Draw::default_step_m(radius_m), random_steps: 1000, ..Draw::PAPER };
        assert_eq!(draw.step_m, 8e-5);
        assert!(draw.check(radius_m).is_ok());
        for number in 0..1000 {
            for at in random_path(&draw, "A1", number, radius_m) {
                assert!(norm(at) <= radius_m, "{at:?} of path {number}");
            }
        }
        assert_eq!(Draw::default_step_m(RADIUS_M), Draw::PAPER.step_m);
    }

    #[test]
    fn steps_that_are_too_long_for_a_path_are_refused() {
        let refused = |draw: Draw| draw.check(8e-4).map_err(|error| error.to_string());
        let random = Draw { regular_m: None, ..Draw::PAPER };
        let line = refused(random.clone()).expect_err("1 mm steps in a ball of 0.8 mm");
        for words in ["steps of 1 mm", "radius 0.8 mm", "--step-mm 0.08 or less", "--random 0"] {
            assert!(line.contains(words), "{line}");
        }
        assert_eq!(refused(Draw { random: 0, ..random }), Ok(()));
        let line = refused(Draw { random: 0, regular_m: Some(8e-4), ..Draw::PAPER });
        let line = line.expect_err("paths shorter than a step");
        assert!(line.contains("regular paths of 0.8 mm") && line.contains("--regular-mm 0"), "{line}");
    }

    #[test]
    fn uniform_positions_fill_the_ball_evenly() {
        let draw = Draw::PAPER;
        let all: Vec<[f64; 3]> = (0..4000).map(|n| uniform_position(&draw, "A1", n, RADIUS_M)).collect();
        // Half the volume lies within 2^(-1/3) of the radius. The means are those of a symmetric
        // distribution.
        let inner = all.iter().filter(|&&p| norm(p) < RADIUS_M * 0.5_f64.cbrt()).count();
        assert!((1900..2100).contains(&inner), "{inner}");
        for axis in 0..3 {
            let mean = all.iter().map(|p| p[axis]).sum::<f64>() / 4000.0;
            assert!(mean.abs() < 0.03 * RADIUS_M, "{mean}");
        }
        assert!(all.iter().all(|&p| norm(p) <= RADIUS_M));
    }

    #[test]
    fn a_position_depends_on_seed_node_kind_and_number_alone() {
        let draw = Draw::PAPER;
        let one = uniform_position(&draw, "A1", 7, RADIUS_M);
        assert_eq!(one, uniform_position(&Draw { uniform: 1, random: 0, ..draw.clone() }, "A1", 7, RADIUS_M));
        assert_ne!(one, uniform_position(&draw, "A2", 7, RADIUS_M));
        assert_ne!(one, uniform_position(&draw, "A1", 8, RADIUS_M));
        assert_ne!(one, uniform_position(&Draw { seed: 2, ..draw }, "A1", 7, RADIUS_M));
    }

    #[test]
    fn training_points_on_a_path_are_known() {
        let grid = SpaceGrid::new(0.01, 0.05).expect("a grid");
        let axis = regular_path([1.0, 0.0, 0.0], 0.05, 1e-3);
        let on = |increments| axis.iter().filter(|&&p| is_on_training_lattice(&grid, increments, p)).count();
        assert_eq!((on(None), on(Some(5))), (5, 25));
        assert!(!is_on_training_lattice(&grid, None, [0.01, 0.0, 1e-5]));
    }
}
