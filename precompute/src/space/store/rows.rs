//! Conversion between rows of the tables and SQLite, with checksums.

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use palpate_core::ConfigTag;
use rusqlite::types::{Type, Value};
use rusqlite::{Connection, params, params_from_iter};

use super::super::job::Outcome;
use super::super::record::{Equilibrium, Record, Solution, StoredSeed};
use crate::num::jet::EnergyJet;
use crate::spec::GridIndex;

/// Checksum of rows. It equals that of the core, but uses a larger table, which firmware cannot afford.
/// States are long, and rank 0 of a cluster computes it for every attempt.
pub(super) static CHECKSUM: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);

/// Columns of a record, in the order of [`read`].
pub(super) const COLUMNS: &str = "i, j, k, attempt, tag, round, parent_i, parent_j, parent_k, parent_attempt, failure, \
     energy_j, fx_n, fy_n, fz_n, sxx_n_m, sxy_n_m, sxz_n_m, syy_n_m, syz_n_m, szz_n_m, \
     third_n_m2, residual_n, min_jacobian, inverted, unstable_modes, switched, \
     volume_m3, \
     iterations, factorisations, increments, seconds, checksum";

/// A record with its stored checksum.
pub(in crate::space) struct Row {
    pub(super) record: Record,
    checksum: u32,
}

impl Row {
    /// The record; `None` if it is damaged.
    pub(in crate::space) fn intact(self, active: usize) -> Option<Record> {
        (self.checksum == checksum(active, &self.record)).then_some(self.record)
    }
}

pub(super) fn damaged(index: &GridIndex) -> String {
    format!("the configuration at grid point {index:?} is damaged")
}

/// Reads a row of [`COLUMNS`].
pub(super) fn read(row: &rusqlite::Row<'_>) -> rusqlite::Result<Row> {
    let parent: [Option<i32>; 3] = [row.get(6)?, row.get(7)?, row.get(8)?];
    let attempt: Option<u32> = row.get(9)?;
    let result = match equilibrium(row, [4, 10, 22])? {
        Ok(equilibrium) => {
            let third = doubles(&row.get::<_, Vec<u8>>(21)?);
            let third_n_m2 = third.try_into().map_err(|_| unreadable(21, Type::Blob))?;
            Ok(Solution { equilibrium, third_n_m2, volume_m3: row.get(27)? })
        }
        Err(failure) => Err(failure),
    };
    let record = Record {
        index: [row.get(0)?, row.get(1)?, row.get(2)?],
        attempt: row.get(3)?,
        round: row.get(5)?,
        parent: match (parent, attempt) {
            ([Some(i), Some(j), Some(k)], Some(attempt)) => Some(([i, j, k], attempt)),
            _ => None,
        },
        result,
        residual_n: row.get(22)?,
        iterations: row.get(28)?,
        factorisations: row.get(29)?,
        increments: row.get(30)?,
        seconds: row.get(31)?,
    };
    Ok(Row { record, checksum: row.get(32)? })
}

/// The solution or the reason of the failure, from the columns of the tag, the failure and the residual. W, h
/// and S follow the failure, the condition of the mesh follows the residual.
pub(super) fn equilibrium(
    row: &rusqlite::Row<'_>,
    [tag, failure, residual]: [usize; 3],
) -> rusqlite::Result<Result<Equilibrium, String>> {
    let terminating = match ConfigTag::from_name(&row.get::<_, String>(tag)?) {
        Some(ConfigTag::Failed) => return Ok(Err(row.get(failure)?)),
        Some(tag) if tag.is_solved() => tag == ConfigTag::Terminating,
        _ => return Err(unreadable(tag, Type::Text)),
    };
    let mut numbers = [0.0_f64; 20];
    for (column, number) in numbers[..10].iter_mut().enumerate() {
        *number = row.get(failure + 1 + column)?;
    }
    // Only a failed solve can be without a residual. The writer refuses what is not finite.
    let residual_n: f64 = row.get(residual)?;
    let min_jacobian: f64 = row.get(residual + 1)?;
    if !(residual_n.is_finite() && min_jacobian.is_finite() && numbers.iter().all(|x| x.is_finite())) {
        return Err(unreadable(residual, Type::Real));
    }
    Ok(Ok(Equilibrium {
        min_jacobian,
        inverted: row.get(residual + 2)?,
        unstable_modes: row.get(residual + 3)?,
        switched: row.get(residual + 4)?,
        ..Solution::of_jet(&EnergyJet::from_numbers([0.0; 3], &numbers), terminating).equilibrium
    }))
}

