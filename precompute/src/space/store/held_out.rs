//! Held-out reference values in the store.

use std::collections::{BTreeMap, BTreeSet};

use palpate_core::ConfigTag;
use rusqlite::types::{Type, Value};
use rusqlite::{Connection, params};

use super::error::StoreFault;
use super::rows::{CHECKSUM, equilibrium, insert_row, numbers, plain, unreadable};
use super::{Store, StoreError};
use crate::space::walk::{Kind, Truth, Walk, WalkOutcome};

const COLUMNS: &str = "kind, number, step, x_m, y_m, z_m, tag, failure, energy_j, fx_n, fy_n, fz_n, sxx_n_m, sxy_n_m, sxz_n_m, \
                       syy_n_m, syz_n_m, szz_n_m, residual_n, min_jacobian, inverted, unstable_modes, switched, iterations, \
                       factorisations, seconds, displacements, checksum";

impl Store {
    /// Stores the rule of the held-out draw and the length of regular paths, or compares them with the stored
    /// ones: values of two draws are never mixed.
    pub(crate) fn agree_on_draw(&self, identity: &str, regular_m: Option<f64>) -> Result<(), StoreError> {
        self.agree("held_out", identity)?;
        regular_m.map_or(Ok(()), |length| {
            self.agree("held_out_regular", &format!("regular paths of {length:?} m"))
        })
    }

    /// The rule of the stored draw; `None` if nothing is drawn yet.
    pub(crate) fn draw_identity(&self) -> Result<Option<String>, StoreError> {
        self.optional("held_out")
    }

    fn agree(&self, key: &str, wanted: &str) -> Result<(), StoreError> {
        match self.optional(key)? {
            None => {
                let sql = "INSERT INTO meta VALUES (?1, ?2)";
                self.wrap(self.connection.execute(sql, params![key, wanted])).map(drop)
            }
            Some(stored) if stored == wanted => Ok(()),
            Some(stored) => Err(StoreFault::Drawn { stored, wanted: wanted.into() }.at(&self.path)),
        }
    }

    /// A text that belongs to the held-out values, `key` beginning with `held_out`.
    pub(crate) fn kept(&self, key: &str) -> Result<Option<String>, StoreError> {
        self.optional(key)
    }

    /// Keeps a text with the held-out values, in place of an earlier one.
    pub(crate) fn keep(&self, key: &str, text: &str) -> Result<(), StoreError> {
        let sql = "INSERT INTO meta VALUES (?1, ?2) ON CONFLICT (key) DO UPDATE SET value = ?2";
        self.wrap(self.connection.execute(sql, params![key, text])).map(drop)
    }

    /// Deletes all held-out values, so that they can be drawn again.
    pub fn forget_held_out(&self) -> Result<(), StoreError> {
        self.wrap(self.connection.execute_batch(
            "BEGIN; DELETE FROM held_out; DELETE FROM meta WHERE key LIKE 'held_out%'; COMMIT",
        ))
    }

    /// Adds the outcome of a walk in one transaction. A walk with a number that is not finite is refused.
    pub(crate) fn add_walk(&self, outcome: &WalkOutcome) -> Result<(), StoreError> {
        for (step, truth) in (1..).zip(&outcome.truths) {
            let residual_n = truth.residual_n.unwrap_or(f64::NAN);
            let of_solution = truth.equilibrium().into_iter();
            let of_solution =
                of_solution.flat_map(|at| at.numbers().into_iter().chain([at.min_jacobian, residual_n]));
            self.expect_finite(truth.displacement_m.into_iter().chain(of_solution), || {
                format!("{} walk {}, step {step}", outcome.walk.kind.name(), outcome.walk.number)
            })?;
        }
        self.write(|connection| {
            connection.execute_batch("SAVEPOINT walk")?;
            let inserted = (1..)
                .zip(&outcome.truths)
                .try_for_each(|(step, truth)| insert(connection, &outcome.walk, step, truth));
            match inserted {
                Ok(()) => connection.execute_batch("RELEASE walk"),
                Err(error) => {
                    let _ = connection.execute_batch("ROLLBACK TO walk; RELEASE walk");
                    Err(error)
                }
            }
        })
    }

