//! Compares a saved prediction with the results in a solved `.space`, and in the blob packed from it.

use palpate_core::{Method, Organ};
use serde::Serialize;

use super::prediction::{Interval, Line, Prediction};
use crate::certificate::Certificate;
use crate::space::{Store, StoreError, state};

/// One predicted quantity.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Compared {
    /// Name of the quantity, with its node.
    pub what: String,
    /// Predicted interval.
    pub predicted: Interval,
    /// Actual value.
    pub happened: f64,
    /// N, B, s, ns or 1.
    pub unit: &'static str,
    /// Whether the value is inside the interval.
    pub inside: bool,
}

/// The comparison.
#[derive(Debug, Default, Serialize)]
pub struct Comparison {
    /// The quantities.
    pub lines: Vec<Compared>,
    /// What is not compared, and lattices that took over.
    pub notes: Vec<String>,
}

/// A blob packed from the space.
#[derive(Debug, Clone, Copy)]
pub struct PackedBlob<'b> {
    /// View of its content.
    pub organ: &'b Organ<'b>,
    /// Its certificate, if it has one.
    pub certificate: Option<&'b Certificate>,
    /// Size of the file, bytes.
    pub bytes: usize,
}

/// Compares every finished node of `store`, and `blob` if there is one.
pub fn compare(
    prediction: &Prediction,
    store: &Store,
    blob: Option<&PackedBlob<'_>>,
) -> Result<Comparison, StoreError> {
    let mut all = Comparison::default();
    let (mut tried, mut kept, mut solving_s, mut is_finished) = (0.0, 0.0, 0.0, true);
    let mut lattices = 0.0;
    let nodes = store.active()?;
    for (active, (name, _)) in nodes.iter().enumerate() {
        let state = state(store, active)?;
        if state.open > 0 {
            all.notes.push(format!("{name}: not finished, not compared"));
            is_finished = false;
            continue;
        }
        let attempts = store.attempts(active)?;
        let solved = store.records(active)?.iter().filter(|record| record.tag().is_solved()).count();
        let of_node = [attempts.len() as f64, solved as f64, attempts.iter().map(|a| a.seconds).sum::<f64>()];
        tried += of_node[0];
        kept += of_node[1];
        solving_s += of_node[2];
        let Some(line) = prediction.of_node(name) else {
            all.notes.push(format!("{name}: not in the prediction"));
            continue;
        };
        all.solves(name, line, of_node);
        if state.fallback().is_some() {
            lattices += 1.0;
            let probability = line.lattice.map_or(0.0, |lattice| lattice.probability);
            all.notes.push(format!(
                "{name}: a lattice took over, predicted with probability {:.0} %",
                100.0 * probability
            ));
        }
    }
    if is_finished && nodes.len() > 1 {
        all.solves(&prediction.total.of, &prediction.total, [tried, kept, solving_s]);
        all.add("nodes with a lattice that took over".into(), prediction.lattices, lattices, "1");
    }
    if let Some(peak) = store.peak()? {
        all.add("memory".into(), prediction.memory_bytes, peak as f64, "B");
    }
    if let Some(blob) = blob {
        all.blob(prediction, blob, nodes.len());
    }
    Ok(all)
}

impl Comparison {
    fn add(&mut self, what: String, predicted: Interval, happened: f64, unit: &'static str) {
        let inside = predicted.contains(happened);
        self.lines.push(Compared { what, predicted, happened, unit, inside });
    }

    fn solves(&mut self, name: &str, line: &Line, [tried, kept, solving_s]: [f64; 3]) {
        self.add(format!("{name}: solves tried"), line.tried, tried, "1");
        self.add(format!("{name}: configurations kept"), line.kept, kept, "1");
        self.add(format!("{name}: seconds of solving"), line.seconds, solving_s, "s");
    }

    fn blob(&mut self, prediction: &Prediction, blob: &PackedBlob<'_>, nodes: usize) {
        let PackedBlob { organ, certificate, bytes } = *blob;
        let others = [Method::Trilinear, Method::RbfLinear, Method::RbfCubic, Method::Kernel];
        let has_others = organ.spaces.iter().any(|space| others.iter().any(|&method| space.has(method)));
        if has_others || organ.spaces.len() < nodes {
            self.notes.push(
                "blob: the prediction is for all nodes with the method `energy` alone, sizes are not compared".into(),
            );
        } else {
            let missing = if certificate.is_some() { 0.0 } else { prediction.certificate_bytes };
            let predicted = prediction.total.blob_bytes.less(missing);
            self.add("blob".into(), predicted, bytes as f64, "B");
        }
        let mut slowest_ns: Option<f64> = None;
        for space in certificate.iter().flat_map(|certificate| &certificate.spaces) {
            let Some(measured) = space.methods.iter().find(|m| m.method == Method::Energy.name()) else {
                continue;
            };
            slowest_ns = Some(slowest_ns.unwrap_or(0.0).max(measured.probe.nanoseconds));
            if let Some(p99_n) = prediction.of_node(&space.active).and_then(|line| line.p99_n) {
                let away = if measured.at_branch_jumps.count > 0 { " away from branch jumps" } else { "" };
                self.add(format!("{}: error at p99{away}", space.active), p99_n, measured.uniform.p99_n, "N");
            }
        }
        if let (Some(predicted), Some(happened)) = (prediction.query_ns, slowest_ns) {
            self.add("query".into(), predicted, happened, "ns");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::prediction::tests::ended;
    use super::*;

    #[test]
    fn a_value_is_inside_its_interval_or_not() {
        let prediction = ended(2);
        let mut all = Comparison::default();
        let line = prediction.of_node("A1").expect("probed");
        all.solves("A1", line, [11.0, 9.0, line.seconds.likely]);
        assert_eq!(all.lines.iter().map(|line| line.inside).collect::<Vec<_>>(), [true, false, true]);
    }
}
