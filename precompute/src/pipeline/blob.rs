//! From a solved space to a certified blob.

use std::path::Path;
use std::sync::atomic::Ordering;

use palpate_core::{AlignedBytes, Method, Organ};

use super::discretisation::{DISCRETISATION_POSITIONS, solve_discretisation};
use super::ledger::ledger;
use super::{Analysis, PipelineError, Run};
use crate::certificate::{Certificate, MAX_SEPARATE_NODES, certify, clear_positions};
use crate::error::InputError;
use crate::held_out::{Draw, HeldOutProgress, Summary};
use crate::pack::{PackError, PackOptions, Packed, pack};
use crate::space::{Kind, Store, state};

/// One error for each active node of a space that has unsolved positions.
pub fn unfinished(store: &Store) -> Result<Vec<InputError>, PipelineError> {
    let mut unfinished = Vec::new();
    for (active, (name, _)) in store.active()?.into_iter().enumerate() {
        let open = state(store, active)?.open;
        if open > 0 {
            let what =
                format!("active node {name} is not finished: {open} points or more are still to be solved");
            let fix = "run `palpate precompute` again, or pack with --partial";
            unfinished.push(InputError::new(store.path(), what, fix));
        }
    }
    if unfinished.is_empty() && store.identity()?.charts.is_some() && !store.are_charts_complete()? {
        let what = "the charts of the field are not complete";
        unfinished.push(InputError::new(store.path(), what, "run `palpate precompute` again"));
    }
    Ok(unfinished)
}

/// Total number of uniform positions of a blob of many nodes. If none fails, they certify 99.5 % with 95 %
/// confidence.
const BATCH: u32 = 600;
/// Minimum number of uniform positions of one node.
const MIN_UNIFORM: u32 = 3;

/// Default number of uniform positions of a node.
fn default_uniform(nodes: usize) -> u32 {
    if nodes <= MAX_SEPARATE_NODES {
        return Draw::PAPER.uniform;
    }
    BATCH.div_ceil(u32::try_from(nodes).unwrap_or(u32::MAX)).max(MIN_UNIFORM)
}

/// Maximum number of rounds in which uniform positions are solved. The number of positions at branch jumps is
/// known only after each round.
const MAX_ROUNDS: u32 = 4;

/// Solves uniform positions of every active node and stores them in the `.space` file. It ends when `uniform`
/// of them lie away from branch jumps, or when more positions would not help. With `None` it solves 299 for
/// each of up to eight nodes; for more nodes 600 in total, at least three of each. Returns the number of positions
/// solved by this call.
///
/// Only nodes with branch jumps get more positions. If many nodes are certified together, no node gets more,
/// because the positions of the other nodes suffice.
pub fn solve_held_out_positions(
    space: &Path,
    uniform: Option<u32>,
    run: Run<'_>,
    mut progress: impl FnMut(&HeldOutProgress),
) -> Result<usize, PipelineError> {
    let nodes = Store::open(space)?.active()?.len();
    let asked = uniform.unwrap_or_else(|| default_uniform(nodes));
    let rounds = if nodes > MAX_SEPARATE_NODES && uniform.is_none() { 1 } else { MAX_ROUNDS };
    let (mut lacking, mut wanted, mut solved): (Vec<usize>, _, _) = ((0..nodes).collect(), asked, 0);
    for round in 1..=rounds {
        let (solved_now, is_whole) = solve_uniform(space, &lacking, wanted, run, &mut progress)?;
        solved += solved_now;
        if !is_whole || round == rounds {
            break;
        }
        let store = Store::open(space)?;
        let flags_only = PackOptions { methods: &[], use_intermediate_states: false, threads: run.threads };
        let bytes = AlignedBytes::from(&pack(&store, &flags_only)?.bytes()?[..]);
        let organ = read(&bytes)?;
        let mut clear = clear_positions(&store, &organ)?;
        clear.retain(|&(_, count)| count > 0 && count < asked as usize);
        let Some(least) = clear.iter().map(|&(_, count)| count as u32).min() else { break };
        lacking = clear.into_iter().map(|(active, _)| active).collect();
        wanted += ((asked - least) * wanted).div_ceil(least);
    }
    Ok(solved)
}

