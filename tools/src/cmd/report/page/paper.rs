//! Section (d): the paper's Figs. 6 to 9 on this body and this machine.

use std::collections::BTreeSet;

use palpate_core::Method;

use super::super::curves::CurveRow;
use super::super::measure::{Along, Measured, PathRow};
use super::super::results::Report;
use super::cost::radius;
use super::{method_keys, title};
use crate::html::{Key, figure as plots, files, heading, paragraph, says, section as whole};
use crate::plot::{Axis, Bars, Chart, Point, Series, Style, Value};
use crate::words::{count, figure, law, list, milli, percent, seconds};

/// The just-noticeable difference of a force.
const JND: f64 = 0.07;

/// Returns the section.
pub(super) fn section(report: &Report) -> String {
    let body = [curves(report), along(report), times(report), means(report), maxima(report)].concat();
    whole("d", "(d) The paper\u{2019}s figures", &body)
}

/// Fig. 6.
fn curves(report: &Report) -> String {
    let rows = &report.curves;
    let ways: BTreeSet<(&str, &str)> =
        rows.iter().map(|row| (row.held.as_str(), row.active.as_str())).collect();
    let ways: Vec<(&str, &str)> = ways.into_iter().collect();
    let mut laws: Vec<&str> = Vec::new();
    for row in rows {
        if !laws.contains(&row.law.as_str()) {
            laws.push(&row.law);
        }
    }
    let of = |law: &str, way: (&str, &str)| -> Vec<&CurveRow> {
        rows.iter().filter(|row| row.law == law && (row.held.as_str(), row.active.as_str()) == way).collect()
    };
    let chart = |name: &str| {
        let series = ways.iter().enumerate().map(|(n, &way)| Series {
            style: Style::number(n),
            joined: true,
            marked: true,
            points: of(name, way)
                .iter()
                .enumerate()
                .map(|(step, row)| Point {
                    x: 1e3 * row.distance_m,
                    y: row.force_n,
                    // Every fifth point has a marker.
                    r: if step % 5 == 0 { 4.0 } else { 0.0 },
                    title: format!("{} mm: {} N", milli(row.distance_m), figure(row.force_n)),
                    note: None,
                })
                .collect(),
        });
        Chart {
            title: law(name),
            x: Axis::linear(
                "displacement of the active node, mm",
                rows.iter().map(|row| 1e3 * row.distance_m),
            ),
            y: Axis::linear("force |h|, N", rows.iter().filter(|row| row.law == name).map(|row| row.force_n)),
            series: series.collect(),
            levels: vec![],
        }
        .svg()
    };
    let keys: Vec<Key> = ways
        .iter()
        .enumerate()
        .map(|(n, (held, active))| Key::line(Style::number(n), format!("held {held}, touched at {active}")))
        .collect();
    let mut charts: Vec<String> = laws.iter().map(|law| chart(law)).collect();
    charts.extend(ways.first().map(|&way| laws_chart(rows, &laws, way)));
    let mut words = Vec::new();
    for name in &laws {
        let (mut stiffen, mut soften, mut ended) = (Vec::new(), Vec::new(), Vec::new());
        for &way in &ways {
            let curve = of(name, way);
            let Some(last) = curve.last() else { continue };
            let half = curve[curve.len() / 2].force_n.max(f64::MIN_POSITIVE);
            let who = format!("{}/{} {} N", way.0, way.1, figure(last.force_n));
            if last.force_n > 2.1 * half {
                stiffen.push(who)
            } else {
                soften.push(who)
            }
            if curve.len() < rows.iter().filter(|row| row.law == **name).count() / ways.len() {
                ended.push(format!("{}/{} at {} mm", way.0, way.1, milli(last.distance_m)));
            }
        }
        let mut line = format!("{}, force at the end", law(name));
        if !stiffen.is_empty() {
            line += &format!("; stiffening: {}", list(&stiffen));
        }
        if !soften.is_empty() {
            line += &format!("; not stiffening: {}", list(&soften));
        }
        if !ended.is_empty() {
            line += &format!("; ended early: {}", list(&ended));
        }
        words.push(line + ".");
    }
    heading("Fig. 6: force against displacement by finite elements")
        + &paragraph(
            "setting",
            "Along the regular direction nearest to the outward normal, up to r_G. Stiffening: the force at the end is more than \
             2.1 times that at half the distance.",
        )
        + &says(&words)
        + &plots(&keys, "", &charts)
        + &files(&["curves"])
}

