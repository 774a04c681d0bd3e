//! The error of the discretisation: the force of a scene's elements against that of more accurate ones.
//!
//! It is apart from the errors of interpolation, which are differences from the force of the same elements. A
//! tool with a size has a force that converges under refinement, so a finer model of the same scene measures
//! it. The force of a single node does not converge.

use serde::{Deserialize, Serialize};

use super::{Reason, Verdict};
use crate::num::vector::{distance, norm};
use crate::space::{Store, StoreError};
use crate::spec::{Tolerance, percent_in_words};

/// Forces of the scene's elements and of more accurate ones at some held-out positions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Discretisation {
    /// Elements of the scene, such as "P1/P1".
    pub elements: String,
    /// The more accurate model.
    pub reference: String,
    /// Mean edge of the triangles of the skin within the radius of the tool at these positions, m.
    pub edge_m: f64,
    /// Radius of the tool, m.
    pub radius_m: f64,
    /// What the scene tolerates.
    pub tolerance: Tolerance,
    /// The positions that both models solved.
    pub positions: Vec<FinerForce>,
    /// Number of positions that the more accurate model did not solve.
    pub unsolved: usize,
    /// Number of those whose place another position took; 0 in files of earlier versions, which replaced none.
    #[serde(default)]
    pub replaced: usize,
}

/// One position.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FinerForce {
    /// The active node.
    pub active: String,
    /// Number of the uniform position.
    pub number: u32,
    /// Displacement of the tool, m.
    pub displacement_m: [f64; 3],
    /// Force of the scene's elements, N.
    pub force_n: [f64; 3],
    /// Force of the more accurate ones, N.
    pub finer_n: [f64; 3],
    /// Wall time of the more accurate solve from rest, s.
    pub seconds: f64,
}

impl FinerForce {
    /// How much stiffer the scene's elements are: (|h| - |h'|) / |h'|.
    pub fn stiffer(&self) -> f64 {
        norm(self.force_n) / norm(self.finer_n) - 1.0
    }

    /// |h - h'| / |h'|.
    pub fn relative(&self) -> f64 {
        distance(self.force_n, self.finer_n) / norm(self.finer_n)
    }
}

impl Discretisation {
    /// Where a space keeps it, as JSON, until its held-out positions are drawn again.
    const KEY: &str = "held_out_discretisation";

    /// The stored one of a space.
    pub(crate) fn stored(store: &Store) -> Result<Option<Self>, StoreError> {
        let Some(text) = store.kept(Self::KEY)? else { return Ok(None) };
        let unreadable = |error| store.corrupt(format!("its `{}` cannot be read ({error})", Self::KEY));
        serde_json::from_str(&text).map(Some).map_err(unreadable)
    }

    /// Keeps it in its space.
    pub(crate) fn keep_in(&self, store: &Store) -> Result<(), StoreError> {
        store.keep(Self::KEY, &serde_json::to_string(self).expect("numbers and names"))
    }

    /// Mean of [`FinerForce::stiffer`].
    pub fn stiffer(&self) -> f64 {
        self.positions.iter().map(FinerForce::stiffer).sum::<f64>() / self.positions.len() as f64
    }

    /// Largest [`FinerForce::relative`].
    pub fn largest(&self) -> f64 {
        self.positions.iter().map(FinerForce::relative).fold(0.0, f64::max)
    }

    /// Green if as many positions were solved as are wanted, all within the tolerance. An error of the mesh is a
    /// stiffness that the tissue does not have, not a fault of the numbers: so it is never red.
    pub fn verdict(&self) -> Verdict {
        let is_within = |of: &FinerForce| distance(of.force_n, of.finer_n) <= self.tolerance.at(of.finer_n);
        let all = !self.positions.is_empty() && self.unsolved == self.replaced;
        if all && self.positions.iter().all(is_within) { Verdict::Green } else { Verdict::Yellow }
    }

    /// The reason to distrust the forces of a mesh, from its measurement and whether the tool has a size.
    pub(super) fn doubt(measured: Option<&Self>, has_size: bool) -> Option<Reason> {
        let yellow = |what: String| Some(Reason { verdict: Verdict::Yellow, what });
        match measured {
            _ if !has_size => yellow(
                "the tool holds nodes, so its force depends on the mesh; that of a fingertip converges ([tool] shape = \"fingertip\")".into(),
            ),
            None => yellow("the error of the discretisation was not measured".into()),
            Some(of) if of.verdict() == Verdict::Green => None,
            Some(of) => yellow(format!(
                "{}; the tolerance is {} %: use {}",
                of.in_words(),
                percent_in_words(of.tolerance.relative),
                of.remedy()
            )),
        }
    }

