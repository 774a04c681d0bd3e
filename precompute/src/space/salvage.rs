//! Copies the intact part of a damaged store.

use std::path::{Path, PathBuf};

use rusqlite::{Connection, OpenFlags, OptionalExtension};

use super::job::Outcome;
use super::plans::Plans;
use super::store::{Store, StoreError, StoreFault, StoreIdentity, held_out, lock, rows};
use crate::mesh::TetMesh;
use crate::spec::{GridIndex, Lattice, Sampling};

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
    /// caller. Before the file is moved, its meta table is compared with them if it is readable. A file that is
    /// not damaged, one that another process writes, and one that is not a space remain unchanged.
    pub fn salvage(
        path: &Path,
        identity: &StoreIdentity,
        mesh: &TetMesh,
        fixed: &[u32],
        active: &[(String, u32)],
    ) -> Result<(Self, Salvaged), StoreError> {
        Self::expect_saveable(path)?;
        {
            let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
            let connection = Connection::open_with_flags(path, flags);
            let lock = lock(path)?;
            if let Ok(connection) = connection {
                let old = Self::with(connection, path, Some(lock));
                match old.expect_inputs(identity) {
                    Err(other) if matches!(other.fault(), StoreFault::Mismatch { .. }) => return Err(other),
                    Ok(()) if old.is_intact(mesh, fixed, active.len()) => {
                        return Err(StoreFault::NotDamaged.at(path));
                    }
                    _ => {}
                }
            }
        }
        // Files of an earlier salvage are kept too.
        let mut names = (1_u32..).map(|n| path.with_extension(format!("damaged-{n}.space")));
        let moved_to = names.find(|name| !name.exists()).expect("some number is free");
        for suffix in ["", "-wal", "-shm"] {
            let with = |p: &Path| PathBuf::from(format!("{}{suffix}", p.display()));
            if with(path).exists() {
                let moved = std::fs::rename(with(path), with(&moved_to));
                moved.map_err(|error| StoreFault::Io(error).at(path))?;
            }
        }
        let store = Self::create_or_resume(path, identity, mesh, fixed, active)?;
        let mut salvaged = Salvaged { saved: 0, damaged: 0, walks: 0, moved_to: moved_to.clone() };
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let Ok(old) = Connection::open_with_flags(&moved_to, flags) else { return Ok((store, salvaged)) };
        for number in 0..active.len() {
            match identity.sampling {
                Sampling::Lattice(Lattice { grid, complete_cells, increments }) => {
                    for point in grid.points(complete_cells) {
                        salvaged.copy(&old, &store, number, point, increments)?;
                    }
                }
                Sampling::Scattered(_) => {
                    // The search determines its positions batch by batch.
                    let mut plan = Plans::of(&store)?.plan(&store, number)?;
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
            let outcome = match row {
                Ok(None) => return Ok(()),
                row => row.ok().flatten().and_then(|row| intact(old, active, row, increments)),
            };
            let Some(outcome) = outcome else {
                self.damaged += 1;
                return Ok(());
            };
            store.add(&outcome, None)?;
            self.saved += 1;
        }
        Ok(())
    }
}

/// The outcome of a row with its state and intermediate states; `None` if one of them is damaged.
fn intact(old: &Connection, active: usize, row: rows::Row, increments: Option<u32>) -> Option<Outcome> {
    let record = row.intact(active)?;
    let (index, attempt) = (record.index, record.attempt);
    let seed = match record.tag().is_solved() {
        true => Some(rows::state(old, active, index, attempt).ok()?.seed(&record)?),
        false => None,
    };
    // A transition of n parts has n - 1 intermediate states. The rest point and failed attempts have none.
    let parts = match increments {
        Some(parts) if seed.is_some() && record.parent.is_some() => parts - 1,
        _ => 0,
    };
    let intermediate = (1..=parts)
        .map(|part| rows::intermediate(old, active, index, attempt, part))
        .collect::<Option<_>>()?;
    Some(Outcome { active: active as u32, record, seed, intermediate })
}