/// All laws for one fixed set and one active node.
fn laws_chart(rows: &[CurveRow], laws: &[&str], (held, active): (&str, &str)) -> String {
    let of = |name: &str| -> Vec<&CurveRow> {
        rows.iter().filter(|row| row.law == name && row.held == held && row.active == active).collect()
    };
    let series = laws.iter().enumerate().map(|(n, name)| {
        let curve = of(name);
        let last = curve.len().saturating_sub(1);
        let point = |(step, row): (usize, &&CurveRow)| Point {
            x: 1e3 * row.distance_m,
            y: row.force_n,
            r: 0.0,
            title: String::new(),
            note: (step == last).then(|| law(name)),
        };
        Series {
            style: Style::number(n + 4),
            joined: true,
            marked: true,
            points: curve.iter().enumerate().map(point).collect(),
        }
    });
    let all = || laws.iter().flat_map(|name| of(name));
    Chart {
        title: format!("held {held}, touched at {active}: the laws"),
        x: Axis::linear("displacement of the active node, mm", all().map(|row| 1e3 * row.distance_m)),
        y: Axis::linear("force |h|, N", all().map(|row| row.force_n)),
        series: series.collect(),
        levels: vec![],
    }
    .svg()
}

/// Fig. 6, interpolated.
fn along(report: &Report) -> String {
    let shown = [Method::Trilinear, Method::RbfCubic, Method::Energy];
    let (mut charts, mut words) = (Vec::new(), Vec::new());
    for (n, cases) in report.cases.iter().enumerate() {
        let Some(case) = cases.first() else { continue };
        let along = &case.along;
        if along.distance_m.is_empty() {
            continue;
        }
        let x =
            || Axis::linear("displacement of the active node, mm", along.distance_m.iter().map(|d| 1e3 * d));
        let chosen: Vec<&(Method, Vec<[f64; 2]>)> =
            along.methods.iter().filter(|(method, _)| shown.contains(method)).collect();
        charts.push(force_chart(&title(report, n), along, &chosen, x()).svg());
        let errors = chosen.iter().map(|(method, answers)| series(along, *method, answers, 1, 1e3));
        charts.push(
            Chart {
                title: format!("error along the path, {} points", count(case.space.grid as usize)),
                x: x(),
                y: Axis::log("|error|, mN", chosen.iter().flat_map(|(_, a)| a.iter().map(|a| 1e3 * a[1]))),
                series: errors.collect(),
                levels: vec![],
            }
            .svg(),
        );
        let largest: Vec<String> = chosen
            .iter()
            .map(|(method, a)| {
                format!("{} {} mN", method.name(), milli(a.iter().map(|a| a[1]).fold(0.0, f64::max)))
            })
            .collect();
        words.push(format!(
            "{}, {} points: force up to {} N; largest error along the path: {}.",
            case.space.scene,
            count(case.space.grid as usize),
            figure(along.truth_n.iter().fold(0.0, |a, b| a.max(*b))),
            largest.join(", ")
        ));
    }
    let mut keys = method_keys(report);
    keys.retain(|key| shown.iter().any(|method| method.name() == key.name));
    heading("Fig. 6, interpolated: finite elements (line) and methods (markers) along one regular path")
        + &says(&words)
        + &plots(&keys, "", &charts)
        + &files(&["along"])
}

fn series(along: &Along, method: Method, answers: &[[f64; 2]], of: usize, scale: f64) -> Series {
    let points = along.distance_m.iter().zip(answers).map(|(d, a)| Point {
        x: 1e3 * d,
        y: scale * a[of],
        // Different sizes, so that no marker hides another.
        r: match method {
            _ if of == 1 => 3.2,
            Method::Trilinear => 5.6,
            Method::RbfCubic => 4.4,
            _ => 3.0,
        },
        title: format!("{}, {} mm: {}", method.name(), milli(*d), figure(scale * a[of])),
        note: None,
    });
    Series { style: Style::of_method(method), joined: of == 1, marked: true, points: points.collect() }
}

