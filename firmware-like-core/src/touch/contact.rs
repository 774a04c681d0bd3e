//! Which active nodes the tool holds: engage, slide, release.
//!
//! A space defines the force for a displacement of its node, but not whether the tool touches it. The tool is
//! one point, the haptic interface point (HIP). It engages where its path crosses the surface of the organ at
//! rest; a controller without a [`TouchSurface`] uses the plane of the nearest active node. While engaged,
//! the displacement is measured from the anchor: initially the point where the path crosses the surface, or
//! for a grasp the HIP. Thus every touch starts at d = 0 and without force, at any point of a triangle.
//!
//! - **Snap** (Peterlik 2010): the nearest active node is held, and the anchor stays.
//! - **Slide**: where all three corners of the touched triangle are active nodes, the force is the sum of
//!   their spaces, h = sum w_i h_i(d), with the barycentric weights of the anchor. While the tool pushes, the
//!   anchor slips along the surface as Coulomb friction permits. The weights are continuous across edges, and
//!   so is the force.

use super::approach::Approach;
use super::grip::{Grip, Pressed};
use super::surface::{Crossing, Foot, NodeWeight, TouchSurface, entry};
use crate::num::vec3::{self, Vec3};
use crate::space::Space;

/// Largest slip of one tick, metres: 2 m/s at 1 kHz, the speed limit of a hand.
const MAX_SLIP_M: f32 = 2e-3;

/// When contact begins and ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactConfig {
    /// Largest distance from the point of contact to the rest position of the node that is engaged, and
    /// largest distance that the anchor slides beyond the edge of the active region, metres.
    pub capture_radius_m: f32,
    /// Tension h . n along the outward normal at which a pushing tool disengages, newtons.
    pub release_tension_n: f32,
    /// Height above the anchor's plane at which a pushing tool disengages, metres. It must exceed the noise
    /// of the encoders, otherwise contact chatters.
    pub release_height_m: f32,
    /// Coefficient of Coulomb friction of a pushing tool or a sphere, 0 to 1; infinite for one that sticks to
    /// its place.
    pub friction: f32,
    /// A grasp is lost if |d| exceeds this multiple of the grid radius, or if the force for the hand before
    /// limiting exceeds this multiple of `max_force_n`.
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
    /// It is a sphere: the displacement is that of its centre, wherever it touches.
    Sphere,
}

/// Where and how the tool holds the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Engaged {
    /// The spaces and their weights; a single space is the first and has weight 1.
    pub(crate) weights: [NodeWeight; 3],
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
    /// Holds the node of a single space.
    fn by(kind: ContactKind, space: u16, anchor_m: Vec3, normal: Vec3) -> Self {
        let weights = [NodeWeight { space, weight: 1.0 }, NodeWeight::default(), NodeWeight::default()];
        Self { weights, foot: None, anchor_m, normal, kind }
    }

    /// The space with the largest weight; the first one if several are equal.
    pub(crate) fn main_space(&self) -> u16 {
        let [first, rest @ ..] = self.weights;
        rest.into_iter().fold(first, |most, node| if node.weight > most.weight { node } else { most }).space
    }
}

/// Contact from sample to sample.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Contact {
    engaged: Option<Engaged>,
    /// HIP of the previous sample, if any. A push begins where the path from it crosses the surface.
    previous_hip_m: Option<Vec3>,
    buttons: u32,
    /// Whether a sphere of a live field was out of reach of the skin at the previous sample. A touch begins then.
    was_away: bool,
    /// The ends of its axis then.
    ends_m: [Vec3; 2],
    /// The tangential spring of a sphere, while it presses.
    grip: Option<Grip>,
}

impl Default for Contact {
    /// Free. Buttons count as pressed already: a grasp needs the transition from released to pressed.
    fn default() -> Self {
        Self {
            engaged: None,
            previous_hip_m: None,
            buttons: u32::MAX,
            was_away: false,
            ends_m: [vec3::ZERO; 2],
            grip: None,
        }
    }
}

impl Contact {
    /// Whether the tool touches.
    pub(crate) const fn is_engaged(&self) -> bool {
        self.engaged.is_some()
    }

