//! A plan, a prediction and its comparison as text.

use std::fmt::Write;

use palpate_precompute::pipeline::Analysis;
use palpate_precompute::plan::{Comparison, Interval, Line, Plan, PlannedNode, Prediction, Row};

use crate::cmd::inspect::certificate::significant;

/// The scene and its probes.
pub(super) fn nodes(plan: &Plan, analysis: &Analysis) -> String {
    let scene = &analysis.scene;
    let mut text = format!(
        "{}: {}, {}, {} of {} active nodes probed; tolerance {} % of |h| or {} mN\n",
        scene.name,
        scene.size_in_words(),
        analysis.body.law_names(),
        plan.nodes.len(),
        scene.active.len(),
        significant(100.0 * plan.tolerance.relative),
        significant(1e3 * plan.tolerance.absolute_n)
    );
    for node in &plan.nodes {
        let PlannedNode { name, reach_m: [near, far], .. } = node;
        text.push_str(&format!(
            "  {name}: {:.0} N/m at rest; {} probes reach {:.0} to {:.0} mm ({} beyond f_max, {} failed, {} on another branch; {} of {} on another branch from another start), {:.2} s each; error of a linear body \
             {:.0} mN (p99)\n",
            node.stiffness_n_m,
            node.probes,
            1e3 * near,
            1e3 * far,
            node.beyond,
            node.failed,
            node.on_another_branch,
            node.again_on_another_branch,
            node.again,
            node.far_s.iter().sum::<f64>() / node.far_s.len().max(1) as f64,
            1e3 * node.linear_p99_n
        ));
    }
    text
}

/// Model, sampling and method of a row.
pub(super) fn row(row: &Row) -> String {
    let sampling = match row.spacing_m {
        Some(spacing_m) => format!("spacing_m = {spacing_m:.4}"),
        None => "adaptive sampling".into(),
    };
    format!("{}, {sampling}, {}", row.model, row.method)
}

/// The rows as a table.
pub(super) fn table(rows: &[Row], threads: usize) -> String {
    let width = rows.iter().map(|row| row.model.len()).fold("model".len(), usize::max);
    let mut text = format!(
        "  {:<width$} {:<17} {:<10} {:>7} {:>9} {:>8} {:>9} {:>7} {:>9} {:>8} {:>9}\n",
        "model",
        "sampling",
        "method",
        "solves",
        "seconds",
        "memory",
        "blob",
        "tick ns",
        "p99 mN",
        "within",
        "stiffer"
    );
    for row in rows {
        let sampling =
            row.spacing_m.map_or("adaptive sampling".into(), |s| format!("lattice {:.2} mm", 1e3 * s));
        let mark = if row.recommended { '>' } else { ' ' };
        let about = if row.extrapolated { "~" } else { "" };
        let stiffer = row.stiffer.map_or("-".into(), |s| format!("{:+.0} %", 100.0 * s));
        let _ = writeln!(
            text,
            "{mark} {:<width$} {sampling:<17} {:<10} {:>7.0} {:>9} {:>8} {:>9} {:>7.0} {:>9} {:>7.1}% {stiffer:>9}{}",
            row.model,
            row.method,
            row.configurations,
            format!("{about}{}", seconds(row.solving_s / threads as f64)),
            bytes(row.memory_bytes),
            bytes(row.blob_bytes),
            row.nanoseconds,
            format!("{about}{:.2}", 1e3 * row.p99_n),
            100.0 * row.within,
            if row.asked { "  (as the scene asks)" } else { "" }
        );
    }
    text
}

/// Two significant digits.
fn seconds(s: f64) -> String {
    match s {
        s if s >= 100.0 => format!("{s:.0}"),
        s if s >= 10.0 => format!("{s:.1}"),
        s => format!("{s:.2}"),
    }
}

/// Formats a size in kB or MB.
fn bytes(b: f64) -> String {
    if b >= 1e7 {
        format!("{:.0} MB", b * 1e-6)
    } else if b >= 1e6 {
        format!("{:.1} MB", b * 1e-6)
    } else {
        format!("{:.0} kB", b * 1e-3)
    }
}

/// A number without decimals.
fn count(x: f64) -> String {
    format!("{x:.0}")
}

