//! One tick of the haptic loop: (config, &mut state, now, sample) -> command.
//!
//! Time is an argument; nothing is allocated or locked, and every loop is bounded. For any input the command
//! is finite and its force within the limit. After a fault the force is zero at once, regardless of the slew
//! limit, until [`State::reset`] and [`State::arm`]. Zero force is the safe state.

mod config;
mod state;

pub use config::{Config, ControllerError};
pub use state::{Command, Fault, Phase, Sample, State};

use crate::blob::format::Sphere;
use crate::blob::{Limits, Organ};
use crate::field::{Field, Packed, Touch};
use crate::guard::limit::{self, Freshness, StaleWatch};
use crate::guard::passivity::NotPassive;
use crate::guard::speed::SpeedWindow;
use crate::guard::stiffness;
use crate::method::ForceSample;
use crate::num::vec3::{self, Vec3};
use crate::space::Space;
use crate::touch::approach::Approach;
use crate::touch::contact::{Contact, ContactKind, Engaged, blended_slope_n};
use crate::touch::grip::Pressed;
use crate::touch::{NodeWeight, TouchSurface};

/// A sphere is engaged within this share of its reach from the surface of the first touch.
const BESIDE_FIRST_TOUCH: f32 = 0.25;
/// A sphere that presses with no more than this has left the body, N.
const LEFT_N: f32 = 1e-3;
/// A sphere presses at most so far, metres: the bound of the energy that it stores.
const SPHERE_DEPTH_M: f32 = 0.05;
/// Time in which a new stiffness lowers the force from all to nothing, s.
const SCALE_S: f32 = 0.05;
/// Largest duration of a tick that the slew limit uses: a late tick does not permit a large step.
const MAX_SLEW_TIME_US: u64 = 2_000;

/// An organ with the settings of its controller.
#[derive(Debug, Clone, Copy)]
pub struct Controller<'o, 'a, const N: usize = { Limits::PC.spaces }> {
    organ: &'o Organ<'a, N>,
    surface: Option<TouchSurface<'o>>,
    config: Config,
    stiffest_n_m: f32,
    hand_scale: f32,
}

impl<'o, 'a, const N: usize> Controller<'o, 'a, N> {
    /// Checks the settings and finds the largest stiffness of the organ.
    ///
    /// Contact is with the planes of the active nodes until [`Controller::on_surface`] is called.
    ///
    /// Without a method the force comes from jets ([`Controller::tick_on`]): no table is needed, and the stiffness
    /// that limits the force is that of the jets so far.
    ///
    /// Errors: [`ControllerError`] if a number is out of range, or if a space has no table for the method.
    pub fn new(organ: &'o Organ<'a, N>, config: Config) -> Result<Self, ControllerError> {
        config.check()?;
        let Config { method, limits, .. } = config;
        let Some(method) = method else {
            return Ok(Self { organ, surface: None, config, stiffest_n_m: 0.0, hand_scale: 1.0 });
        };
        if let Some((space, _)) = (0..u16::MAX).zip(&organ.spaces).find(|(_, space)| !space.has(method)) {
            return Err(ControllerError::MissingMethod { method, space });
        }
        let is_limited = limits.max_stiffness_n_m.is_finite();
        let spaces = if is_limited { organ.spaces.as_slice() } else { &[] };
        let (stiffest_n_m, hand_scale) =
            stiffness::hand_scale(spaces, method, limits.max_stiffness_n_m, limits.max_force_n);
        Ok(Self { organ, surface: None, config, stiffest_n_m, hand_scale })
    }

    /// Uses the surface of the organ for contact instead of the planes of its nodes.
    #[must_use]
    pub const fn on_surface(self, surface: Option<TouchSurface<'o>>) -> Self {
        Self { surface, ..self }
    }

    /// Largest stiffness of the organ, N/m before the workspace scale; 0 if the settings have no limit.
    pub const fn stiffest_n_m(&self) -> f32 {
        self.stiffest_n_m
    }

