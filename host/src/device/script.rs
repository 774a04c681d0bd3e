//! Scripted motion of the simulated hand: a closed tour of strokes over the active nodes.

use super::places::places;
use palpate_core::{Organ, Vec3, vec3};

/// Button bit that the script holds while grasping; equal to the default of `ContactConfig::grasp_button`.
pub const GRASP_BUTTON: u32 = 1;

/// Largest speed of the target: a fast arm motion, far below the overspeed limit of 2 m/s, which no script
/// may reach.
pub const MAX_TARGET_SPEED_M_S: f32 = 0.8;

/// Size and speed of the strokes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StrokeConfig {
    /// Depth of a press below the surface, m.
    pub press_m: f32,
    /// Sideways drag while pressing or pulling, m.
    pub drag_m: f32,
    /// Height of a pull above the surface, m.
    pub pull_m: f32,
    /// Height of the hand above the surface between strokes, m.
    pub clearance_m: f32,
    /// Time for all motions at one node, s. It is longer if a motion would exceed [`MAX_TARGET_SPEED_M_S`].
    pub seconds_per_node: f32,
}

/// Largest press and drag of a simulated finger, as a share of the solved radius: together they stay within it.
const SHARE_OF_RADIUS: f32 = 0.65;

/// Largest press and largest drag of a hand on this organ, m. A fingertip stays within what is solved at every
/// contact point; a hand that holds nodes may leave it, as the paper's does.
pub(super) fn largest_stroke_m<const N: usize>(organ: &Organ<'_, N>) -> f32 {
    if organ.tool.fingertip().is_none() {
        return f32::INFINITY;
    }
    let radii_m = organ.spaces.iter().map(|space| space.lattice().radius_m());
    SHARE_OF_RADIUS * radii_m.fold(f32::INFINITY, f32::min)
}

impl Default for StrokeConfig {
    fn default() -> Self {
        Self { press_m: 0.015, drag_m: 0.015, pull_m: 0.020, clearance_m: 0.030, seconds_per_node: 7.0 }
    }
}

/// One smooth motion of the target, from rest to rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Segment {
    pub(super) from_m: Vec3,
    pub(super) to_m: Vec3,
    /// Offset at mid-path that fades to both ends: it bends the path round the organ.
    pub(super) bow_m: Vec3,
    pub(super) duration_s: f32,
    pub(super) buttons: u32,
}

impl Segment {
    /// Minimum-jerk position (Flash and Hogan 1985): s(t) = 10 t^3 - 15 t^4 + 6 t^5.
    pub(super) fn at(&self, elapsed_s: f32) -> Vec3 {
        let t = (elapsed_s / self.duration_s).clamp(0.0, 1.0);
        let s = t * t * t * (10.0 + t * (6.0 * t - 15.0));
        let straight = vec3::add(self.from_m, vec3::scale(vec3::sub(self.to_m, self.from_m), s));
        vec3::add(straight, vec3::scale(self.bow_m, 4.0 * s * (1.0 - s)))
    }

    /// Increases the duration if the speed exceeds the limit anywhere. Speed is inversely proportional to
    /// duration, so one pass is enough.
    fn slow_down_to(&mut self, max_m_s: f32) {
        const STEPS: u16 = 200;
        let step_s = self.duration_s / f32::from(STEPS);
        let at = |step: u16| self.at(step_s * f32::from(step));
        let longest_m = (1..=STEPS).map(|step| vec3::distance(at(step - 1), at(step))).fold(0.0, f32::max);
        self.duration_s *= (longest_m / (step_s * max_m_s)).max(1.0);
    }
}

/// Height above the surface at which the hand closes its grip, so that grasping does not press.
pub(super) const GRIP_HEIGHT_M: f32 = 0.002;

/// Closed tour: press, drag, release, grasp, pull, drag and release at every active node.
#[derive(Debug, Clone, PartialEq)]
pub struct Script {
    segments: Vec<Segment>,
    current: usize,
    elapsed_s: f32,
}

impl Script {
    /// Plans the tour over an organ's active nodes. Without active nodes the hand stays at the origin.
    #[must_use]
    pub fn new<const N: usize>(organ: &Organ<'_, N>, config: &StrokeConfig) -> Self {
        let nodes = places(organ);
        let largest_m = largest_stroke_m(organ);
        let config = StrokeConfig {
            press_m: config.press_m.min(largest_m),
            drag_m: config.drag_m.min(largest_m),
            ..*config
        };
        Self::over_nodes(&nodes, surface_centre(organ), &config, organ.tool.grasps())
    }

