//! Motion of the simulated hand: the tour of a [`Script`], or endless random palpation that depends only on a
//! seed.

use super::places::places;
use super::script::{
    GRASP_BUTTON, GRIP_HEIGHT_M, Script, Segment, SplitMix, largest_stroke_m, surface_centre, tangents,
};
use super::way::Way;
use palpate_core::{Organ, Orientation, Vec3, vec3};

/// Ranges of random palpation. Each value is drawn uniformly from its range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RandomConfig {
    /// Seed of the random numbers.
    pub seed: u64,
    /// Largest angle between the approach and the surface normal, rad.
    pub cone_rad: f32,
    /// Depth of a press along the approach, m.
    pub depth_m: [f32; 2],
    /// Sideways drag, m.
    pub drag_m: [f32; 2],
    /// Length of a pull, m.
    pub pull_m: [f32; 2],
    /// Rest at the end of a press or pull, s.
    pub rest_s: [f32; 2],
    /// Largest speed of a motion, m/s.
    pub speed_m_s: [f32; 2],
    /// Height above the surface between two touches, m.
    pub clearance_m: f32,
    /// Share of the touches that grasp and pull.
    pub grasps: f32,
}

impl RandomConfig {
    /// The default ranges with a seed.
    #[must_use]
    pub const fn new(seed: u64) -> Self {
        Self {
            seed,
            cone_rad: 0.6,
            depth_m: [0.003, 0.020],
            drag_m: [0.0, 0.015],
            pull_m: [0.003, 0.020],
            rest_s: [0.0, 0.6],
            speed_m_s: [0.02, 0.25],
            clearance_m: 0.025,
            grasps: 0.3,
        }
    }
}

/// Peak speed of a minimum-jerk motion, in units of length / duration: s'(1/2) = 15 / 8.
const PEAK_SPEED: f32 = 1.875;

/// Shortest duration of a motion, s.
const MIN_DURATION_S: f32 = 0.1;

/// Largest number of motions of one touch: approach, in, aside, rest, out; or approach, down, grip, up,
/// aside, rest, down, release, away. Before both, the way back of a hand that was caught.
const MAX_MOTIONS: usize = 10;

/// A hand that travels is caught by the body if it feels this force, N, for this time, s. It goes back this far, m, the way
/// the body pushes it.
const CAUGHT_N: f32 = 0.3;
const CAUGHT_S: f32 = 0.2;
const BACK_M: f32 = 0.05;

/// Endless sequence of touches: any active node, any direction within a cone, any depth, with drags and
/// pulls.
///
/// It plans one touch ahead in an array that is allocated once, so it can run inside the tick.
#[derive(Debug, Clone)]
pub struct RandomPalpation {
    config: RandomConfig,
    nodes: Box<[(Vec3, Vec3)]>,
    centre_m: Vec3,
    random: SplitMix,
    motions: Box<[Segment; MAX_MOTIONS]>,
    planned: usize,
    current: usize,
    elapsed_s: f32,
    /// Number of the first motions that lead through the air, and for how long the hand has been caught in them.
    through_air: usize,
    caught_s: f32,
}

impl RandomPalpation {
    /// A hand above the first place to touch: an active node, or with a sphere a vertex of the surface. Without any it
    /// stays at the origin.
    #[must_use]
    pub fn new<const N: usize>(organ: &Organ<'_, N>, config: RandomConfig) -> Self {
        let nodes = places(organ).into_boxed_slice();
        let largest_m = largest_stroke_m(organ);
        let shrink = |range: [f32; 2]| range.map(|metres| metres * (largest_m / range[1]).min(1.0));
        let config = RandomConfig {
            depth_m: shrink(config.depth_m),
            drag_m: shrink(config.drag_m),
            grasps: if organ.tool.grasps() { config.grasps } else { 0.0 },
            ..config
        };
        Self::over_nodes(nodes, surface_centre(organ), config)
    }

    fn over_nodes(nodes: Box<[(Vec3, Vec3)]>, centre_m: Vec3, config: RandomConfig) -> Self {
        let start_m = nodes
            .first()
            .map_or(vec3::ZERO, |(rest, normal)| vec3::add(*rest, vec3::scale(*normal, config.clearance_m)));
        let still = Segment {
            from_m: start_m,
            to_m: start_m,
            bow_m: vec3::ZERO,
            duration_s: 2.0 * MIN_DURATION_S,
            buttons: 0,
        };
        Self {
            random: SplitMix::new(config.seed),
            motions: Box::new([still; MAX_MOTIONS]),
            planned: 1,
            current: 0,
            elapsed_s: 0.0,
            through_air: 1,
            caught_s: 0.0,
            nodes,
            centre_m,
            config,
        }
    }

