//! Conversion between rows of the tables and SQLite, with checksums.

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use palpate_core::ConfigTag;
use rusqlite::types::Type;
use rusqlite::{Connection, params};

use super::super::job::Outcome;
use super::super::record::{Equilibrium, Record, Solution, StoredSeed};
use crate::num::jet::EnergyJet;
use crate::spec::GridIndex;

/// Checksum of rows. It equals that of the core, but uses a larger table, which firmware cannot afford.
/// States are long, and rank 0 of a cluster computes it for every attempt.
pub(super) static CHECKSUM: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);

/// Columns of a record, in the order of [`read`].
pub(in crate::space) const COLUMNS: &str = "i, j, k, attempt, tag, round, parent_i, parent_j, parent_k, parent_attempt, failure, \
                                  energy_j, fx_n, fy_n, fz_n, sxx_n_m, sxy_n_m, sxz_n_m, syy_n_m, syz_n_m, szz_n_m, \
                                  third_n_m2, residual_n, min_jacobian, inverted, unstable_modes, switched, \
                                  volume_m3, \
                                  iterations, factorisations, increments, seconds, checksum";

/// A record with its stored checksum.
pub(in crate::space) struct Row {
    pub(in crate::space) record: Record,
    pub(in crate::space) checksum: u32,
}

pub(in crate::space) fn damaged(index: &GridIndex) -> String {
    format!("the configuration at grid point {index:?} is damaged")
}

/// Reads a row of [`COLUMNS`].
pub(in crate::space) fn read(row: &rusqlite::Row<'_>) -> rusqlite::Result<Row> {
    let parent: [Option<i32>; 3] = [row.get(6)?, row.get(7)?, row.get(8)?];
    let attempt: Option<u32> = row.get(9)?;
    let tag: String = row.get(4)?;
    let result = match ConfigTag::from_name(&tag) {
        Some(ConfigTag::Failed) => Err(row.get::<_, Option<String>>(10)?.unwrap_or_default()),
        Some(tag) if tag.is_solved() => Ok(solution(row, tag)?),
        _ => return Err(unreadable(4, Type::Text)),
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
        residual_n: nullable(row, 22)?,
        iterations: row.get(28)?,
        factorisations: row.get(29)?,
        increments: row.get(30)?,
        seconds: row.get(31)?,
    };
    Ok(Row { record, checksum: row.get(32)? })
}

fn solution(row: &rusqlite::Row<'_>, tag: ConfigTag) -> rusqlite::Result<Solution> {
    let third = doubles(&row.get::<_, Vec<u8>>(21)?);
    let equilibrium = Equilibrium {
        min_jacobian: nullable(row, 23)?,
        inverted: row.get(24)?,
        unstable_modes: row.get(25)?,
        switched: row.get(26)?,
        ..equilibrium(row, tag, 11)?
    };
    Ok(Solution {
        equilibrium,
        third_n_m2: third.try_into().map_err(|_| unreadable(21, Type::Blob))?,
        volume_m3: nullable(row, 27)?,
    })
}

/// W, h and S in ten columns from `first` on; the condition of the mesh is that of rest.
pub(super) fn equilibrium(
    row: &rusqlite::Row<'_>,
    tag: ConfigTag,
    first: usize,
) -> rusqlite::Result<Equilibrium> {
    let mut numbers = [0.0; 20];
    for (column, number) in numbers[..10].iter_mut().enumerate() {
        *number = row.get(first + column)?;
    }
    let jet = EnergyJet::from_numbers([0.0; 3], &numbers);
    Ok(Solution::of_jet(&jet, tag == ConfigTag::Terminating).equilibrium)
}

/// A number that SQLite returns as NULL if it is NaN.
pub(super) fn nullable(row: &rusqlite::Row<'_>, column: usize) -> rusqlite::Result<f64> {
    row.get::<_, Option<f64>>(column).map(|x| x.unwrap_or(f64::NAN))
}

pub(in crate::space) fn unreadable(column: usize, kind: Type) -> rusqlite::Error {
    rusqlite::Error::InvalidColumnType(column, "damaged".into(), kind)
}

