//! `palpate inspect FILE.space`: the solved configurations, their solves and their anomalies.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use palpate_precompute::fit::BranchJump;
use palpate_precompute::held_out::Summary;
use palpate_precompute::mesh::write::{Cell, Field, Grid};
use palpate_precompute::num::norm;
use palpate_precompute::space::{Equilibrium, FallbackLattice, Record, Store, branch_jumps, state};
use palpate_precompute::spec::{GridIndex, Lattice, Sampling};
use serde_json::json;

use super::columns::cells;
use super::summarised::Summarised;
use super::{Args, Shown, held_out, map, scattered};
use crate::analysis::existing_space;
use crate::cmd::paper::held_out::in_words;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output};
use crate::output::Csv;

/// One active node's space, read once.
struct Space {
    name: String,
    node: u32,
    attempts: Vec<Record>,
    /// The record that counts of every point.
    records: Vec<Record>,
    branch_jumps: Vec<BranchJump>,
    /// Number of open attempts.
    open: usize,
}

/// The files to write from a store.
struct Outputs {
    csv: Option<Output>,
    held_out: Option<Output>,
    picture: Option<Output>,
    /// One per active node; none if not requested.
    vtu: Vec<Output>,
}

impl Outputs {
    fn of(args: &Args, store: &Store, files: &mut Files) -> Result<Self, Failure> {
        let mut write = |option, path: Option<&Path>, kind| -> Result<Option<Output>, Failure> {
            path.map(|path| files.write(option, path, kind)).transpose()
        };
        let csv = write("--csv", args.csv.as_deref(), FileKind::Table)?;
        let held_out = write("--held-out", args.held_out.as_deref(), FileKind::Table)?;
        let picture = write("--picture", args.picture.as_deref(), FileKind::Png)?;
        let nodes = store.active()?;
        let mut vtu = Vec::new();
        for (name, _) in &nodes {
            let path = args.vtu.as_deref();
            let path = path.map(|path| if nodes.len() > 1 { beside(path, name) } else { path.to_path_buf() });
            vtu.extend(write("--vtu", path.as_deref(), FileKind::Vtu)?);
        }
        Ok(Self { csv, held_out, picture, vtu })
    }
}

