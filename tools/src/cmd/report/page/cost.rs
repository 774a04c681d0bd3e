//! Sections (a), (b) and (c): error as a function of nanoseconds, configurations and seconds, and bytes.

use std::collections::BTreeMap;

use palpate_precompute::spec::Tolerance;

use super::super::measure::{Measured, MethodRow};
use super::super::results::Report;
use super::{is_of_the_paper, least, method_keys, row, title};
use crate::html::{figure as plots, files, paragraph, says, section};
use crate::plot::{Axis, Chart, Point, Series, Style};
use crate::words::{bytes, count, figure, list, milli, plain, seconds, times};

/// A cost on the horizontal axis.
struct Price {
    label: &'static str,
    of: fn(&MethodRow) -> f64,
    shown: fn(&MethodRow) -> String,
}

const QUERY: Price = Price {
    label: "time of a query, ns",
    of: |row| row.nanoseconds,
    shown: |row| format!("{} ns", figure(row.nanoseconds)),
};
const CONFIGURATIONS: Price = Price {
    label: "configurations solved",
    of: |row| row.configurations as f64,
    shown: |row| format!("{} configurations", count(row.configurations)),
};
const SECONDS: Price = Price {
    label: "solve time in seconds, all threads together",
    of: |row| row.solve_seconds,
    shown: |row| seconds(row.solve_seconds),
};
const BYTES: Price = Price {
    label: "bytes of the method\u{2019}s tables",
    of: |row| row.table_bytes as f64,
    shown: |row| bytes(row.table_bytes),
};

/// Returns the three sections.
pub(super) fn sections(report: &Report) -> String {
    let a = says(&each(report, query_words)) + &figure_of(report, &[&QUERY]) + &files(&["methods"]);
    let b = says(&each(report, solving_words))
        + &figure_of(report, &[&CONFIGURATIONS])
        + &figure_of(report, &[&SECONDS])
        + &paragraph(
            "setting",
            "All methods of one grid use the same configurations. The counts include the corners that complete the cells at the rim.",
        )
        + &files(&["methods", "spaces"]);
    let c = says(&each(report, byte_words))
        + &figure_of(report, &[&BYTES])
        + &paragraph(
            "setting",
            "Bytes are those of the method\u{2019}s own tables in a blob: forces only, without the organ\u{2019}s surface, its \
             displacements for display, and the certificate.",
        )
        + &files(&["methods"]);
    section("a", "(a) Error against the time of a query", &a)
        + &section("b", "(b) Error against configurations solved and seconds of precompute", &b)
        + &section("c", "(c) Error against the size of the tables", &c)
}

/// The sentences of every family.
fn each(report: &Report, words: fn(&[Measured]) -> Vec<String>) -> Vec<String> {
    let named = |(n, cases): (usize, &Vec<Measured>)| -> Vec<String> {
        let name = &report.plan.families[n].name;
        words(cases).into_iter().map(|line| format!("{name}: {line}")).collect()
    };
    report.cases.iter().enumerate().flat_map(named).collect()
}

/// Mean and 99th percentile of every family against each price.
fn figure_of(report: &Report, prices: &[&Price]) -> String {
    let grids: Vec<String> = report.plan.grids.iter().map(|(points, _)| count(*points as usize)).collect();
    let note = format!("larger markers: larger grids; {} points", grids.join(", "));
    let mut charts = Vec::new();
    for price in prices {
        for n in 0..report.cases.len() {
            for (what, of) in
                [("mean", (|row| row.mean_n) as fn(&MethodRow) -> f64), ("p99", |row| row.p99_n)]
            {
                charts.push(chart(report, n, price, what, of).svg());
            }
        }
    }
    plots(&method_keys(report), &note, &charts)
}

fn chart(report: &Report, family: usize, price: &Price, what: &str, error: fn(&MethodRow) -> f64) -> Chart {
    let cases = &report.cases[family];
    let rows = || cases.iter().flat_map(|case| &case.methods);
    let point = |(n, row): (usize, &MethodRow)| Point {
        x: (price.of)(row),
        y: 1e3 * error(row),
        r: radius(n),
        title: format!(
            "{} on {} points: {what} {} mN, {}",
            row.method,
            count(row.grid as usize),
            milli(error(row)),
            (price.shown)(row)
        ),
        note: None,
    };
    let series = report.plan.methods.iter().map(|&method| Series {
        style: Style::of_method(method),
        joined: true,
        marked: true,
        points: cases
            .iter()
            .enumerate()
            .filter_map(|(n, case)| Some((n, row(case, method)?)))
            .map(point)
            .collect(),
    });
    let level = if what == "p99" {
        vec![(
            1e3 * Tolerance::IMPERCEPTIBLE.absolute_n,
            format!("{} mN: always below JND", milli(Tolerance::IMPERCEPTIBLE.absolute_n)),
        )]
    } else {
        vec![]
    };
    Chart {
        title: format!("{}: {what}", title(report, family)),
        x: Axis::log(price.label, rows().map(price.of)),
        y: Axis::log(&format!("{what} |error|, mN"), rows().map(|row| 1e3 * error(row))),
        series: series.collect(),
        levels: level,
    }
}

/// Marker size for grid number `n`.
pub(super) fn radius(n: usize) -> f64 {
    3.0 + 1.1 * n.min(5) as f64
}

