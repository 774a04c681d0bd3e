//! `palpate pack`: fits the tables of a `.space` file, measures them, and writes the blob.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_core::{Method, Organ};
use palpate_host::BlobFile;
use palpate_precompute::certificate::{Certificate, Effort, certify, clear_positions, ledger};
use palpate_precompute::held_out::{Draw, Summary};
use palpate_precompute::pack::{PackError, PackOptions, Packed, needed_method, pack};
use palpate_precompute::space::{Kind, Store, planned, still_to_solve, with_threads};

use super::inspect::certificate;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output, Replace};
use crate::output;
use crate::progress::WorkProgress;
use crate::workbench::{Workbench, stop_flag, threads};

/// Fit the tables of a .space file, measure them, and pack them into a .blob for the real-time loop.
///
/// The packed tables are measured against finite-element solves that no fit has seen, and what comes out is kept in the blob as its
/// certificate. Uniform positions that the .space file does not hold yet are solved into it first; `palpate held-out` adds paths.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// The .space file
    space: PathBuf,
    /// Methods to pack, separated by commas: trilinear, tricubic, hybrid, rbf-linear, rbf-cubic, hermite, energy, kernel. Methods of one
    /// table come together: the first three, and hermite and energy; kernel is the fit of scattered positions itself. If not given the
    /// scene's needs choose between energy and kernel (`form` and `blob_bytes` under [needs]); without any it is energy
    #[arg(long = "method", value_delimiter = ',', value_parser = method)]
    methods: Vec<Method>,
    /// The .blob file to write
    #[arg(long)]
    out: PathBuf,
    /// Pack a space that is not finished: where it has no data the force is extrapolated. Such a blob has no certificate
    #[arg(long)]
    partial: bool,
    /// Leave the certificate out; `palpate run` then wants to be told to trust the blob. The same scene then gives the same file to the
    /// last bit, whatever the number of threads; a certificate holds measured times
    #[arg(long)]
    no_certificate: bool,
    /// Uniform positions away from folds that are solved for the certificate, an active node. If not given 299, which can certify 99 %
    /// with 95 % confidence; of more than eight nodes 600 in all, which can certify 99.5 % of a random position of a random node. 0: the
    /// blind loop's own verdict alone, at once; `palpate run` then wants to be told to trust the blob
    #[arg(long, value_name = "N")]
    uniform: Option<u32>,
    /// Add element order and mesh to the ledger (which tells what the blob leaves out and what that changes and saves: linear body, f_max,
    /// modes, digits): so many of the certificate's positions are solved by each other body, the finer of which take seconds each. Of more
    /// than eight nodes the first has a ledger
    #[arg(long, value_name = "POSITIONS", num_args = 0..=1, default_missing_value = "8")]
    ledger: Option<usize>,
    /// Leave states between grid points, which a scene with `increments` keeps, out of the radial basis functions
    #[arg(long)]
    grid_only: bool,
    /// Worker threads for those; one a core if not given
    #[arg(long)]
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
    let store = Store::open(&args.space)?;
    let finished = check_finished(&store, args)?;
    let threads = threads(args.threads);
    let needed = if args.methods.is_empty() { vec![needed_method(&store, threads)?] } else { Vec::new() };
    let methods = if args.methods.is_empty() { &needed } else { &args.methods };
    let options = PackOptions { methods, intermediate: !args.grid_only, threads };
    if methods.contains(&Method::Kernel) {
        expect_kernels(&store)?;
    }
    let (packed, made) = if args.no_certificate || !finished {
        (pack(&store, &options)?, None)
    } else {
        let nodes = store.active()?.len();
        drop(store);
        solve_truth(args, &space, nodes)?;
        let store = Store::open(&args.space)?;
        let (mut packed, mut made) = certified(&store, &options)?;
        measure_ledger(&store, (&mut packed, &mut made), args.ledger.unwrap_or(0), options.threads)?;
        (packed, Some(made))
    };
    for name in &packed.left_out {
        eprintln!("palpate: warning: active node {name} has no solved configuration and is left out");
    }
    packed.expect_kernels()?;
    let bytes = packed.bytes()?;
    blob.put(&bytes)?;
    if args.json {
        return output::line(serde_json::to_string_pretty(&made).map_err(Failure::work)?);
    }
    let names: Vec<&str> = methods.iter().map(|m| m.name()).collect();
    output::line(format!("{}: {} bytes, {}", args.out.display(), bytes.len(), names.join(", ")))?;
    match made {
        Some(made) => output::line(certificate::in_words(&made)),
        None => output::line("not certified"),
    }
}

