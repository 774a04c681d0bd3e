//! The spaces that answer at a held-out position: one, or between contact points three with their weights.

use palpate_core::{Coverage, Method, Organ, Space};

use super::branch_jump::has_branch_jump;
use crate::held_out::{Draw, Places};
use crate::space::{Kind, Store, StoreError, Walk};

/// Numbers of spaces with their weights, of sum 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Blend {
    parts: [(usize, f32); 3],
}

impl Blend {
    /// This space alone.
    pub(crate) const fn alone(space: usize) -> Self {
        Self { parts: [(space, 1.0), (space, 0.0), (space, 0.0)] }
    }

    pub(super) fn is_alone(&self) -> bool {
        self.parts.iter().any(|(_, weight)| *weight == 1.0)
    }

    pub(super) fn parts<'s, 'a>(
        &self,
        spaces: &'s [Space<'a>],
    ) -> impl Iterator<Item = (&'s Space<'a>, f32)> {
        let parts = self.parts.into_iter().filter(|(_, weight)| *weight > 0.0);
        parts.map(|(space, weight)| (&spaces[space], weight))
    }

    /// Force of a method, N, and whether its own data surround the displacement in every space; `None` if a
    /// space lacks the method.
    pub(super) fn force(
        &self,
        spaces: &[Space<'_>],
        method: Method,
        displacement_m: [f32; 3],
    ) -> Option<([f32; 3], bool)> {
        let (mut sum, mut covered) = ([0.0; 3], true);
        for (space, weight) in self.parts(spaces) {
            let found = space.force(method, displacement_m)?;
            covered &= found.coverage != Coverage::Extrapolated;
            for (sum, h) in sum.iter_mut().zip(found.force_n) {
                *sum += weight * h;
            }
        }
        Some((sum, covered))
    }

    /// Whether the displacement is in the ball of every space.
    pub(super) fn is_inside(&self, spaces: &[Space<'_>], displacement_m: [f32; 3]) -> bool {
        self.parts(spaces).all(|(space, _)| space.lattice().locate(displacement_m).inside)
    }

    pub(super) fn has_branch_jump(&self, spaces: &[Space<'_>], displacement_m: [f32; 3]) -> bool {
        self.parts(spaces).any(|(space, _)| has_branch_jump(space, displacement_m))
    }
}

/// The blends at the held-out positions of a blob.
pub(crate) struct Blends {
    /// Space of each active node of the store, if it is packed.
    space_of: Vec<Option<usize>>,
    names: Vec<String>,
    between: Option<(Places, Draw)>,
}

impl Blends {
    /// For a blob that was packed from `store`.
    pub(crate) fn of(store: &Store, organ: &Organ<'_>) -> Result<Self, StoreError> {
        let names: Vec<String> = store.active()?.into_iter().map(|(name, _)| name).collect();
        let find = |name: &String| organ.spaces.iter().position(|space| *space.active.name == **name);
        let places = Places::of(store.identity()?.contacts, &store.body()?.0);
        Ok(Self { space_of: names.iter().map(find).collect(), names, between: places.zip(Draw::of(store)?) })
    }

    /// The blend at a position of a walk. Only uniform positions are between contact points. `None` if a space
    /// is not packed.
    pub(crate) fn at(&self, walk: &Walk) -> Option<Blend> {
        let active = walk.active as usize;
        let place = self.between.as_ref().filter(|_| walk.kind == Kind::Uniform);
        let place =
            place.and_then(|(places, draw)| places.drawn(draw, active, &self.names[active], walk.number));
        let Some(place) = place else { return Some(Blend::alone(self.space_of[active]?)) };
        let [a, b, c] = place.corners.map(|corner| self.space_of[corner as usize]);
        let spaces = [a?, b?, c?];
        Some(Blend { parts: std::array::from_fn(|k| (spaces[k], place.weights[k] as f32)) })
    }
}