    /// Height above the surface at which [`Script::press_and_hold`] starts, m.
    pub const PRESS_FROM_M: f32 = 0.005;

    /// Moves within one second from above an active node to `depth_m` below its surface, holds, returns
    /// within one second, and repeats.
    #[must_use]
    pub fn press_and_hold(rest_m: Vec3, normal: Vec3, depth_m: f32, hold_s: f32) -> Self {
        let height = |metres: f32| vec3::add(rest_m, vec3::scale(normal, metres));
        let mut plan = Plan { segments: Vec::new(), position_m: height(Self::PRESS_FROM_M), buttons: 0 };
        plan.go(height(-depth_m), 1.0);
        plan.stay(hold_s);
        plan.go(height(Self::PRESS_FROM_M), 1.0);
        plan.stay(1.0);
        Self { segments: plan.segments, current: 0, elapsed_s: 0.0 }
    }

    /// Presses and drags at every node; with `grips` then takes hold of it and pulls, which a fingertip cannot.
    fn over_nodes(nodes: &[(Vec3, Vec3)], centre_m: Vec3, config: &StrokeConfig, grips: bool) -> Self {
        let mut plan = Plan { segments: Vec::new(), position_m: vec3::ZERO, buttons: 0 };
        let home_m = |(rest, normal): (Vec3, Vec3)| vec3::add(rest, vec3::scale(normal, config.clearance_m));
        for (i, &(rest, normal)) in nodes.iter().enumerate() {
            let (first, second) = tangents(normal);
            let height = |metres: f32| vec3::add(rest, vec3::scale(normal, metres));
            let aside = |point: Vec3, axis: Vec3, metres: f32| vec3::add(point, vec3::scale(axis, metres));
            let (bottom, grip, top) =
                (height(-config.press_m), height(GRIP_HEIGHT_M), height(GRIP_HEIGHT_M + config.pull_m));

            plan.position_m = home_m((rest, normal));
            plan.go(bottom, 1.0);
            plan.stay(0.3);
            plan.go(aside(bottom, first, config.drag_m), 0.7);
            plan.go(aside(bottom, second, config.drag_m), 0.8);
            plan.go(bottom, 0.5);
            plan.go(height(0.5 * config.clearance_m), 0.7);
            if grips {
                plan.go(grip, 0.5);
                plan.buttons = GRASP_BUTTON;
                plan.stay(0.2);
                plan.go(top, 1.0);
                plan.go(aside(top, second, -config.drag_m), 0.7);
                plan.go(grip, 0.8);
                plan.buttons = 0;
                plan.stay(0.15);
            }
            plan.go(home_m((rest, normal)), 0.4);
            let next = home_m(nodes[(i + 1) % nodes.len()]);
            if nodes.len() > 1 {
                plan.travel(next, centre_m, 0.8);
            }
        }
        if plan.segments.is_empty() {
            plan.stay(1.0);
        }
        let planned_s: f32 = plan.segments.iter().map(|segment| segment.duration_s).sum();
        let requested_s = config.seconds_per_node.max(0.1) * nodes.len().max(1) as f32;
        for segment in &mut plan.segments {
            segment.duration_s *= requested_s / planned_s;
            segment.slow_down_to(MAX_TARGET_SPEED_M_S);
        }
        Self { segments: plan.segments, current: 0, elapsed_s: 0.0 }
    }

    /// Current target of the hand.
    #[must_use]
    pub fn target_m(&self) -> Vec3 {
        self.segments[self.current].at(self.elapsed_s)
    }

    /// Buttons held at present.
    #[must_use]
    pub fn buttons(&self) -> u32 {
        self.segments[self.current].buttons
    }

    /// Duration of the tour, s.
    #[must_use]
    pub fn duration_s(&self) -> f32 {
        self.segments.iter().map(|segment| segment.duration_s).sum()
    }

    /// Advances the time by less than a segment's duration; the tour repeats.
    pub fn advance(&mut self, by_s: f32) {
        self.elapsed_s += by_s;
        let duration_s = self.segments[self.current].duration_s;
        if self.elapsed_s >= duration_s {
            self.elapsed_s -= duration_s;
            self.current = (self.current + 1) % self.segments.len();
        }
    }
}

struct Plan {
    segments: Vec<Segment>,
    position_m: Vec3,
    buttons: u32,
}

impl Plan {
    fn go(&mut self, to_m: Vec3, duration_s: f32) {
        self.push(to_m, vec3::ZERO, duration_s);
    }

