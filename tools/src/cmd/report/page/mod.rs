//! The page: one HTML file that contains its style and drawings.

mod cost;
mod footer;
mod overview;
mod paper;

use palpate_core::Method;

use super::measure::{Measured, MethodRow};
use super::results::Report;
use crate::failure::Failure;
use crate::files::Output;
use crate::html::{self, Key};
use crate::plot::Style;
use crate::words;

/// Writes the page.
pub(super) fn write(report: &Report, file: &Output) -> Result<(), Failure> {
    let names: Vec<String> = report.plan.families.iter().map(|family| family.name.clone()).collect();
    let title = format!("Palpate: speed against error, {}", words::list(&names));
    let body =
        [overview::section(report), cost::sections(report), paper::section(report), footer::section(report)]
            .concat();
    file.put(html::page(&title, &body).as_bytes())
}

/// The legend of the displayed methods.
fn method_keys(report: &Report) -> Vec<Key> {
    let shown = |method: &Method| report.cases.iter().flatten().any(|case| row(case, *method).is_some());
    let methods = report.plan.methods.iter().copied().filter(shown);
    methods.map(|method| Key::line(Style::of_method(method), method.name())).collect()
}

/// A method's row of a case.
fn row(case: &Measured, method: Method) -> Option<&MethodRow> {
    case.methods.iter().find(|row| row.method == method.name())
}

/// Name and law, for the title of a plot.
fn title(report: &Report, family: usize) -> String {
    let family = &report.plan.families[family];
    format!("{}, {}", family.name, words::law(&family.bench.body.law_names()))
}

/// The row with the smallest value, of those that have one.
fn least<'r>(
    rows: impl IntoIterator<Item = &'r MethodRow>,
    of: fn(&MethodRow) -> f64,
) -> Option<&'r MethodRow> {
    rows.into_iter().filter(|row| of(row).is_finite()).min_by(|a, b| of(a).total_cmp(&of(b)))
}

/// The methods that the paper compares.
fn is_of_the_paper(row: &MethodRow) -> bool {
    ["trilinear", "tricubic", "rbf-linear", "rbf-cubic"].contains(&row.method)
}

/// A method's name, with a mark if it is not one of the paper's.
fn method_words(row: &MethodRow) -> String {
    format!("{}{}", row.method, if is_of_the_paper(row) { "" } else { " *" })
}
