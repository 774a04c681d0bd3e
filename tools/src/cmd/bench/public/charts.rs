//! Plots of the tables.

use palpate_core::Method;

use super::figures::{Row, Section, Table};
use super::systems::YOURS;
use super::zwidth::{DAMPING, DEVICES, RATES_HZ, SPRINGS, WALL};
use super::{cost, forces, nodule, ticks};
use crate::html::{Key, figure as plots};
use crate::plot::{Axis, Bars, Chart, Point, Series, Style, Value};
use crate::words::figure;

/// Style of a system, the same in every plot.
fn style(column: &str, number: usize) -> Style {
    match (Method::from_name(column), column) {
        (Some(method), _) => Style::of_method(method),
        (None, "live") => Style::number(0).hollow(),
        (None, "guarded") => Style::of_method(Method::Energy).hollow(),
        (None, "plain wall") => Style::number(0),
        (None, "bound") => Style::number(6),
        _ => Style::number(number),
    }
}

/// Columns with at least one value in these tables, with their styles.
fn shown(tables: &[Table]) -> Vec<(String, Style)> {
    let mut names: Vec<String> = Vec::new();
    for table in tables {
        for (n, column) in table.columns.iter().enumerate() {
            let has_value = table.rows.iter().any(|row| row.values.get(n).copied().flatten().is_some());
            if has_value && column != YOURS && !names.contains(column) {
                names.push(column.clone());
            }
        }
    }
    names
        .into_iter()
        .enumerate()
        .map(|(n, name)| {
            let style = style(&name, n);
            (name, style)
        })
        .collect()
}

fn keys(shown: &[(String, Style)]) -> Vec<Key> {
    shown.iter().map(|(name, style)| Key::line(*style, name.clone())).collect()
}

/// Stems of one row of every table on a logarithmic axis: a group for each table.
fn stems(title: &str, label: &str, tables: &[Table], rows: &[(&str, String)]) -> String {
    let shown = shown(tables);
    let mut all = Vec::new();
    let mut groups = Vec::new();
    for table in tables {
        for (row, name) in rows {
            let values = shown.iter().map(|(column, style)| {
                let value = table.value(row, column).filter(|value| *value > 0.0);
                all.extend(value);
                let text = format!("{column}: {}", value.map(figure).unwrap_or_default());
                Value { style: *style, value, text }
            });
            let organ = table.key.rsplit_once('.').map_or("", |(_, organ)| organ);
            let group = if tables.len() == 1 {
                name.clone()
            } else if rows.len() == 1 {
                organ.into()
            } else {
                format!("{organ}, {name}")
            };
            groups.push((group, values.collect()));
        }
    }
    let y = Axis::log(label, all);
    Bars { title: title.into(), x_label: String::new(), y, groups, solid: false }.svg()
}

/// The plots of a section; empty if it has none.
pub(super) fn of(section: &Section, all: &[Section]) -> String {
    let tables = &section.tables[..];
    let row = |key: &str| [(key.to_owned(), String::new())];
    let one = |title: &str, label: &str, key: &str| {
        let rows = row(key);
        stems(title, label, tables, &[(&rows[0].0, String::new())])
    };
    let drawn = match section.key.as_str() {
        forces::FORCE => vec![
            one("Mean error", "mean force error, mN", "mean_mn"),
            one("Largest error", "largest force error, mN", "max_mn"),
        ],
        forces::HANDS => {
            let hands = ["press", "poke", "slide"];
            let of = |table: &Table| {
                // Fewer than 100 errors have no 99th percentile.
                let has_p99 =
                    hands.iter().all(|hand| table.rows.iter().any(|row| row.key == format!("{hand}.p99_mn")));
                let (part, says) = if has_p99 {
                    ("p99_mn", "99 % of the errors are below")
                } else {
                    ("max_mn", "largest errors")
                };
                let keys = hands.map(|hand| format!("{hand}.{part}"));
                let rows: Vec<(&str, String)> =
                    keys.iter().zip(hands).map(|(key, hand)| (key.as_str(), hand.to_owned())).collect();
                let title = format!("{}: {says}", table.title);
                stems(&title, "force error, mN", std::slice::from_ref(table), &rows)
            };
            tables.iter().map(of).collect()
        }
        forces::ENERGY => vec![
            one("Net of the exchanged energy", "mean share of a loop, %", "share_percent"),
            one("Largest net energy of a loop", "net energy, mJ", "net_mj"),
        ],
        cost::KEY => speed_and_error(section, all),
        super::zwidth::KEY => return zwidth(tables),
        nodule::KEY => {
            let place = |row: &Row| row.key.strip_suffix(".detectability").map(String::from);
            let rows = tables.iter().flat_map(|table| &table.rows);
            let rows: Vec<(&str, String)> =
                rows.filter_map(|row| Some((row.key.as_str(), place(row)?))).collect();
            vec![stems("Nodules under the skin", "detectability; above 1 it is felt", tables, &rows)]
        }
        ticks::KEY => {
            let rows = [
                ("p50_us", "median".to_owned()),
                ("p9999_us", "99.99 %".into()),
                ("max_us", "largest".into()),
            ];
            let of = |table: &Table| {
                let organ = table.key.rsplit_once('.').map_or("", |(_, organ)| organ);
                stems(&format!("Time of a tick, {organ}"), "\u{b5}s", std::slice::from_ref(table), &rows)
            };
            tables.iter().map(of).collect()
        }
        _ => return String::new(),
    };
    if drawn.is_empty() { String::new() } else { plots(&keys(&shown(tables)), "", &drawn) }
}

