//! The rows of the plan, and the recommended row.

use serde::Serialize;

use super::model::ComparedModel;

/// Required share of the positions within the tolerance.
const REQUIRED_SHARE: f64 = 0.99;

/// One choice for all active nodes of the scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Shape functions and pressure, or the linear law.
    pub model: String,
    /// Spacing of the lattice, m; `None` if positions are scattered.
    pub spacing_m: Option<f64>,
    /// Method of the tables.
    pub method: &'static str,
    /// Configurations of all nodes.
    pub configurations: f64,
    /// Seconds of the solves, with all threads.
    pub solving_s: f64,
    /// Peak memory, bytes.
    pub memory_bytes: f64,
    /// Size of the blob, bytes.
    pub blob_bytes: f64,
    /// Time of a query, ns.
    pub nanoseconds: f64,
    /// 99th percentile of the force's error against the finite elements of this model, N.
    pub p99_n: f64,
    /// Share of the reachable positions with an error within the tolerance.
    pub within: f64,
    /// How much stiffer it feels than the most accurate model of second order, minus 1: at a push for a tool with
    /// a size, at rest for a point. `None` if that was not solved.
    pub stiffer: Option<f64>,
    /// Whether the scene specifies this row.
    pub asked: bool,
    /// Whether this row is recommended.
    pub recommended: bool,
    /// Whether it is extrapolated from coarser lattices or from a solve at rest alone.
    pub extrapolated: bool,
}

impl Row {
    /// A message that this row of another model is both faster and softer than the chosen row, which has the
    /// scene's model; empty if it is not.
    pub(super) fn reason_against(&self, chosen: &Self) -> String {
        let is_softer = matches!((self.stiffer, chosen.stiffer), (Some(own), Some(other)) if own <= other);
        if self.solving_s >= chosen.solving_s || !is_softer {
            return String::new();
        }
        format!(
            "; {} would take {:.0} % of that time and is not stiffer",
            self.model,
            100.0 * self.solving_s / chosen.solving_s
        )
    }

    fn is_enough(&self) -> bool {
        self.within >= REQUIRED_SHARE
    }

    /// The same sampling of another model.
    pub(super) fn with(
        &self,
        words: String,
        beside: &ComparedModel,
        stiffer: Option<f64>,
        memory_bytes: f64,
    ) -> Self {
        Self {
            model: words,
            solving_s: self.solving_s * beside.times,
            memory_bytes,
            stiffer,
            asked: false,
            recommended: false,
            extrapolated: true,
            ..self.clone()
        }
    }
}

/// Marks the linear law if it is within the tolerance. Otherwise marks the cheapest row within it, by seconds
/// and then by bytes, or else the row with the smallest error. Returns the reason.
pub(super) fn recommend(rows: &mut [Row], tolerance: &str) -> (usize, String) {
    let cost = |row: &Row| (row.solving_s, row.blob_bytes);
    // A linear law needs no search for configurations: within the tolerance it is the choice, independently
    // of the measured times.
    let rank = |n: usize| (rows[n].model != LINEAR, cost(&rows[n]));
    let cheapest = (0..rows.len()).filter(|&n| rows[n].is_enough()).min_by(|&a, &b| {
        let ((law, (s, bytes)), (other_law, (other_s, other))) = (rank(a), rank(b));
        law.cmp(&other_law).then(s.total_cmp(&other_s)).then(bytes.total_cmp(&other))
    });
    let closest = || (0..rows.len()).max_by(|&a, &b| rows[a].within.total_cmp(&rows[b].within)).unwrap_or(0);
    let chosen = cheapest.unwrap_or_else(closest);
    let row = &mut rows[chosen];
    row.recommended = true;
    let (mn, share) = (1e3 * row.p99_n, 100.0 * row.within);
    // The errors are against the finite elements of the same model.
    let beside =
        row.stiffer.filter(|stiffer| stiffer.abs() > MIN_DIFFERENCE).map_or_else(String::new, |stiffer| {
            format!(
                " of that model, which itself is {:+.0} % stiffer than quadratic elements",
                100.0 * stiffer
            )
        });
    let why = match cheapest {
        Some(_) if row.model == LINEAR => {
            format!(
                "small displacements: a linear model is within {tolerance} ({mn:.1} mN at p99), and each of its solves is one iteration"
            )
        }
        Some(_) => {
            format!(
                "the shortest solve time with the scene's own model within {tolerance}: {mn:.1} mN at p99{beside}"
            )
        }
        None => format!(
            "no choice is within {tolerance} at 99 % of the positions; this one is the closest, with {share:.1} %. A smaller radius_m \
             or max_force_n would help"
        ),
    };
    (chosen, why)
}

/// Models whose stiffness differs more than this from that of quadratic elements are mentioned.
const MIN_DIFFERENCE: f64 = 0.1;

/// The name of the row with the linear law.
pub(super) const LINEAR: &str = "linear law";

#[cfg(test)]
mod tests {
    use super::*;

    fn row(solving_s: f64, blob_bytes: f64, within: f64) -> Row {
        Row {
            model: "P1/P1".into(),
            spacing_m: Some(0.01),
            method: "energy",
            configurations: 10.0,
            solving_s,
            memory_bytes: 1e8,
            blob_bytes,
            nanoseconds: 100.0,
            p99_n: 0.01,
            within,
            stiffer: Some(0.9),
            asked: false,
            recommended: false,
            extrapolated: false,
        }
    }

    #[test]
    fn the_cheapest_within_the_tolerance_is_recommended() {
        let mut rows =
            [row(1.0, 10.0, 0.95), row(5.0, 30.0, 0.999), row(5.0, 20.0, 0.995), row(9.0, 1.0, 1.0)];
        let (chosen, why) = recommend(&mut rows, "the JND of force");
        assert_eq!(chosen, 2);
        assert!(rows[2].recommended && why.contains("10.0 mN"), "{why}");
        let mut none = [row(1.0, 1.0, 0.5), row(2.0, 1.0, 0.7)];
        let (chosen, why) = recommend(&mut none, "the JND of force");
        assert!(chosen == 1 && why.contains("70.0 %"), "{why}");
    }

    #[test]
    fn the_linear_law_is_called_by_its_name() {
        let mut rows = [row(5.0, 1.0, 1.0), Row { model: LINEAR.into(), ..row(6.0, 1.0, 1.0) }];
        let (chosen, why) = recommend(&mut rows, "the JND of force");
        assert!(chosen == 1 && why.contains("small displacements: a linear model"), "{why}");
    }
}