/// Newtons as millinewtons.
fn millinewtons(n: f64) -> String {
    let millinewtons = 1e3 * n;
    if millinewtons < 10.0 { format!("{millinewtons:.1}") } else { count(millinewtons) }
}

/// An interval, the median in brackets; one value if the ends do not differ.
fn interval(of: Interval, figure: impl Fn(f64) -> String) -> String {
    let [low, likely, high] = [of.low, of.likely, of.high].map(figure);
    if low == high { low } else { format!("{low} to {high} ({likely})") }
}

/// A prediction: a table with a row per node and for all, and the figures of the whole scene.
pub(super) fn prediction(prediction: &Prediction) -> String {
    let is_sum = prediction.nodes.len() > 1 || prediction.others.is_some();
    let nodes = prediction.nodes.iter().chain(&prediction.others).map(|line| (line, true));
    let lines = nodes.chain(is_sum.then_some((&prediction.total, false)));
    let heading = ["", "solves", "kept", "seconds", "tables", "p99 mN"].map(String::from);
    let cells = |(line, with_tables): (&Line, bool)| {
        [
            line.of.clone(),
            interval(line.tried, count),
            interval(line.kept, count),
            interval(line.seconds, seconds),
            if with_tables { interval(line.blob_bytes, bytes) } else { String::new() },
            line.p99_n.map_or_else(String::new, |p99_n| interval(p99_n, millinewtons)),
        ]
    };
    let rows: Vec<[String; 6]> = std::iter::once(heading).chain(lines.clone().map(cells)).collect();
    let mut text = String::from(
        "Prediction as the scene asks: 10 to 90 % of the outcomes (median); seconds on one thread\n",
    );
    text.push_str(&aligned(&rows));
    for (line, _) in lines {
        let Some(lattice) = &line.lattice else { continue };
        text.push_str(&format!(
            "  {}: with probability {:.0} % a lattice takes over: then {} solves, {} s\n",
            line.of,
            100.0 * lattice.probability,
            interval(lattice.tried, count),
            interval(lattice.seconds, seconds)
        ));
    }
    if is_sum && prediction.lattices.high > 0.0 {
        text.push_str(&format!("  a lattice takes over at {} nodes\n", interval(prediction.lattices, count)));
    }
    let [memory, blob] = [prediction.memory_bytes, prediction.total.blob_bytes].map(|b| interval(b, bytes));
    text.push_str(&format!("  memory {memory}; blob with surface and certificate {blob}\n"));
    let query = prediction.query_ns.map(|ns| format!("query {} ns", interval(ns, count)));
    let threads = prediction.threads as f64;
    let wall = (prediction.threads > 1).then(|| {
        let wall = interval(prediction.total.seconds, |s| seconds(s / threads));
        format!("solving with {threads} busy threads {wall} s")
    });
    let more: Vec<String> = query.into_iter().chain(wall).collect();
    if !more.is_empty() {
        text.push_str(&format!("  {}\n", more.join("; ")));
    }
    text
}