    /// Copies the held-out paths of an active node that another store with this draw contains and this one
    /// lacks, without its uniform positions.
    pub fn copy_paths(
        &self,
        from: &Self,
        active: usize,
        (draw, regular_m): (&str, Option<f64>),
    ) -> Result<(), StoreError> {
        self.agree_on_draw(draw, regular_m)?;
        let done = self.walks_done(active)?;
        let mut paths: BTreeMap<Walk, Vec<Truth>> = BTreeMap::new();
        from.each_truth(active, |walk, _, truth| {
            if walk.kind != Kind::Uniform && !done.contains_key(&(walk.kind, walk.number)) {
                paths.entry(*walk).or_default().push(truth.clone());
            }
        })?;
        for (walk, truths) in paths {
            self.add_walk(&WalkOutcome { walk, truths })?;
        }
        self.commit()
    }

    /// Finished walks of an active node, each with its last tag.
    pub fn walks_done(&self, active: usize) -> Result<BTreeMap<(Kind, u32), ConfigTag>, StoreError> {
        let mut done = BTreeMap::new();
        self.each_truth(active, |walk, _, truth| {
            done.insert((walk.kind, walk.number), truth.tag());
        })?;
        Ok(done)
    }

    /// Calls `see` for every held-out value of an active node, ordered by kind, walk and step.
    pub fn each_truth(
        &self,
        active: usize,
        mut see: impl FnMut(&Walk, u32, &Truth),
    ) -> Result<(), StoreError> {
        let sql = format!("SELECT {COLUMNS} FROM held_out WHERE active = ?1 ORDER BY kind, number, step");
        self.each_row(&sql, active, |row| {
            let (walk, step, truth, stored) = self.wrap(read(active, row))?;
            if stored != checksum(&walk, step, &truth) {
                let what = format!("{} walk {}, step {step} is damaged", walk.kind.name(), walk.number);
                return Err(self.corrupt(what));
            }
            see(&walk, step, &truth);
            Ok(())
        })
    }
}

/// Copies the intact held-out walks of a damaged file; returns their number.
///
/// Reads every kind from both ends, so that a damaged page costs only the walks on it. Copies nothing if the
/// meta table does not give the rule of the draw.
pub(in crate::space) fn salvage(old: &Connection, new: &Store, actives: usize) -> Result<usize, StoreError> {
    let keys = "SELECT key, value FROM meta WHERE key LIKE 'held_out%'";
    let drawn: rusqlite::Result<Vec<(String, String)>> = old
        .prepare(keys)
        .and_then(|mut statement| statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?.collect());
    let Some(drawn) = drawn.ok().filter(|drawn| !drawn.is_empty()) else { return Ok(0) };
    for (key, value) in &drawn {
        new.agree(key, value)?;
    }
    let mut saved = 0;
    for active in 0..actives {
        for kind in Kind::ALL {
            let mut done = BTreeSet::new();
            for order in ["number, step", "number DESC, step DESC"] {
                let sql = format!(
                    "SELECT {COLUMNS} FROM held_out WHERE active = {active} AND kind = '{}' ORDER BY {order}",
                    kind.name()
                );
                let Ok(mut statement) = old.prepare(&sql) else { continue };
                let Ok(mut rows) = statement.query([]) else { continue };
                let mut walk: Option<(Walk, Vec<(u32, Truth)>)> = None;
                loop {
                    let row = match rows.next() {
                        Ok(Some(row)) => read(active, row)
                            .ok()
                            .filter(|(walk, step, truth, stored)| *stored == checksum(walk, *step, truth)),
                        // The end of the table: the last walk is complete.
                        Ok(None) => {
                            saved += keep(new, &mut done, walk.take())?;
                            break;
                        }
                        Err(_) => None,
                    };
                    // A damaged row: the walk that contains it is incomplete.
                    let Some((here, step, truth, _)) = row else { break };
                    if walk.as_ref().is_some_and(|(before, _)| *before != here) {
                        saved += keep(new, &mut done, walk.take())?;
                    }
                    walk.get_or_insert((here, Vec::new())).1.push((step, truth));
                }
            }
        }
    }
    Ok(saved)
}

