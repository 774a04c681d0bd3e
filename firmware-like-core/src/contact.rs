//! When the tool holds which active nodes: engage, follow, slide, release.
//!
//! A space knows the force for a displacement of its node, not whether the tool touches it. Here the tool is one point, the
//! HIP. It engages where its way goes through the surface of the organ at rest (without a surface: through the plane of the nearest
//! node). While engaged, the displacement is measured from the anchor, the place where the HIP was at first touch, so that every touch
//! starts at d = 0 and therefore at no force, wherever on a triangle it happens.
//!
//! - **Snap** (Peterlik 2010): the nearest active node answers, and the anchor stays.
//! - **Slide**: where all three corners of the touched triangle are active nodes, their spaces answer together, h = sum w_i h_i(d), with the
//!   anchor's barycentric weights; while the tool pushes, the anchor slips along the surface as Coulomb friction lets it. Weights are
//!   continuous over edges, so the force is.

use crate::surface::{Foot, Share, TouchSurface};
use crate::table::Space;
use crate::vec3::{self, Vec3};

/// Longest slip of one tick, metres: 2 m/s at 1 kHz, as fast as a hand may be.
const MOST_SLIP_M: f32 = 2e-3;

/// When contact begins and ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactConfig {
    /// Largest distance from the HIP to the rest position of the node it may engage, metres.
    pub capture_radius_m: f32,
    /// Tension h . n along the outward normal at which a pushing tool lets go, newtons.
    pub release_tension_n: f32,
    /// Height above the anchor's plane at which a pushing tool lets go, metres. Above the encoder's noise, or contact chatters.
    pub release_height_m: f32,
    /// Coulomb friction of a pushing tool on the surface; infinite for a tool that sticks to the nearest node.
    pub friction: f32,
    /// A grasping tool slips off beyond this many times the grid's radius or the largest force.
    pub grasp_slip: f32,
    /// Largest distance from the surface at which a grasp takes hold, metres; tissue is not taken hold of through the air.
    pub grasp_distance_m: f32,
    /// Buttons that grasp (any of them); 0 for never.
    pub grasp_button: u32,
}

impl Default for ContactConfig {
    fn default() -> Self {
        Self {
            capture_radius_m: 0.02,
            release_tension_n: 0.2,
            // The Falcon resolves 54 um, so 0.2 mm are about four counts.
            release_height_m: 0.2e-3,
            friction: 0.3,
            grasp_slip: 1.1,
            grasp_distance_m: 3e-3,
            grasp_button: 1,
        }
    }
}

/// How the tool holds on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ContactKind {
    /// Pressing on the surface: no pull.
    Push,
    /// Holding on: pushes and pulls until the button is released.
    Grasp,
}

/// Whether, and where, the tool touches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ContactState {
    /// Not touching.
    Free {
        /// HIP of the sample before, if there was one: engaging needs a crossing.
        previous_hip_m: Option<Vec3>,
    },
    /// Touching.
    Engaged(Engaged),
}

/// Where and how the tool holds on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Engaged {
    /// The spaces that answer; with one alone, its weight is 1 and it is the first.
    pub shares: [Share; 3],
    /// The anchor on the surface, if it may slide.
    pub foot: Option<Foot>,
    /// Where the displacement is measured from, model frame.
    pub anchor_m: Vec3,
    /// Outward unit normal at the anchor.
    pub normal: Vec3,
    /// How it holds.
    pub kind: ContactKind,
}

impl Engaged {
    /// The space with the largest share, the first of equals.
    pub fn heaviest(&self) -> u16 {
        let [first, rest @ ..] = self.shares;
        rest.into_iter()
            .fold(first, |most, share| if share.weight > most.weight { share } else { most })
            .space
    }
}

/// Contact from sample to sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Contact {
    state: ContactState,
    buttons: u32,
}

impl Default for Contact {
    fn default() -> Self {
        Self::new()
    }
}

impl Contact {
    /// Free, and blind to buttons already held: a grasp needs a press that was seen to happen.
    pub const fn new() -> Self {
        Self { state: ContactState::Free { previous_hip_m: None }, buttons: u32::MAX }
    }