/// Error against the time of a query, a plot for each organ.
fn speed_and_error(section: &Section, all: &[Section]) -> Vec<String> {
    let Some(force) = all.iter().find(|section| section.key == forces::FORCE) else { return Vec::new() };
    let mut drawn = Vec::new();
    for table in &section.tables {
        let organ = table.key.rsplit_once('.').map_or("", |(_, organ)| organ);
        let Some(errors) =
            force.tables.iter().find(|table| table.key == format!("{}.{organ}", forces::FORCE))
        else {
            continue;
        };
        let mut series = Vec::new();
        for (column, style) in shown(std::slice::from_ref(table)) {
            let Some((x, y)) = table.value("query_ns", &column).zip(errors.value("mean_mn", &column)) else {
                continue;
            };
            let title = format!("{column}: {} ns, {} mN", figure(x), figure(y));
            let points = vec![Point { x, y, r: 6.0, title, note: Some(column) }];
            series.push(Series { style, joined: false, marked: true, points });
        }
        let all = |of: fn(&Point) -> f64| {
            series.iter().flat_map(move |s| s.points.iter().map(of)).collect::<Vec<_>>()
        };
        drawn.push(
            Chart {
                title: format!("{}: error against time", table.title),
                x: Axis::log("one force query, ns", all(|p| p.x)),
                y: Axis::log("mean force error, mN", all(|p| p.y)),
                series,
                levels: vec![],
            }
            .svg(),
        );
    }
    drawn
}

/// A series over the rows whose names are read as numbers by `x`.
fn series(
    table: &Table,
    column: &str,
    style: Style,
    joined: bool,
    x: impl Fn(&str) -> Option<f64>,
) -> Series {
    let point = |row: &super::figures::Row| {
        let (x, y) = (x(&row.key)?, row.values[table.column(column)?]?);
        Some(Point { x, y, r: 4.0, title: format!("{column}, {}: {} N/m", row.name, figure(y)), note: None })
    };
    let points = table.rows.iter().filter_map(point).collect();
    Series { style, joined, marked: !joined || !style.hollow, points }
}

/// The plots of the Z-width.
fn zwidth(tables: &[Table]) -> String {
    let find = |key: &str| tables.iter().find(|table| table.key == key);
    let (Some(wall), Some(springs)) = (find(WALL), find(SPRINGS)) else { return String::new() };
    let (Some(damping), Some(devices)) = (find(DAMPING), find(DEVICES)) else { return String::new() };
    let rates: Vec<(String, Style)> =
        RATES_HZ.iter().enumerate().map(|(n, rate)| (format!("{rate} Hz"), Style::number(n))).collect();
    let mut of_wall = Vec::new();
    for (rate, style) in &rates {
        let number = |row: &str| row.parse().ok();
        of_wall.push(series(wall, rate, *style, false, number));
        of_wall.push(series(springs, rate, style.hollow(), false, number));
        let dashed = Style { dash: "4 3", ..*style };
        let line = Series { marked: false, ..series(wall, &format!("{rate} bound"), dashed, true, number) };
        of_wall.push(line);
    }
    let values = |series: &[Series], of: fn(&Point) -> f64| -> Vec<f64> {
        series.iter().flat_map(|s| s.points.iter().map(of)).collect()
    };
    let label = "largest stiffness K, N/m";
    let first = Chart {
        title: "Plain wall, ideal device".into(),
        x: Axis::linear("virtual damping B, N s/m", values(&of_wall, |p| p.x)),
        y: Axis::linear(label, values(&of_wall, |p| p.y)),
        series: of_wall,
        levels: vec![],
    };
    let at_rate = |rate: String| move |row: &str| row.strip_prefix(&rate)?.parse::<f64>().ok();
    let by_rate: Vec<Series> = RATES_HZ
        .iter()
        .zip(&rates)
        .map(|(rate, (_, style))| series(damping, "energy", *style, true, at_rate(format!("{rate}_hz."))))
        .map(|series| Series { marked: true, ..series })
        .collect();
    let second = Chart {
        title: "Organ (energy) on an emulated omega.3".into(),
        x: Axis::log("damping b of the device, N s/m", values(&by_rate, |p| p.x)),
        y: Axis::log(label, values(&by_rate, |p| p.y)),
        series: by_rate,
        levels: vec![],
    };
    let renderers = shown(std::slice::from_ref(damping));
    let by_renderer: Vec<Series> = renderers
        .iter()
        .map(|(column, style)| {
            let of = series(damping, column, *style, true, at_rate("1000_hz.".into()));
            Series { marked: true, ..of }
        })
        .collect();
    let third = Chart {
        title: "Renderers at 1 kHz on an emulated omega.3".into(),
        x: Axis::log("damping b of the device, N s/m", values(&by_renderer, |p| p.x)),
        y: Axis::log(label, values(&by_renderer, |p| p.y)),
        series: by_renderer,
        levels: vec![],
    };
    let at_1_khz: Vec<(&str, String)> = devices
        .rows
        .iter()
        .filter_map(|row| Some((row.key.as_str(), row.key.strip_suffix(".1000_hz")?.to_owned())))
        .collect();
    let fourth = stems("Bundled devices at 1 kHz", label, std::slice::from_ref(devices), &at_1_khz);
    let rate_keys: Vec<Key> = rates.into_iter().map(|(name, style)| Key::line(style, name)).collect();
    plots(&rate_keys, "", &[first.svg(), second.svg()])
        + &plots(&keys(&renderers), "", &[third.svg(), fourth])
}
