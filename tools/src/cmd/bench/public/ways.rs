//! Ways of the tool: hands and closed loops that keep the tool in contact and within the solved ball.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use palpate_precompute::num::{SPLIT_MIX_STEP, split_mix, unit_interval};

use super::questions::Way;
use crate::cmd::bench::live::hands::{moves, tremor};

type V = Vector3<f64>;

/// Depth at which every way begins and ends, in radii of the ball: the tool of a finger only pushes.
const FIRST: f64 = 0.15;
/// Middle of the loops, their distance from the axis of the push, and their radius, in radii of the ball.
const MIDDLE: f64 = 0.5;
const ASIDE: f64 = 0.2;
const LOOP: f64 = 0.2;
/// Ticks of the way to a loop, and of its rest there.
const LEAD_MS: usize = 300;
const REST_MS: usize = 100;
/// Ticks of a loop.
const LOOP_MS: usize = 1000;

/// The frame of a place of the skin, and the radius of the solved ball.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    inwards: V,
    across: [V; 2],
    radius_m: f64,
}

impl Frame {
    /// Of a place with this outward normal.
    pub(super) fn new(normal: [f64; 3], radius_m: f64) -> Self {
        let inwards = -V::from(normal).normalize();
        let other = if inwards.x.abs() < 0.7 { V::x() } else { V::y() };
        let one = (other - inwards * inwards.dot(&other)).normalize();
        Self { inwards, across: [one, inwards.cross(&one)], radius_m }
    }

    fn at(&self, depth: f64, aside: [f64; 2]) -> V {
        self.radius_m * (depth * self.inwards + aside[0] * self.across[0] + aside[1] * self.across[1])
    }

    /// A press, a poke and a slide, with the tremor of a hand.
    pub(super) fn hands(&self) -> Vec<Way> {
        let rest = self.at(FIRST, [0.0; 2]);
        let press = [rest, self.at(0.7, [0.14, 0.0]), rest, self.at(0.65, [-0.1, 0.16]), rest];
        let poke = [rest, self.at(0.8, [0.0; 2]), rest, self.at(0.72, [0.0, 0.22]), rest];
        let deep = self.at(0.5, [0.0; 2]);
        let slide = [rest, deep, self.at(0.5, [0.0, 0.6]), self.at(0.5, [0.0, -0.6]), deep, rest];
        [("press", &press[..], 0.05, 150), ("poke", &poke, 0.3, 80), ("slide", &slide, 0.1, 50)]
            .into_iter()
            .map(|(name, stops, m_s, pause)| {
                let mut way = moves(stops, m_s, pause);
                tremor(&mut way);
                finished(name.into(), 0, &way)
            })
            .collect()
    }

    /// Circles of random position and axis, once round in a second.
    pub(super) fn loops(&self, count: usize, seed: u64) -> Vec<Way> {
        let mut state = seed;
        let mut random = || {
            state = state.wrapping_add(SPLIT_MIX_STEP);
            2.0 * unit_interval(split_mix(state)) - 1.0
        };
        let mut direction = move || loop {
            let v = V::new(random(), random(), random());
            if (0.1..=1.0).contains(&v.norm()) {
                return v;
            }
        };
        let circle = |number: usize| {
            let (place, axis) = (direction(), direction().normalize());
            let middle = self.at(MIDDLE, [ASIDE * place.x, ASIDE * place.y]);
            let u = axis.cross(&if axis.x.abs() < 0.7 { V::x() } else { V::y() }).normalize();
            let v = axis.cross(&u);
            let round = |ms: usize| {
                let angle = TAU * (ms % LOOP_MS) as f64 / LOOP_MS as f64;
                middle + LOOP * self.radius_m * (u * libm::cos(angle) + v * libm::sin(angle))
            };
            let (from, to) = (self.at(FIRST, [0.0; 2]), round(0));
            let peak_m_s = 1.875 * (to - from).norm() / (1e-3 * LEAD_MS as f64);
            let mut way = moves(&[from, to], peak_m_s, REST_MS);
            let lead = way.len() - 1;
            way.extend((1..=LOOP_MS).map(round));
            finished(format!("loop-{number}"), lead, &way)
        };
        (1..=count).map(circle).collect()
    }
}

/// The way of these places, rounded to f32 as the tables take them, so that every system is asked the same.
fn finished(name: String, counted_from: usize, way: &[V]) -> Way {
    let displacement_m: Vec<[f64; 3]> =
        way.iter().map(|d| <[f64; 3]>::from(*d).map(|x| f64::from(x as f32))).collect();
    Way { name, counted_from, truth_n: vec![None; displacement_m.len()], displacement_m }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ways_push_stay_in_the_ball_and_loops_are_closed() {
        let (normal, radius_m) = ([0.6, 0.0, 0.8], 0.02);
        let frame = Frame::new(normal, radius_m);
        let (hands, loops) = (frame.hands(), frame.loops(20, 1));
        assert_eq!((hands.len(), loops.len()), (3, 20));
        for way in hands.iter().chain(&loops) {
            for d in &way.displacement_m {
                let d = V::from(*d);
                assert!(d.norm() < 0.97 * radius_m, "{}: {} m", way.name, d.norm());
                assert!(d.dot(&V::from(normal)) < 0.0, "{} pulls", way.name);
            }
            let steps = way.displacement_m.windows(2).map(|w| (V::from(w[1]) - V::from(w[0])).norm());
            assert!(steps.fold(0.0, f64::max) < 0.4e-3, "{} jumps", way.name);
        }
        for way in &loops {
            let counted = &way.displacement_m[way.counted_from..];
            assert_eq!(counted.len(), LOOP_MS + 1);
            assert_eq!(counted.first(), counted.last(), "{} is not closed", way.name);
        }
        assert_eq!(frame.loops(3, 1), loops[..3], "the first loops do not depend on their number");
        assert_ne!(frame.loops(3, 2), loops[..3]);
    }
}
