//! The starting memory of a session: jets of the tables of a blob.
//!
//! The tables of a blob are the energy W of a contact. A jet needs its derivatives: h and S are those of the
//! interpolant, and W_ijk are central differences of S. Jets on a lattice of 7 mm lie within their trust radius of
//! every position between them, so the hand finds everything known where the tables hold.

use nalgebra::Matrix3;
use palpate_core::{Coverage, Method, Organ, Space};

use super::error::LiveError;
use super::memory::Trust;
use super::skin::Skin;
use crate::num::jet::{EnergyJet, THIRD_INDICES};
use crate::num::vector::{distance, dot, norm};
use crate::pack::{Place, fingertip};
use crate::scene::ResolvedScene;
use crate::spec::Tolerance;

/// Spacing of the lattice, m, and its growth while there are too many points.
const SPACING_M: f64 = 7e-3;
/// Half the diagonal of its cells, in its spacing.
const HALF_DIAGONAL: f64 = 0.87;
/// Jets at rest and near it are sent before the tool touches, m.
pub(super) const NEAR_REST_M: f64 = 8e-3;
/// The model is checked where the tables have the largest force within this distance from rest, m.
const CHECKED_M: f64 = 0.025;
const COARSER: f64 = 1.15;
/// Most jets of a contact: the memory of the loop has room for those of the session too.
const MOST: usize = 192;
/// Half the step of the differences of S, m.
const STEP_M: f64 = 1.5e-3;
/// A contact of the blob is one of the session if their positions at rest agree to this, m.
const SAME_M: f64 = 1e-5;
/// A table whose stiffness at rest differs by this share is of another model.
const SAME_STIFFNESS: f64 = 0.02;

/// The contact of a session that has the tables of a space.
pub(super) fn contact_of(skin: &Skin, space: &Space<'_>) -> Option<u16> {
    let rest_m = space.active.rest_position_m.map(f64::from);
    let is_same =
        |contact: &Place| contact.node == space.active.node && distance(contact.rest_m, rest_m) < SAME_M;
    let at = skin.contacts.iter().position(is_same)?;
    u16::try_from(at).ok()
}

/// The method of a blob that has an energy, if its mesh, tool and law are those of the scene.
pub(super) fn check(organ: &Organ<'_>, scene: &ResolvedScene, law: &str) -> Result<Method, LiveError> {
    let other = |what| Err(LiveError::OtherBlob(what));
    if organ.mesh_hash != scene.mesh.content_hash() {
        return other("another mesh");
    }
    if scene.tool.sphere().is_some() || organ.tool.fingertip() != scene.tool.fingertip().map(fingertip) {
        return other("another tool");
    }
    if organ.law.as_str() != law {
        return other("another law");
    }
    let has_energy = |method: &Method| organ.spaces.iter().all(|space| space.has(*method));
    let method = [Method::Energy, Method::Kernel].into_iter().find(has_energy);
    method.ok_or(LiveError::OtherBlob("no table of an energy (`palpate pack` without --method makes one)"))
}

/// W, h, S and W_ijk of a table at a control, m; `None` outside its domain.
pub(super) fn jet(space: &Space<'_>, method: Method, control_m: [f64; 3]) -> Option<EnergyJet> {
    let estimate = |at_m: [f64; 3]| {
        let found = space.estimate(method, at_m.map(|x| x as f32))?;
        let stiffness = Matrix3::from_fn(|i, j| f64::from(found.stiffness_n_m[i][j]));
        (found.coverage != Coverage::Extrapolated)
            .then_some((found, 0.5 * (stiffness + stiffness.transpose())))
    };
    let (found, stiffness_n_m) = estimate(control_m)?;
    let slope = |axis: usize| {
        let at = |step_m: f64| {
            let mut at_m = control_m;
            at_m[axis] += step_m;
            estimate(at_m).map(|(_, stiffness)| stiffness)
        };
        // At the rim of the domain the difference is one-sided.
        let (low, high) = (at(-STEP_M), at(STEP_M));
        match (low, high) {
            (Some(low), Some(high)) => Some((high - low) / (2.0 * STEP_M)),
            (Some(low), None) => Some((stiffness_n_m - low) / STEP_M),
            (None, Some(high)) => Some((high - stiffness_n_m) / STEP_M),
            (None, None) => None,
        }
    };
    let slopes = [slope(0)?, slope(1)?, slope(2)?];
    // Symmetric in exact arithmetic; the mean of the three removes what the differences leave.
    let third = |[i, j, k]: [usize; 3]| (slopes[k][(i, j)] + slopes[j][(i, k)] + slopes[i][(j, k)]) / 3.0;
    let jet = EnergyJet {
        control_m,
        energy_j: f64::from(found.energy_j?),
        force_n: found.force_n.map(f64::from),
        stiffness_n_m,
        third_n_m2: THIRD_INDICES.map(third),
    };
    jet.is_finite().then_some(jet)
}

/// Jets of a table where the tool presses with at most `max_force_n`, that at rest first, and the distance within
/// which every position between them has one, m.
pub(super) fn jets(space: &Space<'_>, method: Method, max_force_n: f64) -> (Vec<EnergyJet>, f64) {
    let normal = space.active.outward_normal.map(f64::from);
    let Some(rest) = jet(space, method, [0.0; 3]) else { return (Vec::new(), 0.0) };
    let mut spacing_m = SPACING_M;
    loop {
        let reach = (f64::from(space.lattice().radius_m()) / spacing_m).floor() as i32;
        let all = (-reach..=reach)
            .flat_map(|i| (-reach..=reach).flat_map(move |j| (-reach..=reach).map(move |k| [i, j, k])));
        let places = all.map(|index| index.map(|n| f64::from(n) * spacing_m));
        let presses = |jet: &EnergyJet| {
            norm(jet.force_n) <= max_force_n && dot(jet.force_n, normal) <= 0.0 && jet.control_m != [0.0; 3]
        };
        let mut found = vec![rest];
        found.extend(places.filter_map(|at_m| jet(space, method, at_m)).filter(presses).take(MOST));
        if found.len() <= MOST {
            return (found, HALF_DIAGONAL * spacing_m);
        }
        spacing_m *= COARSER;
    }
}

/// The jet with the largest force within the distance where the model is checked.
pub(super) fn hardest(jets: &[EnergyJet]) -> Option<&EnergyJet> {
    let within = jets.iter().filter(|jet| norm(jet.control_m) <= CHECKED_M);
    within.max_by(|a, b| norm(a.force_n).total_cmp(&norm(b.force_n)))
}

/// Whether a table has the force of the model, as far as it can be felt.
pub(super) fn is_force_of_model(table: &EnergyJet, solved_n: [f64; 3]) -> bool {
    distance(table.force_n, solved_n) <= Tolerance::IMPERCEPTIBLE.at(solved_n)
}

/// Whether a table's jet at rest is that of the model, by its stiffness.
pub(super) fn is_of_model(table: &EnergyJet, solved: &Trust) -> bool {
    let difference = table.stiffness_n_m - solved.jet.stiffness_n_m;
    difference.norm() <= SAME_STIFFNESS * solved.jet.stiffness_n_m.norm()
}