    /// Current target of the hand.
    #[must_use]
    pub fn target_m(&self) -> Vec3 {
        self.motions[self.current].at(self.elapsed_s)
    }

    /// Buttons held at present.
    #[must_use]
    pub fn buttons(&self) -> u32 {
        self.motions[self.current].buttons
    }

    /// Advances the time by less than the shortest duration of a motion.
    pub fn advance(&mut self, by_s: f32) {
        self.elapsed_s += by_s;
        let duration_s = self.motions[self.current].duration_s;
        if self.elapsed_s < duration_s {
            return;
        }
        self.elapsed_s -= duration_s;
        self.current += 1;
        if self.current == self.planned {
            self.plan();
        }
    }

    /// What the hand feels where it is, for a time. On the way to the next place it touches nothing on purpose: if the body
    /// holds it, it goes back, as a person would, and then on.
    pub fn feel(&mut self, position_m: Vec3, force_n: Vec3, for_s: f32) {
        let size_n = vec3::norm(force_n);
        let is_caught = self.current < self.through_air && size_n > CAUGHT_N;
        self.caught_s = if is_caught { self.caught_s + for_s } else { 0.0 };
        if self.caught_s < CAUGHT_S {
            return;
        }
        let (from_m, home_m) = (self.target_m(), self.motions[self.through_air - 1].to_m);
        let back_m = vec3::add(position_m, vec3::scale(force_n, BACK_M / size_n));
        let touch = self.through_air..self.planned;
        self.motions.copy_within(touch.clone(), 2);
        (self.planned, self.current, self.elapsed_s, self.caught_s) = (0, 0, 0.0, 0.0);
        let duration_s = PEAK_SPEED * vec3::distance(from_m, back_m) / self.config.speed_m_s[1];
        self.push(Segment { from_m, to_m: back_m, bow_m: vec3::ZERO, duration_s, buttons: 0 });
        self.travel(back_m, home_m);
        (self.through_air, self.planned) = (2, 2 + touch.len());
    }

    fn draw(&mut self, [low, high]: [f32; 2]) -> f32 {
        low + (high - low) * self.random.unit()
    }

    /// A direction drawn uniformly from the spherical cap of the cone.
    fn direction(&mut self, normal: Vec3) -> Vec3 {
        let cosine = 1.0 - self.random.unit() * (1.0 - self.config.cone_rad.cos());
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        vec3::add(vec3::scale(normal, cosine), vec3::scale(self.sideways(normal), sine))
    }

    /// A random unit vector perpendicular to another.
    fn sideways(&mut self, normal: Vec3) -> Vec3 {
        let (first, second) = tangents(normal);
        let (sine, cosine) = (core::f32::consts::TAU * self.random.unit()).sin_cos();
        vec3::add(vec3::scale(first, cosine), vec3::scale(second, sine))
    }

    /// Plans the next touch from the end of the last one.
    fn plan(&mut self) {
        let position_m = self.motions[self.planned - 1].to_m;
        (self.planned, self.current, self.through_air) = (0, 0, 1);
        let drawn = self.random.next() % self.nodes.len().max(1) as u64;
        let Some(&(rest_m, normal)) = self.nodes.get(drawn as usize) else {
            self.stay(position_m, 1.0, 0);
            return;
        };
        let config = self.config;
        let inward = self.direction(normal);
        let at = |metres: f32| vec3::add(rest_m, vec3::scale(inward, metres));
        let home_m = at(config.clearance_m);
        self.travel(position_m, home_m);
        let drag_m = self.draw(config.drag_m);
        let aside = vec3::scale(self.sideways(inward), drag_m);
        let rest_s = self.draw(config.rest_s);
        if self.random.unit() < config.grasps {
            let grip_m = vec3::add(rest_m, vec3::scale(normal, GRIP_HEIGHT_M));
            let top_m = at(GRIP_HEIGHT_M + self.draw(config.pull_m));
            self.go(home_m, grip_m, 0);
            self.stay(grip_m, 0.2, GRASP_BUTTON);
            self.go(grip_m, top_m, GRASP_BUTTON);
            let end_m = vec3::add(top_m, aside);
            self.go(top_m, end_m, GRASP_BUTTON);
            self.stay(end_m, rest_s, GRASP_BUTTON);
            self.go(end_m, grip_m, GRASP_BUTTON);
            self.stay(grip_m, 0.15, 0);
            self.go(grip_m, home_m, 0);
        } else {
            let bottom_m = at(-self.draw(config.depth_m));
            self.go(home_m, bottom_m, 0);
            let end_m = vec3::add(bottom_m, aside);
            self.go(bottom_m, end_m, 0);
            self.stay(end_m, rest_s, 0);
            self.go(end_m, home_m, 0);
        }
    }

