//! `palpate pack`: fits the tables of a `.space` file, measures their errors, and writes the blob.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_core::Method;
use palpate_precompute::pack::{PackError, PackOptions, pack};
use palpate_precompute::pipeline::{
    DISCRETISATION_POSITIONS, Run, add_ledgers, certified, solve_discretisation, solve_held_out_positions,
    unfinished,
};
use palpate_precompute::space::{Store, state};

use super::inspect::overview::{headline, overview};
use crate::analysis::{existing_space, threads};
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output, Replace};
use crate::interrupt::stop_flag;
use crate::output;
use crate::progress::WorkProgress;

/// Fit a .space file, measure the errors, pack it into a .blob.
///
/// The tables are compared with finite-element solutions that no fit uses. The errors are stored in the blob
/// as its certificate, which `palpate inspect --verbose` prints. Missing uniform positions are first solved
/// into the .space file; `palpate paper held-out` adds paths.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// The .space file
    space: PathBuf,
    /// The .blob file to write
    #[arg(long, value_name = "FILE.blob")]
    out: PathBuf,
    /// Methods to pack, separated by commas
    ///
    /// trilinear, tricubic, hybrid, rbf-linear, rbf-cubic, hermite, energy, kernel. trilinear, tricubic and
    /// hybrid share a table, hermite and energy another; a shared table is packed for all its methods. kernel
    /// is the fit of adaptive sampling itself: a smaller blob with slower queries than energy.
    #[arg(long = "method", value_name = "M,M", value_delimiter = ',', value_parser = method, default_value = "energy")]
    methods: Vec<Method>,
    /// Positions of the certificate per active node; 299 if not given
    ///
    /// They are uniform and away from branch jumps. 299 can certify 99 % of the positions with 95 %
    /// confidence. With more than eight nodes the default is 600 in total, at least three per node, which can certify
    /// 99.5 % of the positions of all nodes together. 0: no errors are measured; `palpate run` then needs --uncertified.
    #[arg(long, value_name = "N")]
    uniform: Option<u32>,
    /// Positions of the certificate that more accurate elements solve too; 0: none
    ///
    /// They measure the error of the discretisation, for a tool with a size: linear elements against quadratic
    /// ones, these against a mesh refined near the tool.
    #[arg(long, value_name = "N", default_value_t = DISCRETISATION_POSITIONS)]
    discretisation: usize,
    /// Measure the effects of element order and mesh refinement too
    ///
    /// Each refined body is solved at this many positions of the certificate, which takes seconds per
    /// position. With more than eight nodes only the first node has a ledger.
    #[arg(long, value_name = "POSITIONS", num_args = 0..=1, default_missing_value = "8")]
    ledger: Option<usize>,
    /// Omit the certificate; `palpate run` then needs --uncertified
    ///
    /// The same scene then gives the same file to the last bit with any number of threads; a certificate
    /// holds measured times.
    #[arg(long)]
    no_certificate: bool,
    /// Pack an unfinished space. Where it has no data, the force is extrapolated. The blob has no certificate
    #[arg(long, hide_short_help = true)]
    partial: bool,
    /// Fit the radial basis functions without the states between grid points (a scene with `increments` has
    /// such states)
    #[arg(long, hide_short_help = true)]
    grid_only: bool,
    /// Worker threads; one per core if not given
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Print the certificate as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    replace: Replace,
}