/// Rows with columns of equal width, the first one to the left.
fn aligned<const N: usize>(rows: &[[String; N]]) -> String {
    let wide: [usize; N] =
        std::array::from_fn(|column| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0));
    let mut text = String::new();
    for row in rows {
        let mut line = format!("  {:<wide$}", row[0], wide = wide[0]);
        for (cell, wide) in row.iter().zip(wide).skip(1) {
            line.push_str(&format!("  {cell:>wide$}"));
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

/// A comparison as text.
pub(super) fn comparison(comparison: &Comparison) -> String {
    let rows: Vec<[String; 4]> = comparison
        .lines
        .iter()
        .map(|line| {
            let value = |x: f64| match line.unit {
                "s" => format!("{} s", seconds(x)),
                "B" => bytes(x),
                "N" => format!("{} mN", millinewtons(x)),
                "ns" => format!("{x:.0} ns"),
                _ => count(x),
            };
            let verdict = if line.inside { "inside" } else { "outside" };
            [line.what.clone(), interval(line.predicted, value), value(line.happened), verdict.into()]
        })
        .collect();
    let heading = ["", "predicted (10 to 90 %)", "happened", ""].map(String::from);
    let mut text = aligned(&std::iter::once(heading).chain(rows).collect::<Vec<_>>());
    for note in &comparison.notes {
        text.push_str(&format!("  {note}\n"));
    }
    let inside = comparison.lines.iter().filter(|line| line.inside).count();
    text + &format!("{inside} of {} inside", comparison.lines.len())
}

#[cfg(test)]
mod tests {
    use palpate_precompute::plan::Compared;
    use serde_json::json;

    use super::*;

    fn exactly(value: f64) -> Interval {
        Interval { low: value, likely: value, high: value }
    }

    /// Five nodes, two of them probed, without a lattice.
    fn predicted() -> Prediction {
        let line = |of: &str, tried: f64, kept: f64, p99_n: Option<Interval>| {
            let about = Interval { low: 20.0, likely: 30.0, high: 50.0 };
            json!({ "of": of, "tried": exactly(tried), "kept": exactly(kept), "seconds": about,
                    "blob_bytes": exactly(1e5), "p99_n": p99_n, "lattice": null })
        };
        let error = Interval { low: 0.01 / 3.0, likely: 0.01, high: 0.03 };
        let saved = json!({
            "format": "palpate prediction 1", "scene": "a", "key": "key", "threads": 2,
            "nodes": [line("A1", 11.0, 10.0, Some(error)), line("A2", 11.0, 10.0, None)],
            "others": line("each of 3 others", 11.0, 10.0, None), "total": line("all 5 nodes", 55.0, 50.0, None),
            "lattices": exactly(0.0), "memory_bytes": exactly(1e7), "certificate_bytes": 3e3, "query_ns": exactly(80.0),
        });
        serde_json::from_value(saved).expect("a prediction")
    }

    #[test]
    fn an_interval_without_width_is_one_number() {
        assert_eq!(interval(Interval { low: 10.0, likely: 50.0, high: 90.0 }, count), "10 to 90 (50)");
        assert_eq!(interval(exactly(5.0), count), "5");
    }

    #[test]
    fn a_prediction_has_a_line_a_node_and_one_for_all() {
        let text = prediction(&predicted());
        let rows: Vec<Vec<&str>> = text
            .lines()
            .map(|line| line.split("  ").map(str::trim).filter(|s| !s.is_empty()).collect())
            .collect();
        assert_eq!(rows[2], ["A1", "11", "10", "20.0 to 50.0 (30.0)", "100 kB", "3.3 to 30 (10)"]);
        assert_eq!(rows[5], ["all 5 nodes", "55", "50", "20.0 to 50.0 (30.0)"]);
        assert!(text.lines().all(|line| line.chars().count() <= 120), "{text}");
        assert!(!text.contains("lattice"), "{text}");
    }

    #[test]
    fn the_table_has_a_line_a_row_and_marks_the_recommended_one() {
        let row = Row {
            model: "P1/P1".into(),
            spacing_m: Some(0.01),
            method: "energy",
            configurations: 10.0,
            solving_s: 5.0,
            memory_bytes: 1e8,
            blob_bytes: 2e6,
            nanoseconds: 100.0,
            p99_n: 0.01,
            within: 1.0,
            stiffer: Some(0.9),
            asked: false,
            recommended: true,
            extrapolated: false,
        };
        let text = table(&[row.clone(), Row { recommended: false, ..row }], 2);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 3);
        assert!(
            lines[1].starts_with("> P1/P1") && lines[1].contains("2.0 MB") && lines[1].contains("2.50"),
            "{text}"
        );
        assert!(lines[2].starts_with("  P1/P1"));
    }

    #[test]
    fn each_line_says_what_was_predicted_what_happened_and_whether_it_is_inside() {
        let line = |what: &str, predicted: f64, happened: f64| Compared {
            what: what.into(),
            predicted: exactly(predicted),
            happened,
            unit: "1",
            inside: predicted == happened,
        };
        let lines = vec![line("A1: solves tried", 11.0, 11.0), line("A1: configurations kept", 10.0, 9.0)];
        let text = comparison(&Comparison { lines, notes: Vec::new() });
        let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(lines[1], ["A1:", "solves", "tried", "11", "11", "inside"]);
        assert_eq!(lines[2], ["A1:", "configurations", "kept", "10", "9", "outside"]);
        assert!(text.ends_with("1 of 2 inside"), "{text}");
    }
}