    /// Processes one HIP sample; returns how the tool holds the body now, or `None` without contact.
    ///
    /// Cost while free: the triangles round the HIP, and one pass over the active nodes at a crossing or
    /// grasp. Without a surface this pass runs at every sample. Cost while engaged: constant.
    pub(crate) fn update(
        &mut self,
        config: &ContactConfig,
        spaces: &[Space<'_>],
        surface: Option<&TouchSurface<'_>>,
        hip_m: Vec3,
        buttons: u32,
    ) -> Option<Engaged> {
        let pressed = buttons & config.grasp_button != 0;
        let just_pressed = pressed && self.buttons & config.grasp_button == 0;
        self.buttons = buttons;
        let previous_hip_m = self.previous_hip_m.replace(hip_m);
        self.engaged = match self.engaged {
            None if just_pressed => grasp(config, spaces, surface, hip_m),
            None => push(config, spaces, surface, previous_hip_m, hip_m),
            Some(at) => {
                let height_m = vec3::dot(vec3::sub(hip_m, at.anchor_m), at.normal);
                match at.kind {
                    ContactKind::Grasp if !pressed => None,
                    // A grasp that starts during a push keeps the anchor, so that the force is continuous.
                    ContactKind::Push if just_pressed => Some(Engaged { kind: ContactKind::Grasp, ..at }),
                    ContactKind::Push if height_m > config.release_height_m => None,
                    ContactKind::Push | ContactKind::Grasp | ContactKind::Sphere => Some(at),
                }
            }
        };
        self.engaged
    }

    /// The same for a sphere, which is engaged within a distance of the surface, and as long as the controller does not
    /// release it.
    ///
    /// The surface of a field of charts is that of the first touch, where the centre is when the sphere just touches the
    /// skin. The foot is its point nearest to the centre at the beginning. Then it follows along the surface, so that it
    /// stays on the side from which the sphere came. Its weights are those of the charts, and the displacement counts from
    /// it. A live field has one space, and the surface is the skin. There a touch begins where a tool comes from out of reach: one
    /// that starts at the body or inside touches nothing until it has left, nor does one that goes through the fixed part.
    // On its own, so that it costs the ticks of other tools nothing.
    #[inline(never)]
    pub(crate) fn follow(
        &mut self,
        spaces: &[Space<'_>],
        surface: Option<&TouchSurface<'_>>,
        approach: &Approach,
    ) -> Option<Engaged> {
        let hip_m = approach.centre_m;
        self.previous_hip_m = Some(hip_m);
        let surface = surface?;
        if surface.is_of_contacts {
            let foot = match self.engaged.and_then(|at| at.foot) {
                Some(foot) => surface.slide(foot, vec3::sub(hip_m, surface.point(&foot))).0,
                None => surface.nearest(hip_m, approach.within_m)?,
            };
            let weights = surface.node_weights(&foot)?;
            let normal = blended_normal(spaces, &weights)?;
            let (anchor_m, kind) = (surface.point(&foot), ContactKind::Sphere);
            self.engaged = Some(Engaged { weights, foot: Some(foot), anchor_m, normal, kind });
            return self.engaged;
        }
        let before_m = core::mem::replace(&mut self.ends_m, approach.ends_m());
        if self.engaged.is_some() {
            if surface.is_pierced(before_m, self.ends_m) {
                self.release(hip_m);
            }
        } else {
            let is_outside = surface.is_met_outside(approach);
            let comes_from_outside = self.was_away && is_outside == Some(true);
            self.was_away = is_outside.is_none();
            if comes_from_outside {
                let active = &spaces.first()?.active;
                let (start_m, normal) = (active.rest_position_m, active.outward_normal);
                self.engaged = Some(Engaged::by(ContactKind::Sphere, 0, start_m, normal));
            }
        }
        self.engaged
    }

    /// Disengages: from the next sample on the tool is free.
    pub(crate) const fn release(&mut self, hip_m: Vec3) {
        (self.engaged, self.grip) = (None, None);
        self.previous_hip_m = Some(hip_m);
    }

    /// The friction that a sphere feels at its centre, newtons.
    pub(crate) fn friction_n(&mut self, config: &ContactConfig, hip_m: Vec3, by: Pressed) -> Vec3 {
        let (along_n, grip) = Grip::follow(self.grip, config.friction, hip_m, by);
        self.grip = grip;
        along_n
    }

    /// Slips the anchor of a pushing tool towards the point where friction balances the reaction h at d. The
    /// slip is used from the next sample on.
    ///
    /// With the HIP p at rest, a slip of the anchor x changes the blended energy W(x, d) = sum w_i(x) W_i(d),
    /// d = p - x, by -g . dx with g = h - sum W_i grad w_i. The slip is parallel to the tangential part of g. So
    /// the energy of the body falls by g . dx, which friction turns into heat: on no closed path does the hand
    /// receive energy. Its length is half of the excess of g over friction, divided by the secant stiffness
    /// |h|/|d|. A method without an energy uses g = h.
    pub(crate) fn slip(
        &mut self,
        config: &ContactConfig,
        spaces: &[Space<'_>],
        surface: Option<&TouchSurface<'_>>,
        (displacement_m, force_n): (Vec3, Vec3),
        energy_j: impl Fn(u16) -> Option<f32>,
    ) {
        let (Some(at), Some(surface)) = (&mut self.engaged, surface) else { return };
        let (ContactKind::Push, Some(foot)) = (at.kind, at.foot) else { return };
        let pressing_n = -vec3::dot(force_n, at.normal);
        let driving_n = match blended_slope_n(surface, at, &foot, energy_j) {
            Some(slope_n) => vec3::sub(force_n, slope_n),
            None => force_n,
        };
        let along_n = vec3::sub(driving_n, vec3::scale(at.normal, vec3::dot(driving_n, at.normal)));
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
        // On a face that is tilted against the blended normal, the slip must not lift the energy.
        let face = surface.face_normal(foot.triangle);
        let in_face_m = vec3::sub(slip_m, vec3::scale(face, vec3::dot(slip_m, face)));
        if vec3::dot(driving_n, in_face_m) <= 0.0 {
            return;
        }
        let from_m = surface.point(&foot);
        let wanted_m = vec3::sub(vec3::add(at.anchor_m, slip_m), from_m);
        let (next, left_active_region) = surface.slide(foot, wanted_m);
        let Some(weights) = surface.node_weights(&next) else { return };
        let Some(normal) = blended_normal(spaces, &weights) else { return };
        // Beyond the edge of the active region the weights stay those of the edge, and the anchor continues
        // in the tangent plane there.
        let beyond_m = if left_active_region {
            let left_m = vec3::sub(vec3::add(from_m, wanted_m), surface.point(&next));
            vec3::sub(left_m, vec3::scale(normal, vec3::dot(left_m, normal)))
        } else {
            vec3::ZERO
        };
        let anchor_m = vec3::add(surface.point(&next), beyond_m);
        let hip_m = vec3::add(at.anchor_m, displacement_m);
        *at = Engaged { weights, foot: Some(next), anchor_m, normal, kind: at.kind };
        if vec3::norm(beyond_m) > config.capture_radius_m {
            self.release(hip_m);
        }
    }
}

/// sum W_i grad w_i, newtons; `None` if a space has no energy. With it the force of a sphere, whose foot is the projection of
/// its centre, is the exact gradient of sum w_i W_i. It is small where the charts agree, and zero within one chart.
pub(crate) fn blended_slope_n(
    surface: &TouchSurface<'_>,
    at: &Engaged,
    foot: &Foot,
    energy_j: impl Fn(u16) -> Option<f32>,
) -> Option<Vec3> {
    let mut sum = vec3::ZERO;
    let [a, b, c] = at.weights.map(|node| node.space);
    if a == b && b == c {
        return Some(sum);
    }
    for (node, slope) in at.weights.iter().zip(surface.weight_slopes(foot.triangle)?) {
        sum = vec3::add(sum, vec3::scale(slope, energy_j(node.space)?));
    }
    Some(sum)
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
    is_close.then(|| Engaged::by(ContactKind::Grasp, space, hip_m, node.active.outward_normal))
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
        let (_, anchor_m) = entry([previous_hip_m, hip_m], |point_m| height_m(node, point_m))?;
        return Some(Engaged::by(kind, space, anchor_m, node.active.outward_normal));
    };
    let Crossing { at_m: anchor_m, foot } = surface.crossing(previous_hip_m, hip_m)?;
    if config.friction < f32::INFINITY
        && let Some(weights) = surface.node_weights(&foot)
    {
        let normal = blended_normal(spaces, &weights)?;
        return Some(Engaged { weights, foot: Some(foot), anchor_m, normal, kind });
    }
    let (space, _) = nearest(spaces, anchor_m, config.capture_radius_m)?;
    Some(Engaged::by(kind, space, anchor_m, surface.face_normal(foot.triangle)))
}

/// Height of a point above the plane of a node, metres.
fn height_m(node: &Space<'_>, point_m: Vec3) -> f32 {
    vec3::dot(vec3::sub(point_m, node.active.rest_position_m), node.active.outward_normal)
}

/// Weighted mean of the normals of the nodes: continuous over the surface, unlike the normals of its faces.
fn blended_normal(spaces: &[Space<'_>], weights: &[NodeWeight; 3]) -> Option<Vec3> {
    let mut sum = vec3::ZERO;
    for node in weights {
        let space = spaces.get(usize::from(node.space))?;
        sum = vec3::add(sum, vec3::scale(space.active.outward_normal, node.weight));
    }
    let normal = vec3::normalize_or_zero(sum);
    (normal != vec3::ZERO).then_some(normal)
}

/// The active node nearest to a point within a radius; the first one if several are equally near.
fn nearest<'s, 'a>(spaces: &'s [Space<'a>], point_m: Vec3, radius_m: f32) -> Option<(u16, &'s Space<'a>)> {
    let mut best = None;
    let mut best_squared = radius_m * radius_m;
    for (index, space) in (0..u16::MAX).zip(spaces) {
        let squared = vec3::norm_squared(vec3::sub(point_m, space.active.rest_position_m));
        if squared < best_squared || (best.is_none() && squared <= best_squared) {
            best = Some((index, space));
            best_squared = squared;
        }
    }
    best
}