/// Writes an outcome.
pub(in crate::space) fn insert(connection: &Connection, outcome: &Outcome) -> rusqlite::Result<()> {
    let (active, r) = (outcome.active, &outcome.record);
    let (solution, at) = (r.solution(), r.equilibrium());
    let parent = r.parent.map(|(index, _)| index);
    let number = |column: usize| at.map(|at| at.numbers()[column]);
    let sql = format!(
        "INSERT INTO configuration (active, {COLUMNS}) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, \
         ?13, ?14, ?15, ?16, ?17, ?18, ?19, ?20, ?21, ?22, ?23, ?24, ?25, ?26, ?27, ?28, ?29, ?30, ?31, ?32, ?33, ?34)"
    );
    connection.prepare_cached(&sql)?.execute(params![
        active,
        r.index[0],
        r.index[1],
        r.index[2],
        r.attempt,
        r.tag().name(),
        r.round,
        parent.map(|p| p[0]),
        parent.map(|p| p[1]),
        parent.map(|p| p[2]),
        r.parent.map(|(_, attempt)| attempt),
        r.failure(),
        number(0),
        number(1),
        number(2),
        number(3),
        number(4),
        number(5),
        number(6),
        number(7),
        number(8),
        number(9),
        solution.map(|s| bytes(&s.third_n_m2)),
        r.residual_n,
        at.map(|at| at.min_jacobian),
        at.map(|at| at.inverted),
        at.and_then(|at| at.unstable_modes),
        at.map(|at| at.switched),
        solution.map(|s| s.volume_m3),
        r.iterations,
        r.factorisations,
        r.increments,
        r.seconds,
        checksum(active as usize, r),
    ])?;
    if let Some(seed) = &outcome.seed {
        let sql = "INSERT INTO state VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)";
        let [i, j, k] = r.index;
        connection.prepare_cached(sql)?.execute(params![
            active,
            i,
            j,
            k,
            r.attempt,
            seed.state,
            seed.sensitivity,
            seed_checksum(&seed.state, &seed.sensitivity)
        ])?;
    }
    for (part, state) in outcome.intermediate.iter().enumerate() {
        let sql = "INSERT INTO intermediate VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)";
        let [i, j, k] = r.index;
        let part = part as i64 + 1;
        let numbers = pack_intermediate(state);
        connection.prepare_cached(sql)?.execute(params![active, i, j, k, r.attempt, part, numbers])?;
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
    pub(in crate::space) fn is_intact(&self) -> bool {
        self.checksum == seed_checksum(&self.state, &self.sensitivity)
    }

    /// Start state of later solves: the state, and the condensed energy of its record. `None` if the state is
    /// damaged or the attempt failed.
    pub(in crate::space) fn seed(self, record: &Record) -> Option<StoredSeed> {
        let numbers = record.jet([0.0; 3])?.numbers();
        self.is_intact().then_some(StoredSeed { state: self.state, sensitivity: self.sensitivity, numbers })
    }
}

/// Columns of a state, in the order of [`read_state`].
pub(in crate::space) const STATE: &str = "state, sensitivity, checksum";

/// Reads a row of [`STATE`].
pub(in crate::space) fn read_state(row: &rusqlite::Row<'_>) -> rusqlite::Result<State> {
    Ok(State { state: row.get(0)?, sensitivity: row.get(1)?, checksum: row.get(2)? })
}

/// A number as SQLite returns it.
pub(in crate::space) fn plain(x: f64) -> f64 {
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
pub(in crate::space) fn checksum(active: usize, r: &Record) -> u32 {
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
    digest.update(r.failure().unwrap_or("").as_bytes());
    let of_solution = r.solution().map(|solution| {
        let at = &solution.equilibrium;
        let [energy_j, force_and_stiffness @ ..] = at.numbers();
        let scalars = [energy_j, at.min_jacobian, solution.volume_m3];
        scalars.into_iter().chain(force_and_stiffness).chain(solution.third_n_m2)
    });
    for x in of_solution.into_iter().flatten().chain([r.residual_n, r.seconds]) {
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
pub(in crate::space) fn unpack_intermediate(packed: &[u8]) -> Option<EnergyJet> {
    let (numbers, checksum) = packed.split_last_chunk::<4>()?;
    if CHECKSUM.checksum(numbers) != u32::from_le_bytes(*checksum) {
        return None;
    }
    let numbers = doubles(numbers);
    let (control_m, numbers) = numbers.split_first_chunk::<3>()?;
    Some(EnergyJet::from_numbers(*control_m, numbers.try_into().ok()?))
}