fn force_chart(title: &str, along: &Along, chosen: &[&(Method, Vec<[f64; 2]>)], x: Axis) -> Chart {
    let truth = Series {
        style: Style::number(6),
        joined: true,
        marked: false,
        points: along
            .distance_m
            .iter()
            .zip(&along.truth_n)
            .map(|(d, f)| Point { x: 1e3 * d, y: *f, r: 0.0, title: String::new(), note: None })
            .collect(),
    };
    let methods = chosen.iter().map(|(method, answers)| Series {
        style: Style::of_method(*method).hollow(),
        ..series(along, *method, answers, 0, 1.0)
    });
    Chart {
        title: title.into(),
        x,
        y: Axis::linear("force |h|, N", along.truth_n.iter().copied()),
        series: std::iter::once(truth).chain(methods).collect(),
        levels: vec![],
    }
}

/// Fig. 7.
fn times(report: &Report) -> String {
    let mut groups = Vec::new();
    for (g, (points, _)) in report.plan.grids.iter().enumerate() {
        let values = report.cases.iter().enumerate().map(|(n, cases)| {
            let space = &cases[g].space;
            let text = seconds(space.solve_seconds);
            Value { style: bar_style(n), value: Some(space.solve_seconds), text }
        });
        groups.push((count(*points as usize), values.collect()));
    }
    let all = || report.cases.iter().flatten().map(|case| &case.space);
    let x_label = "grid points within r_G";
    let time = Bars {
        title: "Solving a configuration space".into(),
        x_label: x_label.into(),
        y: Axis::linear("seconds, all threads together", all().map(|space| 1.06 * space.solve_seconds)),
        groups,
        solid: true,
    };
    let mut groups = Vec::new();
    for (g, (points, _)) in report.plan.grids.iter().enumerate() {
        let values = report.cases.iter().enumerate().map(|(n, cases)| {
            let each = each_ms(&cases[g]);
            let text = format!("{} ms", figure(each));
            Value { style: bar_style(n), value: Some(each), text }
        });
        groups.push((count(*points as usize), values.collect()));
    }
    let each = Bars {
        title: "One configuration".into(),
        x_label: x_label.into(),
        y: Axis::linear(
            "milliseconds, one thread",
            report.cases.iter().flatten().map(|case| 1.06 * each_ms(case)),
        ),
        groups,
        solid: true,
    };
    let keys: Vec<Key> = (0..report.cases.len()).map(|n| Key::bar(bar_style(n), title(report, n))).collect();
    let words: Vec<String> = report
        .cases
        .iter()
        .filter_map(|cases| {
            let (first, last) = (&cases.first()?.space, &cases.last()?.space);
            Some(format!(
                "{}: {} configurations in {}, {} in {}; {} attempts failed on the finest grid.",
                first.scene,
                count(first.configurations),
                seconds(first.solve_seconds),
                count(last.configurations),
                seconds(last.solve_seconds),
                count(last.failed)
            ))
        })
        .collect();
    heading("Fig. 7: the cost of a configuration space")
        + &says(&words)
        + &plots(&keys, "", &[time.svg(), each.svg()])
        + &files(&["spaces"])
}

/// Every second bar is hollow, because printing may lose the colours.
fn bar_style(n: usize) -> Style {
    if n % 2 == 1 { Style::number(n).hollow() } else { Style::number(n) }
}

/// Milliseconds per configuration, with the time of failed attempts distributed over all.
fn each_ms(case: &Measured) -> f64 {
    1e3 * case.space.solve_seconds / case.space.configurations.max(1) as f64
}

