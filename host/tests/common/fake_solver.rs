//! A solver without finite elements: jets of an analytic energy. Included by path.
//!
//! W = k |d|^2 / 2 (1 + |d|^2 / (2 l^2)) at every contact, so h = k d (1 + |d|^2 / l^2).
#![allow(dead_code)]

use core::time::Duration;
use palpate_core::{Jet, JetFlags, Vec3, vec3};
use palpate_host::live::{Hand, SolverEnd, Work};

/// Stiffness at rest, N/m.
pub(crate) const STIFFNESS_N_M: f32 = 250.0;
/// Displacement at which the secant stiffness is doubled, m.
pub(crate) const HARDENING_M: f32 = 0.04;
/// Trust radius of every jet, m.
pub(crate) const TRUST_M: f32 = 0.006;
/// How far ahead the position is predicted, s.
const AHEAD_S: f32 = 0.005;
/// A position with a jet so near is known, m.
const KNOWN_M: f32 = 0.4 * TRUST_M;

/// h at a displacement, N.
pub(crate) fn force_n(d: Vec3) -> Vec3 {
    vec3::scale(d, STIFFNESS_N_M * (1.0 + vec3::dot(d, d) / (HARDENING_M * HARDENING_M)))
}

/// The jet at a displacement.
pub(crate) fn jet(contact: u16, sequence: u32, d: Vec3) -> Jet {
    let (k, l2) = (STIFFNESS_N_M, HARDENING_M * HARDENING_M);
    let same = |i: usize, j: usize| if i == j { 1.0 } else { 0.0 };
    let secant = k * (1.0 + vec3::dot(d, d) / l2);
    let stiffness = |i: usize, j: usize| secant * same(i, j) + 2.0 * k / l2 * d[i] * d[j];
    let third =
        |[i, j, m]: [usize; 3]| 2.0 * k / l2 * (d[m] * same(i, j) + d[i] * same(j, m) + d[j] * same(i, m));
    const PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
    const TRIPLES: [[usize; 3]; 10] = [
        [0, 0, 0],
        [0, 0, 1],
        [0, 0, 2],
        [0, 1, 1],
        [0, 1, 2],
        [0, 2, 2],
        [1, 1, 1],
        [1, 1, 2],
        [1, 2, 2],
        [2, 2, 2],
    ];
    Jet {
        contact,
        sequence,
        flags: JetFlags { joined: true, ..JetFlags::default() },
        control_m: d,
        energy_j: 0.5 * k * vec3::dot(d, d) * (1.0 + 0.5 * vec3::dot(d, d) / l2),
        force_n: force_n(d),
        stiffness_n_m: PAIRS.map(|(i, j)| stiffness(i, j)),
        third_n_m2: TRIPLES.map(third),
        trust_m: TRUST_M,
        coupling: None,
        model: 0,
    }
}

/// Sends a jet wherever the hand is, or heads for, and none is near.
#[derive(Debug)]
pub(crate) struct FakeSolver {
    pub(crate) end: SolverEnd,
    known: Vec<(u16, Vec3)>,
    waiting: Vec<(u16, Vec3)>,
    pub(crate) sent: u32,
}

impl FakeSolver {
    /// Begins with the rest jets of all contacts.
    pub(crate) fn new(end: SolverEnd, contacts: u16) -> Self {
        let waiting = (0..contacts).map(|contact| (contact, vec3::ZERO)).collect();
        Self { end, known: Vec::new(), waiting, sent: 0 }
    }

    /// One turn: beats, and sends what is wanted and has room. Returns the hand.
    pub(crate) fn turn(&mut self, now_ns: u64) -> Hand {
        self.end.heart().beat(now_ns);
        let hand = self.end.hand();
        let ahead_m = vec3::add(hand.displacement_m, vec3::scale(hand.velocity_m_s, AHEAD_S));
        for at in hand.engaged.iter().filter(|at| at.weight > 0.0) {
            for target_m in [hand.displacement_m, ahead_m] {
                let is_near = |(contact, d): &(u16, Vec3)| {
                    *contact == at.space && vec3::distance(*d, target_m) < KNOWN_M
                };
                if !self.known.iter().chain(&self.waiting).any(is_near) {
                    self.waiting.push((at.space, target_m));
                }
            }
        }
        self.end.set_work(if self.waiting.is_empty() { Work::Idle } else { Work::Solving });
        while let Some((contact, d)) = self.waiting.first().copied() {
            if !self.end.try_send(&jet(contact, self.sent + 1, d)) {
                break;
            }
            self.sent += 1;
            self.known.push(self.waiting.remove(0));
        }
        hand
    }

    /// Turns until the session ends.
    pub(crate) fn run(&mut self, now_ns: impl Fn() -> u64) {
        while !self.end.has_session_ended() {
            self.turn(now_ns());
            std::thread::sleep(Duration::from_micros(500));
        }
    }
}
