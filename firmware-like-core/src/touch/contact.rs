//! Which active nodes the tool holds: engage, slide, release.
//!
//! A space defines the force for a displacement of its node, but not whether the tool touches it. The tool is
//! one point, the HIP. It engages where its path passes through the surface of the organ at rest, or without
//! a surface through the plane of the nearest node. While engaged, the displacement is measured from the
//! anchor, the position of the HIP at first touch. Thus every touch starts at d = 0 and without force, at any
//! point of a triangle.
//!
//! - **Snap** (Peterlik 2010): the nearest active node is held, and the anchor stays.
//! - **Slide**: where all three corners of the touched triangle are active nodes, the force is the sum of
//!   their spaces, h = sum w_i h_i(d), with the barycentric weights of the anchor. While the tool pushes, the
//!   anchor slips along the surface as Coulomb friction permits. The weights are continuous across edges, and
//!   so is the force.

use super::surface::{Foot, Share, TouchSurface};
use crate::num::vec3::{self, Vec3};
use crate::space::Space;

/// Largest slip of one tick, metres: 2 m/s at 1 kHz, the speed limit of a hand.
const MAX_SLIP_M: f32 = 2e-3;

/// When contact begins and ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactConfig {
    /// Largest distance from the HIP to the rest position of a node that it may engage, metres.
    pub capture_radius_m: f32,
    /// Tension h . n along the outward normal at which a pushing tool disengages, newtons.
    pub release_tension_n: f32,
    /// Height above the anchor's plane at which a pushing tool disengages, metres. It must exceed the noise
    /// of the encoders, otherwise contact chatters.
    pub release_height_m: f32,
    /// Coefficient of Coulomb friction of a pushing tool; infinite for a tool that sticks to the nearest
    /// node.
    pub friction: f32,
    /// A grasp is lost beyond this multiple of the radius of the grid or of the largest force.
    pub grasp_slip: f32,
    /// Largest distance from the surface at which a grasp begins, metres.
    pub grasp_distance_m: f32,
    /// Bits of the buttons that grasp, any of them; 0 for none.
    pub grasp_button: u32,
}

impl Default for ContactConfig {
    fn default() -> Self {
        Self {
            capture_radius_m: 0.02,
            release_tension_n: 0.2,
            // About four counts of the Falcon, which resolves 54 um.
            release_height_m: 0.2e-3,
            friction: 0.3,
            grasp_slip: 1.1,
            grasp_distance_m: 3e-3,
            grasp_button: 1,
        }
    }
}

/// How the tool holds the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ContactKind {
    /// It presses on the surface and cannot pull.
    Push,
    /// It pushes and pulls until the button is released.
    Grasp,
}

/// Whether and where the tool touches.
#[derive(Debug, Clone, Copy, PartialEq)]
enum ContactState {
    Free {
        /// HIP of the previous sample, if there was one: engaging needs a crossing.
        previous_hip_m: Option<Vec3>,
    },
    Engaged(Engaged),
}

/// Where and how the tool holds the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Engaged {
    /// The spaces and their weights; a single space is the first and has weight 1.
    pub(crate) shares: [Share; 3],
    /// The anchor on the surface, if it may slide.
    pub(crate) foot: Option<Foot>,
    /// Origin of the displacement, model frame, metres.
    pub(crate) anchor_m: Vec3,
    /// Outward unit normal at the anchor.
    pub(crate) normal: Vec3,
    /// How it holds.
    pub(crate) kind: ContactKind,
}

impl Engaged {
    /// The space with the largest weight; the first one if several are equal.
    pub(crate) fn largest_share(&self) -> u16 {
        let [first, rest @ ..] = self.shares;
        rest.into_iter()
            .fold(first, |most, share| if share.weight > most.weight { share } else { most })
            .space
    }
}

/// Contact from sample to sample.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Contact {
    state: ContactState,
    buttons: u32,
}

impl Contact {
    /// Free. Buttons count as pressed already: a grasp needs the transition from released to pressed.
    pub(crate) const fn new() -> Self {
        Self { state: ContactState::Free { previous_hip_m: None }, buttons: u32::MAX }
    }

    /// Whether the tool touches.
    pub(crate) const fn is_engaged(&self) -> bool {
        matches!(self.state, ContactState::Engaged(_))
    }