/// Fig. 8.
fn means(report: &Report) -> String {
    let (mut charts, mut words) = (Vec::new(), Vec::new());
    for (n, cases) in report.cases.iter().enumerate() {
        for (what, unit, scale, relative) in [("relative", "%", 100.0, true), ("absolute", "mN", 1e3, false)]
        {
            let of = |mean_n: f64, mean_relative: f64| scale * if relative { mean_relative } else { mean_n };
            let groups = cases.iter().map(|case| {
                let values = report.plan.methods.iter().map(|method| {
                    let row = case.means.iter().find(|row| row.method == method.name());
                    let value = row.map(|row| of(row.mean_n, row.mean_relative));
                    let text = format!("{}: {} {unit}", method.name(), value.map(figure).unwrap_or_default());
                    Value { style: Style::of_method(*method), value, text }
                });
                (count(case.space.grid as usize), values.collect())
            });
            let all = cases.iter().flat_map(|case| &case.means).map(|row| of(row.mean_n, row.mean_relative));
            charts.push(
                Bars {
                    title: format!("{}: {what}", title(report, n)),
                    x_label: "grid points within r_G".into(),
                    y: Axis::log(&format!("mean {what} error of a component, {unit}"), all),
                    groups: groups.collect(),
                    solid: false,
                }
                .svg(),
            );
        }
        for case in [cases.first(), cases.last().filter(|_| cases.len() > 1)].into_iter().flatten() {
            let mut means: Vec<_> = case.means.iter().collect();
            means.sort_by(|a, b| a.mean_n.total_cmp(&b.mean_n));
            let each: Vec<String> = means
                .iter()
                .map(|row| {
                    format!("{} {} mN / {}", row.method, milli(row.mean_n), percent(row.mean_relative))
                })
                .collect();
            words.push(format!(
                "{}, {} points: {}.",
                case.space.scene,
                count(case.space.grid as usize),
                each.join(", ")
            ));
        }
    }
    let paths =
        report.cases.iter().flatten().flat_map(|case| &case.means).map(|row| row.paths).max().unwrap_or(0);
    heading("Fig. 8: mean errors along paths")
        + &paragraph(
            "setting",
            &format!(
                "Eqs. (13) and (14), averaged over {} regular and random paths with |h| < f_max; without steps at branch jumps and grid points, \
                 and for the relative error without components below 0.5 N.",
                count(paths)
            ),
        )
        + &says(&words)
        + &plots(&method_keys(report), "", &charts)
        + &files(&["means", "paths"])
}

/// Fig. 9: the coarsest grid, and the finest with all displayed methods.
fn maxima(report: &Report) -> String {
    let shown: Vec<Method> = [Method::Trilinear, Method::RbfCubic, Method::Energy]
        .into_iter()
        .filter(|method| report.plan.methods.contains(method))
        .collect();
    let Some(cases) = report.cases.first() else { return String::new() };
    let whole = |case: &&Measured| shown.iter().all(|m| case.means.iter().any(|row| row.method == m.name()));
    let (first, last) = (cases.iter().find(whole), cases.iter().rfind(whole));
    let chosen: Vec<&Measured> = match (first, last) {
        (Some(a), Some(b)) if a.space.grid != b.space.grid => vec![a, b],
        (Some(a), _) => vec![a],
        _ => return String::new(),
    };
    let usable = |row: &&PathRow| row.positions > 0 && shown.iter().any(|m| m.name() == row.method);
    let all = || chosen.iter().flat_map(|case| case.paths.iter().filter(usable));
    let (mut charts, mut words) = (Vec::new(), Vec::new());
    for case in &chosen {
        let series = shown.iter().map(|method| {
            let of_method = case.paths.iter().filter(usable).filter(|row| row.method == method.name());
            let points = of_method.map(|row| Point {
                x: 100.0 * row.max_relative,
                y: 1e3 * row.max_n,
                r: radius(0) + 0.6,
                title: format!(
                    "{}, {} path {}: {}, {} mN",
                    row.method,
                    row.kind,
                    row.number,
                    percent(row.max_relative),
                    milli(row.max_n)
                ),
                note: None,
            });
            Series {
                style: Style::of_method(*method).hollow(),
                joined: false,
                marked: true,
                points: points.collect(),
            }
        });
        charts.push(
            Chart {
                title: format!(
                    "{}, {} points: largest error of each path",
                    case.space.scene,
                    count(case.space.grid as usize)
                ),
                x: Axis::log(
                    "largest relative error of a component, %",
                    all().map(|row| 100.0 * row.max_relative),
                ),
                y: Axis::log("largest absolute error of a component, mN", all().map(|row| 1e3 * row.max_n)),
                series: series.collect(),
                levels: vec![],
            }
            .svg(),
        );
        let each: Vec<String> = shown
            .iter()
            .map(|method| {
                let of_method = || case.paths.iter().filter(usable).filter(|row| row.method == method.name());
                let felt = of_method().filter(|row| row.max_relative > JND).count();
                format!("{} {felt} of {}", method.name(), of_method().count())
            })
            .collect();
        words.push(format!(
            "on {} points, paths with a relative error of a component above {}: {}.",
            count(case.space.grid as usize),
            percent(JND),
            each.join(", ")
        ));
    }
    let mut keys = method_keys(report);
    keys.retain(|key| shown.iter().any(|method| method.name() == key.name));
    heading("Fig. 9: largest errors of every path")
        + &says(&words)
        + &plots(&keys, "", &charts)
        + &files(&["paths"])
}
