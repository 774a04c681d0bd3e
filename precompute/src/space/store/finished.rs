//! Finished spaces in the store: points by tag, and the fit of adaptive sampling.

use rusqlite::{Connection, OptionalExtension, params};
use serde::{Deserialize, Serialize};

use super::rows::{self, CHECKSUM};
use super::{Store, StoreError};
use crate::adaptive::{AdaptiveFit, LinearModelErrors, Shared, Test, Verdict};
use crate::fit::{Base, KernelFit};
use crate::num::jet::EnergyJet;
use crate::space::state::SpaceState;
use crate::space::task::TagCounts;
use crate::spec::{GridIndex, Quantity, Requirements, displacement_m, nearest_index};

/// The stored form of the fit, in postcard. The jets of its configurations are in their rows.
#[derive(Serialize, Deserialize)]
struct StoredFit {
    wanted: Requirements,
    verdict: Verdict,
    length_m: f64,
    /// Indices and weights of the configurations of the fit, rest first, without those of neighbouring charts.
    configurations: Vec<(GridIndex, [f64; 20])>,
    /// Configurations of neighbouring charts with their weights. In the fit they follow rest.
    shared: Vec<(Shared, [f64; 20])>,
    tests: Vec<Test>,
    leave_one_out: Vec<f64>,
    deviation: Option<f64>,
    linear: LinearModelErrors,
    condition: f64,
}

impl StoredFit {
    /// `None` while the search continues.
    fn of(fit: &AdaptiveFit) -> Option<Self> {
        let configuration = |(jet, weights): (&EnergyJet, &_)| (nearest_index(jet.control_m), *weights);
        let all = || fit.jets.iter().zip(&fit.fit.weights);
        let is_shared = |at: usize| (1..=fit.shared.len()).contains(&at);
        let own = all().enumerate().filter(|(at, _)| !is_shared(*at)).map(|(_, of)| configuration(of));
        Some(Self {
            wanted: fit.wanted,
            verdict: fit.verdict?,
            length_m: fit.fit.length_m,
            configurations: own.collect(),
            shared: fit.shared.iter().copied().zip(fit.fit.weights.iter().skip(1).copied()).collect(),
            tests: fit.tests.clone(),
            leave_one_out: fit.leave_one_out.clone(),
            deviation: fit.deviation,
            linear: fit.linear,
            condition: fit.condition,
        })
    }

    /// The fit with the jets of its own configurations; `None` without rest.
    fn with(self, jets: Vec<EnergyJet>) -> Option<AdaptiveFit> {
        let (length_m, quantity) = (self.length_m, self.wanted.quantity);
        let own = jets.into_iter().zip(self.configurations.iter().map(|(_, weights)| *weights));
        let (mut jets, mut weights): (Vec<EnergyJet>, Vec<[f64; 20]>) = own.unzip();
        let (shared, their_weights): (Vec<Shared>, Vec<_>) = self.shared.into_iter().unzip();
        jets.splice(1.min(jets.len())..1.min(jets.len()), shared.iter().map(|shared| shared.jet));
        weights.splice(1.min(weights.len())..1.min(weights.len()), their_weights);
        let fit = KernelFit {
            length_m,
            quantity,
            base: Base::of(quantity, jets.first()?)?,
            centres: jets.iter().map(|jet| jet.control_m.map(|x| x / length_m)).collect(),
            weights,
        };
        let Self { wanted, verdict, tests, leave_one_out, deviation, linear, condition, .. } = self;
        let verdict = Some(verdict);
        Some(AdaptiveFit {
            wanted,
            verdict,
            jets,
            shared,
            fit,
            tests,
            leave_one_out,
            deviation,
            linear,
            condition,
        })
    }
}