    /// What makes the elements more accurate.
    fn remedy(&self) -> &'static str {
        match &self.elements[..] {
            linear if linear.starts_with("P1") => "order = \"tool\" or 2, or [mesh] refine = \"tool\"",
            near_tool if near_tool.ends_with("near tool") => "order = 2, or [mesh] refine = \"tool\"",
            _ => "[mesh] refine = \"tool\" with a smaller refine_edge_m",
        }
    }

    /// One line: elements, their size, and what they cost.
    pub fn in_words(&self) -> String {
        let Self { elements, reference, edge_m, radius_m, .. } = self;
        let size = format!("{elements}, h = {:.2} a", edge_m / radius_m);
        let unsolved = match (self.unsolved, self.replaced) {
            (0, _) => String::new(),
            (some, all) if some == all => {
                format!("; {some} more not solved by it and replaced, error unknown there")
            }
            (some, part) => {
                format!("; {some} more not solved by it, {part} of them replaced, error unknown there")
            }
        };
        let count = self.positions.len();
        if count == 0 {
            return format!("{size}: not measured{unsolved}");
        }
        let percent = 100.0 * self.stiffer();
        let (size_of_it, word) = (percent.abs(), if percent < 0.0 { "soft" } else { "stiff" });
        let digits = usize::from(size_of_it < 10.0);
        format!(
            "{size}: {size_of_it:.digits$} % too {word} on average, at most {:.digits$} %, against {reference} at {count} \
             held-out positions{unsolved}",
            100.0 * self.largest()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(force_n: f64, finer_n: f64) -> FinerForce {
        FinerForce {
            active: "A".into(),
            number: 0,
            displacement_m: [0.0, 0.0, -5e-3],
            force_n: [0.0, 0.0, force_n],
            finer_n: [0.0, 0.0, finer_n],
            seconds: 1.0,
        }
    }

    fn of(positions: &[FinerForce]) -> Discretisation {
        Discretisation {
            elements: "P1".into(),
            reference: "P2".into(),
            edge_m: 8.4e-3,
            radius_m: 0.01,
            tolerance: Tolerance { relative: 0.08, absolute_n: 0.02 },
            positions: positions.to_vec(),
            unsolved: 0,
            replaced: 0,
        }
    }

    #[test]
    fn the_line_says_what_the_mesh_costs() {
        let stiff = of(&[at(-1.36, -1.0), at(-1.5, -1.0)]);
        assert_eq!(
            stiff.in_words(),
            "P1, h = 0.84 a: 43 % too stiff on average, at most 50 %, against P2 at 2 held-out positions"
        );
        assert_eq!(stiff.verdict(), Verdict::Yellow);
        let close = of(&[at(-1.079, -1.0), at(-0.11, -0.1)]);
        assert_eq!(close.verdict(), Verdict::Green, "8 %, and 10 mN of a small force");
        assert_eq!(of(&[at(-1.09, -1.0)]).verdict(), Verdict::Yellow);
        assert_eq!(of(&[at(-1.0, -1.0), at(-1.09, -1.0)]).verdict(), Verdict::Yellow, "one of two is enough");
        assert_eq!(Discretisation::doubt(Some(&close), true), None);
        let strict = Tolerance { relative: 0.035, absolute_n: 0.02 };
        let strict = Discretisation { tolerance: strict, ..stiff.clone() };
        let said = Discretisation::doubt(Some(&strict), true).expect("a reason").what;
        assert!(said.contains("the tolerance is 3.5 %: use"), "{said}");
        let doubt = |measured, has_size| Discretisation::doubt(measured, has_size).expect("a reason");
        assert!(
            doubt(Some(&stiff), true)
                .what
                .ends_with("the tolerance is 8 %: use order = \"tool\" or 2, or [mesh] refine = \"tool\"")
        );
        assert!(
            doubt(None, true).what.contains("not measured")
                && doubt(None, false).what.contains("depends on the mesh")
        );
        assert!(of(&[at(-0.95, -1.0)]).in_words().contains("5.0 % too soft"));
        assert_eq!(of(&[]).verdict(), Verdict::Yellow);
        assert_eq!(of(&[]).in_words(), "P1, h = 0.84 a: not measured");
    }

    #[test]
    fn green_needs_a_position_in_place_of_each_that_was_not_solved() {
        let close = of(&[at(-1.02, -1.0), at(-1.03, -1.0)]);
        let lacking = |unsolved, replaced| Discretisation { unsolved, replaced, ..close.clone() };
        assert_eq!(lacking(2, 2).verdict(), Verdict::Green);
        assert!(
            lacking(2, 2).in_words().ends_with(
                "at 2 held-out positions; 2 more not solved by it and replaced, error unknown there"
            )
        );
        assert_eq!(lacking(1, 0).verdict(), Verdict::Yellow);
        assert_eq!(lacking(3, 2).verdict(), Verdict::Yellow);
        let doubt = Discretisation::doubt(Some(&lacking(3, 2)), true).expect("a reason");
        assert!(doubt.what.contains("3 more not solved by it, 2 of them replaced"), "{}", doubt.what);
        assert_eq!(of(&[]).verdict(), Verdict::Yellow, "none wanted");
    }

    #[test]
    fn a_file_of_an_earlier_version_is_read() {
        let now = Discretisation { unsolved: 1, ..of(&[at(-1.02, -1.0)]) };
        let mut json = serde_json::to_value(&now).expect("numbers and names");
        json.as_object_mut().expect("fields").remove("replaced").expect("the new one");
        let read: Discretisation = serde_json::from_value(json).expect("read");
        assert_eq!((&read, read.verdict()), (&now, Verdict::Yellow));
    }
}
