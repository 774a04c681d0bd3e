//! `palpate paper protocol`: the paper's regular paths, 10 active nodes x 26 directions x 2 fixed sets.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_precompute::held_out::{Draw, Summary};
use palpate_precompute::mesh::{Surface, TetMesh};
use palpate_precompute::pipeline::Analysis;
use palpate_precompute::scene::{ResolvedScene, Scene};
use palpate_precompute::space::with_threads;
use serde_json::json;

use super::held_out::after;
use crate::analysis::{self, open_space, threads};
use crate::failure::Failure;
use crate::files::{FileKind, Files, Replace};
use crate::interrupt::stop_flag;
use crate::output::{self, Table};
use crate::progress::WorkProgress;

/// Solve the paper's regular paths and count those that do not converge.
///
/// Section 5.2 of the paper. There are 520 paths of 10 cm in steps of 1 mm for the scene's law: 10 active
/// nodes, 26 directions, 2 fixed sets.
///
/// The active nodes are free surface nodes as far apart as possible, including the scene's first one. The
/// scene's force limit is ignored, as in the paper. One .space file per fixed set holds every position. Run
/// the same command again to continue.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene file (TOML)
    scene: PathBuf,
    /// Folder for the .space files
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Groups of the mesh to fix, one per run of the protocol
    #[arg(long, value_name = "F1,F2", value_delimiter = ',', default_value = "F1,F2")]
    fixed: Vec<String>,
    /// Number of active nodes
    #[arg(long, value_name = "N", default_value_t = 10)]
    active_nodes: usize,
    /// Length of a path, mm
    #[arg(long, value_name = "MM", default_value_t = 100.0)]
    length_mm: f64,
    /// Length of a step, mm
    #[arg(long, value_name = "MM", default_value_t = 1.0)]
    step_mm: f64,
    /// Random paths of 200 steps per active node (the paper: 5,000 per law)
    #[arg(long, value_name = "N", default_value_t = 0)]
    random: u32,
    /// Discard the paths in the files and solve them again
    #[arg(long)]
    again: bool,
    /// Worker threads; one per core if not given
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let threads = threads(args.threads)?;
    if !(args.step_mm > 0.0 && args.length_mm >= args.step_mm && args.length_mm.is_finite()) {
        return Err(Failure::input("--step-mm must be positive and --length-mm at least as long"));
    }
    let twice = args.fixed.iter().enumerate().find(|(n, name)| args.fixed[..*n].contains(*name));
    if let Some((_, name)) = twice {
        return Err(Failure::input(format!("--fixed names {name} twice; its paths would count twice")));
    }
    let mut files = Files::new(Replace::default());
    files.read_scene(&args.scene)?;
    let scene = Scene::load(&args.scene)?.resolve()?;
    let actives = spread(&scene, &args.fixed, args.active_nodes)?;
    let folder = files.folder("--out", &args.out, |_| None)?;
    let spaces = args
        .fixed
        .iter()
        .map(|fixed| {
            let path = folder.path().join(format!("{}-{fixed}.space", scene.name));
            files.write("--out", &path, FileKind::Space)
        })
        .collect::<Result<Vec<_>, Failure>>()?;
    let benches = args
        .fixed
        .iter()
        .map(|fixed| Ok((fixed, Arc::new(variant(args, &scene, fixed, &actives)?))))
        .collect::<Result<Vec<_>, Failure>>()?;
    let draw = Draw {
        step_m: 1e-3 * args.step_mm,
        regular_m: Some(1e-3 * args.length_mm),
        random: args.random,
        uniform: 0,
        ..Draw::PAPER
    };
    let (stop, sets) = (stop_flag()?, benches.len());
    let start = Instant::now();
    let header = [
        "fixed",
        "paths",
        "whole",
        "failed",
        "failed, %",
        "positions",
        "inverted",
        "branches",
        "iterations",
        "CPU, s",
    ];
    let (mut table, mut figures) = (Table::new(1, header), Vec::new());
    let mut total = Summary::default();
    for (number, ((fixed, bench), space)) in (1..).zip(benches.iter().zip(&spaces)) {
        let store = open_space(bench, space, false)?;
        if args.again {
            store.forget_held_out()?;
        }
        let all: Vec<usize> = (0..bench.scene.active.len()).collect();
        let mut progress =
            WorkProgress::new(&format!("{} {fixed} ({number} of {sets})", scene.name), "paths");
        let held_out = bench.held_out(&all, draw.clone())?;
        let solved = with_threads(&bench.context()?, threads, |executor| {
            held_out.run(&store, executor, &stop, |p| progress.held_out(p))
        });
        progress.finish();
        solved.map_err(|error| after(args.again, error.into()))?;
        let mut of_set = Summary::default();
        for active in all {
            for (kind, sum) in Summary::of(&store, active)? {
                let name = &bench.scene.active[active].name;
                figures
                    .push(json!({ "fixed": fixed, "active": name, "node": bench.scene.active[active].node,
                                     "kind": kind.name(), "summary": sum }));
                of_set.add(&sum);
            }
        }
        table.row(row(fixed, &of_set));
        total.add(&of_set);
    }
    let seconds = start.elapsed().as_secs_f64();
    if args.json {
        let law = benches.first().map(|(_, bench)| bench.body.law_names());
        let whole = json!({ "scene": scene.name, "law": law, "rows": figures, "total": total, "seconds": seconds,
                            "threads": threads });
        return output::json(&whole);
    }
    table.row(row("all", &total));
    let reasons: Vec<String> = total.failed.iter().map(|(reason, n)| format!("{n} {reason}")).collect();
    let reasons = if reasons.is_empty() { String::new() } else { format!(" ({})", reasons.join(", ")) };
    output::line(format!("{} of {} paths failed{reasons}\n\n{table}", total.failures(), total.walks))?;
    output::line(format!(
        "\n{seconds:.1} s on {threads} threads; every position is in {}",
        args.out.display()
    ))
}