impl Store {
    /// The state of a finished space; `None` if it is not finished.
    pub(crate) fn finished(&self, active: usize) -> Result<Option<SpaceState>, StoreError> {
        let sql = "SELECT expandable, terminating, failed, unknown, attempts, fit, checksum, \
                   (SELECT count(*) FROM configuration AS c WHERE c.active = f.active) FROM finished AS f \
                   WHERE active = ?1";
        let found = self.connection.prepare_cached(sql).and_then(|mut statement| {
            let read = |row: &rusqlite::Row<'_>| {
                let whole = [row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?, row.get(4)?];
                Ok((whole, row.get::<_, Option<Vec<u8>>>(5)?, row.get::<_, u32>(6)?, row.get::<_, u32>(7)?))
            };
            statement.query_row([active as i64], read).optional()
        });
        let Some((whole, fit, stored, rows)) = self.wrap(found)? else { return Ok(None) };
        let damaged = || self.corrupt(format!("the fit of active node number {active} is damaged"));
        if stored != checksum(active, &whole, fit.as_deref()) || whole[4] != rows {
            return Err(damaged());
        }
        let [expandable, terminating, failed, unknown, _] = whole.map(|n: u32| n as usize);
        let counts = TagCounts { expandable, terminating, failed, unknown };
        let fit = match fit {
            Some(bytes) => {
                let stored: StoredFit = postcard::from_bytes(&bytes).map_err(|_| damaged())?;
                let quantity = stored.wanted.quantity;
                let jet = |(index, _): &_| self.jet(active, *index, quantity);
                let jets = stored.configurations.iter().map(jet).collect::<Result<_, _>>()?;
                Some(stored.with(jets).ok_or_else(damaged)?)
            }
            None => None,
        };
        Ok(Some(SpaceState { open: 0, counts, fit }))
    }

    /// The jet of an adaptively sampled configuration, as fits use it.
    fn jet(&self, active: usize, index: GridIndex, quantity: Quantity) -> Result<EnergyJet, StoreError> {
        let row = self.wrap(rows::record(&self.connection, active, index, 0))?;
        let jet = self.checked(active, row)?.jet_for_fit(displacement_m(index), quantity);
        jet.ok_or_else(|| self.corrupt(rows::damaged(&index)))
    }

    /// Stores the state of a finished space.
    pub(crate) fn finish(&self, active: usize, state: &SpaceState) -> Result<(), StoreError> {
        self.write(|connection| insert(connection, active, state))
    }
}

/// The key of the table `meta` that says whether the charts of a sphere's field are complete.
const COMPLETE: &str = "charts_complete";

impl Store {
    /// Whether the fits of all charts contain the configurations of the charts round them.
    pub fn are_charts_complete(&self) -> Result<bool, StoreError> {
        Ok(self.optional(COMPLETE)?.is_some())
    }

    /// Stores the completed states of all charts.
    pub(in crate::space) fn complete_charts(&self, states: &[SpaceState]) -> Result<(), StoreError> {
        self.write(|connection| {
            for (active, state) in states.iter().enumerate() {
                insert(connection, active, state)?;
            }
            let sql = "INSERT OR REPLACE INTO meta VALUES (?1, 'yes')";
            connection.execute(sql, [COMPLETE]).map(drop)
        })
    }
}

pub(super) fn insert(connection: &Connection, active: usize, state: &SpaceState) -> rusqlite::Result<()> {
    let TagCounts { expandable, terminating, failed, unknown } = state.counts;
    let count = "SELECT count(*) FROM configuration WHERE active = ?1";
    let attempts: u32 = connection.prepare_cached(count)?.query_row([active as i64], |row| row.get(0))?;
    let [expandable, terminating, failed, unknown] =
        [expandable, terminating, failed, unknown].map(|n| n as u32);
    let whole = [expandable, terminating, failed, unknown, attempts];
    let fit = state.fit.as_ref().and_then(StoredFit::of);
    let fit = fit.map(|fit| postcard::to_stdvec(&fit)).transpose();
    let fit = fit.map_err(|error| rusqlite::Error::ToSqlConversionFailure(error.into()))?;
    let checksum = checksum(active, &whole, fit.as_deref());
    let sql = "INSERT OR REPLACE INTO finished VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)";
    let row = params![active as i64, expandable, terminating, failed, unknown, attempts, fit, checksum];
    connection.prepare_cached(sql)?.execute(row).map(drop)
}

