//! `palpate bench forms`: compares the storage forms of a fitted energy in one run: bytes, nanoseconds and
//! error.

mod cell;

use std::path::PathBuf;

use clap::Args as ClapArgs;
use palpate_core::{Method, Organ, Space, Vec3, vec3};
use palpate_host::{BlobFile, Instructions, Interpolator};
use palpate_precompute::certificate::{Answer, Compared, Errors, answers, reference_force_n};
use palpate_precompute::fit::KernelFit;
use palpate_precompute::pack::{PackOptions, pack};
use palpate_precompute::space::{Kind, Store, state};
use serde::Serialize;

use super::common::{Out, Pinned};
use super::core::timing::{self, Run};
use crate::failure::Failure;
use crate::output;
use cell::CellTable;

/// Compare the storage forms of the fitted energy of a space of adaptive sampling.
///
/// The forms are one polynomial per cell (not in blobs), the derivatives at nodes (`energy`), and the fit
/// itself (`kernel`).
///
/// The positions are reachable by the tool, in random order. The forms run interleaved in small batches.
/// Errors are those at the held-out positions of the space (`palpate pack` solves some, `palpate held-out`
/// more), and the difference from the fit in f64.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// The .space file of a space of adaptive sampling
    space: PathBuf,
    /// Active node; all nodes with a fit if not given
    #[arg(long, value_name = "NAME")]
    active: Option<String>,
    /// Number of interleaved batches of each form
    #[arg(long, value_name = "N", default_value_t = 400)]
    rounds: usize,
    #[command(flatten)]
    pinned: Pinned,
    #[command(flatten)]
    out: Out,
}

/// One form for one node and one instruction set.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct FormRow {
    pub(crate) active: String,
    /// Configurations of the fit.
    pub(crate) configurations: usize,
    pub(crate) form: &'static str,
    pub(crate) instructions: &'static str,
    /// Bytes of the data that it reads, without flags and displacements, which every form has.
    pub(crate) bytes: usize,
    pub(crate) median_ns: f64,
    /// Median of dependent queries, each of which needs the result of the one before.
    pub(crate) waits_ns: Option<f64>,
    /// Number of held-out positions away from branch jumps, and the errors there.
    pub(crate) positions: usize,
    pub(crate) mean_n: f64,
    pub(crate) p99_n: f64,
    pub(crate) max_n: f64,
    /// Difference from the fit in f64, at positions within reach.
    pub(crate) from_fit_p99_n: f64,
    pub(crate) from_fit_max_n: f64,
    /// Difference from the same form in f64.
    pub(crate) rounding_n: f64,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let out = args.out.ready([args.space.as_path()])?;
    let pinned = args.pinned.pin();
    let store = Store::open(&args.space)?;
    let rows = measure(&store, args.active.as_deref(), args.rounds.max(1))?;
    if rows.is_empty() {
        return Err(Failure::input(format!(
            "{}: no such active node has a fit of adaptive sampling",
            args.space.display()
        )));
    }
    out.write(|| output::csv(&rows), &rows, || table(&rows, &pinned))
}

/// Measures every form of every node that has a fit.
pub(crate) fn measure(store: &Store, wanted: Option<&str>, rounds: usize) -> Result<Vec<FormRow>, Failure> {
    let methods = &[Method::Energy, Method::Kernel];
    let file = BlobFile::of(
        &pack(store, &PackOptions { methods, use_intermediate_states: false, threads: 1 })?.bytes()?,
    );
    let organ: Organ<'_> = Organ::read(file.bytes()).map_err(Failure::work)?;
    let mut rows = Vec::new();
    for (active, (name, _)) in store.active()?.into_iter().enumerate() {
        let space =
            organ.spaces.iter().find(|space| space.active.name == name.as_str() && space.has(Method::Kernel));
        let (Some(space), Some(fit)) = (space, state(store, active)?.fit) else { continue };
        if wanted.is_some_and(|wanted| wanted != name) {
            continue;
        }
        let places: Vec<Vec3> =
            fit.places(4_000).into_iter().map(|at| at.map(|x| x as f32)).filter(within(space)).collect();
        let mut truths = answers(store, active, space, Method::Energy)?;
        truths.retain(|answer| answer.walk.kind == Kind::Uniform && !answer.near_branch_jump);
        rows.extend(of_space(&name, space, &fit.fit, (&places, &truths), rounds));
    }
    Ok(rows)
}

fn within<'s>(space: &'s Space<'_>) -> impl Fn(&Vec3) -> bool + 's {
    |at| space.lattice().locate(*at).inside
}

