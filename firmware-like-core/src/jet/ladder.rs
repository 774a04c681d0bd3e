//! What happens to the force while the solver lags behind the tool.
//!
//! A clock runs while the force is extrapolated, another one while the solver is silent or gone; the longer one
//! counts. They have effect while the force is extrapolated or the solver is gone: a solver that is late by a
//! moment changes nothing inside the trust of its jets.
//!
//! - below 150 ms: nothing;
//! - from 150 ms: |h| does not exceed what it was then, and the tool is damped, h += b v with b = 2 N s/m;
//! - from 500 ms: the force falls to zero in 300 ms.
//!
//! When jets cover the tool again, its clock starts anew and the factor of the force rises to 1 in 300 ms. The
//! damping comes and goes over 50 ms, so that the force has no step.

use crate::guard::limit::clamp_force;
use crate::guard::velocity::AdaptiveWindow;
use crate::num::vec3::{self, Vec3};

/// Time until the force is held, us.
const HOLD_US: u64 = 150_000;
/// Time until the force fades out, us.
const FADE_US: u64 = 500_000;
/// Duration of the fade, and of the return, s.
const FADE_S: f32 = 0.3;
/// Damping of the tool while the force is held, N s/m.
const DAMPING_N_S_M: f32 = 2.0;
/// Time in which the damping comes and goes, s.
const DAMPING_RISE_S: f32 = 0.05;
/// Largest speed that is damped, m/s: the speed limit of a hand.
const MAX_SPEED_M_S: f32 = 2.0;
/// Error of the positions for the velocity, m: half an encoder count of the Falcon, as in the passivity
/// control.
const NOISE_M: f32 = 27e-6;

/// State of the solver as its heartbeat shows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Solver {
    /// It works.
    #[default]
    Alive,
    /// No heartbeat for a moment. Nothing changes inside the trust of the jets, but the time counts if it
    /// turns out to be gone.
    Silent,
    /// It has ended or hangs: the force fades out, and the controller latches [`crate::Fault::Solver`].
    Gone,
}

/// Size of the force when it was first held, and its factor then.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Held {
    size_n: f32,
    gain: f32,
}

/// State of the ladder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ladder {
    last_us: Option<u64>,
    /// Start of the present time without cover.
    uncovered_us: Option<u64>,
    /// Start of the present silence of the solver.
    silent_us: Option<u64>,
    held: Option<Held>,
    /// Factor of the force, without that of the fade.
    gain: f32,
    /// Factor of the fade; 1 before it.
    left: f32,
    /// Share of the damping.
    damped: f32,
    window: AdaptiveWindow,
}

impl Default for Ladder {
    fn default() -> Self {
        Self {
            last_us: None,
            uncovered_us: None,
            silent_us: None,
            held: None,
            gain: 1.0,
            left: 1.0,
            damped: 0.0,
            window: AdaptiveWindow::default(),
        }
    }
}

impl Ladder {
    /// The force for the tool, from the force of the jets.
    pub(super) fn apply(
        &mut self,
        (now_us, hip_m): (u64, Vec3),
        force_n: Vec3,
        is_covered: bool,
        solver: Solver,
    ) -> Vec3 {
        self.window.push(now_us, hip_m);
        let (clock_us, elapsed_s) = self.advance(now_us, is_covered, solver);
        let damping_step = elapsed_s / DAMPING_RISE_S;
        if clock_us.is_some_and(|clock_us| clock_us >= HOLD_US) {
            let size_n = vec3::norm(force_n);
            let gain = self.gain;
            let held = *self.held.get_or_insert(Held { size_n: gain * size_n, gain });
            let most = if size_n > held.size_n { held.size_n / size_n } else { 1.0 };
            self.gain = held.gain.min(most);
            self.damped = (self.damped + damping_step).min(self.left);
        } else {
            self.held = None;
            // While a clock has effect the factor does not rise.
            if clock_us.is_none() {
                self.gain = (self.gain + elapsed_s / FADE_S).min(1.0);
            }
            self.damped = (self.damped - damping_step).max(0.0);
        }
        let felt_n = vec3::scale(force_n, self.gain());
        if self.damped <= 0.0 {
            return felt_n;
        }
        let (velocity_m_s, _) = clamp_force(self.window.velocity_m_s(NOISE_M), MAX_SPEED_M_S);
        vec3::add(felt_n, vec3::scale(velocity_m_s, self.damped * DAMPING_N_S_M))
    }

    /// The tool touches nothing: a solver that is gone fades out all the same, and the rest is forgotten.
    pub(super) fn free(&mut self, now_us: u64, solver: Solver) {
        let Self { last_us, silent_us, left, .. } = *self;
        *self = Self { last_us, silent_us, left, ..Self::default() };
        self.advance(now_us, true, solver);
        self.gain = 1.0;
    }

    /// Factor of the force.
    pub(super) fn gain(&self) -> f32 {
        self.gain * self.left
    }

    /// Whether the force has faded out.
    pub(super) fn is_faded(&self) -> bool {
        self.left <= 0.0
    }

    /// Advances the clocks and the fade. Returns the clock while it has effect, and the time since the last
    /// tick.
    fn advance(&mut self, now_us: u64, is_covered: bool, solver: Solver) -> (Option<u64>, f32) {
        let elapsed_us = now_us.saturating_sub(self.last_us.replace(now_us).unwrap_or(now_us));
        let elapsed_s = elapsed_us as f32 * 1e-6;
        let is_alive = solver == Solver::Alive;
        self.uncovered_us = self.uncovered_us.or(Some(now_us)).filter(|_| !is_covered);
        self.silent_us = self.silent_us.or(Some(now_us)).filter(|_| !is_alive);
        let since_us = [self.uncovered_us, self.silent_us].into_iter().flatten().min();
        let since_us = since_us.filter(|_| !is_covered || solver == Solver::Gone);
        let clock_us = since_us.map(|since_us| now_us.saturating_sub(since_us));
        if clock_us.is_some_and(|clock_us| clock_us > FADE_US) {
            // A clock that gets effect late starts no step.
            let fading_s = clock_us.unwrap_or(0).saturating_sub(FADE_US) as f32 * 1e-6;
            self.left = (1.0 - fading_s / FADE_S).max(self.left - elapsed_s / FADE_S).max(0.0);
        } else {
            (self.gain, self.left) = (self.gain(), 1.0);
        }
        (clock_us, elapsed_s)
    }
}