    fn go(&mut self, from_m: Vec3, to_m: Vec3, buttons: u32) {
        let speed_m_s = self.draw(self.config.speed_m_s);
        let duration_s = PEAK_SPEED * vec3::distance(from_m, to_m) / speed_m_s;
        self.push(Segment { from_m, to_m, bow_m: vec3::ZERO, duration_s, buttons });
    }

    /// Moves to another node on a path that is bowed away from the organ's centre by half its length, so that
    /// it does not pass through the organ.
    fn travel(&mut self, from_m: Vec3, to_m: Vec3) {
        let middle = vec3::scale(vec3::add(from_m, to_m), 0.5);
        let outward = vec3::normalize_or_zero(vec3::sub(middle, self.centre_m));
        let length_m = vec3::distance(from_m, to_m);
        let bow_m = vec3::scale(outward, 0.5 * length_m);
        // The combined speed along path and bow is at most that of the straight path plus four bows.
        let duration_s = PEAK_SPEED * (length_m + 4.0 * vec3::norm(bow_m)) / self.config.speed_m_s[1];
        self.push(Segment { from_m, to_m, bow_m, duration_s, buttons: 0 });
    }

    fn stay(&mut self, at_m: Vec3, duration_s: f32, buttons: u32) {
        self.push(Segment { from_m: at_m, to_m: at_m, bow_m: vec3::ZERO, duration_s, buttons });
    }

    fn push(&mut self, motion: Segment) {
        self.motions[self.planned] = Segment { duration_s: motion.duration_s.max(MIN_DURATION_S), ..motion };
        self.planned += 1;
    }
}

/// Motion that the hand follows.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant, reason = "there is one per hand, so boxing saves nothing")]
pub enum Palpation {
    /// A closed tour of strokes.
    Tour(Script),
    /// Random touches.
    Random(RandomPalpation),
    /// A given motion.
    Way(Way),
}

impl Palpation {
    /// Current target of the hand.
    #[must_use]
    pub fn target_m(&self) -> Vec3 {
        match self {
            Self::Tour(script) => script.target_m(),
            Self::Random(random) => random.target_m(),
            Self::Way(way) => way.target_m(),
        }
    }

    /// How the grip is turned on a given way; `None` on other motions.
    #[must_use]
    pub fn orientation(&self) -> Option<Orientation> {
        match self {
            Self::Way(way) => Some(Orientation::of_vector(way.between(|at| at.turn_rad))),
            Self::Tour(_) | Self::Random(_) => None,
        }
    }

    /// Buttons held at present.
    #[must_use]
    pub fn buttons(&self) -> u32 {
        match self {
            Self::Tour(script) => script.buttons(),
            Self::Random(random) => random.buttons(),
            Self::Way(_) => 0,
        }
    }

    /// What the hand feels where it is, for a time.
    pub fn feel(&mut self, position_m: Vec3, force_n: Vec3, for_s: f32) {
        if let Self::Random(random) = self {
            random.feel(position_m, force_n, for_s);
        }
    }