/// A node without a kernel is an error before its certificate is solved for.
fn expect_kernels(store: &Store) -> Result<(), Failure> {
    for (active, (name, _)) in store.active()?.into_iter().enumerate() {
        let has_fit = planned(store, active)?.is_some_and(|plan| plan.switched().is_none());
        let is_empty = store.records(active)?.iter().filter(|record| record.tag.is_solved()).count() < 2;
        if !has_fit && !is_empty {
            return Err(PackError::NoKernel { active: name }.into());
        }
    }
    Ok(())
}

/// Packs tables with their certificate.
pub(crate) fn certified(store: &Store, options: &PackOptions<'_>) -> Result<(Packed, Certificate), Failure> {
    let mut packed = pack(store, options)?;
    // The very bytes that the loop will read.
    let file = BlobFile::of(&packed.bytes()?);
    let organ: Organ<'_> = Organ::read(file.bytes()).map_err(Failure::work)?;
    let certificate = certify(store, &organ)?;
    packed.certify(&serde_json::to_string(&certificate).map_err(Failure::work)?)?;
    Ok((packed, certificate))
}

/// Adds the ledgers to a certificate: without `positions` what the blob itself leaves out, with them what the discretisation does, too.
fn measure_ledger(
    store: &Store,
    (packed, made): (&mut Packed, &mut Certificate),
    positions: usize,
    threads: usize,
) -> Result<(), Failure> {
    let file = BlobFile::of(&packed.bytes()?);
    let organ: Organ<'_> = Organ::read(file.bytes()).map_err(Failure::work)?;
    let (bench, stop) = (Workbench::of_store(store)?, stop_flag()?);
    let effort = Effort { positions, threads, stop: &stop };
    let wanted = if made.spaces.len() > FEW { 1 } else { made.spaces.len() };
    let names: Vec<String> = store.active()?.into_iter().map(|(name, _)| name).collect();
    for space in &mut made.spaces[..wanted] {
        let Some(active) = names.iter().position(|name| *name == space.active) else { continue };
        if positions > 0 {
            eprintln!("palpate: ledger of {}: {positions} positions by each other body", space.active);
        }
        space.ledger = ledger(store, active, (&organ, space), &bench.scene, effort)?;
        if stop.load(Ordering::Relaxed) {
            return Err(Failure::work(
                "interrupted; what was solved for the certificate is kept, run the same command to go on",
            ));
        }
    }
    packed.certify(&serde_json::to_string(&*made).map_err(Failure::work)?).map_err(Failure::work)
}

/// Uniform positions of a blob of many nodes, all together: without a failure they certify 99.5 % with 95 % confidence.
const TOGETHER: u32 = 600;
/// Fewer than this say nothing of a node.
const LEAST: u32 = 3;

/// More nodes than this are certified together.
const FEW: usize = 8;

/// Uniform positions a node, where nobody says how many.
fn enough(nodes: usize) -> u32 {
    if nodes <= FEW {
        return Draw::PAPER.uniform;
    }
    TOGETHER.div_ceil(u32::try_from(nodes).unwrap_or(u32::MAX)).max(LEAST)
}

/// Uniform positions are solved in at most this many goes: how many of them fall at folds is known only afterwards.
const GOES: u32 = 4;