pub(super) fn unreadable(column: usize, kind: Type) -> rusqlite::Error {
    rusqlite::Error::InvalidColumnType(column, "damaged".into(), kind)
}

/// W, h and S of a solution as values of columns; NULL for a failed solve.
pub(super) fn numbers(at: Option<&Equilibrium>) -> [Value; 10] {
    let numbers = at.map(Equilibrium::numbers);
    std::array::from_fn(|column| numbers.map(|all| all[column]).into())
}

/// Adds a row of these columns, preceded by the column of the active node.
pub(super) fn insert_row(
    connection: &Connection,
    table: &str,
    columns: &str,
    row: Vec<Value>,
) -> rusqlite::Result<()> {
    let places = vec!["?"; row.len()].join(", ");
    let sql = format!("INSERT INTO {table} (active, {columns}) VALUES ({places})");
    connection.prepare_cached(&sql)?.execute(params_from_iter(row)).map(drop)
}

/// Writes an outcome.
pub(super) fn insert(connection: &Connection, outcome: &Outcome) -> rusqlite::Result<()> {
    let (active, r) = (outcome.active, &outcome.record);
    let (solution, at) = (r.result.as_ref().ok(), r.equilibrium());
    let parent = r.parent.map_or([None; 3], |(index, _)| index.map(Some));
    let mut row: Vec<Value> = vec![active.into()];
    row.extend(r.index.map(Value::from));
    row.extend([r.attempt.into(), r.tag().name().to_owned().into(), r.round.into()]);
    row.extend(parent.map(Value::from));
    row.extend([r.parent.map(|(_, attempt)| attempt).into(), r.result.clone().err().into()]);
    row.extend(numbers(at));
    row.extend([
        solution.map(|s| bytes(&s.third_n_m2)).into(),
        r.residual_n.into(),
        at.map(|at| at.min_jacobian).into(),
        at.map(|at| at.inverted).into(),
        at.and_then(|at| at.unstable_modes).into(),
        at.map(|at| at.switched).into(),
        solution.map(|s| s.volume_m3).into(),
        r.iterations.into(),
        r.factorisations.into(),
        r.increments.into(),
        r.seconds.into(),
        checksum(active as usize, r).into(),
    ]);
    insert_row(connection, "configuration", COLUMNS, row)?;
    let [i, j, k] = r.index;
    if let Some(StoredSeed { state, sensitivity, .. }) = &outcome.seed {
        let sql = "INSERT INTO state VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)";
        let checksum = seed_checksum(state, sensitivity);
        let row = params![active, i, j, k, r.attempt, state, sensitivity, checksum];
        connection.prepare_cached(sql)?.execute(row)?;
    }
    for (part, state) in (1_u32..).zip(&outcome.intermediate) {
        let sql = "INSERT INTO intermediate VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)";
        let row = params![active, i, j, k, r.attempt, part, pack_intermediate(state)];
        connection.prepare_cached(sql)?.execute(row)?;
    }
    Ok(())
}

/// The record of an attempt.
pub(in crate::space) fn record(
    connection: &Connection,
    active: usize,
    index: GridIndex,
    attempt: u32,
) -> rusqlite::Result<Row> {
    let sql = format!("SELECT {COLUMNS} FROM configuration WHERE {ATTEMPT}");
    let key = params![active as i64, index[0], index[1], index[2], attempt];
    connection.prepare_cached(&sql)?.query_row(key, read)
}

