//! The `.space` file: SQLite, self-contained. docs/formats.md, section 3, describes every table.
//!
//! Every attempt at every point is one row. Attempts within a tenth of a second share a commit. States and
//! sensitivities are little-endian f32, because they only serve as initial guesses and for rendering; energy,
//! force and its derivatives are f64. Every row has a checksum, because SQLite detects a damaged page but not
//! a damaged number. One process writes; others can read at the same time.

mod error;
mod finished;
pub(super) mod held_out;
mod identity;
mod reading;
mod recognise;
mod refusal;
pub(super) mod rows;

pub use error::StoreError;
pub(super) use error::StoreFault;
pub use identity::{StoreIdentity, solver_version};

use std::cell::Cell;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rusqlite::{Connection, OptionalExtension, params};

use super::job::Outcome;
use super::plan::supersedes;
use super::record::{Record, StoredSeed};
use super::state::SpaceState;
use crate::fem::solve::Seed;
use crate::mesh::TetMesh;
use crate::num::jet::EnergyJet;
use crate::spec::GridIndex;

const SCHEMA: &str = include_str!("schema.sql");

/// Longest time from the end of a solve to its commit.
///
/// A commit costs a tenth of a millisecond (the log is not synchronised). A kill loses the uncommitted
/// attempts.
const COMMIT_AFTER: Duration = Duration::from_millis(100);
/// Outcomes further apart than this are committed one by one.
const MAX_UNCOMMITTED_TIME: Duration = Duration::from_millis(50);

/// An open `.space` file.
#[derive(Debug)]
pub struct Store {
    connection: Connection,
    path: PathBuf,
    /// Start of the open transaction, and time of the last addition.
    begun: Cell<Instant>,
    added: Cell<Instant>,
    /// Lock of the single writer. It is declared after the connection because fields drop in this order.
    /// Closing any handle of the file releases the locks that SQLite holds on it.
    _lock: Option<File>,
}

impl Store {
    /// Opens `path` for a run of `identity`; creates the file if it does not exist.
    ///
    /// A file of another scene, mesh, solver version or instruction set is refused, because its numbers would
    /// be mixed with others. A file that another process writes is refused, and so is a file that is not a
    /// space.
    pub fn create_or_resume(
        path: &Path,
        identity: &StoreIdentity,
        mesh: &TetMesh,
        fixed: &[u32],
        active: &[(String, u32)],
    ) -> Result<Self, StoreError> {
        let fresh = !path.exists();
        Self::expect_space(path)?;
        let at = |error| StoreFault::Sqlite(error).at(path);
        let connection = Connection::open(path).map_err(at)?;
        let lock = lock(path)?;
        configure(&connection).map_err(at)?;
        let mut store = Self::with(connection, path, Some(lock));
        if fresh || store.is_empty()? {
            store.initialise(identity, mesh, fixed, active)?;
        }
        store.check(identity, active)?;
        store.expect_body(mesh, fixed)?;
        store.refresh(identity)?;
        Ok(store)
    }

