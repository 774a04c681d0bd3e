//! How deep a lump can be felt: a ball under one place, for several depths, sizes and ratios of stiffness.

use super::{Ball, Compared, Goal, Inclusion, InclusionError, MapError, Mapped, Place, Work};
use crate::scene::ResolvedScene;

/// The balls under a place: every combination.
#[derive(Debug, Clone, PartialEq)]
pub struct Sweep {
    /// Tissue between the skin and the ball along the inward normal, m.
    pub covers_m: Vec<f64>,
    /// Radii, m.
    pub radii_m: Vec<f64>,
    /// Stiffness of the ball over that of the tissue.
    pub ratios: Vec<f64>,
}

/// One ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepRow {
    /// Tissue between the skin and the ball, m.
    pub cover_m: f64,
    /// Radius, m.
    pub radius_m: f64,
    /// Ratio of stiffness.
    pub ratio: f64,
    /// What was found; `None` if the ball does not fit into the body there.
    pub found: Option<SweepFound>,
}

/// The comparison of the forces above a ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepFound {
    /// Number of tets of the ball.
    pub tets: usize,
    /// Their volume over that of the ball.
    pub volume_share: f64,
    /// Stiffness at rest with the ball, N/m.
    pub stiffness_n_m: f64,
    /// Whether the push reached the wanted force.
    pub reached: bool,
    /// The forces with and without the ball; `None` if a push failed.
    pub compared: Option<Compared>,
}

impl Sweep {
    /// Pushes at `place` with every ball under it, in the order of covers, radii and ratios.
    pub fn run(
        &self,
        scene: &ResolvedScene,
        place: &Place,
        goal: &Goal,
        work: Work<'_>,
    ) -> Result<Vec<SweepRow>, MapError> {
        let mut balls = Vec::new();
        for &cover_m in &self.covers_m {
            for &radius_m in &self.radii_m {
                balls.extend(self.ratios.iter().map(|&ratio| (cover_m, radius_m, ratio)));
            }
        }
        work.all(&balls, |&(cover_m, radius_m, ratio)| {
            let along = cover_m + radius_m;
            let centre_m = std::array::from_fn(|k| place.position_m[k] + along * place.inward[k]);
            let found = match Inclusion::ball(scene, Ball { centre_m, radius_m, ratio }) {
                Ok(inclusion) => Some(found(&inclusion, radius_m, place, goal)?),
                Err(InclusionError::Outside(_) | InclusionError::ThroughSkin { .. }) => None,
                Err(error) => return Err(error.into()),
            };
            Ok(SweepRow { cover_m, radius_m, ratio, found })
        })
    }
}

fn found(inclusion: &Inclusion, radius_m: f64, place: &Place, goal: &Goal) -> Result<SweepFound, MapError> {
    let mapped = Mapped::new(&inclusion.with, Some(&inclusion.without))?;
    let push = mapped.push(place, goal)?;
    Ok(SweepFound {
        tets: inclusion.tets.len(),
        volume_share: inclusion.volume_m3 / (4.0 / 3.0 * std::f64::consts::PI * radius_m.powi(3)),
        stiffness_n_m: push.press.stiffness_n_m(),
        reached: push.depth_m.is_some(),
        compared: push.compared,
    })
}