fn checksum(active: usize, whole: &[u32; 5], fit: Option<&[u8]>) -> u32 {
    let mut digest = CHECKSUM.digest();
    for n in std::iter::once(active as u32).chain(*whole) {
        digest.update(&n.to_le_bytes());
    }
    digest.update(fit.unwrap_or_default());
    digest.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::synthetic::{jet, spread};
    use crate::space::plan::SpacePlan;
    use crate::space::plans::{Plans, state};
    use crate::space::tests::synthetic::{SyntheticExecutor, actives, mesh};
    use crate::space::{Outcome, Record, Task};
    use crate::spec::{Sampling, Scattered, Tolerance};

    /// A body whose force jumps by `jump_n` to another branch beyond a plane.
    fn outcome(task: &Task, jump_n: f64) -> Outcome {
        let jet = jet(displacement_m(task.target));
        let beyond = jet.control_m[0] - 0.011;
        let jump_n = if beyond > 0.0 { jump_n } else { 0.0 };
        let [x, y, z] = jet.force_n;
        let energy_j = jet.energy_j + jump_n * beyond;
        let jet = EnergyJet { energy_j, force_n: [x + jump_n, y, z], ..jet };
        let record = Record::of_jet(task, &jet, false);
        Outcome { active: 0, record, seed: None, intermediate: Vec::new() }
    }

    /// A store whose only space is solved to its end but not stored as finished, with its plan.
    fn solved(folder: &std::path::Path, radius_m: f64, jump_n: f64) -> (Store, Box<dyn SpacePlan>) {
        let scattered = Scattered {
            radius_m,
            tolerance: Tolerance::IMPERCEPTIBLE,
            only_push: radius_m < 0.01,
            workspace_m: Some([[-1.0; 3], [1.0; 3]]),
        };
        let mut identity = SyntheticExecutor::new(1.0, 0.0).identity();
        identity.sampling = Sampling::Scattered(scattered);
        identity.max_force_n = 8.0;
        identity.normals = vec![[0.0, 0.0, 1.0]];
        let path = folder.join(format!("{radius_m}-{jump_n}.space"));
        let store = Store::create_or_resume(&path, &identity, &mesh(), &[0], &actives(1)).expect("a store");
        let mut plan = Plans::of(&store).expect("a body").plan(&store, 0).expect("a plan");
        while let Some(task) = plan.next_task() {
            let outcome = outcome(&task, jump_n);
            plan.decide(&outcome.record);
            store.add(&outcome, None).expect("added");
        }
        assert!(plan.is_done());
        (store, plan)
    }

    /// All fields of a fit and the bits of its predictions.
    fn bits(state: &SpaceState) -> (TagCounts, Requirements, Option<Verdict>, Vec<u64>, Vec<Test>) {
        let fit = state.fit.as_ref().expect("a fit");
        let answers = (0..50).map(|n| spread(n, fit.wanted.radius_m)).flat_map(|at| {
            let (jet, known) = (fit.fit.jet(at), fit.is_valid_at(at));
            jet.numbers().into_iter().chain([f64::from(u8::from(known))])
        });
        let places = fit.places(700).into_iter().flatten();
        let linear = [fit.linear.worst, fit.linear.from_fit, fit.linear.tests as f64];
        let whole = [fit.condition, fit.deviation.unwrap_or(-1.0), fit.fit.length_m];
        let jets = fit.jets.iter().flat_map(|jet| jet.control_m.into_iter().chain(jet.numbers()));
        let numbers = answers.chain(places).chain(linear).chain(whole).chain(jets);
        let numbers = numbers.chain(fit.leave_one_out.iter().copied());
        (state.counts, fit.wanted, fit.verdict, numbers.map(f64::to_bits).collect(), fit.tests.clone())
    }

    #[test]
    fn a_fit_comes_back_from_the_store_to_the_bit() {
        let folder = tempfile::tempdir().expect("a folder");
        for (radius_m, jump_n, verdict) in
            [(0.04, 0.0, Verdict::Passed), (0.0005, 0.0, Verdict::Linear), (0.04, 2.0, Verdict::Stagnated)]
        {
            let (store, plan) = solved(folder.path(), radius_m, jump_n);
            assert!(store.finished(0).expect("read").is_none());
            let replayed = state(&store, 0).expect("replayed");
            store.finish(0, &plan.state(0)).expect("kept");
            let kept = store.finished(0).expect("read").expect("finished");
            assert_eq!(kept.fit.as_ref().and_then(|fit| fit.verdict), Some(verdict));
            assert!(bits(&kept) == bits(&plan.state(0)), "{verdict:?}: another fit than that of the search");
            assert!(bits(&kept) == bits(&replayed), "{verdict:?}: another fit than that of the records");
        }
    }

    #[test]
    fn a_damaged_fit_and_one_of_other_configurations_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let (store, plan) = solved(folder.path(), 0.04, 0.0);
        store.finish(0, &plan.state(0)).expect("kept");
        store.commit().expect("committed");
        let run = |sql: &str| store.connection.execute_batch(sql).expect("it runs");
        let refused = || store.finished(0).expect_err("refused").to_string();
        run("BEGIN; UPDATE finished SET fit = CAST(substr(fit, 1, 99) || x'5a' || substr(fit, 101) AS BLOB)");
        assert!(refused().contains("the fit of active node number 0 is damaged"), "{}", refused());
        run("ROLLBACK; BEGIN; DELETE FROM configuration WHERE i > 9000");
        assert!(refused().contains("the fit of active node number 0 is damaged"), "{}", refused());
        run("ROLLBACK");
        assert!(store.finished(0).expect("intact").is_some());
    }
}