    fn stay(&mut self, duration_s: f32) {
        self.push(self.position_m, vec3::ZERO, duration_s);
    }

    /// Moves to another node on a path bowed away from the organ's centre by its length, so that it does not
    /// pass through the organ.
    fn travel(&mut self, to_m: Vec3, centre_m: Vec3, duration_s: f32) {
        let middle = vec3::scale(vec3::add(self.position_m, to_m), 0.5);
        let outward = vec3::normalize_or_zero(vec3::sub(middle, centre_m));
        self.push(to_m, vec3::scale(outward, 0.5 * vec3::distance(self.position_m, to_m)), duration_s);
    }

    fn push(&mut self, to_m: Vec3, bow_m: Vec3, duration_s: f32) {
        self.segments.push(Segment {
            from_m: self.position_m,
            to_m,
            bow_m,
            duration_s,
            buttons: self.buttons,
        });
        self.position_m = to_m;
    }
}

/// Two unit vectors perpendicular to a normal and to each other.
pub(super) fn tangents(normal: Vec3) -> (Vec3, Vec3) {
    // The axis with a small component along the normal, so that the cross product is long.
    let axis = if normal[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let first = vec3::normalize_or_zero(vec3::cross(axis, normal));
    (first, vec3::cross(normal, first))
}

/// Middle of the surface's bounding box; without a surface in the blob, of the active nodes.
pub(super) fn surface_centre<const N: usize>(organ: &Organ<'_, N>) -> Vec3 {
    let surface = [0, 1, 2].map(|axis: usize| range(organ.surface.position_m[axis].iter().copied()));
    let nodes = [0, 1, 2]
        .map(|axis: usize| range(organ.spaces.iter().map(|space| space.active.rest_position_m[axis])));
    let bounds = if organ.surface.node.is_empty() { nodes } else { surface };
    bounds.map(|(low, high)| if low <= high { 0.5 * (low + high) } else { 0.0 })
}

fn range(values: impl Iterator<Item = f32>) -> (f32, f32) {
    values.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

/// Element `index` of the sequence SplitMix64 (Steele, Lea and Flood 2014): the same numbers on every machine.
#[must_use]
pub const fn split_mix(seed: u64, index: u64) -> u64 {
    let mut z = seed.wrapping_add(index.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The sequence from a seed.
#[derive(Debug, Clone)]
pub(super) struct SplitMix {
    seed: u64,
    index: u64,
}

impl SplitMix {
    pub(super) const fn new(seed: u64) -> Self {
        Self { seed, index: 0 }
    }

    pub(super) const fn next(&mut self) -> u64 {
        self.index += 1;
        split_mix(self.seed, self.index - 1)
    }

    /// Uniform in [0, 1).
    pub(super) fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1_u64 << 24) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::palpation::{RandomConfig, RandomPalpation};
    use crate::synthetic;
    use palpate_core::format::{Fingertip, Tool};

    fn two_nodes() -> Script {
        let nodes = [([0.05, 0.0, 0.0], [1.0, 0.0, 0.0]), ([0.0, 0.0, 0.05], [0.0, 0.0, 1.0])];
        Script::over_nodes(&nodes, vec3::ZERO, &StrokeConfig::default(), true)
    }

    #[test]
    fn the_tour_is_smooth_and_closed() {
        let mut script = two_nodes();
        assert!((script.duration_s() - 14.0).abs() < 1e-3);
        let start = script.target_m();
        let mut before = start;
        let dt = 1e-3;
        for _ in 0..(script.duration_s() / dt) as usize {
            script.advance(dt);
            let now = script.target_m();
            assert!(vec3::distance(before, now) < 1e-3, "faster than 1 m/s");
            before = now;
        }
        assert!(vec3::distance(start, before) < 1e-4);
    }

    #[test]
    fn a_fingertip_presses_and_does_not_pull() {
        let node = ([0.05, 0.0, 0.0], [1.0, 0.0, 0.0]);
        let config = StrokeConfig::default();
        for grips in [false, true] {
            let mut script = Script::over_nodes(&[node], vec3::ZERO, &config, grips);
            let (mut buttons, mut deepest_m) = (0, 0.0_f32);
            for _ in 0..(script.duration_s() / 1e-3) as usize {
                script.advance(1e-3);
                buttons |= script.buttons();
                deepest_m = deepest_m.max(0.05 - script.target_m()[0]);
            }
            assert_eq!(buttons == GRASP_BUTTON, grips);
            assert!((deepest_m - config.press_m).abs() < 1e-4, "{deepest_m}");
        }
    }

    /// A finger stays within what is solved, with its press and its drag together; the scripted and the random one.
    #[test]
    fn a_fingertip_stays_within_the_solved_radius() {
        let blob = synthetic::organ(&synthetic::Shape::default());
        let mut organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        organ.spaces.truncate(1);
        let (solved_m, active) = (organ.spaces[0].lattice().radius_m(), organ.spaces[0].active.clone());
        let far_m = 2.0 * solved_m;
        let strokes = StrokeConfig { press_m: far_m, drag_m: far_m, ..StrokeConfig::default() };
        let random = RandomConfig { depth_m: [0.0, far_m], drag_m: [0.0, far_m], ..RandomConfig::new(3) };
        for tool in [Tool::Point, Tool::Fingertip(Fingertip { radius_m: 0.01, stiffness_n_m: 500.0 })] {
            let organ = Organ { tool, ..organ.clone() };
            let mut script = Script::new(&organ, &strokes);
            let mut hand = RandomPalpation::new(&organ, random);
            let mut farthest_m = [0.0_f32; 2];
            for _ in 0..20_000 {
                script.advance(1e-3);
                hand.advance(1e-3);
                for (farthest_m, target_m) in farthest_m.iter_mut().zip([script.target_m(), hand.target_m()])
                {
                    let d_m = vec3::sub(target_m, active.rest_position_m);
                    if vec3::dot(d_m, active.outward_normal) < 0.0 {
                        *farthest_m = farthest_m.max(vec3::norm(d_m));
                    }
                }
            }
            let is_within = farthest_m.map(|metres| metres <= solved_m);
            assert_eq!(is_within, [!tool.grasps(); 2], "{farthest_m:?} of {solved_m}");
        }
    }

    #[test]
    fn a_short_tour_stays_below_the_speed_limit() {
        let nodes = [([0.05, 0.0, 0.0], [1.0, 0.0, 0.0]), ([0.0, 0.0, 0.25], [0.0, 0.0, 1.0])];
        let hurry = StrokeConfig { seconds_per_node: 0.5, ..StrokeConfig::default() };
        let mut script = Script::over_nodes(&nodes, vec3::ZERO, &hurry, true);
        let (mut before, mut fastest, dt_s) = (script.target_m(), 0.0_f32, 1e-3);
        for _ in 0..(script.duration_s() / dt_s) as usize {
            script.advance(dt_s);
            fastest = fastest.max(vec3::distance(before, script.target_m()) / dt_s);
            before = script.target_m();
        }
        assert!(fastest > 0.95 * MAX_TARGET_SPEED_M_S && fastest < 1.02 * MAX_TARGET_SPEED_M_S, "{fastest}");
    }

    #[test]
    fn it_presses_below_and_grasps_and_pulls_above_the_surface() {
        let mut script = two_nodes();
        let (mut lowest, mut highest_held, mut button_seen_below) = (f32::INFINITY, 0.0_f32, false);
        for _ in 0..6_300 {
            let height = script.target_m()[0] - 0.05;
            lowest = lowest.min(height);
            if script.buttons() == GRASP_BUTTON {
                highest_held = highest_held.max(height);
                button_seen_below |= height < 0.0;
            }
            script.advance(1e-3);
        }
        assert!((lowest + 0.015).abs() < 1e-5, "{lowest}");
        assert!((highest_held - 0.022).abs() < 1e-5, "{highest_held}");
        assert!(!button_seen_below);
    }

    #[test]
    fn the_path_between_nodes_goes_round_the_middle() {
        let nodes = [([0.05, 0.0, 0.0], [1.0, 0.0, 0.0]), ([-0.05, 0.001, 0.0], [-1.0, 0.0, 0.0])];
        let mut script = Script::over_nodes(&nodes, vec3::ZERO, &StrokeConfig::default(), true);
        let mut nearest = f32::INFINITY;
        for _ in 0..14_000 {
            nearest = nearest.min(vec3::norm(script.target_m()));
            script.advance(1e-3);
        }
        assert!(nearest > 0.03, "{nearest}");
    }

    #[test]
    fn without_nodes_the_hand_stays() {
        let mut script = Script::over_nodes(&[], vec3::ZERO, &StrokeConfig::default(), true);
        script.advance(0.5);
        assert_eq!(script.target_m(), vec3::ZERO);
    }
}
