//! Maps over the skin: stiffness at rest, depth at a force, and whether an inclusion can be felt.
//!
//! At every place the tool pushes along the inward normal ([`Press`]). F is the normal force on the body of
//! the scene, F_0 that on the body with the surrounding material in the inclusion's place. The
//! *detectability* of the inclusion is
//!
//! D = |F(z) - F_0(z)| / max(w F_0(z), F_t),
//!
//! with the Weber fraction w and the detection threshold F_t, at the depth z where F is the wanted force or,
//! if it is not reached, at the end of the push. The inclusion can be felt where D > 1: a hand that pushes as
//! deep at a place without it notices the difference.

mod inclusion;
mod places;
mod press;
mod sweep;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

pub use inclusion::{Ball, Inclusion, InclusionError};
pub use places::{Place, Places, SURE_EDGE};
pub use press::{Goal, Press, Sample};
pub use sweep::{Sweep, SweepFound, SweepRow};

use crate::fem::{Body, SolveFailure, Solver};
use crate::num::parallel::{ThreadError, in_parallel};
use crate::scene::{BodyError, Problems, ResolvedScene};
use crate::spec::Tolerance;

/// Just noticeable difference of force. 7 % is that of fingers that squeeze with 2.5 to 10 N (Pang, Tan and
/// Durlach 1991); 0.02 N is about the smallest force that it notices.
pub const JND: Tolerance = Tolerance { relative: 0.07, absolute_n: 0.02 };

/// Why there is no map.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// The body cannot be built or has no rest state.
    #[error(transparent)]
    Body(#[from] BodyError),
    /// The inclusion cannot be examined.
    #[error(transparent)]
    Inclusion(#[from] InclusionError),
    /// The worker threads do not start.
    #[error(transparent)]
    Threads(#[from] ThreadError),
    /// The body at rest cannot be solved with the tool at a place.
    #[error("the body cannot be solved at rest with the tool at {0:?} m: {1}")]
    Rest([f64; 3], SolveFailure),
    /// The stop flag was raised.
    #[error("interrupted; nothing is written")]
    Interrupted,
}

/// How the work is done.
#[derive(Clone, Copy)]
pub struct Work<'s> {
    /// Number of threads; the results do not depend on it.
    pub threads: usize,
    /// Raised to end the work early.
    pub stop: &'s AtomicBool,
    /// Called with the number of finished items.
    pub done: &'s (dyn Fn(usize) + Sync),
}

impl Work<'_> {
    /// Results for all items, in order, or the first error in that order.
    fn all<I: Sync, T: Send>(
        &self,
        items: &[I],
        work: impl Fn(&I) -> Result<T, MapError> + Sync + Send,
    ) -> Result<Vec<T>, MapError> {
        let done = AtomicUsize::new(0);
        let results = in_parallel(items, self.threads, |item| {
            if self.stop.load(Ordering::Relaxed) {
                return Err(MapError::Interrupted);
            }
            let result = work(item);
            (self.done)(1 + done.fetch_add(1, Ordering::Relaxed));
            result
        })?;
        results.into_iter().collect()
    }
}

/// The forces with and without an inclusion at the same depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Compared {
    /// Depth, m.
    pub depth_m: f64,
    /// F, N.
    pub force_n: f64,
    /// F_0, N.
    pub without_n: f64,
    /// Stiffness at rest without the inclusion, N/m.
    pub stiffness_without_n_m: f64,
}

impl Compared {
    /// D for a just noticeable difference.
    pub fn detectability(&self, jnd: &Tolerance) -> f64 {
        (self.force_n - self.without_n).abs() / jnd.of_size(self.without_n)
    }
}

/// What a push at a place has found.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// The push on the body of the scene.
    pub press: Press,
    /// Depth at the wanted force, m; `None` if it is not reached.
    pub depth_m: Option<f64>,
    /// The comparison; `None` without an inclusion, or if no push of the other body reaches the depth.
    pub compared: Option<Compared>,
}

/// The body of a scene, or of a scene with and without an inclusion.
#[derive(Debug)]
pub struct Mapped {
    with: Problems,
    without: Option<Problems>,
}

impl Mapped {
    /// Builds the body of `scene`, and that of `without` if there is an inclusion.
    pub fn new(scene: &ResolvedScene, without: Option<&ResolvedScene>) -> Result<Self, BodyError> {
        let problems = |scene: &ResolvedScene| -> Result<Problems, BodyError> {
            let body: Arc<Body> = Arc::new(scene.body()?);
            Ok(scene.problems(&body))
        };
        Ok(Self { with: problems(scene)?, without: without.map(problems).transpose()? })
    }

    /// Pushes at one place.
    pub fn push(&self, place: &Place, goal: &Goal) -> Result<Found, MapError> {
        let no_rest = |failure| MapError::Rest(place.position_m, failure);
        let solver = |problems: &Problems| Solver::new(problems.of(&place.active));
        let press = Press::to(&mut solver(&self.with), place.inward, goal).map_err(no_rest)?;
        let depth_m = press.depth_at(goal.force_n);
        let compared = match &self.without {
            Some(problems) => {
                let other = Press::like(&mut solver(problems), place.inward, &press).ok();
                other.map(|other| {
                    let depth_m = depth_m.unwrap_or(press.end_m());
                    Compared {
                        depth_m,
                        force_n: press.force_n(depth_m),
                        without_n: other.force_n(depth_m),
                        stiffness_without_n_m: other.stiffness_n_m(),
                    }
                })
            }
            None => None,
        };
        Ok(Found { press, depth_m, compared })
    }

    /// Pushes at all places.
    pub fn all(&self, places: &[Place], goal: &Goal, work: Work<'_>) -> Result<Vec<Found>, MapError> {
        work.all(places, |place| self.push(place, goal))
    }
}

#[cfg(test)]
mod tests;