/// Adds a complete walk that is not stored yet.
fn keep(
    store: &Store,
    done: &mut BTreeSet<Walk>,
    walk: Option<(Walk, Vec<(u32, Truth)>)>,
) -> Result<usize, StoreError> {
    let Some((walk, mut steps)) = walk else { return Ok(0) };
    steps.sort_unstable_by_key(|(step, _)| *step);
    // A lost page can remove rows.
    let gapless = steps.iter().zip(1..).all(|((step, _), n)| *step == n);
    if !gapless || !done.insert(walk) {
        return Ok(0);
    }
    store.add_walk(&WalkOutcome { walk, truths: steps.into_iter().map(|(_, truth)| truth).collect() })?;
    Ok(1)
}

fn insert(connection: &Connection, walk: &Walk, step: u32, t: &Truth) -> rusqlite::Result<()> {
    let at = t.equilibrium();
    let mut row: Vec<Value> =
        vec![walk.active.into(), walk.kind.name().to_owned().into(), walk.number.into(), step.into()];
    row.extend(t.displacement_m.map(Value::from));
    row.extend([t.tag().name().to_owned().into(), t.result.clone().err().into()]);
    row.extend(numbers(at));
    row.extend([
        t.residual_n.into(),
        at.map(|at| at.min_jacobian).into(),
        at.map_or(0, |at| at.inverted).into(),
        at.and_then(|at| at.unstable_modes).into(),
        at.is_some_and(|at| at.switched).into(),
        t.iterations.into(),
        t.factorisations.into(),
        t.seconds.into(),
        t.displacements.clone().into(),
        checksum(walk, step, t).into(),
    ]);
    insert_row(connection, "held_out", COLUMNS, row)
}

/// Reads a row of [`COLUMNS`] with its stored checksum.
fn read(active: usize, row: &rusqlite::Row<'_>) -> rusqlite::Result<(Walk, u32, Truth, u32)> {
    let kind = Kind::from_name(&row.get::<_, String>(0)?).ok_or_else(|| unreadable(0, Type::Text))?;
    let walk = Walk { active: active as u32, kind, number: row.get(1)? };
    let truth = Truth {
        displacement_m: [row.get(3)?, row.get(4)?, row.get(5)?],
        result: equilibrium(row, [6, 7, 18])?,
        residual_n: row.get(18)?,
        iterations: row.get(23)?,
        factorisations: row.get(24)?,
        seconds: row.get(25)?,
        displacements: row.get(26)?,
    };
    Ok((walk, row.get(2)?, truth, row.get(27)?))
}

/// CRC-32 of a held-out value as it is read back.
fn checksum(walk: &Walk, step: u32, t: &Truth) -> u32 {
    let mut digest = CHECKSUM.digest();
    let at = t.equilibrium();
    let unstable = at.and_then(|at| at.unstable_modes).map_or(0, |n| n + 1);
    let (inverted, switched) = at.map_or((0, 0), |at| (at.inverted, u32::from(at.switched)));
    for n in [walk.active, walk.number, step, inverted, unstable, switched, t.iterations, t.factorisations] {
        digest.update(&n.to_le_bytes());
    }
    let failure = t.result.as_ref().err().map_or("", String::as_str);
    for text in [walk.kind.name(), t.tag().name(), failure] {
        digest.update(text.as_bytes());
    }
    let of_solution = at.map(|at| {
        let [energy_j, force_and_stiffness @ ..] = at.numbers();
        [energy_j, at.min_jacobian].into_iter().chain(force_and_stiffness)
    });
    let always = t.displacement_m.into_iter().chain([t.residual_n.unwrap_or(f64::NAN), t.seconds]);
    for x in of_solution.into_iter().flatten().chain(always) {
        digest.update(&plain(x).to_le_bytes());
    }
    digest.update(&t.displacements);
    digest.finalize()
}