    /// Opens an existing store for reading. The folder can be without write permission.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        Self::expect_space(path)?;
        let store = Self::with(reading::connect(path)?, path, None);
        if store.is_empty()? {
            return Err(StoreFault::Empty.at(path));
        }
        store.expect_layout()?;
        Ok(store)
    }

    pub(in crate::space) fn with(connection: Connection, path: &Path, lock: Option<File>) -> Self {
        let now = Instant::now();
        let (begun, added) = (Cell::new(now), Cell::new(now));
        Self { connection, path: path.to_path_buf(), begun, added, _lock: lock }
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn wrap<T>(&self, result: rusqlite::Result<T>) -> Result<T, StoreError> {
        result.map_err(|error| StoreFault::Sqlite(error).at(&self.path))
    }

    pub(crate) fn corrupt(&self, what: impl Into<String>) -> StoreError {
        StoreFault::Corrupt(what.into()).at(&self.path)
    }

    fn is_empty(&self) -> Result<bool, StoreError> {
        let tables: i64 =
            self.wrap(self.connection.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0)))?;
        Ok(tables == 0)
    }

    fn initialise(
        &mut self,
        identity: &StoreIdentity,
        mesh: &TetMesh,
        fixed: &[u32],
        active: &[(String, u32)],
    ) -> Result<(), StoreError> {
        let created = self.connection.transaction().and_then(|transaction| {
            transaction.execute_batch(SCHEMA)?;
            for (key, value) in identity.meta() {
                transaction.execute("INSERT INTO meta VALUES (?1, ?2)", params![key, value])?;
            }
            let row = params![
                mesh.nodes_m.iter().flatten().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>(),
                mesh.tets.iter().flatten().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>(),
                fixed.iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>(),
                serde_json::json!([mesh.node_groups, mesh.tet_groups]).to_string(),
            ];
            transaction.execute("INSERT INTO mesh VALUES (0, ?1, ?2, ?3, ?4)", row)?;
            for (id, (name, node)) in active.iter().enumerate() {
                transaction
                    .execute("INSERT INTO active VALUES (?1, ?2, ?3)", params![id as i64, name, node])?;
            }
            transaction.commit()
        });
        self.wrap(created)
    }

    /// Active nodes (name, mesh node) in the order of their numbers.
    pub fn active(&self) -> Result<Vec<(String, u32)>, StoreError> {
        let mut statement =
            self.wrap(self.connection.prepare("SELECT name, node FROM active ORDER BY id"))?;
        let rows = self.wrap(statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?))))?;
        self.wrap(rows.collect())
    }

    /// Mesh and fixed nodes of the body.
    pub fn body(&self) -> Result<(TetMesh, Vec<u32>), StoreError> {
        let (nodes, tets, fixed, groups): (Vec<u8>, Vec<u8>, Vec<u8>, String) = self.wrap(
            self.connection.query_row("SELECT nodes_m, tets, fixed, groups FROM mesh", [], |row| {
                Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?))
            }),
        )?;
        let coordinates: Vec<f64> = nodes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
        let corners: Vec<u32> = tets.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect();
        let fixed: Vec<u32> = fixed.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect();
        let nodes_m = coordinates.as_chunks().0.to_vec();
        let tets = corners.as_chunks().0.to_vec();
        let in_range = |n: &u32| (*n as usize) < nodes_m.len();
        if !tets.iter().flatten().chain(&fixed).all(in_range) {
            return Err(self.corrupt("its mesh refers to a node that does not exist"));
        }
        let (node_groups, tet_groups) = serde_json::from_str(&groups)
            .map_err(|error| self.corrupt(format!("the groups of its mesh cannot be read ({error})")))?;
        let mesh = TetMesh::new(nodes_m, tets)
            .map_err(|fault| self.corrupt(format!("its mesh is not a body ({fault:?})")))?;
        Ok((TetMesh { node_groups, tet_groups, ..mesh }, fixed))
    }

    /// Refuses a file whose mesh differs from that of the same scene.
    fn expect_body(&self, mesh: &TetMesh, fixed: &[u32]) -> Result<(), StoreError> {
        let (stored, held) = self.body()?;
        if stored == *mesh && held == fixed { Ok(()) } else { Err(self.corrupt("its mesh is damaged")) }
    }

    /// All attempts at all points of one active node, sorted by grid index and attempt.
    pub fn attempts(&self, active: usize) -> Result<Vec<Record>, StoreError> {
        let sql = format!(
            "SELECT {} FROM configuration WHERE active = ?1 ORDER BY i, j, k, attempt",
            rows::COLUMNS
        );
        let mut records = Vec::new();
        self.each_row(&sql, active, |row| {
            records.push(self.checked(active, self.wrap(rows::read(row))?)?);
            Ok(())
        })?;
        Ok(records)
    }

    /// Calls `see` for each row that `sql` selects for an active node.
    fn each_row(
        &self,
        sql: &str,
        active: usize,
        mut see: impl FnMut(&rusqlite::Row<'_>) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let mut statement = self.wrap(self.connection.prepare(sql))?;
        let mut found = self.wrap(statement.query([active as i64]))?;
        while let Some(row) = self.wrap(found.next())? {
            see(row)?;
        }
        Ok(())
    }

    fn checked(&self, active: usize, row: rows::Row) -> Result<Record, StoreError> {
        let index = row.record.index;
        row.intact(active).ok_or_else(|| self.corrupt(rows::damaged(&index)))
    }

    /// All decided points of one active node, sorted by grid index: the accepted solution of each, or its
    /// last failure.
    pub fn records(&self, active: usize) -> Result<Vec<Record>, StoreError> {
        let mut kept: Vec<Record> = Vec::new();
        for record in self.attempts(active)? {
            match kept.last_mut().filter(|last| last.index == record.index) {
                Some(last) if supersedes(&record, Some(last)) => *last = record,
                Some(_) => {}
                None => kept.push(record),
            }
        }
        Ok(kept)
    }

    /// Intermediate states of transitions, each with target point and attempt, sorted by these and along the
    /// transition.
    pub fn intermediate(&self, active: usize) -> Result<Vec<(GridIndex, u32, EnergyJet)>, StoreError> {
        let mut states = Vec::new();
        self.each_intermediate(active, |index, attempt, jet| states.push((index, attempt, jet)))?;
        Ok(states)
    }

    fn each_intermediate(
        &self,
        active: usize,
        mut take: impl FnMut(GridIndex, u32, EnergyJet),
    ) -> Result<(), StoreError> {
        let sql = "SELECT i, j, k, attempt, numbers FROM intermediate WHERE active = ?1 ORDER BY i, j, k, attempt, part";
        self.each_row(sql, active, |row| {
            let read =
                || Ok(([row.get(0)?, row.get(1)?, row.get(2)?], row.get(3)?, row.get::<_, Vec<u8>>(4)?));
            let (index, attempt, bytes) = self.wrap(read())?;
            let state = rows::unpack_intermediate(&bytes);
            take(index, attempt, state.ok_or_else(|| self.corrupt("an intermediate state is damaged"))?);
            Ok(())
        })
    }

    /// Adds an outcome, and with the last outcome of a space the state of the space. Outcomes in quick
    /// succession share a commit; slow ones are committed at once. A number that is not finite is refused.
    pub(crate) fn add(&self, outcome: &Outcome, finished: Option<&SpaceState>) -> Result<(), StoreError> {
        let record = &outcome.record;
        let solution = record.result.as_ref().ok().map(|solution| {
            let residual_n = record.residual_n.unwrap_or(f64::NAN);
            let scalars = [solution.equilibrium.min_jacobian, solution.volume_m3, residual_n];
            solution.jet([0.0; 3]).numbers().into_iter().chain(scalars)
        });
        let intermediate = outcome.intermediate.iter().flat_map(EnergyJet::numbers);
        self.expect_finite(solution.into_iter().flatten().chain(intermediate), || {
            format!("the configuration at grid point {:?}", record.index)
        })?;
        self.write(|connection| {
            rows::insert(connection, outcome)?;
            finished.map_or(Ok(()), |state| finished::insert(connection, outcome.active as usize, state))
        })
    }

    /// Refuses numbers that are infinite or NaN.
    fn expect_finite(
        &self,
        mut numbers: impl Iterator<Item = f64>,
        what: impl FnOnce() -> String,
    ) -> Result<(), StoreError> {
        let is_finite = numbers.all(f64::is_finite);
        if is_finite { Ok(()) } else { Err(StoreFault::NotFinite(what()).at(&self.path)) }
    }

    fn write(&self, rows: impl FnOnce(&Connection) -> rusqlite::Result<()>) -> Result<(), StoreError> {
        let now = Instant::now();
        if self.connection.is_autocommit() {
            self.wrap(self.connection.execute_batch("BEGIN IMMEDIATE"))?;
            self.begun.set(now);
        }
        let added = self.wrap(rows(&self.connection));
        if added.is_err() {
            // Earlier outcomes are committed if the disk still accepts them. The first error is returned.
            let _ = self.commit();
            return added;
        }
        let slow = now.duration_since(self.added.replace(now)) > MAX_UNCOMMITTED_TIME;
        if slow || now.duration_since(self.begun.get()) > COMMIT_AFTER { self.commit() } else { Ok(()) }
    }

    /// Commits what was added.
    pub(crate) fn commit(&self) -> Result<(), StoreError> {
        if self.connection.is_autocommit() {
            return Ok(());
        }
        let committed = self.wrap(self.connection.execute_batch("COMMIT"));
        if committed.is_err() {
            // Removes the partial transaction. The first error is returned.
            let _ = self.connection.execute_batch("ROLLBACK");
        }
        committed
    }

    /// Reads all data of one active node, besides its records, that later solves or fits use. So a damaged
    /// row is found before the store is used.
    pub fn check_states(&self, active: usize) -> Result<(), StoreError> {
        let sql = format!("SELECT {}, i, j, k FROM state WHERE active = ?1", rows::STATE);
        self.each_row(&sql, active, |row| {
            if self.wrap(rows::read_state(row))?.is_intact() {
                return Ok(());
            }
            let index = self.wrap((|| Ok([row.get(3)?, row.get(4)?, row.get(5)?]))())?;
            Err(self.corrupt(rows::damaged(&index)))
        })?;
        let sql = "SELECT i, j, k FROM configuration AS c WHERE active = ?1 AND tag <> 'failed' AND NOT EXISTS (SELECT 1 \
                   FROM state AS s WHERE (s.active, s.i, s.j, s.k, s.attempt) = (c.active, c.i, c.j, c.k, c.attempt))";
        let index = |row: &rusqlite::Row<'_>| Ok([row.get(0)?, row.get(1)?, row.get(2)?]);
        let stateless = self.connection.query_row(sql, [active as i64], index).optional();
        if let Some(index) = self.wrap(stateless)? {
            return Err(self.corrupt(rows::damaged(&index)));
        }
        self.each_intermediate(active, |_, _, _| {})
    }

    /// Whether all pages and rows of the file are intact.
    pub(in crate::space) fn is_intact(&self, mesh: &TetMesh, fixed: &[u32], actives: usize) -> bool {
        let pages = self.connection.query_row("PRAGMA integrity_check(1)", [], |row| row.get::<_, String>(0));
        let rows = |active| {
            self.attempts(active)?;
            self.check_states(active)?;
            self.finished(active)?;
            self.each_truth(active, |_, _, _| ())
        };
        pages.is_ok_and(|answer| answer == "ok")
            && self.expect_body(mesh, fixed).is_ok()
            && (0..actives).all(|n| rows(n).is_ok())
    }

    /// The final state of one attempt at a point.
    pub fn stored_seed(
        &self,
        active: usize,
        index: GridIndex,
        attempt: u32,
    ) -> Result<StoredSeed, StoreError> {
        let found = self.wrap(rows::state(&self.connection, active, index, attempt).optional())?;
        let state = found.ok_or_else(|| self.corrupt(format!("no state at grid point {index:?}")))?;
        let record = self.wrap(rows::record(&self.connection, active, index, attempt))?;
        let record = self.checked(active, record)?;
        state.seed(&record).ok_or_else(|| self.corrupt(rows::damaged(&index)))
    }

    /// Start state of a solve near the point of a record.
    pub fn seed(&self, active: usize, record: &Record, displacement_m: [f64; 3]) -> Result<Seed, StoreError> {
        let stored = self.stored_seed(active, record.index, record.attempt)?;
        stored
            .unpack(displacement_m)
            .ok_or_else(|| self.corrupt(format!("no usable state at grid point {:?}", record.index)))
    }

    /// Displacement of every node in one configuration, m (f32 as stored).
    pub fn displacements(
        &self,
        active: usize,
        index: GridIndex,
        attempt: u32,
    ) -> Result<Vec<[f32; 3]>, StoreError> {
        let seed = self.stored_seed(active, index, attempt)?;
        self.of_nodes(&seed.state, self.nodes()?, index)
    }

    /// Displacement of every node, and its derivatives along x, y and z of the active node's displacement.
    pub(crate) fn displacements_and_slopes(
        &self,
        active: usize,
        index: GridIndex,
        attempt: u32,
    ) -> Result<[Vec<[f32; 3]>; 4], StoreError> {
        let (seed, nodes) = (self.stored_seed(active, index, attempt)?, self.nodes()?);
        let slope = |n: usize| {
            let length = seed.state.len();
            let column = seed.sensitivity.get(n * length..(n + 1) * length).unwrap_or_default();
            self.of_nodes(column, nodes, index)
        };
        Ok([self.of_nodes(&seed.state, nodes, index)?, slope(0)?, slope(1)?, slope(2)?])
    }

    /// Number of mesh nodes.
    fn nodes(&self) -> Result<usize, StoreError> {
        let sql = "SELECT length(nodes_m) / 24 FROM mesh";
        let nodes = self.wrap(self.connection.query_row(sql, [], |row| row.get::<_, i64>(0)))?;
        Ok(nodes as usize)
    }

    /// The node displacements, with which the column of a state begins.
    fn of_nodes(&self, column: &[u8], nodes: usize, index: GridIndex) -> Result<Vec<[f32; 3]>, StoreError> {
        let values: Vec<f32> = column.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        let displacements = values.as_chunks().0.get(..nodes).map(<[[f32; 3]]>::to_vec);
        displacements.ok_or_else(|| self.corrupt(format!("the state at grid point {index:?} is too short")))
    }
}

/// Acquires the writer's lock of `path`.
pub(super) fn lock(path: &Path) -> Result<File, StoreError> {
    let file = File::open(path).map_err(|error| StoreFault::Io(error).at(path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(StoreFault::InUse.at(path)),
        Err(TryLockError::Error(error)) => Err(StoreFault::Io(error).at(path)),
    }
}

fn configure(connection: &Connection) -> rusqlite::Result<()> {
    // WAL: other threads can read while one writes. NORMAL: a power failure can lose the last commits; a kill
    // loses none.
    connection.pragma_update(None, "journal_mode", "WAL")?;
    connection.pragma_update(None, "synchronous", "NORMAL")?;
    connection.busy_timeout(std::time::Duration::from_secs(5))
}