/// Parses a method's name.
pub(crate) fn method(text: &str) -> Result<Method, String> {
    Method::from_name(text).ok_or_else(|| {
        let names: Vec<&str> = Method::ALL.iter().map(|m| m.name()).collect();
        format!("no such method; choose from {}", names.join(", "))
    })
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let mut files = Files::new(args.replace);
    let space = files.update_space(&args.space);
    let blob = files.write("--out", &args.out, FileKind::Blob)?;
    let store = existing_space(&args.space)?;
    let finished = check_finished(&store, args)?;
    let threads = threads(args.threads)?;
    let methods = &args.methods;
    let options = PackOptions { methods, use_intermediate_states: !args.grid_only, threads };
    let wants_kernels = methods.contains(&Method::Kernel);
    if wants_kernels {
        refuse_lattices(&store)?;
    }
    let (packed, certificate) = if args.no_certificate || !finished {
        let _progress = in_phase("tables, without a certificate");
        (pack(&store, &options)?, None)
    } else {
        drop(store);
        solve_certificate(args, &space)?;
        let store = Store::open(&args.space)?;
        let progress = in_phase("tables and certificate");
        let (mut packed, mut certificate) = certified(&store, &options)?;
        progress.finish();
        let (stop, positions) = (stop_flag()?, args.ledger.unwrap_or(0));
        add_ledgers(
            &store,
            (&mut packed, &mut certificate),
            positions,
            Run { threads, stop: &stop },
            |active| {
                eprintln!("palpate: ledger of {active}: {positions} positions with each altered body");
            },
        )?;
        (packed, Some(certificate))
    };
    for name in &packed.nodes_without_data {
        eprintln!("palpate: warning: active node {name} has no solved configuration and is omitted");
    }
    if wants_kernels {
        packed.expect_kernels()?;
    }
    let bytes = packed.bytes()?;
    blob.put(&bytes)?;
    if args.json {
        return output::json(&certificate);
    }
    let names: Vec<&str> = methods.iter().map(|m| m.name()).collect();
    let (out, size) = (args.out.display(), bytes.len());
    let written = format!("{out}: {size} bytes, {}", names.join(", "));
    let Some(certificate) = certificate else {
        return output::line(format!("{written}; not certified, `palpate run` needs --uncertified"));
    };
    output::line(headline(&certificate))?;
    output::line(format!("{written}\n\n{}", overview(&certificate)))?;
    output::line(format!("\nthe whole certificate: palpate inspect {out} --verbose"))
}

/// Progress display of a phase of unknown length.
fn in_phase(doing: &str) -> WorkProgress {
    let mut progress = WorkProgress::new("pack", "");
    progress.phase(doing);
    progress
}

/// Refuses a node whose space is a lattice, before the certificate is solved.
fn refuse_lattices(store: &Store) -> Result<(), Failure> {
    for (active, (name, _)) in store.active()?.into_iter().enumerate() {
        let state = state(store, active)?;
        let has_fit = state.fit.is_some() && state.fallback().is_none();
        let has_only_rest =
            store.records(active)?.iter().filter(|record| record.tag().is_solved()).count() < 2;
        if !has_fit && !has_only_rest {
            return Err(PackError::NoKernel { active: name }.into());
        }
    }
    Ok(())
}

/// Solves the positions of the certificate that the space does not contain.
fn solve_certificate(args: &Args, space: &Output) -> Result<(), Failure> {
    let (stop, start) = (stop_flag()?, Instant::now());
    let run = Run { threads: threads(args.threads)?, stop: &stop };
    let mut progress = WorkProgress::new("held-out solutions", "positions");
    let solved = solve_held_out_positions(space.path(), args.uniform, run, |p| progress.held_out(p));
    progress.finish();
    let (solved, seconds) = (solved?, start.elapsed().as_secs_f64());
    if solved > 0 {
        eprintln!(
            "palpate: {solved} held-out positions solved for the certificate in {seconds:.1} s, kept in the .space file"
        );
    }
    let (progress, start) = (Mutex::new(WorkProgress::new("discretisation", "positions")), Instant::now());
    let solved = solve_discretisation(space.path(), args.discretisation, run, |done, all| {
        let mut progress = progress.lock().unwrap_or_else(PoisonError::into_inner);
        progress.steps("more accurate elements", done, all);
    });
    progress.into_inner().unwrap_or_else(PoisonError::into_inner).finish();
    let (solved, seconds) = (solved?, start.elapsed().as_secs_f64());
    if solved > 0 {
        eprintln!("palpate: {solved} positions solved with more accurate elements in {seconds:.1} s");
    }
    Ok(())
}

/// A blob of an unfinished space is packed only with `--partial`. Returns whether the space is finished.
fn check_finished(store: &Store, args: &Args) -> Result<bool, Failure> {
    let unfinished = unfinished(store)?;
    match unfinished.first() {
        Some(first) if !args.partial => Err(first.clone().into()),
        _ => {
            for node in &unfinished {
                eprintln!("palpate: warning: {}: {}", node.file.display(), node.what);
            }
            Ok(unfinished.is_empty())
        }
    }
}