/// Solves the missing ones of `wanted` uniform positions of these active nodes. Returns how many it solved,
/// and whether all of them exist.
fn solve_uniform(
    space: &Path,
    actives: &[usize],
    wanted: u32,
    run: Run<'_>,
    progress: &mut dyn FnMut(&HeldOutProgress),
) -> Result<(usize, bool), PipelineError> {
    let store = Store::open(space)?;
    let actives = lacking_uniform(&store, actives, wanted)?;
    if actives.is_empty() {
        return Ok((0, true));
    }
    let analysis = Analysis::of_store(&store)?;
    drop(store);
    let store = analysis.store(space)?;
    let step_m = Draw::default_step_m(analysis.sampling()?.radius_m());
    let uniform_only = Draw { step_m, regular_m: None, random: 0, ..Draw::PAPER };
    let draw = Draw { uniform: wanted, ..Draw::of(&store)?.unwrap_or(uniform_only) };
    let held_out = analysis.held_out(&actives, draw)?;
    let mut solved = 0;
    analysis.solve_held_out(&held_out, &store, run, |p| {
        solved = p.positions_now;
        progress(p);
    })?;
    Ok((solved, lacking_uniform(&store, &actives, wanted)?.is_empty()))
}

/// Active nodes that have a space but fewer than `wanted` uniform positions.
fn lacking_uniform(store: &Store, actives: &[usize], wanted: u32) -> Result<Vec<usize>, PipelineError> {
    let mut lacking = Vec::new();
    for &active in actives {
        let there = Summary::of(store, active)?.get(&Kind::Uniform).map_or(0, |sum| sum.whole);
        let solved = store.records(active)?.iter().filter(|r| r.tag().is_solved()).count();
        if there < wanted && solved > 1 {
            lacking.push(active);
        }
    }
    Ok(lacking)
}

/// Fits the tables of a space and measures their errors at the held-out positions. The measurement reads the
/// bytes of the blob, as the haptic loop does.
pub fn certified(store: &Store, options: &PackOptions<'_>) -> Result<(Packed, Certificate), PipelineError> {
    let mut packed = pack(store, options)?;
    let bytes = AlignedBytes::from(&packed.bytes()?[..]);
    let organ = read(&bytes)?;
    let certificate = certify(store, &organ)?;
    packed.certify(&as_json(&certificate))?;
    Ok((packed, certificate))
}

/// The organ of a packed blob.
fn read(bytes: &AlignedBytes) -> Result<Box<Organ<'_>>, PackError> {
    Organ::read_boxed(bytes).map_err(PackError::Refused)
}

fn as_json(certificate: &Certificate) -> String {
    serde_json::to_string(certificate).expect("a certificate is plain data")
}

/// Adds the error ledgers to a certificate: the effects that the blob omits and, with `positions` above zero,
/// the effects of element order and mesh. Calls `began` with the name of each node before its positions are
/// solved.
pub fn add_ledgers(
    store: &Store,
    (packed, certificate): (&mut Packed, &mut Certificate),
    positions: usize,
    run: Run<'_>,
    began: impl Fn(&str),
) -> Result<(), PipelineError> {
    let bytes = AlignedBytes::from(&packed.bytes()?[..]);
    let organ = read(&bytes)?;
    let analysis = Analysis::of_store(store)?;
    let wanted = if certificate.spaces.len() > MAX_SEPARATE_NODES { 1 } else { certificate.spaces.len() };
    let names: Vec<String> = store.active()?.into_iter().map(|(name, _)| name).collect();
    for space in &mut certificate.spaces[..wanted] {
        let Some(active) = names.iter().position(|name| *name == space.active) else { continue };
        if positions > 0 {
            began(&space.active);
        }
        space.ledger = ledger(&analysis, store, active, (&organ, space), positions, run)?;
        if run.stop.load(Ordering::Relaxed) {
            return Err(PipelineError::Interrupted);
        }
    }
    packed.certify(&as_json(certificate))?;
    Ok(())
}

/// The certified blob of a finished space, in memory. `uniform` as in [`solve_held_out_positions`].
pub fn certified_blob(
    space: &Path,
    methods: &[Method],
    uniform: Option<u32>,
    run: Run<'_>,
) -> Result<Vec<u8>, PipelineError> {
    if let Some(unfinished) = unfinished(&Store::open(space)?)?.into_iter().next() {
        return Err(unfinished.into());
    }
    solve_held_out_positions(space, uniform, run, |_| {})?;
    solve_discretisation(space, DISCRETISATION_POSITIONS, run, |_, _| {})?;
    let options = PackOptions { methods, use_intermediate_states: true, threads: run.threads };
    Ok(certified(&Store::open(space)?, &options)?.0.bytes()?)
}