/// Describes the store, and writes the requested files.
pub(super) fn show(args: &Args, files: &mut Files) -> Result<Shown, Failure> {
    files.update_space(&args.file);
    let store = existing_space(&args.file)?;
    let outputs = Outputs::of(args, &store, files)?;
    let identity = store.identity()?;
    let (sampling, points_of_all) = (identity.sampling, identity.sampling.points());
    let (points, completed, grid_words) = match sampling {
        Sampling::Lattice(Lattice { grid, .. }) => {
            let (points, total) = (grid.lattice.points().count(), points_of_all.unwrap_or(0));
            let completed = total - points;
            let corners = match completed {
                0 => String::new(),
                _ => format!(" and {completed} corners that complete its cells"),
            };
            let words =
                format!("{points} points{corners}, r_G {} m, spacing {} m", grid.radius_m, grid.spacing_m);
            (Some(points), Some(completed), words)
        }
        Sampling::Scattered(scattered) => (None, None, super::in_words(&scattered)),
    };
    if let Some(picture) = &outputs.picture {
        let sides = if args.from.is_empty() { &map::SIDES[..] } else { &args.from[..] };
        map::write(&store, sides, picture)?;
    }
    let unreachable = super::left_out_of(&store)?;
    let head = format!(
        "scene   {} ({})\ngrid    {grid_words}, f_max {} N{}\nsolver  {}\n",
        identity.scene_name,
        identity.law,
        identity.max_force_n,
        super::left_out(&unreachable),
        store.meta("solver")?
    );
    let mut text = head.clone();
    let mut summary = Summarised::new();
    let (mut figures, mut table) = (Vec::new(), Csv::new(CSV_HEADER.split(','))?);
    for (active, (name, node)) in store.active()?.into_iter().enumerate() {
        let attempts = store.attempts(active)?;
        let records = store.records(active)?;
        store.check_states(active)?;
        let state = state(&store, active)?;
        let fallback = state.fallback();
        let branch_jumps = match (&sampling, &fallback) {
            (Sampling::Lattice(lattice), _) => branch_jumps(&lattice.grid, &records),
            (_, Some(lattice)) => in_units(lattice, &records),
            _ => Vec::new(),
        };
        let space = Space { name, node, branch_jumps, attempts, records, open: state.open };
        let (words, mut numbers) = space.describe(points_of_all);
        summary.take(&numbers);
        text.push_str(&words);
        if sampling.scattered().is_some() {
            let fallback = fallback.as_ref().map(|lattice| (lattice, &space.records[..]));
            let (words, of_loop) = scattered::describe(state.fit.as_ref(), fallback);
            text.push_str(&words);
            numbers["loop"] = of_loop;
        }
        let walks = Summary::of(&store, active)?;
        if !walks.is_empty() {
            text.push_str(&format!("  held-out solutions\n{}\n", in_words("   ", &walks)));
        }
        let walks: BTreeMap<&str, &Summary> = walks.iter().map(|(kind, sum)| (kind.name(), sum)).collect();
        numbers["held_out"] = json!(walks);
        figures.push(numbers);
        if outputs.csv.is_some() {
            space.rows(&sampling, args.all_tries, &mut table)?;
        }
        if let Some(vtu) = outputs.vtu.get(active) {
            space.cloud(&sampling, vtu)?;
        }
    }
    if let Some(csv) = &outputs.csv {
        csv.put(&table.finish()?)?;
    }
    if let Some(file) = &outputs.held_out {
        held_out::write(&store, &sampling, file)?;
    }
    let figures = json!({
        "scene": identity.scene_name, "law": identity.law, "points": points, "completing": completed,
        "radius_m": sampling.radius_m(), "spacing_m": sampling.unit_m(), "scattered": sampling.scattered(),
        "max_force_n": identity.max_force_n, "unreachable": unreachable,
        "solver": store.meta("solver")?, "spaces": figures,
    });
    let text = if args.verbose { format!("{}\n\n{text}", summary.headline()) } else { summary.text(&head) };
    Ok((text.trim_end().into(), figures))
}

/// The branch jumps of a replacement lattice, with their ends numbered as in the store.
fn in_units(lattice: &FallbackLattice, records: &[Record]) -> Vec<BranchJump> {
    let own = |index: GridIndex| index.map(|n| n * lattice.spacing);
    let found = branch_jumps(&lattice.grid, &lattice.records(records));
    found.into_iter().map(|jump| BranchJump { from: own(jump.from), to: own(jump.to), ..jump }).collect()
}

/// `dir/file-NAME.vtu` for `dir/file.vtu`.
fn beside(path: &Path, name: &str) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}-{name}.vtu"))
}

impl Space {
    /// Solved points except rest.
    fn solved(&self) -> impl Iterator<Item = &Record> {
        self.records.iter().filter(|r| r.tag().is_solved() && r.index != [0; 3])
    }

