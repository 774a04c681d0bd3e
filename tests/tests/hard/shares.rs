//! The paper's shares of non-convergent paths (section 5.1): straight paths of 100 mm in steps of 1 mm on the
//! bundled organ.
//!
//! A path is non-convergent if it fails before its end. The paper: St. Venant-Kirchhoff 53 %, Mooney-Rivlin
//! under 5 %. GetFEM on a similar organ with one active node less: 47 of 52 and 2 of 50.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use palpate_precompute::fem::material::Material;
use palpate_precompute::fem::{Handle, Solver};
use palpate_tests::{mooney_rivlin, st_venant_kirchhoff};

use super::walk::{Walk, norm, organ, problem, walk};

const STEP_M: f64 = 0.001;
const STEPS: u32 = 100;

/// A path to solve.
struct Path {
    fixed: &'static str,
    active: String,
    node: u32,
    direction: [i32; 3],
}

/// The 26 directions to the neighbours of a lattice point.
fn directions() -> impl Iterator<Item = [i32; 3]> {
    (0..27).map(|code| [code / 9 - 1, code / 3 % 3 - 1, code % 3 - 1]).filter(|d| *d != [0; 3])
}

fn share(law: Material) -> (usize, usize) {
    let scene = organ();
    let paths: Vec<Path> = ["F1", "F2"]
        .into_iter()
        .flat_map(|fixed| {
            scene.active.iter().flat_map(move |active| {
                let path =
                    |direction| Path { fixed, active: active.name.clone(), node: active.node, direction };
                directions().map(path)
            })
        })
        .collect();
    let bodies: BTreeMap<&str, _> = ["F1", "F2"]
        .map(|fixed| {
            let mut scene = scene.clone();
            scene.fixed.clone_from(&scene.mesh.node_groups[fixed]);
            scene.materials[0].material = law.clone();
            (fixed, super::walk::body(&scene.mesh, &scene.model()))
        })
        .into();
    let walks: Mutex<Vec<(usize, Walk, f64)>> = Mutex::new(Vec::new());
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(|| {
                while let Some(path) = paths.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let index =
                        paths.iter().position(|p| std::ptr::eq(p, path)).expect("the path is in the list");
                    let started = Instant::now();
                    let mut solver = Solver::new(problem(&bodies[path.fixed], Handle::node(path.node)));
                    let path_result = walk(&mut solver, path.direction.map(f64::from), STEP_M, STEPS)
                        .expect("the organ is fixed");
                    let seconds = started.elapsed().as_secs_f64();
                    walks.lock().expect("no walk panics").push((index, path_result, seconds));
                }
            });
        }
    });
    let mut walks = walks.into_inner().expect("no walk panics");
    walks.sort_by_key(|(index, ..)| *index);
    let mut failed = BTreeMap::new();
    let mut reasons: BTreeMap<String, u32> = BTreeMap::new();
    let (mut seconds, mut iterations, mut switched) = (0.0, 0, 0);
    for (index, w, took) in &walks {
        let Path { fixed, active, direction, .. } = &paths[*index];
        let mm = |m: Option<f64>| m.map_or("-".into(), |m| format!("{:.0}", 1e3 * m));
        println!(
            "{} {fixed} {active} {direction:>2?}  {:>3.0} mm  {:15} |h| {:7.3} N  min J {:7.3}  {:2} inverted (from {} mm)  \
             unstable from {} mm  {:3} split steps  {} branch jumps  {:5} iterations  {took:5.1} s",
            law.name(),
            1e3 * w.reached_m,
            w.failure.map_or("whole".into(), |f| f.reason.to_string()),
            norm(w.last.jet().force_n),
            w.last.min_jacobian,
            w.last.inverted,
            mm(w.inverted_at_m),
            mm(w.unstable_at_m),
            w.split_steps,
            w.switches,
            w.cost.iterations,
        );
        let [bad, all] = failed.entry((*fixed, active.as_str())).or_insert([0, 0]);
        *all += 1;
        *bad += usize::from(w.failure.is_some());
        if let Some(failure) = w.failure {
            *reasons.entry(failure.reason.to_string()).or_default() += 1;
        }
        seconds += took;
        switched += usize::from(w.failure.is_none() && w.switches > 0);
        iterations += w.cost.iterations;
    }
    let (bad, all) = failed.values().fold((0, 0), |(b, a), [bad, all]| (b + bad, a + all));
    println!(
        "{}: {bad} of {all} paths non-convergent ({:.1} %), {switched} complete with a branch jump; by set {failed:?}; reasons {reasons:?}; {iterations} iterations, \
         {seconds:.0} s on one core",
        law.name(),
        100.0 * bad as f64 / all as f64
    );
    (bad, all)
}

#[test]
#[ignore = "some minutes on two cores; run by hand after a change of the solver for the table of shares in docs/measurements.md, section 7"]
fn share_of_non_convergent_paths() {
    let (bad_stvk, all) = share(st_venant_kirchhoff());
    assert_eq!(all, 104);
    let (bad_mr, all) = share(mooney_rivlin());
    assert_eq!(all, 104);
    // The paper's order of the laws and its bound for Mooney-Rivlin, with a margin for another body.
    assert!(bad_stvk > 2 * bad_mr, "St. Venant-Kirchhoff must fail more often: {bad_stvk} against {bad_mr}");
    assert!(bad_mr * 10 <= all, "Mooney-Rivlin: {bad_mr} of {all}");
}