    /// Whether the tool touches.
    pub const fn state(&self) -> ContactState {
        self.state
    }

    /// Takes one HIP sample; returns how the tool holds on now, if it does.
    ///
    /// Cost: while free, a look at the surface round the HIP, and one pass over the active nodes at a crossing (without a surface at every
    /// sample); while engaged, constant.
    pub fn update(
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
            // Grasping what one already presses keeps the anchor: the force goes on where it is.
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

    /// Lets go: from the next sample on the tool is free.
    pub const fn release(&mut self, hip_m: Vec3) {
        self.state = ContactState::Free { previous_hip_m: Some(hip_m) };
    }

    /// Slips the anchor of a pushing tool towards where friction holds it against the reaction h at d; the next sample feels it.
    ///
    /// The slip goes the way of h's tangential part, so the work h . slip it takes out of the body is never negative. Its length is half of
    /// what the excess over friction is worth at the secant stiffness |h| / |d|.
    pub fn slip(
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
        let slip_m = vec3::scale(along_n, slip_m.min(MOST_SLIP_M) / size_n);
        if !vec3::is_finite(slip_m) {
            return;
        }
        let from_m = surface.point(&foot);
        let wanted_m = vec3::sub(vec3::add(at.anchor_m, slip_m), from_m);
        let (next, is_stopped) = surface.slide(foot, wanted_m);
        let Some(shares) = surface.shares(&next) else { return };
        let Some(normal) = blended_normal(spaces, &shares) else { return };
        // Beyond the last active nodes they go on to answer, and the anchor goes on in their plane.
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

/// The node that a press of the button takes hold of, where the HIP is.
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
        normal: node.outward_normal,
        kind: ContactKind::Grasp,
    })
}

/// What a way through the surface touches.
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
            normal: node.outward_normal,
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

/// Height above the plane of a node.
fn height_m(node: &Space<'_>, point_m: Vec3) -> f32 {
    vec3::dot(vec3::sub(point_m, node.rest_position_m), node.outward_normal)
}

/// Where a way goes down through the plane of a node.
fn through_plane(node: &Space<'_>, previous_hip_m: Vec3, hip_m: Vec3) -> Option<Vec3> {
    let (before, now) = (height_m(node, previous_hip_m), height_m(node, hip_m));
    if !(before > 0.0 && now <= 0.0) {
        return None;
    }
    // before > 0 >= now, so the quotient is in (0, 1]; min guards its rounding.
    let share = (before / (before - now)).min(1.0);
    let travel = vec3::sub(hip_m, previous_hip_m);
    // On the plane itself the sample is the crossing; rounding must not give d a last digit.
    Some(if now == 0.0 { hip_m } else { vec3::add(previous_hip_m, vec3::scale(travel, share)) })
}

fn alone(space: u16) -> [Share; 3] {
    [Share { space, weight: 1.0 }, Share::default(), Share::default()]
}

/// Normal between the nodes': continuous over the surface, unlike that of its faces.
fn blended_normal(spaces: &[Space<'_>], shares: &[Share; 3]) -> Option<Vec3> {
    let mut sum = vec3::ZERO;
    for share in shares {
        let space = spaces.get(usize::from(share.space))?;
        sum = vec3::add(sum, vec3::scale(space.outward_normal, share.weight));
    }
    let normal = vec3::normalize_or_zero(sum);
    (normal != vec3::ZERO).then_some(normal)
}

/// Active node nearest to a point, within the radius. The first of equals, so that the choice is reproducible.
fn nearest<'s, 'a>(spaces: &'s [Space<'a>], point_m: Vec3, radius_m: f32) -> Option<(u16, &'s Space<'a>)> {
    let mut best = None;
    let mut best_squared = radius_m * radius_m;
    for (index, space) in (0..u16::MAX).zip(spaces) {
        let squared = vec3::norm_squared(vec3::sub(point_m, space.rest_position_m));
        if squared < best_squared || (best.is_none() && squared <= best_squared) {
            best = Some((index, space));
            best_squared = squared;
        }
    }
    best
}
