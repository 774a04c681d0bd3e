//! Compares predictions with the results of a solved `.space`, and of the blob packed from it.

use std::path::Path;

use palpate_core::{Method, Organ};
use palpate_precompute::space::Store;
use serde::Serialize;

use super::node::NodePlan;
use super::row::{bytes, seconds};
use super::tables::other_bytes;
use crate::blob;
use crate::cmd::inspect::certificate;
use crate::failure::Failure;

/// Allowed factor between prediction and result.
pub(super) const FACTOR: f64 = 2.0;

/// One figure.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Compared {
    /// Name of the quantity, with its node.
    pub what: String,
    /// Predicted value.
    pub predicted: f64,
    /// Actual value.
    pub happened: f64,
    /// N, B, s or 1.
    pub unit: &'static str,
}

impl Compared {
    /// Prediction divided by result.
    pub(super) fn ratio(&self) -> f64 {
        self.predicted / self.happened
    }

    /// Whether it is within the factor in either direction.
    pub(super) fn holds(&self) -> bool {
        let ratio = self.ratio();
        (1.0 / FACTOR..=FACTOR).contains(&ratio)
    }
}

/// The plans of the probed nodes, by their number in the scene. Other nodes have the mean of these.
pub(super) struct Predicted<'p> {
    /// The plans.
    pub nodes: &'p [NodePlan],
    /// Spacing of the scene's lattice, m; `None` if it is scattered.
    pub spacing_m: Option<f64>,
    /// Surface vertices and triangles.
    pub skin: [usize; 2],
    /// Peak memory of the row that the scene specifies, bytes.
    pub memory_bytes: f64,
}

impl Predicted<'_> {
    fn mean_of(&self, active: usize, figure: impl Fn(&NodePlan) -> f64) -> f64 {
        let own: Vec<&NodePlan> = self.nodes.iter().filter(|node| node.probed.active == active).collect();
        let these = if own.is_empty() { self.nodes.iter().collect() } else { own };
        these.iter().map(|node| figure(node)).sum::<f64>() / these.len().max(1) as f64
    }

    fn asked<T>(&self, node: &NodePlan, figure: impl Fn(&super::node::Choice) -> T) -> Option<T> {
        node.choice(self.spacing_m).map(figure)
    }

    /// Compares everything that `store` contains, and `blob` if there is one.
    pub(super) fn compare(&self, store: &Store, blob: Option<&Path>) -> Result<Vec<Compared>, Failure> {
        let mut all = Vec::new();
        let mut solved_nodes = Vec::new();
        for (active, (name, _)) in store.active()?.into_iter().enumerate() {
            let solved = store.records(active)?.iter().filter(|r| r.tag().is_solved()).count();
            if solved < 2 {
                continue;
            }
            solved_nodes.push((active, name.clone()));
            let of = |figure: fn(&super::node::Choice) -> f64| {
                self.mean_of(active, |node| self.asked(node, figure).unwrap_or(f64::NAN))
            };
            all.push(Compared {
                what: format!("{name}: configurations"),
                predicted: of(|c| c.configurations),
                happened: solved as f64,
                unit: "1",
            });
            all.push(Compared {
                what: format!("{name}: seconds of solving"),
                predicted: of(|c| c.solving_s),
                happened: store.attempts(active)?.iter().map(|r| r.seconds).sum(),
                unit: "s",
            });
        }
        if let Some(bytes) = store.peak()? {
            all.push(Compared {
                what: "memory".into(),
                predicted: self.memory_bytes,
                happened: bytes as f64,
                unit: "B",
            });
        }
        if let Some(path) = blob {
            self.compare_blob(path, &solved_nodes, &mut all)?;
        }
        Ok(all)
    }

    fn compare_blob(
        &self,
        path: &Path,
        nodes: &[(usize, String)],
        all: &mut Vec<Compared>,
    ) -> Result<(), Failure> {
        let file = blob::load(path)?;
        let organ: Organ<'_> = blob::organ(path, &file)?;
        let certificate = certificate::of(path, &organ)?;
        let Some(space) = organ.spaces.first() else { return Ok(()) };
        let methods: Vec<Method> = Method::ALL.into_iter().filter(|&method| space.has(method)).collect();
        let visual = space.displacement().is_some();
        let mut predicted =
            other_bytes(self.skin, nodes.len(), certificate.is_some().then_some(methods.len())) as f64;
        for (active, _) in nodes {
            predicted += self.mean_of(*active, |node| {
                let eye = node.eye.as_ref().filter(|_| visual);
                self.asked(node, |c| c.bytes(&methods, eye) as f64).unwrap_or(f64::NAN)
            });
        }
        all.push(Compared { what: "blob".into(), predicted, happened: file.bytes().len() as f64, unit: "B" });
        for space in certificate.iter().flat_map(|certificate| &certificate.spaces) {
            let Some((active, name)) = nodes.iter().find(|(_, name)| *name == space.active) else { continue };
            for method in &space.methods {
                let of = |node: &NodePlan| self.asked(node, |c| c.of(&method.method)).flatten();
                if self.nodes.iter().all(|node| of(node).is_none()) {
                    continue;
                }
                let what = |figure| format!("{name}: {figure} of {}", method.method);
                all.push(Compared {
                    what: what(if method.folded.count > 0 {
                        "error at p99 away from branch jumps"
                    } else {
                        "error at p99"
                    }),
                    predicted: self
                        .mean_of(*active, |node| of(node).map_or(f64::NAN, |(error, _)| error.p99_n)),
                    happened: method.uniform.p99_n,
                    unit: "N",
                });
                all.push(Compared {
                    what: what("tick"),
                    predicted: self.mean_of(*active, |node| of(node).map_or(f64::NAN, |(_, ns)| ns)),
                    happened: method.probe.nanoseconds,
                    unit: "ns",
                });
            }
        }
        Ok(())
    }
}

/// The table as text.
pub(super) fn in_words(all: &[Compared]) -> String {
    let mut text = format!("  {:<34} {:>12} {:>12} {:>7}\n", "", "predicted", "happened", "ratio");
    for c in all {
        let value = |x: f64| match c.unit {
            "s" => format!("{} s", seconds(x)),
            "B" => bytes(x),
            "N" => format!("{:.2} mN", 1e3 * x),
            "ns" => format!("{x:.0} ns"),
            _ => format!("{x:.0}"),
        };
        let verdict = if c.holds() { "" } else { "  beyond a factor of 2" };
        text.push_str(&format!(
            "  {:<34} {:>12} {:>12} {:>7.2}{verdict}\n",
            c.what,
            value(c.predicted),
            value(c.happened),
            c.ratio()
        ));
    }
    let held = all.iter().filter(|c| c.holds()).count();
    text.push_str(&format!("{held} of {} within a factor of {FACTOR:.0}", all.len()));
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_factor_of_two_either_way() {
        let compared = |predicted| Compared { what: "A: x".into(), predicted, happened: 10.0, unit: "1" };
        let holds: Vec<bool> = [4.9, 5.0, 10.0, 20.0, 20.1, f64::NAN].map(|x| compared(x).holds()).into();
        assert_eq!(holds, [false, true, true, true, false, false]);
        let text = in_words(&[compared(8.0), compared(30.0)]);
        assert!(
            text.contains("0.80")
                && text.contains("beyond a factor of 2")
                && text.ends_with("1 of 2 within a factor of 2"),
            "{text}"
        );
    }
}