/// The fastest and the most accurate methods, and those that are fast enough.
fn query_words(cases: &[Measured]) -> Vec<String> {
    let mut lines = Vec::new();
    let ends: Vec<&Measured> = match cases {
        [only] => vec![only],
        [first, .., last] => vec![first, last],
        [] => vec![],
    };
    for case in ends {
        let Some(best) = least(&case.methods, |row| row.mean_n) else {
            let grid = count(case.space.grid as usize);
            lines.push(format!(
                "on {grid} points every position is at a branch jump; there is no comparison."
            ));
            continue;
        };
        let Some(fast) = least(&case.methods, |row| row.nanoseconds) else { continue };
        let mut line = format!(
            "on {} points {} has the smallest mean error, {} mN in {} ns",
            count(best.grid as usize),
            best.method,
            milli(best.mean_n),
            figure(best.nanoseconds)
        );
        if fast.method != best.method {
            line += &format!(
                "; {} is the fastest, {} ns with {} the error",
                fast.method,
                figure(fast.nanoseconds),
                times(fast.mean_n / best.mean_n)
            );
        }
        let of_the_paper = least(case.methods.iter().filter(|row| is_of_the_paper(row)), |row| row.mean_n);
        if let Some(paper) = of_the_paper.filter(|paper| paper.method != best.method) {
            line += &format!(
                "; of the paper\u{2019}s four {} has the smallest error, {} mN in {} ns: {} the error, {} as long",
                paper.method,
                milli(paper.mean_n),
                figure(paper.nanoseconds),
                times(paper.mean_n / best.mean_n),
                times(paper.nanoseconds / best.nanoseconds)
            );
        }
        lines.push(line + ".");
    }
    lines.push(first_below(cases, &QUERY, "fastest"));
    lines
}

/// The lowest cost of a p99 that is at most the absolute part of `Tolerance::IMPERCEPTIBLE`.
fn first_below(cases: &[Measured], price: &Price, word: &str) -> String {
    let rows = || cases.iter().flat_map(|case| &case.methods);
    let limit = milli(Tolerance::IMPERCEPTIBLE.absolute_n);
    match least(rows().filter(|row| row.p99_n <= Tolerance::IMPERCEPTIBLE.absolute_n), price.of) {
        Some(row) => format!(
            "{word} with a p99 of at most {limit} mN: {} on {} points, {} ({} mN).",
            row.method,
            count(row.grid as usize),
            (price.shown)(row),
            milli(row.p99_n)
        ),
        None => match least(rows(), |row| row.p99_n) {
            Some(row) => format!(
                "no table has a p99 of at most {limit} mN; the nearest is {} on {} points with {} mN.",
                row.method,
                count(row.grid as usize),
                milli(row.p99_n)
            ),
            None => String::new(),
        },
    }
}

/// Number of configurations that the best method saves.
fn solving_words(cases: &[Measured]) -> Vec<String> {
    let mut lines = Vec::new();
    let rows = || cases.iter().flat_map(|case| &case.methods);
    let coarse = cases.first().and_then(|case| least(&case.methods, |row| row.mean_n));
    for case in cases {
        let paper = least(case.methods.iter().filter(|row| is_of_the_paper(row)), |row| row.mean_n);
        let (Some(best), Some(paper)) = (coarse, paper) else { continue };
        if best.method == paper.method {
            continue;
        }
        let line: Vec<&MethodRow> = rows().filter(|row| row.method == best.method).collect();
        let Some((needed, at_most)) = needed(&line, paper.mean_n) else { continue };
        if (paper.configurations as f64) < 1.05 * needed {
            continue;
        }
        lines.push(format!(
            "{}, the best of the paper\u{2019}s four on {} points, has {} mN from {} configurations; {} has the same error from {} {}: {}{} fewer.",
            paper.method,
            count(paper.grid as usize),
            milli(paper.mean_n),
            count(paper.configurations),
            best.method,
            if at_most { "at most" } else { "about" },
            plain(needed.round()),
            if at_most { "at least " } else { "" },
            times(paper.configurations as f64 / needed)
        ));
    }
    lines.push(first_below(cases, &CONFIGURATIONS, "fewest configurations"));
    lines
}

/// Configurations for a mean error, interpolated along a method's line on logarithmic axes, and whether its
/// coarsest grid is already better.
fn needed(line: &[&MethodRow], mean_n: f64) -> Option<(f64, bool)> {
    let first = line.first()?;
    if first.mean_n <= mean_n {
        return Some((first.configurations as f64, true));
    }
    let pair = line.windows(2).find(|pair| pair[0].mean_n >= mean_n && pair[1].mean_n <= mean_n)?;
    let [a, b] = [pair[0], pair[1]].map(|row| [row.mean_n.ln(), (row.configurations as f64).ln()]);
    let share = (mean_n.ln() - a[0]) / (b[0] - a[0]);
    Some(((a[1] + share * (b[1] - a[1])).exp(), false))
}

fn byte_words(cases: &[Measured]) -> Vec<String> {
    let mut lines = vec![first_below(cases, &BYTES, "smallest")];
    if let Some(case) = cases.last() {
        // Methods with the same tables share an entry.
        let mut sizes: BTreeMap<usize, Vec<String>> = BTreeMap::new();
        for row in &case.methods {
            sizes.entry(row.table_bytes).or_default().push(row.method.into());
        }
        let sizes: Vec<String> =
            sizes.iter().map(|(n, methods)| format!("{} {}", list(methods), bytes(*n))).collect();
        lines.push(format!("on {} points: {}.", count(case.space.grid as usize), sizes.join("; ")));
    }
    lines
}