    /// Advances the time by an integration step.
    pub fn advance(&mut self, by_s: f32) {
        match self {
            Self::Tour(script) => script.advance(by_s),
            Self::Random(random) => random.advance(by_s),
            Self::Way(way) => way.advance(by_s),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn over(nodes: &[(Vec3, Vec3)], seed: u64) -> RandomPalpation {
        RandomPalpation::over_nodes(nodes.into(), vec3::ZERO, RandomConfig::new(seed))
    }

    const NODES: [(Vec3, Vec3); 3] = [
        ([0.05, 0.0, 0.0], [1.0, 0.0, 0.0]),
        ([0.0, 0.0, 0.05], [0.0, 0.0, 1.0]),
        ([0.0, -0.06, 0.0], [0.0, -1.0, 0.0]),
    ];

    #[test]
    fn ten_minutes_touch_every_node_smoothly_within_the_speed_limit() {
        let mut hand = over(&NODES, 7);
        let dt_s = 1e-3;
        let (mut before_m, mut slowest_step, mut longest_step) = (hand.target_m(), vec3::ZERO, 0.0_f32);
        let mut deepest_m = [0.0_f32; 3];
        let mut highest_held_m = [0.0_f32; 3];
        let mut nearest_m = f32::INFINITY;
        for _ in 0..600_000 {
            hand.advance(dt_s);
            let now_m = hand.target_m();
            let step = vec3::sub(now_m, before_m);
            longest_step = longest_step.max(vec3::norm(step));
            // No jump of the velocity: at most 10 m/s^2.
            assert!(vec3::distance(step, slowest_step) < 1e-5, "{step:?} after {slowest_step:?}");
            (before_m, slowest_step) = (now_m, step);
            nearest_m = nearest_m.min(vec3::norm(now_m));
            for (node, (rest_m, normal)) in NODES.iter().enumerate() {
                let away = vec3::sub(now_m, *rest_m);
                if vec3::norm(away) > 0.04 {
                    continue;
                }
                let height_m = vec3::dot(away, *normal);
                deepest_m[node] = deepest_m[node].min(height_m);
                if hand.buttons() == GRASP_BUTTON {
                    highest_held_m[node] = highest_held_m[node].max(height_m);
                }
            }
        }
        let fastest_m_s = longest_step / dt_s;
        assert!(fastest_m_s > 0.2 && fastest_m_s < 0.251, "{fastest_m_s} m/s");
        assert!(deepest_m.iter().all(|m| (-0.025..-0.015).contains(m)), "{deepest_m:?}");
        assert!(highest_held_m.iter().all(|m| (0.015..0.026).contains(m)), "{highest_held_m:?}");
        assert!(nearest_m > 0.025, "not through the middle: {nearest_m}");
    }

    #[test]
    fn a_hand_that_is_caught_on_its_way_goes_back_and_then_on() {
        let mut hand = over(&NODES, 7);
        let mut caught = 0;
        for _ in 0..600_000 {
            hand.advance(1e-3);
            let (at_m, is_touch) = (hand.target_m(), hand.current >= hand.through_air);
            let touch = hand.motions[hand.through_air..hand.planned].to_vec();
            // Something holds the hand now and then, on its way and while it touches.
            let holds = hand.elapsed_s > 0.3 && hand.through_air == 1;
            hand.feel(at_m, if holds { [0.0, 0.0, 2.0] } else { vec3::ZERO }, 1e-3);
            if hand.through_air == 2 && hand.current == 0 && hand.elapsed_s == 0.0 {
                caught += 1;
                assert!(!is_touch && hand.motions[2..hand.planned] == touch, "{hand:?}");
                let [back, on] = [hand.motions[0], hand.motions[1]];
                let back_m = vec3::add(at_m, [0.0, 0.0, BACK_M]);
                assert!(vec3::distance(back.to_m, back_m) < 1e-6 && on.from_m == back.to_m, "{hand:?}");
                assert!(on.to_m == touch[0].from_m && back.from_m == at_m, "{hand:?}");
            }
        }
        assert!(caught > 50, "{caught}");
    }

    #[test]
    fn a_seed_determines_the_motion() {
        let trace = |seed| {
            let mut hand = over(&NODES, seed);
            core::iter::repeat_with(move || {
                hand.advance(1e-3);
                (hand.target_m().map(f32::to_bits), hand.buttons())
            })
            .take(60_000)
            .collect::<Vec<_>>()
        };
        assert_eq!(trace(1), trace(1));
        assert_ne!(trace(1), trace(2));
    }

    #[test]
    fn directions_fill_the_cone_and_stay_in_it() {
        let mut hand = over(&NODES, 3);
        let normal = vec3::normalize_or_zero([1.0, 2.0, -1.0]);
        let cosines: Vec<f32> = (0..20_000).map(|_| vec3::dot(hand.direction(normal), normal)).collect();
        let edge = hand.config.cone_rad.cos();
        assert!(cosines.iter().all(|cosine| *cosine >= edge - 1e-5));
        // Uniform over the cap: the inner half of its area gets half of the directions.
        let inner = cosines.iter().filter(|cosine| **cosine > 0.5 * (1.0 + edge)).count();
        assert!((9_500..10_500).contains(&inner), "{inner}");
    }

    #[test]
    fn without_nodes_the_hand_stays() {
        let mut hand = over(&[], 1);
        for _ in 0..5_000 {
            hand.advance(1e-3);
            assert_eq!((hand.target_m(), hand.buttons()), (vec3::ZERO, 0));
        }
    }
}