fn of_space(
    name: &str,
    space: &Space<'_>,
    fit: &KernelFit,
    (places, truths): (&[Vec3], &[Answer]),
    rounds: usize,
) -> Vec<FormRow> {
    let Some(cells) = CellTable::of(space) else { return Vec::new() };
    let mut runs = vec![Run::new(
        "cell".into(),
        Instructions::Baseline.name(),
        Method::Energy,
        cells.bytes(),
        |at: &Vec3| cells.force_n(at),
    )];
    for (form, method) in [("node", Method::Energy), ("kernel", Method::Kernel)] {
        // Without flags, as for the cell table.
        let bytes = match method {
            Method::Kernel => super::core::bytes(space, Method::Kernel),
            _ => super::core::bytes(space, Method::Hermite),
        };
        for interpolator in
            Instructions::ALL.into_iter().filter_map(|i| Interpolator::with_instructions(i, method))
        {
            let instructions = interpolator.instructions().name();
            let ask =
                move |at: &Vec3| interpolator.force(space, at).map_or(vec3::ZERO, |answer| answer.force_n);
            runs.push(Run::new(form.into(), instructions, method, bytes, ask));
        }
    }
    let timings = timing::interleave(&mut runs, &shuffled(places), rounds);
    let row = |(run, timing): (&mut Run<'_>, timing::Timing)| {
        let mut compared = Vec::new();
        for truth in truths {
            let found_n = run.ask(&truth.displacement_m).map(f64::from);
            compared.push(Compared { found_n, ..truth.compared });
        }
        let errors = Errors::of(&compared);
        let (mut from_fit, mut rounding_n) = (Vec::new(), 0.0_f64);
        for at in places {
            let found = run.ask(at);
            from_fit.push(apart(found, fit.force_n(at.map(f64::from))));
            let exact = reference_force_n(space, run.compared, *at);
            rounding_n = rounding_n.max(exact.map_or(f64::NAN, |exact| apart(found, exact)));
        }
        from_fit.sort_by(f64::total_cmp);
        let at = |share: usize| from_fit.get(from_fit.len() * share / 100).or(from_fit.last()).copied();
        FormRow {
            active: name.into(),
            configurations: fit.centres.len(),
            form: match run.name.as_str() {
                "cell" => "cell",
                "node" => "node",
                _ => "kernel",
            },
            instructions: run.instructions,
            bytes: run.bytes,
            median_ns: timing.median_ns,
            waits_ns: timing.waits_ns,
            positions: errors.count,
            mean_n: errors.mean_n,
            p99_n: errors.p99_n,
            max_n: errors.max_n,
            from_fit_p99_n: at(99).unwrap_or(f64::NAN),
            from_fit_max_n: at(100).unwrap_or(f64::NAN),
            rounding_n,
        }
    };
    runs.iter_mut().zip(timings).map(row).collect()
}

/// Positions repeated in random order, too many for a branch predictor to learn, with a fixed seed.
fn shuffled(places: &[Vec3]) -> Vec<Vec3> {
    let mut seed = 7_u64;
    let next = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        places.get((seed >> 33) as usize % places.len().max(1)).copied().unwrap_or(vec3::ZERO)
    };
    std::iter::repeat_with(next).take(1 << 16).collect()
}

fn apart(a: Vec3, b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (f64::from(*a) - b).powi(2)).sum::<f64>().sqrt()
}

fn table(rows: &[FormRow], pinned: &str) -> String {
    let mut text = format!(
        "pinned     to {pinned}\n\n\
         node         fit  form    on          bytes  median ns  waits ns   mean mN    p99 mN    max mN  (of)    from the fit p99   max mN  rounding mN"
    );
    for row in rows {
        text += &format!(
            "\n{:<12} {:>3}  {:<7} {:<9} {:>7} {:>10.1} {:>9} {:>9.3} {:>9.3} {:>9.3} {:>5} {:>19.4} {:>8.4} {:>12.5}",
            row.active,
            row.configurations,
            row.form,
            row.instructions,
            row.bytes,
            row.median_ns,
            row.waits_ns.map_or_else(|| "-".into(), |ns| format!("{ns:.1}")),
            1e3 * row.mean_n,
            1e3 * row.p99_n,
            1e3 * row.max_n,
            row.positions,
            1e3 * row.from_fit_p99_n,
            1e3 * row.from_fit_max_n,
            1e3 * row.rounding_n
        );
    }
    text + "\n\ncell: one polynomial of 216 coefficients per cell; measured here only, no blob contains it"
}
