//! Cost of the tables: solves, time, bytes and time of a query.

use std::time::Instant;

use palpate_core::Method;
use palpate_precompute::pack::{PackOptions, pack};
use palpate_precompute::space::Store;

use super::figures::{Best, Others, Row, Section, Table};
use super::organs::Ready;
use super::run::{Context, WORK, finished};
use crate::cmd::bench::core::fastest_ns;
use crate::failure::Failure;

/// Name of the section.
pub(super) const KEY: &str = "cost";

/// Rows of its tables: key, name, and which value is the best one.
pub(super) const ROWS: [(&str, &str, Best); 4] = [
    ("solves", "finite-element solves before the touch", Best::None),
    ("solve_s", "their time, s", Best::None),
    ("bytes", "bytes of the table", Best::Least),
    ("query_ns", "one force query, ns", Best::Least),
];

/// Rounds of the timing.
const ROUNDS: [usize; 2] = [200, 40];

/// Measures the section.
pub(super) fn section(organs: &[Ready], context: &Context<'_>) -> Result<Section, Failure> {
    let start = Instant::now();
    let mut tables = Vec::new();
    for ready in organs {
        context.go_on()?;
        let store = Store::open(&ready.space)?;
        let solved = store.records(0)?.iter().filter(|record| record.tag().is_solved()).count();
        let seconds: f64 = store.attempts(0)?.iter().map(|record| record.seconds).sum();
        let organ = ready.organ()?;
        let times = fastest_ns(&organ.spaces[0], ROUNDS[usize::from(context.quick)]);
        let has = |method: &Method| ready.scene.methods.contains(method);
        let of_all = |value: f64| -> Vec<f64> {
            Method::ALL.iter().map(|method| if has(method) { value } else { f64::NAN }).collect()
        };
        let mut bytes = Vec::new();
        for method in Method::ALL {
            let options =
                PackOptions { methods: &[method], use_intermediate_states: true, threads: context.threads };
            bytes.push(if has(&method) { pack(&store, &options)?.bytes()?.len() as f64 } else { f64::NAN });
        }
        let query = Method::ALL.map(|method| {
            times.iter().find(|(name, _)| *name == method.name()).map_or(f64::NAN, |(_, ns)| *ns)
        });
        let mut table = Table::new(
            &format!("{KEY}.{}", ready.scene.name),
            &format!("Organ \u{201c}{}\u{201d}", ready.scene.name),
            "Solves and their time, summed over threads, are those of the table's positions; all methods of an organ \
             share them. Bytes are those of a blob with this method alone.",
            "measure",
            Method::ALL.map(|method| method.name().to_owned()).to_vec(),
        );
        table.others = Others::Declared;
        let values = [of_all(solved as f64), of_all(seconds), bytes, query.to_vec()];
        let rows = ROWS.into_iter().zip(values);
        table.rows = rows.map(|((key, name, best), values)| Row::new(key, name, best, values)).collect();
        table.without_empty_columns();
        tables.push(table);
    }
    Ok(finished(
        context,
        KEY,
        "Cost of the tables",
        &[
            "What a method needs before the first touch, and in each tick. The time of a query is the median with the fastest \
           vector instructions of this processor.",
        ],
        &[&format!("palpate bench core --blob OUT/{WORK}/point.blob")],
        start.elapsed().as_secs_f64(),
        tables,
    ))
}
