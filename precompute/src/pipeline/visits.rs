//! Finite-element forces at positions that a tool visited, for the errors of a rendered force.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use palpate_core::ConfigTag;

use super::{Analysis, PipelineError, Run};
use crate::fem::solve::{Problem, Solver};
use crate::num::parallel::on_each_thread;
use crate::space::{Record, Store};

impl Analysis {
    /// Forces h, N, at these displacements, m, of active nodes (indices into
    /// [`crate::scene::ResolvedScene::active`]). Each is solved from the nearest configuration in
    /// `store`, and not stored; `None` if it has no solution.
    pub fn forces_at(
        &self,
        store: &Store,
        positions: &[(usize, [f64; 3])],
        run: Run<'_>,
    ) -> Result<Vec<Option<[f64; 3]>>, PipelineError> {
        let sampling = self.sampling()?;
        let problems: Vec<Arc<Problem>> = self.scene.active.iter().map(|a| self.problem(a)).collect();
        let mut solved: Vec<Vec<Record>> = Vec::new();
        for active in 0..problems.len() {
            let records = store.records(active)?;
            solved.push(records.into_iter().filter(|r| r.tag() == ConfigTag::Expandable).collect());
        }
        let nearest = |active: usize, to: [f64; 3]| -> Option<&Record> {
            let cells = to.map(|x| x / sampling.unit_m());
            let distance = |record: &Record| -> f64 {
                record.index.iter().zip(cells).map(|(n, x)| (f64::from(*n) - x).powi(2)).sum()
            };
            solved[active].iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))
        };
        let (next, path) = (AtomicUsize::new(0), store.path());
        let work = || -> Result<Vec<(usize, [f64; 3])>, PipelineError> {
            let reader = Store::open(path)?;
            let mut solvers: Vec<Solver> = problems.iter().map(|p| Solver::new(p.clone())).collect();
            let mut results = Vec::new();
            while !run.stop.load(Ordering::Relaxed) {
                let at = next.fetch_add(1, Ordering::Relaxed);
                let Some(&(active, target)) = positions.get(at) else { break };
                let Some(from) = nearest(active, target) else { continue };
                let seed = reader.seed(active, from, sampling.displacement_m(from.index))?;
                if let Ok(c) = solvers[active].advance(&seed, target) {
                    results.push((at, c.jet().force_n));
                }
            }
            Ok(results)
        };
        let mut forces = vec![None; positions.len()];
        for found in on_each_thread(run.threads, work)? {
            for (at, force_n) in found? {
                forces[at] = Some(force_n);
            }
        }
        if run.stop.load(Ordering::Relaxed) {
            return Err(PipelineError::Interrupted);
        }
        Ok(forces)
    }
}