    fn describe(&self, total: Option<usize>) -> (String, serde_json::Value) {
        let count =
            |tag: &str| self.records.iter().filter(|r| r.tag().name() == tag && r.index != [0; 3]).count();
        let (expandable, terminating, failed) = (count("expandable"), count("terminating"), count("failed"));
        let unknown = total.map_or(0, |total| total.saturating_sub(expandable + terminating + failed));
        let found = || self.solved().filter_map(Record::equilibrium);
        let forces = || found().map(|at| norm(at.force_n));
        let (least, largest) = (forces().fold(f64::INFINITY, f64::min), forces().fold(0.0, f64::max));
        let residual = self.solved().filter_map(|r| r.residual_n).fold(0.0, f64::max);
        let tries = self.attempts.iter().filter(|r| r.index != [0; 3]);
        let (mut iterations, mut factorisations, mut seconds) = (0_u32, 0_u32, 0.0);
        for r in tries.clone() {
            iterations += r.iterations;
            factorisations += r.factorisations;
            seconds += r.seconds;
        }
        let mut reasons: BTreeMap<&str, usize> = BTreeMap::new();
        for r in self.records.iter().filter_map(|record| record.result.as_ref().err()) {
            *reasons.entry(r).or_default() += 1;
        }
        let solved = self.solved().count();
        let inverted = found().filter(|at| at.inverted > 0).count();
        let unstable = found().filter(|at| at.unstable_modes.is_some_and(|n| n > 0)).count();
        let unknown_stability = found().filter(|at| at.unstable_modes.is_none()).count();
        let of_unknown = match unknown_stability {
            0 => String::new(),
            n => format!(", {n} of unknown stability"),
        };
        let again = self.attempts.iter().filter(|r| r.attempt > 0).count();
        let superseded = self.solved().filter(|r| r.attempt > 0).count();
        let per = |n: u32| f64::from(n) / solved.max(1) as f64;
        let state = match (solved, self.open) {
            (0, _) => "nothing solved yet".to_string(),
            (_, 0) => "complete".to_string(),
            (_, n) => format!("not finished: at least {n} points are still to be solved"),
        };
        let mut text = format!(
            "\n{} (node {}): {state}\n  {expandable} expandable, {terminating} terminating, {failed} failed, \
             {unknown} unknown\n",
            self.name, self.node
        );
        if !reasons.is_empty() {
            let list: Vec<String> = reasons.iter().map(|(reason, n)| format!("{n} {reason}")).collect();
            text.push_str(&format!("  failed: {}\n", list.join(", ")));
        }
        if solved > 0 {
            text.push_str(&format!(
                "  {again} solved again (from another neighbour), {superseded} of them counted\n  \
                 {} pairs of neighbours flagged as branch jumps\n  {inverted} with inverted elements, {unstable} unstable{of_unknown}\n  \
                 |h| {least:.3} to {largest:.3} N, residual up to {residual:.1e} N\n  {:.2} Newton iterations and {:.2} \
                 factorisations a configuration, {seconds:.1} s of solving\n",
                self.branch_jumps.len(),
                per(iterations),
                per(factorisations),
            ));
        }
        let figures = json!({
            "name": self.name, "node": self.node, "complete": self.open == 0, "expandable": expandable,
            "terminating": terminating, "failed": failed, "unknown": unknown, "failures": reasons,
            "solved_again": again, "superseded": superseded, "branch_jumps": self.branch_jumps.len(), "inverted": inverted,
            "unstable": unstable, "unknown_stability": unknown_stability, "max_force_n": largest, "max_residual_n": residual, "iterations": iterations,
            "factorisations": factorisations, "seconds": seconds,
        });
        (text, figures)
    }

    /// Largest excesses (rho, rho_h) of the flagged pairs of each point.
    fn excesses(&self) -> HashMap<GridIndex, [f64; 2]> {
        let mut worst: HashMap<GridIndex, [f64; 2]> = HashMap::new();
        for jump in &self.branch_jumps {
            for end in [jump.from, jump.to] {
                let here = worst.entry(end).or_default();
                *here = [here[0].max(jump.rho_n), here[1].max(jump.rho_h_n)];
            }
        }
        worst
    }

    fn rows(&self, grid: &Sampling, all_tries: bool, table: &mut Csv) -> Result<(), Failure> {
        let excesses = self.excesses();
        let kept: HashMap<GridIndex, u32> = self.records.iter().map(|r| (r.index, r.attempt)).collect();
        for record in if all_tries { &self.attempts } else { &self.records } {
            let counts = kept.get(&record.index) == Some(&record.attempt);
            let jump = excesses.get(&record.index).filter(|_| counts);
            write_row(table, &self.name, grid, record, counts, jump)?;
        }
        Ok(())
    }