    /// Processes one HIP sample; returns how the tool holds the body now, or `None` without contact.
    ///
    /// Cost: while free, the triangles round the HIP, and at a crossing (without a surface at every sample)
    /// one pass over the active nodes; while engaged, constant.
    pub(crate) fn update(
        &mut self,
        config: &ContactConfig,
        spaces: &[Space<'_>],
        surface: Option<&TouchSurface<'_>>,
        hip_m: Vec3,
        buttons: u32,
    ) -> Option<Engaged> {
        let pressed = buttons & config.grasp_button != 0;
        let pressed_now = pressed && self.buttons & config.grasp_button == 0;
        self.buttons = buttons;
        let free = ContactState::Free { previous_hip_m: Some(hip_m) };
        self.state = match self.state {
            ContactState::Free { previous_hip_m } => {
                let engaged = if pressed_now {
                    grasp(config, spaces, surface, hip_m)
                } else {
                    push(config, spaces, surface, previous_hip_m, hip_m)
                };
                engaged.map_or(free, ContactState::Engaged)
            }
            ContactState::Engaged(at) if at.kind == ContactKind::Grasp && !pressed => free,
            // A grasp that starts during a push keeps the anchor, so that the force is continuous.
            ContactState::Engaged(at) if at.kind == ContactKind::Push && pressed_now => {
                ContactState::Engaged(Engaged { kind: ContactKind::Grasp, ..at })
            }
            ContactState::Engaged(at)
                if at.kind == ContactKind::Push
                    && vec3::dot(vec3::sub(hip_m, at.anchor_m), at.normal) > config.release_height_m =>
            {
                free
            }
            engaged @ ContactState::Engaged(_) => engaged,
        };
        match self.state {
            ContactState::Free { .. } => None,
            ContactState::Engaged(at) => Some(at),
        }
    }

    /// Disengages: from the next sample on the tool is free.
    pub(crate) const fn release(&mut self, hip_m: Vec3) {
        self.state = ContactState::Free { previous_hip_m: Some(hip_m) };
    }

    /// Slips the anchor of a pushing tool towards the point where friction balances the reaction h at d. The
    /// slip is used from the next sample on.
    ///
    /// The slip is parallel to the tangential part of h, so the work h . slip that leaves the body is never
    /// negative. Its length is half of the excess of h over friction, divided by the secant stiffness
    /// |h|/|d|.
    pub(crate) fn slip(
        &mut self,
        config: &ContactConfig,
        spaces: &[Space<'_>],
        surface: Option<&TouchSurface<'_>>,
        (displacement_m, force_n): (Vec3, Vec3),
    ) {
        let (ContactState::Engaged(at), Some(surface)) = (&mut self.state, surface) else { return };
        let (ContactKind::Push, Some(foot)) = (at.kind, at.foot) else { return };
        let pressing_n = -vec3::dot(force_n, at.normal);
        let along_n = vec3::add(force_n, vec3::scale(at.normal, pressing_n));
        let size_n = vec3::norm(along_n);
        let excess_n = size_n - config.friction * pressing_n.max(0.0);
        if excess_n <= 0.0 {
            return;
        }
        let slip_m = 0.5 * excess_n * vec3::norm(displacement_m) / vec3::norm(force_n);
        let slip_m = vec3::scale(along_n, slip_m.min(MAX_SLIP_M) / size_n);
        if !vec3::is_finite(slip_m) {
            return;
        }
        let from_m = surface.point(&foot);
        let wanted_m = vec3::sub(vec3::add(at.anchor_m, slip_m), from_m);
        let (next, is_stopped) = surface.slide(foot, wanted_m);
        let Some(shares) = surface.shares(&next) else { return };
        let Some(normal) = blended_normal(spaces, &shares) else { return };
        // Beyond the last active nodes the force is that of their spaces; the anchor continues in their
        // plane.
        let beyond_m = if is_stopped {
            let left_m = vec3::sub(vec3::add(from_m, wanted_m), surface.point(&next));
            vec3::sub(left_m, vec3::scale(normal, vec3::dot(left_m, normal)))
        } else {
            vec3::ZERO
        };
        let anchor_m = vec3::add(surface.point(&next), beyond_m);
        let hip_m = vec3::add(at.anchor_m, displacement_m);
        *at = Engaged { shares, foot: Some(next), anchor_m, normal, kind: at.kind };
        if vec3::norm(beyond_m) > config.capture_radius_m {
            self.release(hip_m);
        }
    }
}

/// The node that a press of the button grasps at the HIP.
fn grasp(
    config: &ContactConfig,
    spaces: &[Space<'_>],
    surface: Option<&TouchSurface<'_>>,
    hip_m: Vec3,
) -> Option<Engaged> {
    let (space, node) = nearest(spaces, hip_m, config.capture_radius_m)?;
    let is_close = match surface {
        Some(surface) => surface.is_within(hip_m, config.grasp_distance_m),
        None => height_m(node, hip_m).abs() <= config.grasp_distance_m,
    };
    is_close.then_some(Engaged {
        shares: alone(space),
        foot: None,
        anchor_m: hip_m,
        normal: node.active().outward_normal,
        kind: ContactKind::Grasp,
    })
}

/// Where a path through the surface engages.
fn push(
    config: &ContactConfig,
    spaces: &[Space<'_>],
    surface: Option<&TouchSurface<'_>>,
    previous_hip_m: Option<Vec3>,
    hip_m: Vec3,
) -> Option<Engaged> {
    let previous_hip_m = previous_hip_m?;
    let kind = ContactKind::Push;
    let Some(surface) = surface else {
        let (space, node) = nearest(spaces, hip_m, config.capture_radius_m)?;
        let anchor_m = through_plane(node, previous_hip_m, hip_m)?;
        return Some(Engaged {
            shares: alone(space),
            foot: None,
            anchor_m,
            normal: node.active().outward_normal,
            kind,
        });
    };
    let crossing = surface.crossing(previous_hip_m, hip_m)?;
    let anchor_m = crossing.at_m;
    if config.friction < f32::INFINITY
        && let Some(shares) = surface.shares(&crossing.foot)
    {
        let normal = blended_normal(spaces, &shares)?;
        return Some(Engaged { shares, foot: Some(crossing.foot), anchor_m, normal, kind });
    }
    let (space, _) = nearest(spaces, anchor_m, config.capture_radius_m)?;
    let normal = surface.face_normal(crossing.foot.triangle);
    Some(Engaged { shares: alone(space), foot: None, anchor_m, normal, kind })
}

/// Height of a point above the plane of a node, metres.
fn height_m(node: &Space<'_>, point_m: Vec3) -> f32 {
    let node = node.active();
    vec3::dot(vec3::sub(point_m, node.rest_position_m), node.outward_normal)
}

/// Where a path passes downwards through the plane of a node.
fn through_plane(node: &Space<'_>, previous_hip_m: Vec3, hip_m: Vec3) -> Option<Vec3> {
    let (before, now) = (height_m(node, previous_hip_m), height_m(node, hip_m));
    if !(before > 0.0 && now <= 0.0) {
        return None;
    }
    // before > 0 >= now, so the quotient is in (0, 1]; min limits its rounding.
    let share = (before / (before - now)).min(1.0);
    let travel = vec3::sub(hip_m, previous_hip_m);
    // On the plane itself the sample is the crossing: rounding must not make d differ from 0.
    Some(if now == 0.0 { hip_m } else { vec3::add(previous_hip_m, vec3::scale(travel, share)) })
}

fn alone(space: u16) -> [Share; 3] {
    [Share { space, weight: 1.0 }, Share::default(), Share::default()]
}

/// Weighted mean of the normals of the nodes: continuous over the surface, unlike the normals of its faces.
fn blended_normal(spaces: &[Space<'_>], shares: &[Share; 3]) -> Option<Vec3> {
    let mut sum = vec3::ZERO;
    for share in shares {
        let space = spaces.get(usize::from(share.space))?;
        sum = vec3::add(sum, vec3::scale(space.active().outward_normal, share.weight));
    }
    let normal = vec3::normalize_or_zero(sum);
    (normal != vec3::ZERO).then_some(normal)
}

/// The active node nearest to a point within a radius; the first one if several are equally near.
fn nearest<'s, 'a>(spaces: &'s [Space<'a>], point_m: Vec3, radius_m: f32) -> Option<(u16, &'s Space<'a>)> {
    let mut best = None;
    let mut best_squared = radius_m * radius_m;
    for (index, space) in (0..u16::MAX).zip(spaces) {
        let squared = vec3::norm_squared(vec3::sub(point_m, space.active().rest_position_m));
        if squared < best_squared || (best.is_none() && squared <= best_squared) {
            best = Some((index, space));
            best_squared = squared;
        }
    }
    best
}
