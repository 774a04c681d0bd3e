//! When the tool holds which active node: engage, follow, release.
//!
//! A space knows the force for a displacement of its node, not whether the tool touches it. Here the tool is one point, the
//! HIP, and touches the nearest active node within a capture radius. While engaged, the displacement is measured from the
//! anchor, the place where the HIP was at first touch, so that every touch starts at d = 0 and therefore at no force.

use crate::table::Space;
use crate::vec3::{self, Vec3};

/// When contact begins and ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactConfig {
    /// Largest distance from the HIP to the rest position of the node it may engage, metres.
    pub capture_radius_m: f32,
    /// Tension h . n along the outward normal at which a pushing tool lets go, newtons.
    pub release_tension_n: f32,
    /// Height above the anchor's plane at which a pushing tool lets go, metres. Above the encoder's noise, or contact chatters.
    pub release_height_m: f32,
    /// Buttons that grasp (any of them); 0 for never.
    pub grasp_button: u32,
}

impl Default for ContactConfig {
    fn default() -> Self {
        // The Falcon resolves 54 um, so 0.2 mm are about four counts.
        Self { capture_radius_m: 0.02, release_tension_n: 0.2, release_height_m: 0.2e-3, grasp_button: 1 }
    }
}

/// How the tool holds the node.
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
    Engaged {
        /// Index of the space.
        space: u16,
        /// Where the displacement is measured from, model frame.
        anchor_m: Vec3,
        /// How it holds.
        kind: ContactKind,
    },
}

/// A space in touch and how far its node is displaced.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Touch {
    /// Index of the space.
    pub space: u16,
    /// HIP relative to the anchor.
    pub displacement_m: Vec3,
    /// How it holds.
    pub kind: ContactKind,
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

    /// Takes one HIP sample; returns the touch that results, if any.
    ///
    /// Cost: while free, one pass over the active nodes; while engaged, constant.
    pub fn update(
        &mut self,
        config: &ContactConfig,
        spaces: &[Space<'_>],
        hip_m: Vec3,
        buttons: u32,
    ) -> Option<Touch> {
        let pressed = buttons & config.grasp_button != 0;
        let pressed_now = pressed && self.buttons & config.grasp_button == 0;
        self.buttons = buttons;
        let free = ContactState::Free { previous_hip_m: Some(hip_m) };
        self.state = match self.state {
            ContactState::Free { previous_hip_m } => {
                engage(config, spaces, previous_hip_m, hip_m, pressed_now).unwrap_or(free)
            }
            ContactState::Engaged { kind: ContactKind::Grasp, .. } if !pressed => free,
            // Grasping what one already presses keeps the anchor: the force goes on where it is.
            ContactState::Engaged { space, anchor_m, kind: ContactKind::Push } if pressed_now => {
                ContactState::Engaged { space, anchor_m, kind: ContactKind::Grasp }
            }
            ContactState::Engaged { space, anchor_m, kind: ContactKind::Push }
                if height(spaces, space, anchor_m, hip_m) > config.release_height_m =>
            {
                free
            }
            engaged => engaged,
        };
        match self.state {
            ContactState::Free { .. } => None,
            ContactState::Engaged { space, anchor_m, kind } => {
                Some(Touch { space, displacement_m: vec3::sub(hip_m, anchor_m), kind })
            }
        }
    }

    /// Lets a pushing tool go where the model would pull it: h . n above the release tension. True if it let go.
    ///
    /// Pressing has h . n < 0. A tool that only leans on tissue cannot pull it out.
    pub fn release_if_tensile(
        &mut self,
        config: &ContactConfig,
        normal: Vec3,
        force_n: Vec3,
        hip_m: Vec3,
    ) -> bool {
        let pushing = matches!(self.state, ContactState::Engaged { kind: ContactKind::Push, .. });
        let release = pushing && vec3::dot(force_n, normal) > config.release_tension_n;
        if release {
            self.state = ContactState::Free { previous_hip_m: Some(hip_m) };
        }
        release
    }
}

/// Height of the HIP above the anchor along the node's normal. Infinite for a space that is not there: that releases.
fn height(spaces: &[Space<'_>], space: u16, anchor_m: Vec3, hip_m: Vec3) -> f32 {
    match spaces.get(usize::from(space)) {
        Some(space) => vec3::dot(vec3::sub(hip_m, anchor_m), space.outward_normal),
        None => f32::INFINITY,
    }
}

/// The node a free tool engages with this sample, if any.
fn engage(
    config: &ContactConfig,
    spaces: &[Space<'_>],
    previous_hip_m: Option<Vec3>,
    hip_m: Vec3,
    grasp: bool,
) -> Option<ContactState> {
    let (index, space) = nearest(spaces, hip_m, config.capture_radius_m)?;
    if grasp {
        return Some(ContactState::Engaged { space: index, anchor_m: hip_m, kind: ContactKind::Grasp });
    }
    let above = |point| vec3::dot(vec3::sub(point, space.rest_position_m), space.outward_normal);
    let previous_hip_m = previous_hip_m?;
    let (before, now) = (above(previous_hip_m), above(hip_m));
    if !(before > 0.0 && now <= 0.0) {
        return None;
    }
    // before > 0 >= now, so the quotient is in (0, 1]; min guards its rounding.
    let share = (before / (before - now)).min(1.0);
    let travel = vec3::sub(hip_m, previous_hip_m);
    // On the plane itself the sample is the crossing; rounding must not give d a last digit.
    let anchor_m = if now == 0.0 { hip_m } else { vec3::add(previous_hip_m, vec3::scale(travel, share)) };
    Some(ContactState::Engaged { space: index, anchor_m, kind: ContactKind::Push })
}

/// Active node nearest to the HIP, within the radius. The first of equals, so that the choice is reproducible.
fn nearest<'s, 'a>(spaces: &'s [Space<'a>], hip_m: Vec3, radius_m: f32) -> Option<(u16, &'s Space<'a>)> {
    let mut best = None;
    let mut best_squared = radius_m * radius_m;
    for (index, space) in (0..u16::MAX).zip(spaces) {
        let squared = vec3::norm_squared(vec3::sub(hip_m, space.rest_position_m));
        if squared < best_squared || (best.is_none() && squared <= best_squared) {
            best = Some((index, space));
            best_squared = squared;
        }
    }
    best
}
