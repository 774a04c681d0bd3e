//! The fit as a drawing: forces over the displacement, and the residuals below them in a second plot.

use palpate_precompute::identify::{Identified, Row};
use palpate_precompute::num::norm;

use crate::plot::{Axis, Chart, Point, Series, Style, row};

/// Radius of a marker.
const MARKER: f64 = 3.0;

/// The displacement, mm, and components of the measured and the computed force along it, N.
fn along(row: &Row) -> [f64; 3] {
    let length_m = norm(row.displacement_m);
    let of = |force: &[f64]| match force {
        [single] => *single,
        _ if length_m == 0.0 => 0.0,
        _ => force.iter().zip(row.displacement_m).map(|(f, d)| f * d / length_m).sum(),
    };
    [1e3 * length_m, of(&row.measured_n), of(&row.model_n)]
}

/// The drawing as the content of an SVG file.
pub(super) fn drawing(found: &Identified) -> String {
    let mut tests: Vec<&str> = Vec::new();
    for row in &found.rows {
        if !tests.contains(&row.test.as_str()) {
            tests.push(&row.test);
        }
    }
    let rows: Vec<(usize, [f64; 3])> = found
        .rows
        .iter()
        .map(|row| (tests.iter().position(|test| *test == row.test).expect("collected above"), along(row)))
        .collect();
    let x = Axis::linear("displacement, mm", rows.iter().map(|(_, [d, ..])| *d));
    let forces = rows.iter().flat_map(|(_, [_, measured, model])| [*measured, *model]);
    let residuals = rows.iter().map(|(_, [_, measured, model])| 1e3 * (measured - model));
    let (mut fit, mut rest) = (Vec::new(), Vec::new());
    for (number, test) in tests.iter().enumerate() {
        let style = Style::number(number);
        let of_test: Vec<[f64; 3]> =
            rows.iter().filter(|(own, _)| *own == number).map(|(_, row)| *row).collect();
        let points = |value: &dyn Fn(&[f64; 3]) -> f64, noted: bool| {
            let point = |(place, row): (usize, &[f64; 3])| {
                let [d, measured, model] = row;
                let title = format!("{d:.3} mm: measured {measured:.4} N, model {model:.4} N");
                let is_last = noted && place + 1 == of_test.len() && !test.is_empty();
                Point { x: *d, y: value(row), r: MARKER, title, note: is_last.then(|| (*test).to_owned()) }
            };
            of_test.iter().enumerate().map(point).collect::<Vec<Point>>()
        };
        let series = |points, joined| Series { style, joined, marked: !joined, points };
        fit.push(series(points(&|[_, _, model]| *model, false), true));
        fit.push(series(points(&|[_, measured, _]| *measured, true), false));
        rest.push(series(points(&|[_, measured, model]| 1e3 * (measured - model), true), false));
    }
    let charts = [
        Chart {
            title: "Force: measured (marks), model (lines)".into(),
            x: x.clone(),
            y: Axis::linear("force, N", forces),
            series: fit,
            levels: Vec::new(),
        },
        Chart {
            title: "Measured less model".into(),
            x,
            y: Axis::linear("residual, mN", residuals),
            series: rest,
            levels: Vec::new(),
        },
    ];
    row(&charts, "Fit of material constants to measured forces")
}
