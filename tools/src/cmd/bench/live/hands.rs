//! Scripted hands: what a person does with one place of the skin.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use palpate_precompute::num::{SPLIT_MIX_STEP, split_mix, unit_interval};

type V = Vector3<f64>;

/// Amplitude of the tremor, m, and its lowest frequency, Hz.
const TREMOR_M: f64 = 0.3e-3;
const TREMOR_HZ: f64 = 8.0;
/// Radius of the circle, m.
const CIRCLE_M: f64 = 8e-3;
/// Depth and reach of the drag, m.
const DRAG_M: [f64; 2] = [8e-3, 30e-3];

/// One hand: the control in every millisecond, and the parts that end where they began.
#[derive(Debug, Clone)]
pub(super) struct Hand {
    pub(super) name: &'static str,
    pub(super) control_m: Vec<V>,
    pub(super) loops: Vec<(usize, usize)>,
}

/// Directions and depth of the hands.
#[derive(Debug)]
pub(super) struct Hands {
    origin_m: V,
    inwards: V,
    across: [V; 2],
    depth_m: f64,
}

impl Hands {
    /// Of a place with this normal, where the control is `origin_m`.
    pub(super) fn new(normal: [f64; 3], origin_m: [f64; 3], depth_m: f64) -> Self {
        let inwards = -V::from(normal);
        let other = if inwards.x.abs() < 0.7 { V::x() } else { V::y() };
        let one = (other - inwards * inwards.dot(&other)).normalize();
        Self { origin_m: origin_m.into(), inwards, across: [one, inwards.cross(&one)], depth_m }
    }

    /// The hands with these names, or all.
    pub(super) fn all(&self, names: &[String]) -> Vec<Hand> {
        let slow = [("press10", 0.01), ("press20", 0.02), ("press30", 0.03)];
        let fast = [("press50", 0.05), ("press100", 0.1), ("press200", 0.2)];
        let presses = slow.into_iter().chain(fast).map(|(name, speed)| self.press(name, speed));
        let mut all: Vec<Hand> = presses.chain([self.circle(), self.poke(), self.drag()]).collect();
        all.retain(|hand| names.is_empty() || names.iter().any(|name| name == hand.name));
        all.iter_mut().flat_map(|hand| &mut hand.control_m).for_each(|d| *d += self.origin_m);
        all
    }

    /// In and out, twice, leaning to different sides.
    fn press(&self, name: &'static str, m_s: f64) -> Hand {
        let [a, b] = self.across;
        let lean = |by: V| (self.inwards + by).normalize() * self.depth_m;
        let rest = V::zeros();
        let stops = [rest, lean(0.2 * a), rest, lean(0.25 * b - 0.1 * a), rest];
        let stops = if m_s < 0.03 { &stops[..3] } else { &stops[..] };
        Self::with_tremor(name, moves(stops, m_s, 150))
    }

    fn circle(&self) -> Hand {
        let [a, b] = self.across;
        let deep = self.inwards * (0.6 * self.depth_m);
        let mut control_m = moves(&[V::zeros(), deep + a * CIRCLE_M], 0.06, 50);
        let start = control_m.len() - 1;
        control_m.extend((1..=3000).map(|ms| {
            let angle = TAU * f64::from(ms) / 1000.0;
            deep + CIRCLE_M * (a * libm::cos(angle) + b * libm::sin(angle))
        }));
        let loops = (0..3).map(|turn| (start + 1000 * turn, start + 1000 * (turn + 1))).collect();
        Hand { name: "circle", control_m, loops }
    }

    fn poke(&self) -> Hand {
        let (rest, deep) = (V::zeros(), 0.8 * self.depth_m);
        let aside = (self.inwards + 0.3 * self.across[1]).normalize() * deep;
        Self::with_tremor("poke", moves(&[rest, self.inwards * deep, rest, aside, rest], 0.3, 80))
    }

    fn drag(&self) -> Hand {
        let [depth_m, reach_m] = DRAG_M;
        let deep = self.inwards * depth_m;
        let side = self.across[1] * reach_m;
        let mut control_m = moves(&[V::zeros(), deep], 0.06, 20);
        control_m.extend(moves(&[deep, deep + side, deep - side, deep], 0.1, 50));
        Hand { loops: Vec::new(), ..Self::with_tremor("drag", control_m) }
    }

    /// The whole way is one loop.
    fn with_tremor(name: &'static str, mut control_m: Vec<V>) -> Hand {
        tremor(&mut control_m);
        let end = control_m.len() - 1;
        Hand { name, control_m, loops: vec![(0, end)] }
    }
}

/// Minimum-jerk moves between stops with this peak speed, and a pause at each, ms.
pub(in crate::cmd::bench) fn moves(stops: &[V], m_s: f64, pause: usize) -> Vec<V> {
    let mut way = vec![stops[0]];
    for ends in stops.windows(2) {
        let step = ends[1] - ends[0];
        let ms = (1.875 * step.norm() / m_s * 1e3).ceil().max(1.0) as usize;
        way.extend((1..=ms).map(|k| {
            let s = k as f64 / ms as f64;
            ends[0] + step * (s * s * s * (10.0 - 15.0 * s + 6.0 * s * s))
        }));
        way.extend(std::iter::repeat_n(ends[1], pause));
    }
    way
}

/// Three waves of 8 to 13 Hz in different directions, the same in every run.
pub(in crate::cmd::bench) fn tremor(way: &mut [V]) {
    let mut state = 7u64;
    let mut random = || {
        state = state.wrapping_add(SPLIT_MIX_STEP);
        unit_interval(split_mix(state))
    };
    let waves: Vec<(f64, V, f64)> = (0..3)
        .map(|k| {
            let along = V::from_fn(|_, _| 2.0 * random() - 1.0).normalize() * (TREMOR_M / 1.7);
            (TREMOR_HZ + 2.0 * f64::from(k) + random(), along, TAU * random())
        })
        .collect();
    for (ms, d) in way.iter_mut().enumerate() {
        let t = ms as f64 * 1e-3;
        for (hz, along, phase) in &waves {
            *d += along * ((10.0 * t).min(1.0) * libm::sin(TAU * hz * t + phase));
        }
    }
}