/// The final state of an attempt.
pub(in crate::space) fn state(
    connection: &Connection,
    active: usize,
    index: GridIndex,
    attempt: u32,
) -> rusqlite::Result<State> {
    let sql = format!("SELECT {STATE} FROM state WHERE {ATTEMPT}");
    let key = params![active as i64, index[0], index[1], index[2], attempt];
    connection.prepare_cached(&sql)?.query_row(key, read_state)
}

/// Selects one attempt.
const ATTEMPT: &str = "active = ?1 AND i = ?2 AND j = ?3 AND k = ?4 AND attempt = ?5";

/// A state with its stored checksum.
pub(in crate::space) struct State {
    state: Vec<u8>,
    sensitivity: Vec<u8>,
    checksum: u32,
}

impl State {
    pub(super) fn is_intact(&self) -> bool {
        self.checksum == seed_checksum(&self.state, &self.sensitivity)
    }

    /// Start state of later solves: the state, and the condensed energy of its record. `None` if the state is
    /// damaged or the attempt failed.
    pub(in crate::space) fn seed(self, record: &Record) -> Option<StoredSeed> {
        let numbers = record.jet([0.0; 3])?.numbers();
        self.is_intact().then_some(StoredSeed {
            state: self.state,
            sensitivity: self.sensitivity,
            numbers,
            from_m: [0.0; 3],
        })
    }
}

/// Columns of a state, in the order of [`read_state`].
pub(super) const STATE: &str = "state, sensitivity, checksum";

/// Reads a row of [`STATE`].
pub(super) fn read_state(row: &rusqlite::Row<'_>) -> rusqlite::Result<State> {
    Ok(State { state: row.get(0)?, sensitivity: row.get(1)?, checksum: row.get(2)? })
}

/// A number as SQLite returns it.
pub(super) fn plain(x: f64) -> f64 {
    if x.is_nan() { f64::NAN } else { x + 0.0 }
}

/// One intermediate state of an attempt; `None` if it is missing or damaged.
pub(in crate::space) fn intermediate(
    connection: &Connection,
    active: usize,
    index: GridIndex,
    attempt: u32,
    part: u32,
) -> Option<EnergyJet> {
    let sql = "SELECT numbers FROM intermediate WHERE active = ?1 AND i = ?2 AND j = ?3 AND k = ?4 AND attempt = ?5 \
               AND part = ?6";
    let key = params![active as i64, index[0], index[1], index[2], attempt, part];
    let packed = connection
        .prepare_cached(sql)
        .and_then(|mut statement| statement.query_row(key, |row| row.get::<_, Vec<u8>>(0)));
    unpack_intermediate(&packed.ok()?)
}

/// CRC-32 of a record as it is read back: SQLite keeps neither the sign of zero nor the payload of NaN.
fn checksum(active: usize, r: &Record) -> u32 {
    let mut digest = CHECKSUM.digest();
    let parent = r.parent.map_or([0; 4], |([i, j, k], attempt)| [i, j, k, attempt as i32 + 1]);
    let unstable = r.equilibrium().and_then(|at| at.unstable_modes).map_or(0, |n| n + 1);
    let inverted = r.equilibrium().map_or(0, |at| 2 * at.inverted + u32::from(at.switched));
    let whole =
        [active as u32, r.attempt, r.round, inverted, unstable, r.iterations, r.factorisations, r.increments];
    for n in whole.into_iter().chain(r.index.map(|n| n as u32)).chain(parent.map(|n| n as u32)) {
        digest.update(&n.to_le_bytes());
    }
    digest.update(r.tag().name().as_bytes());
    digest.update(r.result.as_ref().err().map_or("", String::as_str).as_bytes());
    let of_solution = r.result.as_ref().ok().map(|solution| {
        let at = &solution.equilibrium;
        let [energy_j, force_and_stiffness @ ..] = at.numbers();
        let scalars = [energy_j, at.min_jacobian, solution.volume_m3];
        scalars.into_iter().chain(force_and_stiffness).chain(solution.third_n_m2)
    });
    for x in of_solution.into_iter().flatten().chain([r.residual_n.unwrap_or(f64::NAN), r.seconds]) {
        digest.update(&plain(x).to_le_bytes());
    }
    digest.finalize()
}