    /// The factor that scales all forces for the hand to keep the stiffness within the limit; 1 if not
    /// needed.
    pub const fn hand_scale(&self) -> f32 {
        self.hand_scale
    }

    /// The organ.
    pub const fn organ(&self) -> &'o Organ<'a, N> {
        self.organ
    }

    /// The settings.
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// One tick: computes the force to send to the hand now.
    ///
    /// `sample` is the newest reading, or `None` if there is none since the last tick. `now_us` must not
    /// decrease.
    pub fn tick(&self, state: &mut State, now_us: u64, sample: Option<&Sample>) -> Command {
        self.tick_with(state, now_us, sample, |space, displacement_m| {
            space.force(self.config.method?, *displacement_m)
        })
    }

    /// [`Controller::tick`] with the caller's evaluation of [`Space::force`] for the configured method, for
    /// example with the vector instructions of this machine.
    pub fn tick_with(
        &self,
        state: &mut State,
        now_us: u64,
        sample: Option<&Sample>,
        force: impl Fn(&Space<'_>, &Vec3) -> Option<ForceSample>,
    ) -> Command {
        let mut tables = Packed { organ: self.organ, method: self.config.method, evaluate: force };
        self.tick_on(state, now_us, sample, &mut tables)
    }

    /// [`Controller::tick`] with the force of a field, for example the jets of a live solver
    /// ([`crate::JetMemory`]).
    pub fn tick_on(
        &self,
        state: &mut State,
        now_us: u64,
        sample: Option<&Sample>,
        field: &mut (impl Field + ?Sized),
    ) -> Command {
        let command = match state.phase {
            Phase::Active => match self.render(state, now_us, sample, field) {
                Ok(command) => command,
                Err(fault) => {
                    state.enter(Phase::SafeZero(fault));
                    state.last
                }
            },
            phase => {
                field.released(now_us);
                let seen_m = sample.map(|sample| sample.position_m).filter(|&hip_m| vec3::is_finite(hip_m));
                Command::zero(phase, seen_m.unwrap_or(state.last.hip_m))
            }
        };
        state.now_us = Some(now_us);
        state.last = command;
        command
    }

    fn render(
        &self,
        state: &mut State,
        now_us: u64,
        sample: Option<&Sample>,
        field: &mut (impl Field + ?Sized),
    ) -> Result<Command, Fault> {
        let limits = &self.config.limits;
        let before_us = state.now_us.unwrap_or(now_us);
        let elapsed_us = now_us.checked_sub(before_us).ok_or(Fault::Internal)?;
        // The device transfer that read this sample also sent the force of the last tick.
        state.passivity.sent(now_us, state.rendered_n);
        let armed_us = match state.armed_us {
            Some(armed_us) => armed_us,
            None => {
                state.stale = StaleWatch::new(now_us);
                *state.armed_us.insert(now_us)
            }
        };
        let fresh = match (state.stale.judge(limits, now_us, sample.map(|sample| sample.t_us)), sample) {
            (Freshness::Fresh, Some(sample)) => sample,
            (Freshness::Fresh | Freshness::RepeatLast, _) => return Ok(state.last),
            (Freshness::SendZero, _) => {
                (state.rendered_n, state.carried) = (vec3::ZERO, 0.0);
                return Ok(Command { hand_force_n: vec3::ZERO, ..state.last });
            }
            (Freshness::Fault, _) => return Err(Fault::Stale),
        };
        self.check_motion(&mut state.speed, fresh)?;
        let stored_j = state.contact.is_engaged().then(|| self.max_stored_j(state));
        let at = (fresh.t_us, fresh.position_m);
        let damping_n = state.passivity.observe(&self.config.passivity, at, stored_j);
        let damping_n = damping_n.map_err(|NotPassive| Fault::Energy)?;

        let model = self.reaction(&mut state.contact, (now_us, fresh), field)?;
        let ramp = limit::ramp(now_us.saturating_sub(armed_us), limits.ramp_s);
        let elapsed_s = elapsed_us.min(MAX_SLEW_TIME_US) as f32 * 1e-6;
        let reached_n = limits.max_force_n / state.scale.unwrap_or(1.0).max(f32::MIN_POSITIVE);
        let scale = self.scale(field.stiffest_n_m(reached_n), state, &model, elapsed_s);
        let capped_n = vec3::scale(model.reaction_n, -scale);
        let (clamped_n, clamped) = limit::clamp_force(capped_n, limits.max_force_n);
        let wanted_n = vec3::add(vec3::scale(clamped_n, ramp), damping_n);
        // A release, a lost grasp or another organ starts a transition from the last force for the hand.
        if state.handed_over || (model.engaged.is_none() && state.last.engaged.is_some()) {
            state.fade.begin(now_us, vec3::sub(state.rendered_n, wanted_n));
            state.handed_over = false;
        }
        let smooth_n = vec3::add(wanted_n, state.fade.remaining_n(now_us, limits.fade_s));
        let slewed_n = limit::slew(state.rendered_n, smooth_n, limits.max_slew_n_per_s * elapsed_s);
        let weight_n = self.weight_n(&mut state.carried, elapsed_s);
        // Damping, fade and weight can carry the force beyond the limit; this clamp enforces it.
        let sum_n = if weight_n == vec3::ZERO { slewed_n } else { vec3::add(slewed_n, weight_n) };
        let (hand_force_n, _) = limit::clamp_force(sum_n, limits.max_force_n);
        state.rendered_n = vec3::sub(hand_force_n, weight_n);
        let (hand_work_j, damped) = (state.passivity.work_j(), damping_n != vec3::ZERO);
        Ok(Command { hand_force_n, clamped, hand_work_j, damped, ramp, ..model })
    }

    /// The factor of the force that keeps the stiffness within the limit. A field that learns of a greater stiffness
    /// lowers it in time while the tool touches.
    fn scale(&self, stiffest_n_m: f32, state: &mut State, now: &Command, elapsed_s: f32) -> f32 {
        let limit_n_m = self.config.limits.max_stiffness_n_m;
        let wanted = (limit_n_m / stiffest_n_m.max(f32::MIN_POSITIVE)).min(1.0);
        let step = elapsed_s / SCALE_S;
        let scale = match state.scale.filter(|_| now.engaged.is_some()) {
            // The controller has found the stiffness of tables at the start.
            _ if stiffest_n_m <= 0.0 => self.hand_scale,
            Some(before) if wanted < before => (before - step).max(wanted).max(self.least_scale(
                before,
                state.last.reaction_n,
                now.reaction_n,
            )),
            Some(before) => before + (wanted - before).min(step),
            None => wanted,
        };
        state.scale = Some(scale);
        scale
    }

    /// The factor below which the hand would feel a force of the body that rises as one that falls: a hand that presses
    /// deeper would fall into the body. At most the present factor.
    #[inline(never)]
    fn least_scale(&self, scale: f32, before_n: Vec3, now_n: Vec3) -> f32 {
        let (before_n, now_n) = (vec3::norm(before_n), vec3::norm(now_n));
        let felt_n = (scale * before_n).min(self.config.limits.max_force_n);
        if now_n > before_n { felt_n / now_n } else { 0.0 }
    }

    /// The compensation of the handle's weight in this tick.
    fn weight_n(&self, carried: &mut f32, elapsed_s: f32) -> Vec3 {
        let rise_s = self.config.limits.ramp_s;
        *carried = if *carried * rise_s + elapsed_s < rise_s { *carried + elapsed_s / rise_s } else { 1.0 };
        vec3::scale(self.config.gravity_compensation_n, *carried)
    }

    /// Upper bound of the energy stored in the body, J, with the force for the hand and the path of the
    /// device: |h| |d|. It holds for any force that increases with the displacement; a linear spring stores
    /// half of it.
    fn max_stored_j(&self, state: &State) -> f32 {
        let felt_n = state.scale.unwrap_or(self.hand_scale) * vec3::norm(state.last.reaction_n);
        // The displacement of a sphere begins beside the body.
        let most_m = if self.organ.tool.sphere().is_some() { SPHERE_DEPTH_M } else { f32::INFINITY };
        felt_n * vec3::norm(state.last.displacement_m).min(most_m) / self.config.passivity.workspace_scale
    }

    /// Detects positions that a hand cannot reach.
    fn check_motion(&self, speed: &mut SpeedWindow, sample: &Sample) -> Result<(), Fault> {
        let limits = &self.config.limits;
        if !vec3::is_finite(sample.position_m) || !sample.orientation.is_rotation() {
            return Err(Fault::NotFinite);
        }
        if vec3::max_abs(sample.position_m) > limits.max_position_m {
            return Err(Fault::Workspace);
        }
        if speed.speed_m_s(sample.t_us, sample.position_m) > limits.max_speed_m_s {
            return Err(Fault::Overspeed);
        }
        Ok(())
    }

    /// Contact and force of the model for one sample, before any limit.
    fn reaction(
        &self,
        contact: &mut Contact,
        (now_us, sample): (u64, &Sample),
        field: &mut (impl Field + ?Sized),
    ) -> Result<Command, Fault> {
        let (config, spaces) = (&self.config.contact, &self.organ.spaces);
        let (surface, hip_m) = (self.surface.as_ref(), sample.position_m);
        let half_axis_m = self.organ.tool.half_axis_m().map(|half_m| sample.orientation.turn(half_m));
        let was_engaged = contact.is_engaged();
        let at = match self.organ.tool.sphere() {
            Some(sphere) => contact.follow(spaces, surface, &self.approach(sphere, hip_m, half_axis_m)),
            None => contact.update(config, spaces, surface, hip_m, sample.buttons),
        };
        let Some(at) = at else {
            return untouched(field, now_us, hip_m);
        };
        let displacement_m = vec3::sub(hip_m, at.anchor_m);
        let touch = Touch { now_us, weights: at.weights, displacement_m, hip_m, half_axis_m };
        let mut answer = field.force(&touch).ok_or(Fault::Internal)?;
        if at.kind == ContactKind::Sphere {
            let slope_n = self.blended_slope_n(&at, hip_m, field).ok_or(Fault::Internal)?;
            answer.force_n = vec3::add(answer.force_n, slope_n);
        }
        // A sphere that starts inside the body touches nothing until it has left it.
        let starts_inside = at.kind == ContactKind::Sphere
            && at.foot.is_some()
            && !was_engaged
            && answer.force_n != vec3::ZERO;
        if starts_inside || self.is_released(&at, &touch, answer.force_n) {
            contact.release(hip_m);
            return untouched(field, now_us, hip_m);
        }
        if field.is_lost() {
            return Err(Fault::Solver);
        }
        if at.kind == ContactKind::Sphere && config.friction > 0.0 {
            let energy_j = self.blended_energy_j(&at, hip_m, field).ok_or(Fault::Internal)?;
            let stiffest_n_m = self.config.limits.max_stiffness_n_m;
            let by = Pressed { force_n: answer.force_n, energy_j, stiffest_n_m };
            let friction_n = contact.friction_n(config, hip_m, by);
            answer.force_n = vec3::add(answer.force_n, friction_n);
        }
        if field.slips() {
            let energy_j = |space: u16| field.energy_j(space, displacement_m);
            contact.slip(config, spaces, surface, (displacement_m, answer.force_n), energy_j);
        }
        Ok(Command {
            reaction_n: answer.force_n,
            reaction_n_m: half_axis_m.map_or(vec3::ZERO, |half_m| vec3::cross(half_m, field.turning_n())),
            displacement_m,
            engaged: Some(at.main_space()),
            weights: at.weights,
            coverage: Some(answer.coverage),
            ..Command::zero(Phase::Active, hip_m)
        })
    }

    /// W of a sphere in one space, joules.
    fn sphere_energy_j(&self, space: u16, hip_m: Vec3, field: &(impl Field + ?Sized)) -> Option<f32> {
        let origin_m = self.organ.spaces.get(usize::from(space))?.active.rest_position_m;
        field.energy_j(space, vec3::sub(hip_m, origin_m))
    }

    /// sum W_i grad w_i of a sphere; zero in a live field, whose weights do not change.
    fn blended_slope_n(&self, at: &Engaged, hip_m: Vec3, field: &(impl Field + ?Sized)) -> Option<Vec3> {
        let (Some(foot), Some(surface)) = (&at.foot, &self.surface) else { return Some(vec3::ZERO) };
        blended_slope_n(surface, at, foot, |space| self.sphere_energy_j(space, hip_m, field))
    }

    /// sum w_i W_i of a sphere.
    #[inline(never)]
    fn blended_energy_j(&self, at: &Engaged, hip_m: Vec3, field: &(impl Field + ?Sized)) -> Option<f32> {
        let mut sum_j = 0.0;
        for node in at.weights.iter().filter(|node| node.weight > 0.0) {
            sum_j += node.weight * self.sphere_energy_j(node.space, hip_m, field)?;
        }
        Some(sum_j)
    }

    /// Where a sphere or capsule is. It is engaged within its reach of the skin, or a small part of that of the surface of the
    /// first touch.
    fn approach(&self, sphere: Sphere, hip_m: Vec3, half_axis_m: Option<Vec3>) -> Approach {
        let is_of_contacts = self.surface.is_some_and(|surface| surface.is_of_contacts);
        let share = if is_of_contacts { BESIDE_FIRST_TOUCH } else { 1.0 };
        let half_m = half_axis_m.unwrap_or(vec3::ZERO);
        Approach { centre_m: hip_m, half_m, within_m: share * sphere.reach_m() }
    }

    /// Whether a sphere touches nothing, and is not within the distance at which it is engaged. The fade between two jets
    /// comes near to zero and does not reach it.
    #[inline(never)]
    fn has_left(&self, touch: &Touch, reaction_n: Vec3) -> bool {
        let (Some(sphere), Some(surface)) = (self.organ.tool.sphere(), &self.surface) else { return true };
        vec3::norm(reaction_n) <= LEFT_N
            && !surface.is_near(&self.approach(sphere, touch.hip_m, touch.half_axis_m))
    }

    /// Whether the model would pull a pushing tool, or a grasp exceeds its largest distance or force, or a sphere has
    /// left the body.
    ///
    /// h . n is negative while the tool presses; a pushing tool cannot pull tissue.
    fn is_released(&self, at: &Engaged, touch: &Touch, reaction_n: Vec3) -> bool {
        let Config { contact, limits, .. } = &self.config;
        match at.kind {
            ContactKind::Push => vec3::dot(reaction_n, at.normal) > contact.release_tension_n,
            ContactKind::Sphere => self.has_left(touch, reaction_n),
            ContactKind::Grasp => {
                let radius_m = |node: &NodeWeight| {
                    let space = self.organ.spaces.get(usize::from(node.space));
                    space.map_or(0.0, |space| space.lattice().radius_m())
                };
                let held = at.weights.iter().filter(|node| node.weight > 0.0);
                let reach_m = contact.grasp_slip * held.map(radius_m).fold(f32::INFINITY, f32::min);
                let strength_n = contact.grasp_slip * limits.max_force_n;
                vec3::norm(touch.displacement_m) > reach_m
                    || vec3::norm(reaction_n) * self.hand_scale > strength_n
            }
        }
    }
}

/// The command of a tick without contact.
fn untouched(field: &mut (impl Field + ?Sized), now_us: u64, hip_m: Vec3) -> Result<Command, Fault> {
    field.released(now_us);
    if field.is_lost() { Err(Fault::Solver) } else { Ok(Command::zero(Phase::Active, hip_m)) }
}
