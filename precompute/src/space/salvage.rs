//! Copies the intact part of a damaged store.

use std::path::{Path, PathBuf};

use rusqlite::{Connection, OpenFlags, OptionalExtension};

use super::job::Outcome;
use super::plans::Plans;
use super::store::{LAYOUT, Store, StoreError, StoreIdentity, held_out, lock, rows, solver_version};
use crate::mesh::TetMesh;
use crate::spec::{Domain, GridIndex, Lattice, Sampling};

/// Result of a salvage.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Salvaged {
    /// Attempts copied.
    pub saved: usize,
    /// Damaged rows found.
    pub damaged: usize,
    /// Held-out walks copied.
    pub walks: usize,
    /// New path of the damaged file.
    pub moved_to: PathBuf,
}

impl Store {
    /// Copies every intact attempt of the damaged file at `path` into a new file, and keeps the old one under
    /// another name.
    ///
    /// Rows are read one by one, so that a damaged page costs only its own rows. Scene and mesh come from the
    /// caller. Before the file is moved, its meta table is compared with them if it is readable. A file that
    /// another process writes, and a file that is not a space, remain unchanged.
    pub fn salvage(
        path: &Path,
        identity: &StoreIdentity,
        mesh: &TetMesh,
        fixed: &[u32],
        active: &[(String, u32)],
    ) -> Result<(Self, Salvaged), StoreError> {
        let io = |error| StoreError::Io { path: path.to_path_buf(), error };
        Self::expect_saveable(path)?;
        {
            let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
            let connection = Connection::open_with_flags(path, flags);
            let lock = lock(path)?;
            if let Ok(connection) = connection {
                let old = Self::with(connection, path, Some(lock));
                let belongs = old.expect_meta("layout", LAYOUT);
                let belongs = belongs.and_then(|()| old.expect_meta("solver", &solver_version()));
                let belongs = belongs.and_then(|()| old.expect_content(identity));
                if let Err(other @ StoreError::Mismatch { .. }) = belongs {
                    return Err(other);
                }
            }
        }
        // Files of an earlier salvage are kept too.
        let mut names = (1_u32..).map(|n| path.with_extension(format!("damaged-{n}.space")));
        let moved_to = names.find(|name| !name.exists()).expect("some number is free");
        for suffix in ["", "-wal", "-shm"] {
            let with = |p: &Path| PathBuf::from(format!("{}{suffix}", p.display()));
            if with(path).exists() {
                std::fs::rename(with(path), with(&moved_to)).map_err(io)?;
            }
        }
        let store = Self::create_or_resume(path, identity, mesh, fixed, active)?;
        let mut salvaged = Salvaged { saved: 0, damaged: 0, walks: 0, moved_to: moved_to.clone() };
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let Ok(old) = Connection::open_with_flags(&moved_to, flags) else { return Ok((store, salvaged)) };
        for number in 0..active.len() {
            match identity.sampling {
                Sampling::Lattice(Lattice { grid, complete_cells, increments }) => {
                    for point in Domain::new(&grid, complete_cells).points() {
                        salvaged.copy(&old, &store, number, point, increments)?;
                    }
                }
                Sampling::Scattered(_) => {
                    // The search determines its positions batch by batch.
                    let mut plan = Plans::of(&store)?.plan(number);
                    while let Some(task) = plan.next_task() {
                        salvaged.copy(&old, &store, number, task.target, None)?;
                        let copied = store.attempts(number)?.into_iter().find(|r| r.index == task.target);
                        if let Some(record) = copied {
                            plan.decide(&record);
                        }
                    }
                }
            }
        }
        salvaged.walks = held_out::salvage(&old, &store, active.len())?;
        store.commit()?;
        Ok((store, salvaged))
    }
}

impl Salvaged {
    /// Copies the attempts at one point up to the first damaged one. Later attempts are dropped because they
    /// may depend on it.
    fn copy(
        &mut self,
        old: &Connection,
        store: &Store,
        active: usize,
        index: GridIndex,
        increments: Option<u32>,
    ) -> Result<(), StoreError> {
        for attempt in 0.. {
            let row = rows::record(old, active, index, attempt).optional();
            let record = match row {
                Ok(None) => return Ok(()),
                Ok(Some(row)) if row.checksum == rows::checksum(active, &row.record) => row.record,
                _ => {
                    self.damaged += 1;
                    return Ok(());
                }
            };
            let seed = if record.tag().is_solved() {
                let state = rows::state(old, active, index, attempt).ok();
                let Some(seed) = state.and_then(|state| state.seed(&record)) else {
                    self.damaged += 1;
                    return Ok(());
                };
                Some(seed)
            } else {
                None
            };
            // A transition of n parts has n - 1 intermediate states. The rest point and failed attempts have
            // none.
            let parts = match increments {
                Some(parts) if seed.is_some() && record.parent.is_some() => parts - 1,
                _ => 0,
            };
            let on_the_way: Option<Vec<_>> =
                (1..=parts).map(|part| rows::intermediate(old, active, index, attempt, part)).collect();
            let Some(intermediate) = on_the_way else {
                self.damaged += 1;
                return Ok(());
            };
            store.add(&Outcome { active: active as u32, record, seed, intermediate }, None)?;
            self.saved += 1;
        }
        Ok(())
    }
}