fn seed_checksum(state: &[u8], sensitivity: &[u8]) -> u32 {
    let mut digest = CHECKSUM.digest();
    digest.update(state);
    digest.update(sensitivity);
    digest.finalize()
}

fn bytes(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|x| (x + 0.0).to_le_bytes()).collect()
}

fn doubles(bytes: &[u8]) -> Vec<f64> {
    bytes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect()
}

fn pack_intermediate(jet: &EnergyJet) -> Vec<u8> {
    let numbers: Vec<f64> = jet.control_m.into_iter().chain(jet.numbers()).collect();
    let mut packed = bytes(&numbers);
    let checksum = CHECKSUM.checksum(&packed);
    packed.extend(checksum.to_le_bytes());
    packed
}

/// `None` if the bytes are damaged.
pub(super) fn unpack_intermediate(packed: &[u8]) -> Option<EnergyJet> {
    let (numbers, checksum) = packed.split_last_chunk::<4>()?;
    if CHECKSUM.checksum(numbers) != u32::from_le_bytes(*checksum) {
        return None;
    }
    let numbers = doubles(numbers);
    let (control_m, numbers) = numbers.split_first_chunk::<3>()?;
    Some(EnergyJet::from_numbers(*control_m, numbers.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::Task;
    use crate::space::tests::synthetic::SyntheticExecutor;

    /// SQLite stores NaN as NULL. Only the residual of a failed solve may be one.
    #[test]
    fn a_null_in_a_solution_is_damage() {
        let folder = tempfile::tempdir().expect("a folder");
        let store = SyntheticExecutor::new(1.0, 0.0).store(&folder.path().join("a.space"), 1);
        let task = Task { target: [1, 0, 0], attempt: 0, round: 1, parent: Some(([0; 3], 0)), chart: None };
        let jet = EnergyJet::from_numbers([0.01, 0.0, 0.0], &[1.0; 20]);
        let sound = Record::of_jet(&task, &jet, false);
        let failed = Record { attempt: 1, residual_n: None, ..Record::new(&task, Err("not-finite".into())) };
        for record in [&sound, &failed] {
            let outcome = Outcome { active: 0, record: record.clone(), seed: None, intermediate: Vec::new() };
            store.add(&outcome, None).expect("added");
        }
        store.commit().expect("committed");
        assert_eq!(store.attempts(0).expect("sound"), [sound.clone(), failed]);
        type Lose = fn(&mut Record);
        let columns: [(&str, Lose); 3] = [
            ("residual_n", |record| record.residual_n = None),
            ("min_jacobian", |record| {
                record.result.as_mut().expect("solved").equilibrium.min_jacobian = f64::NAN;
            }),
            ("volume_m3", |record| record.result.as_mut().expect("solved").volume_m3 = f64::NAN),
        ];
        for (column, lose) in columns {
            let mut lost = sound.clone();
            lose(&mut lost);
            let row = format!("{column} = NULL, checksum = {}", checksum(0, &lost));
            let sql = format!("BEGIN; UPDATE configuration SET {row} WHERE attempt = 0");
            store.connection.execute_batch(&sql).expect("it runs");
            let line = store.attempts(0).expect_err("damaged").to_string();
            assert!(line.contains("is damaged") && line.contains("--salvage"), "{column}: {line}");
            store.connection.execute_batch("ROLLBACK").expect("it runs");
        }
    }
}