    fn cloud(&self, grid: &Sampling, file: &Output) -> Result<(), Failure> {
        let excesses = self.excesses();
        let points: Vec<[f64; 3]> = self.records.iter().map(|r| grid.displacement_m(r.index)).collect();
        let scalar =
            |value: &dyn Fn(&Record) -> f64| -> Vec<f64> { self.records.iter().map(value).collect() };
        let of_solved = |value: &dyn Fn(&Equilibrium) -> f64| scalar(&|r| r.equilibrium().map_or(0.0, value));
        let tag = scalar(&|r| f64::from(r.tag() as u8));
        let energy = of_solved(&|at| at.energy_j);
        let force: Vec<f64> =
            self.records.iter().flat_map(|r| r.equilibrium().map_or([0.0; 3], |at| at.force_n)).collect();
        let jacobian = of_solved(&|at| at.min_jacobian);
        let inverted = of_solved(&|at| f64::from(at.inverted));
        let round = scalar(&|r| f64::from(r.round));
        let attempt = scalar(&|r| f64::from(r.attempt));
        let iterations = scalar(&|r| f64::from(r.iterations));
        let seconds = scalar(&|r| r.seconds);
        let rho = scalar(&|r| excesses.get(&r.index).map_or(0.0, |e| e[0]));
        let rho_h = scalar(&|r| excesses.get(&r.index).map_or(0.0, |e| e[1]));
        let field = |name, components, values| Field { name, components, values };
        let cloud = Grid {
            nodes_m: &points,
            cell: Cell::Vertex,
            connectivity: &(0..points.len() as u32).collect::<Vec<u32>>(),
            point_data: &[
                field("tag", 1, &tag),
                field("energy_j", 1, &energy),
                field("force_n", 3, &force),
                field("min_jacobian", 1, &jacobian),
                field("inverted", 1, &inverted),
                field("round", 1, &round),
                field("attempt", 1, &attempt),
                field("iterations", 1, &iterations),
                field("seconds", 1, &seconds),
                field("jump_rho_n", 1, &rho),
                field("jump_rho_h_n", 1, &rho_h),
            ],
            cell_data: &[],
            field_data: &[],
        };
        file.put(cloud.encode().map_err(Failure::work)?.as_bytes())
    }
}

const CSV_HEADER: &str = "active,i,j,k,x_m,y_m,z_m,tag,round,parent_i,parent_j,parent_k,failure,energy_j,fx_n,fy_n,fz_n,\
                          sxx_n_m,sxy_n_m,sxz_n_m,syy_n_m,syz_n_m,szz_n_m,residual_n,min_jacobian,inverted,volume_m3,\
                          iterations,increments,seconds,attempt,parent_attempt,counts,factorisations,unstable_modes,switched,\
                          jump_rho_n,jump_rho_h_n,w000_n_m2,w001_n_m2,w002_n_m2,w011_n_m2,w012_n_m2,w022_n_m2,w111_n_m2,\
                          w112_n_m2,w122_n_m2,w222_n_m2";

fn write_row(
    table: &mut Csv,
    active: &str,
    grid: &Sampling,
    r: &Record,
    counts: bool,
    jump: Option<&[f64; 2]>,
) -> Result<(), Failure> {
    let (solution, at) = (r.result.as_ref().ok(), r.equilibrium());
    let parent = r.parent.map_or([None; 3], |(index, _)| index.map(Some));
    let place = (active, r.index, grid.displacement_m(r.index), r.tag().name(), r.round, parent);
    let outcome = (r.result.as_ref().err(), cells(at.map(Equilibrium::numbers)), r.residual_n);
    let quality = (at.map(|at| at.min_jacobian), at.map(|at| at.inverted), solution.map(|s| s.volume_m3));
    let cost = (r.iterations, r.increments, r.seconds);
    let attempt = (r.attempt, r.parent.map(|(_, attempt)| attempt), u32::from(counts), r.factorisations);
    let branch = (at.and_then(|at| at.unstable_modes), at.map(|at| u32::from(at.switched)));
    let more = (cells(jump.copied()), cells(solution.map(|s| s.third_n_m2)));
    table.row((place, outcome, quality, cost, attempt, branch, more))
}

#[cfg(test)]
mod tests {
    use palpate_precompute::num::SECOND_INDICES;

    use super::super::held_out;
    use super::*;

    #[test]
    fn tables_have_the_stiffness_in_the_order_of_all_files() {
        let name = |[i, j]: [usize; 2]| format!("s{}{}_n_m", ["x", "y", "z"][i], ["x", "y", "z"][j]);
        let columns = SECOND_INDICES.map(name).join(",");
        for header in [CSV_HEADER, held_out::CSV_HEADER] {
            assert!(header.contains(&format!(",{columns},")), "{header}");
        }
    }
}
