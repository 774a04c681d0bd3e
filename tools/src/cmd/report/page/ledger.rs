//! Section (i): the ledger, the saving of each omission against its effect.

use super::super::ledger::LedgerRow;
use super::super::plot::{Axis, Chart, Point, Series, Style};
use super::super::results::Report;
use super::super::words::{figure, milli, percent, times};
use super::html::{Cell, Key, figure as plots, files, paragraph, says, section as whole, table};
use palpate_precompute::spec::Tolerance;

/// An effect of an omission.
struct Change {
    title: &'static str,
    label: &'static str,
    of: fn(&LedgerRow) -> Option<f64>,
}

const CHANGES: [Change; 2] = [
    Change {
        title: "force",
        label: "mean change of the force, mN",
        of: |row| row.shown_n().map(|n| 1e3 * n),
    },
    Change {
        title: "displayed surface",
        label: "mean rms change of the surface, mm",
        of: |row| row.surface_rms_mm,
    },
];

/// Returns the section; empty without a ledger.
pub(super) fn section(report: &Report) -> String {
    let rows = &report.ledger;
    let (made, could) = (Style::number(0), Style::number(1).hollow());
    let charts: Vec<String> =
        CHANGES.iter().filter_map(|change| chart(rows, change, [made, could])).collect();
    let scene = rows.first().map_or("", |row| row.scene.as_str());
    let method = rows.first().map_or("", |row| row.method.as_str());
    let head = [
        "",
        "left out",
        "force, mean mN",
        "max mN",
        "surface, rms mm",
        "cost with",
        "without",
        "",
        "cheaper",
    ];
    let milli_or = |value: Option<f64>| value.map_or("\u{2013}".into(), milli);
    let cells = |(n, row): (usize, &LedgerRow)| -> Vec<Cell> {
        vec![
            (n + 1).to_string().into(),
            format!("{}{}", row.what, if row.made { "" } else { " (could be)" }).into(),
            milli_or(row.force_mean_n).into(),
            milli_or(row.force_max_n).into(),
            row.surface_rms_mm.map_or("\u{2013}".into(), figure).into(),
            figure(row.cost_with).into(),
            figure(row.cost_without).into(),
            row.unit.as_str().into(),
            times(row.times()).into(),
        ]
    };
    let table_rows: Vec<Vec<Cell>> = rows.iter().enumerate().map(cells).collect();
    let body = paragraph(
        "setting",
        &format!(
            "{scene}, {method}: approximations of its blob, made or possible, each compared with the blob without that approximation. Right: \
             larger saving; down: smaller effect. Numbers are those of the table; approximations without a measurable effect are in the table only."
        ),
    ) + &says(&rows.iter().filter_map(linear_words).collect::<Vec<_>>())
        + &plots(&[Key::line(made, "made"), Key::line(could, "possible")], "", &charts)
        + &table(&head, &table_rows)
        + &files(&["ledger"]);
    whole("i", "(i) The ledger of approximations", &body)
}

/// A sentence on whether the linear body suffices.
fn linear_words(row: &LedgerRow) -> Option<String> {
    let share = row.below_jnd_share.filter(|_| row.is_linear_body())?;
    Some(if share >= 1.0 {
        "Linear model suffices: its error is below JND at all held-out positions.".into()
    } else {
        format!(
            "A linear model does not suffice: its error is perceptible at {} of the held-out positions.",
            percent(1.0 - share)
        )
    })
}

/// One point per omission, numbered as in the table; `None` if there is nothing to show.
fn chart(rows: &[LedgerRow], change: &Change, styles: [Style; 2]) -> Option<String> {
    let point = |n: usize, row: &LedgerRow| {
        let y = (change.of)(row).filter(|y| *y > 0.0 && y.is_finite())?;
        let x = row.times();
        let short = row.what.split(['(', ',', ';']).next().unwrap_or_default().trim();
        let bound = if row.is_bound { " at most" } else { "" };
        let title = format!("{}: {}{bound}, {}", row.what, figure(y), times(x));
        let note = Some(format!("{} {short}", n + 1));
        (x > 0.0 && x.is_finite()).then_some(Point { x, y, r: 5.0, title, note })
    };
    let of = |made: bool| -> Vec<Point> {
        let chosen = rows.iter().enumerate().filter(|(_, row)| row.made == made);
        chosen.filter_map(|(n, row)| point(n, row)).collect()
    };
    let all = [of(true), of(false)];
    let points = || all.iter().flatten();
    points().next()?;
    let (x, y) = (
        Axis::log("cost ratio without and with the approximation", points().map(|p| p.x)),
        Axis::log(change.label, points().map(|p| p.y)),
    );
    let levels = match change.title {
        "force" => vec![(
            1e3 * Tolerance::IMPERCEPTIBLE.absolute_n,
            format!("{} mN: always below JND", milli(Tolerance::IMPERCEPTIBLE.absolute_n)),
        )],
        _ => Vec::new(),
    };
    let series = styles.into_iter().zip(all);
    let series =
        series.map(|(style, points)| Series { style, joined: false, marked: true, points }).collect();
    Some(Chart { title: format!("Approximations: {}", change.title), x, y, series, levels }.svg())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(made: bool, change_n: f64, cost: [f64; 2]) -> LedgerRow {
        LedgerRow {
            scene: "s".into(),
            grid: 32,
            method: "energy".into(),
            what: "nonlinearity (the linear body instead)".into(),
            made,
            force_mean_n: Some(change_n),
            force_max_n: Some(change_n),
            is_bound: false,
            below_jnd_share: Some(0.75),
            surface_rms_mm: None,
            unit: "configurations".into(),
            cost_with: cost[0],
            cost_without: cost[1],
        }
    }

    /// Logarithmic axes cannot show a zero effect, a zero cost, or a surface that was not measured.
    #[test]
    fn a_line_without_a_size_is_in_no_plot() {
        let styles = [Style::number(0), Style::number(1).hollow()];
        let [force, surface] = &CHANGES;
        let sound = row(false, 0.1, [1.0, 20.0]);
        assert!(chart(std::slice::from_ref(&sound), surface, styles).is_none());
        for bad in
            [row(true, 0.0, [1.0, 20.0]), row(true, f64::NAN, [1.0, 20.0]), row(true, 0.1, [0.0, 20.0])]
        {
            assert!(chart(std::slice::from_ref(&bad), force, styles).is_none(), "{bad:?}");
            let both = chart(&[bad, sound.clone()], force, styles).expect("the sound one");
            assert!(both.contains("2 nonlinearity") && !both.contains("1 nonlinearity"), "{both}");
        }
        assert!(linear_words(&sound).is_some_and(|words| words.contains("perceptible at 25 %")));
        assert!(
            linear_words(&LedgerRow { below_jnd_share: Some(1.0), ..sound })
                .is_some_and(|w| w.contains("suffices"))
        );
    }
}