/// Solves uniform positions until as many as asked are away from folds, or nothing speaks for there being more. Only nodes that fold are
/// asked for more; of many that are certified together none is: the others make up for it, and to look for folds is to fit every space once more.
fn solve_truth(args: &Args, space: &Output, nodes: usize) -> Result<(), Failure> {
    let asked = args.uniform.unwrap_or_else(|| enough(nodes));
    let mut lacking: Vec<usize> = (0..nodes).collect();
    let mut wanted = asked;
    let goes = if nodes > FEW && args.uniform.is_none() { 1 } else { GOES };
    for go in 1..=goes {
        if !solve_uniform(args, space, &lacking, wanted)? || go == goes {
            return Ok(());
        }
        let store = Store::open(space.path())?;
        let flags_only = PackOptions { methods: &[], intermediate: false, threads: threads(args.threads) };
        let file = BlobFile::of(&pack(&store, &flags_only)?.bytes()?);
        let organ: Organ<'_> = Organ::read(file.bytes()).map_err(Failure::work)?;
        let mut clear = clear_positions(&store, &organ)?;
        clear.retain(|&(_, count)| count > 0 && count < asked as usize);
        let Some(least) = clear.iter().map(|&(_, count)| count as u32).min() else { return Ok(()) };
        lacking = clear.into_iter().map(|(active, _)| active).collect();
        wanted += ((asked - least) * wanted).div_ceil(least);
    }
    Ok(())
}

/// Solves what is missing of so many uniform positions of these active nodes; returns whether all of them are there.
fn solve_uniform(args: &Args, space: &Output, actives: &[usize], wanted: u32) -> Result<bool, Failure> {
    let store = Store::open(space.path())?;
    let missing = |store: &Store| -> Result<Vec<usize>, Failure> {
        let mut missing = Vec::new();
        for &active in actives {
            let there = Summary::of(store, active)?.get(&Kind::Uniform).map_or(0, |sum| sum.whole);
            let reach = store.records(active)?.iter().filter(|r| r.tag.is_solved()).count();
            if there < wanted && reach > 1 {
                missing.push(active);
            }
        }
        Ok(missing)
    };
    let actives = missing(&store)?;
    if actives.is_empty() {
        return Ok(true);
    }
    let bench = Arc::new(Workbench::of_store(&store)?);
    drop(store);
    let (stop, threads, start) = (stop_flag()?, threads(args.threads), Instant::now());
    let store = bench.store(space, false)?;
    let draw = Draw {
        uniform: wanted,
        ..Draw::of(&store)?.unwrap_or(Draw { regular_m: None, random: 0, ..Draw::PAPER })
    };
    let held_out = bench.held_out(&actives, draw)?;
    let mut progress = WorkProgress::new("held-out truth", "positions");
    let mut solved_now = 0;
    let solved = with_threads(&bench.workshop()?, threads, |crew| {
        held_out.run(&store, crew, &stop, |p| {
            solved_now = p.positions_now;
            progress.walks(p);
        })
    });
    progress.finish();
    solved?;
    let seconds = start.elapsed().as_secs_f64();
    eprintln!(
        "palpate: {solved_now} held-out positions solved for the certificate in {seconds:.1} s, kept in the .space file"
    );
    Ok(missing(&store)?.is_empty())
}

/// A blob of half a space looks like any other in the hand: it is made only when asked for.
fn check_finished(store: &Store, args: &Args) -> Result<bool, Failure> {
    let space = args.space.display();
    let mut finished = true;
    for (active, (name, _)) in store.active()?.into_iter().enumerate() {
        let open = still_to_solve(store, active)?;
        if open == 0 {
            continue;
        }
        let what = format!(
            "{space}: active node {name} is not finished: {open} points or more are still to be solved"
        );
        if !args.partial {
            return Err(Failure::input(format!(
                "{what}; run `palpate precompute` again, or pack with --partial"
            )));
        }
        finished = false;
        eprintln!("palpate: warning: {what}");
    }
    Ok(finished)
}