fn row(fixed: &str, s: &Summary) -> [String; 10] {
    [
        fixed.into(),
        s.walks.to_string(),
        s.whole.to_string(),
        s.failures().to_string(),
        format!("{:.1}", 100.0 * f64::from(s.failures()) / f64::from(s.walks.max(1))),
        s.positions.to_string(),
        s.inverted.to_string(),
        s.switched.to_string(),
        s.iterations.to_string(),
        format!("{:.1}", s.seconds),
    ]
}

/// Free surface nodes with large distances from one another, starting with the scene's first active node.
fn spread(scene: &ResolvedScene, fixed: &[String], wanted: usize) -> Result<Vec<u32>, Failure> {
    let mesh: &TetMesh = &scene.mesh;
    let mut held = vec![false; mesh.nodes_m.len()];
    for name in fixed {
        let group = mesh.node_groups.get(name.as_str()).ok_or_else(|| {
            let known: Vec<&str> = mesh.node_groups.keys().map(String::as_str).collect();
            Failure::input(format!("--fixed {name}: the mesh has no such group; it has {}", known.join(", ")))
        })?;
        group.iter().for_each(|&node| held[node as usize] = true);
    }
    let surface = Surface::of(mesh);
    let free: Vec<u32> =
        (0..mesh.nodes_m.len() as u32).filter(|&n| surface.contains(n) && !held[n as usize]).collect();
    if wanted == 0 || wanted > free.len() {
        let there = free.len();
        return Err(Failure::input(format!(
            "--active-nodes {wanted}: give 1 to {there}, the free surface nodes"
        )));
    }
    let apart = |a: u32, b: u32| -> f64 {
        let [a, b] = [a, b].map(|n| mesh.nodes_m[n as usize]);
        a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum()
    };
    let first = scene.active.iter().map(|a| a.node).find(|node| free.contains(node)).unwrap_or(free[0]);
    let mut chosen = vec![first];
    while chosen.len() < wanted {
        let nearest = |node: u32| chosen.iter().map(|&c| apart(node, c)).fold(f64::INFINITY, f64::min);
        let next = free.iter().copied().reduce(|best, n| if nearest(n) > nearest(best) { n } else { best });
        chosen.extend(next);
    }
    Ok(chosen)
}

/// The scene with another fixed set and these active nodes, and without a force limit. Its store identifies
/// it as a separate scene.
fn variant(args: &Args, scene: &ResolvedScene, fixed: &str, actives: &[u32]) -> Result<Analysis, Failure> {
    let mut table: toml::Table = toml::from_str(&scene.text).map_err(Failure::input)?;
    let held = toml::Table::from_iter([("group".to_string(), fixed.into())]);
    let nodes = actives.iter().enumerate().map(|(n, &node)| {
        let name = format!("P{}", n + 1);
        toml::Value::Table(toml::Table::from_iter([
            ("name".to_string(), name.into()),
            ("node".to_string(), i64::from(node).into()),
        ]))
    });
    table.insert("fixed".into(), held.into());
    table.insert("active".into(), toml::Value::Array(nodes.collect()));
    table.remove("device");
    let text = toml::to_string(&table).map_err(Failure::work)?;
    analysis::of_scene(&args.scene, Scene::parse(&args.scene, text)?.resolve()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The distance of every free surface node from the nearest chosen node is at most the smallest distance
    /// between chosen nodes. The choice is therefore near the optimum.
    #[test]
    fn the_nodes_are_far_apart_free_and_one_of_them_is_the_scenes_own() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/liver-small.toml");
        let scene = Scene::load(&path).and_then(|scene| scene.resolve()).expect("the bundled scene");
        let fixed = ["F1", "F2"].map(String::from);
        let chosen = spread(&scene, &fixed, 10).expect("there are more");
        assert_eq!((chosen.len(), chosen[0]), (10, scene.active[0].node));
        let mesh = &scene.mesh;
        let apart = |a: u32, b: u32| -> f64 {
            let [a, b] = [a, b].map(|n| mesh.nodes_m[n as usize]);
            a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>().sqrt()
        };
        let nearest = |node: u32| {
            let others = chosen.iter().filter(|&&c| c != node);
            others.map(|&c| apart(node, c)).fold(f64::INFINITY, f64::min)
        };
        let least = chosen.iter().map(|&c| nearest(c)).fold(f64::INFINITY, f64::min);
        assert!(least > 0.03, "{least} m between two of them, on a body of 0.2 m");
        let held = |node: &u32| fixed.iter().any(|group| mesh.node_groups[group].contains(node));
        assert!(!chosen.iter().any(held), "a held node does not move");
        let surface = Surface::of(mesh);
        let free = (0..mesh.nodes_m.len() as u32).filter(|&n| surface.contains(n) && !held(&n));
        for node in free.filter(|n| !chosen.contains(n)) {
            assert!(nearest(node) <= least + 1e-12, "node {node} is {} m from all of them", nearest(node));
        }
    }
}
