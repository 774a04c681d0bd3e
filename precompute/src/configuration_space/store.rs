//! The `.space` file: SQLite, one row per configuration, self-contained.
//!
//! Schema: `meta(key, value)` identifies scene, mesh, solver and instruction set; `mesh` holds the body;
//! `active` the active nodes; `configuration` one row per decided grid point, committed as soon as it is decided, so
//! that a kill loses only the work in flight. States and sensitivities are little-endian f32 columns: they are first
//! guesses of later solves and pictures for the eye, while energy, force and tangent are f64. Because every child
//! starts from what is stored, an interrupted run gives the same bits as an undisturbed one.

use std::path::{Path, PathBuf};

use nalgebra::Matrix3;
use palpate_core::ConfigTag;
use rusqlite::{Connection, OpenFlags, OptionalExtension, params};

use super::GridIndex;
use crate::boundary::Pose;
use crate::mesh::TetMesh;
use crate::solve::{Configuration, Seed, SolveFailure};

/// Layout of the file; a store of another layout is refused.
const LAYOUT: &str = "1";

const SCHEMA: &str = "
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE mesh (
  id INTEGER PRIMARY KEY CHECK (id = 0),
  nodes_m BLOB NOT NULL,      -- f64 x, y, z per node
  tets BLOB NOT NULL,         -- u32 x 4 per tetrahedron
  fixed BLOB NOT NULL         -- u32 per fixed node
);
CREATE TABLE active (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, node INTEGER NOT NULL);
CREATE TABLE configuration (
  active INTEGER NOT NULL REFERENCES active (id),
  i INTEGER NOT NULL, j INTEGER NOT NULL, k INTEGER NOT NULL,   -- grid point, in cells
  tag TEXT NOT NULL,                                            -- expandable | terminating | failed
  round INTEGER NOT NULL,                                       -- round of the expansion that decided it
  parent_i INTEGER, parent_j INTEGER, parent_k INTEGER,         -- NULL for the rest point
  failure TEXT,                                                 -- reason, if failed
  energy_j REAL, fx_n REAL, fy_n REAL, fz_n REAL,
  sxx_n_m REAL, syy_n_m REAL, szz_n_m REAL, sxy_n_m REAL, sxz_n_m REAL, syz_n_m REAL,
  residual_n REAL, min_jacobian REAL, inverted INTEGER, volume_m3 REAL,
  iterations INTEGER NOT NULL, increments INTEGER, seconds REAL NOT NULL,
  state BLOB,                                                   -- f32: displacements, then pressures
  sensitivity BLOB,                                             -- f32: d(state)/dd along x, then y, then z
  PRIMARY KEY (active, i, j, k)
) WITHOUT ROWID;
";

/// What a store was made of: a resumed run must agree on all of it.
#[derive(Debug, Clone, PartialEq)]
pub struct StoreIdentity {
    /// Name of the scene.
    pub scene_name: String,
    /// The scene file's text.
    pub scene: String,
    /// Hash over everything in scene and mesh that changes numbers.
    pub content_hash: String,
    /// Hash of the mesh alone.
    pub mesh_hash: [u8; 32],
    /// Name of the material law.
    pub law: String,
    /// f_max of the scene, N.
    pub max_force_n: f64,
    /// Grid spacing, m.
    pub spacing_m: f64,
    /// Grid radius r_G, m.
    pub radius_m: f64,
    /// Whether the scene needs displacements for the eye.
    pub visual: bool,
}

/// Why a store cannot be used.
#[derive(Debug)]
pub enum StoreError {
    /// SQLite refused.
    Sqlite {
        /// The file.
        path: PathBuf,
        /// What it said.
        error: rusqlite::Error,
    },
    /// The file belongs to something else.
    Mismatch {
        /// The file.
        path: PathBuf,
        /// What differs.
        what: &'static str,
        /// In the file.
        stored: String,
        /// Asked for.
        wanted: String,
    },
    /// A value in the file makes no sense.
    Corrupt {
        /// The file.
        path: PathBuf,
        /// Which.
        what: String,
    },
}

impl std::fmt::Display for StoreError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Sqlite { path, error } => write!(
                f,
                "{}: {error}; check that it is a .space file, that the folder can be written and the disk has room",
                path.display()
            ),
            Self::Mismatch { path, what, stored, wanted } => write!(
                f,
                "{}: made with another {what} ({stored}, now {wanted}); give --out another name or delete the file",
                path.display()
            ),
            Self::Corrupt { path, what } => {
                write!(f, "{}: {what}; the file is damaged, delete it and precompute again", path.display())
            }
        }
    }
}

impl std::error::Error for StoreError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Sqlite { error, .. } => Some(error),
            _ => None,
        }
    }
}

/// One decided grid point.
#[derive(Debug, Clone)]
pub struct Record {
    /// The grid point.
    pub index: GridIndex,
    /// Expandable, terminating or failed.
    pub tag: ConfigTag,
    /// Round of the expansion that decided it.
    pub round: u32,
    /// Where the transition started.
    pub parent: Option<GridIndex>,
    /// Reason, if failed.
    pub failure: Option<String>,
    /// W, J.
    pub energy_j: f64,
    /// h, N.
    pub force_n: [f64; 3],
    /// S, N/m.
    pub stiffness_n_m: Matrix3<f64>,
    /// Residual, N.
    pub residual_n: f64,
    /// Smallest J.
    pub min_jacobian: f64,
    /// Inverted elements.
    pub inverted: u32,
    /// Deformed volume, m^3.
    pub volume_m3: f64,
    /// Newton iterations.
    pub iterations: u32,
    /// Load increments.
    pub increments: u32,
    /// Wall seconds of the solve.
    pub seconds: f64,
}

impl Record {
    /// Record of a solved configuration.
    pub fn solved(
        index: GridIndex,
        tag: ConfigTag,
        round: u32,
        parent: Option<GridIndex>,
        c: &Configuration,
        seconds: f64,
    ) -> Self {
        Self {
            index,
            tag,
            round,
            parent,
            failure: None,
            energy_j: c.energy_j,
            force_n: c.force_n,
            stiffness_n_m: c.stiffness_n_m,
            residual_n: c.residual_n,
            min_jacobian: c.min_jacobian,
            inverted: c.inverted as u32,
            volume_m3: c.volume_m3,
            iterations: c.iterations,
            increments: c.increments,
            seconds,
        }
    }

    /// Record of a transition that failed.
    pub fn failed(
        index: GridIndex,
        round: u32,
        parent: GridIndex,
        failure: &SolveFailure,
        seconds: f64,
    ) -> Self {
        Self {
            index,
            tag: ConfigTag::Failed,
            round,
            parent: Some(parent),
            failure: Some(failure.reason.name().into()),
            energy_j: f64::NAN,
            force_n: [f64::NAN; 3],
            stiffness_n_m: Matrix3::from_element(f64::NAN),
            residual_n: failure.residual_n,
            min_jacobian: f64::NAN,
            inverted: 0,
            volume_m3: f64::NAN,
            iterations: failure.iterations,
            increments: 0,
            seconds,
        }
    }

    /// |h|, N.
    pub fn force_norm_n(&self) -> f64 {
        self.force_n.iter().map(|f| f * f).sum::<f64>().sqrt()
    }
}

/// An open `.space` file.
#[derive(Debug)]
pub struct Store {
    connection: Connection,
    path: PathBuf,
}

const COLUMNS: &str = "i, j, k, tag, round, parent_i, parent_j, parent_k, failure, energy_j, fx_n, fy_n, fz_n, \
                       sxx_n_m, syy_n_m, szz_n_m, sxy_n_m, sxz_n_m, syz_n_m, residual_n, min_jacobian, inverted, \
                       volume_m3, iterations, increments, seconds";

impl Store {
    /// Opens `path` for a run of `identity`, creating it if it is not there.
    ///
    /// A file made with another scene, mesh, solver version or instruction set is refused: continuing it would mix
    /// numbers that do not belong together.
    pub fn create_or_resume(
        path: &Path,
        identity: &StoreIdentity,
        mesh: &TetMesh,
        fixed: &[u32],
        active: &[(String, u32)],
    ) -> Result<Self, StoreError> {
        let fresh = !path.exists();
        let at = |error| StoreError::Sqlite { path: path.to_path_buf(), error };
        let connection = Connection::open(path).map_err(at)?;
        configure(&connection).map_err(at)?;
        let mut store = Self { connection, path: path.to_path_buf() };
        if fresh || store.is_empty()? {
            store.initialise(identity, mesh, fixed, active)?;
        }
        store.check(identity, active)?;
        store.refresh(identity)?;
        Ok(store)
    }

    /// Opens an existing store for reading.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let at = |error| StoreError::Sqlite { path: path.to_path_buf(), error };
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(path, flags).map_err(at)?;
        let store = Self { connection, path: path.to_path_buf() };
        store.expect_meta("layout", LAYOUT)?;
        Ok(store)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn wrap<T>(&self, result: rusqlite::Result<T>) -> Result<T, StoreError> {
        result.map_err(|error| StoreError::Sqlite { path: self.path.clone(), error })
    }

    fn corrupt(&self, what: impl Into<String>) -> StoreError {
        StoreError::Corrupt { path: self.path.clone(), what: what.into() }
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
        let path = self.path.clone();
        let at = |error| StoreError::Sqlite { path: path.clone(), error };
        let transaction = self.connection.transaction().map_err(at)?;
        transaction.execute_batch(SCHEMA).map_err(at)?;
        let meta = [
            ("layout", LAYOUT.to_string()),
            ("solver", solver_version()),
            ("scene_name", identity.scene_name.clone()),
            ("scene", identity.scene.clone()),
            ("content_hash", identity.content_hash.clone()),
            ("mesh_hash", hex(&identity.mesh_hash)),
            ("law", identity.law.clone()),
            ("max_force_n", format!("{:?}", identity.max_force_n)),
            ("spacing_m", format!("{:?}", identity.spacing_m)),
            ("radius_m", format!("{:?}", identity.radius_m)),
            ("visual", identity.visual.to_string()),
        ];
        for (key, value) in meta {
            transaction.execute("INSERT INTO meta VALUES (?1, ?2)", params![key, value]).map_err(at)?;
        }
        transaction
            .execute(
                "INSERT INTO mesh VALUES (0, ?1, ?2, ?3)",
                params![
                    mesh.nodes_m.iter().flatten().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>(),
                    mesh.tets.iter().flatten().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>(),
                    fixed.iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>(),
                ],
            )
            .map_err(at)?;
        for (id, (name, node)) in active.iter().enumerate() {
            transaction
                .execute("INSERT INTO active VALUES (?1, ?2, ?3)", params![id as i64, name, node])
                .map_err(at)?;
        }
        transaction.commit().map_err(at)
    }

    /// Takes over what may change between runs because no number depends on it.
    fn refresh(&self, identity: &StoreIdentity) -> Result<(), StoreError> {
        let current = [
            ("scene_name", identity.scene_name.clone()),
            ("scene", identity.scene.clone()),
            ("visual", identity.visual.to_string()),
        ];
        for (key, value) in current {
            let sql = "UPDATE meta SET value = ?2 WHERE key = ?1 AND value <> ?2";
            self.wrap(self.connection.execute(sql, params![key, value]))?;
        }
        Ok(())
    }

    fn check(&self, identity: &StoreIdentity, active: &[(String, u32)]) -> Result<(), StoreError> {
        self.expect_meta("layout", LAYOUT)?;
        self.expect_meta("solver", &solver_version())?;
        self.expect_meta("content_hash", &identity.content_hash)?;
        let stored = self.active()?;
        if stored != active {
            return Err(StoreError::Mismatch {
                path: self.path.clone(),
                what: "set of active nodes",
                stored: format!("{stored:?}"),
                wanted: format!("{active:?}"),
            });
        }
        Ok(())
    }

    fn expect_meta(&self, key: &'static str, wanted: &str) -> Result<(), StoreError> {
        let stored = self.meta(key)?;
        if stored == wanted {
            return Ok(());
        }
        let what = match key {
            "content_hash" => "scene or mesh",
            "layout" => "file layout",
            _ => "version of the solver",
        };
        let short = |s: &str| s.chars().take(40).collect::<String>();
        Err(StoreError::Mismatch {
            path: self.path.clone(),
            what,
            stored: short(&stored),
            wanted: short(wanted),
        })
    }

    /// Value of a `meta` key.
    pub fn meta(&self, key: &str) -> Result<String, StoreError> {
        let found: Option<String> = self.wrap(
            self.connection
                .query_row("SELECT value FROM meta WHERE key = ?1", [key], |row| row.get(0))
                .optional(),
        )?;
        found.ok_or_else(|| self.corrupt(format!("no `{key}` in its meta table")))
    }

    fn parsed<T: std::str::FromStr>(&self, key: &str) -> Result<T, StoreError> {
        let text = self.meta(key)?;
        text.parse().map_err(|_| self.corrupt(format!("its {key} is `{text}`")))
    }

    /// What the store was made of.
    pub fn identity(&self) -> Result<StoreIdentity, StoreError> {
        Ok(StoreIdentity {
            scene_name: self.meta("scene_name")?,
            scene: self.meta("scene")?,
            content_hash: self.meta("content_hash")?,
            mesh_hash: unhex(&self.meta("mesh_hash")?)
                .ok_or_else(|| self.corrupt("mesh_hash is not a hash"))?,
            law: self.meta("law")?,
            max_force_n: self.parsed("max_force_n")?,
            spacing_m: self.parsed("spacing_m")?,
            radius_m: self.parsed("radius_m")?,
            visual: self.parsed("visual")?,
        })
    }

    /// Active nodes (name, mesh node), in the order of their ids.
    pub fn active(&self) -> Result<Vec<(String, u32)>, StoreError> {
        let mut statement =
            self.wrap(self.connection.prepare("SELECT name, node FROM active ORDER BY id"))?;
        let rows = self.wrap(statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?))))?;
        self.wrap(rows.collect())
    }

    /// Mesh (without groups) and fixed nodes of the body.
    pub fn body(&self) -> Result<(TetMesh, Vec<u32>), StoreError> {
        let (nodes, tets, fixed): (Vec<u8>, Vec<u8>, Vec<u8>) =
            self.wrap(self.connection.query_row("SELECT nodes_m, tets, fixed FROM mesh", [], |row| {
                Ok((row.get(0)?, row.get(1)?, row.get(2)?))
            }))?;
        let coordinates: Vec<f64> = nodes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
        let corners: Vec<u32> = tets.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect();
        let fixed: Vec<u32> = fixed.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect();
        let nodes_m = coordinates.as_chunks().0.to_vec();
        let tets = corners.as_chunks().0.to_vec();
        let in_range = |n: &u32| (*n as usize) < nodes_m.len();
        if !tets.iter().flatten().chain(&fixed).all(in_range) {
            return Err(self.corrupt("its mesh names a node that is not there"));
        }
        let mesh = TetMesh::new(nodes_m, tets)
            .map_err(|fault| self.corrupt(format!("its mesh is not a body ({fault:?})")))?;
        Ok((mesh, fixed))
    }

    /// All decided points of one active node, sorted by grid index.
    pub fn records(&self, active: usize) -> Result<Vec<Record>, StoreError> {
        let sql = format!("SELECT {COLUMNS} FROM configuration WHERE active = ?1 ORDER BY i, j, k");
        let mut statement = self.wrap(self.connection.prepare(&sql))?;
        let mut rows = self.wrap(statement.query([active as i64]))?;
        let mut records = Vec::new();
        while let Some(row) = self.wrap(rows.next())? {
            let tag: String = self.wrap(row.get(3))?;
            let tag =
                ConfigTag::from_name(&tag).ok_or_else(|| self.corrupt(format!("unknown tag `{tag}`")))?;
            records.push(self.wrap(read_record(row, tag))?);
        }
        Ok(records)
    }

    /// Commits one decided point; `seed` is what its children will start from.
    pub fn commit(
        &self,
        active: usize,
        record: &Record,
        seed: Option<&StoredSeed>,
    ) -> Result<(), StoreError> {
        let r = record;
        let s = &r.stiffness_n_m;
        let solved = r.tag.is_solved();
        let number = |x: f64| solved.then_some(x);
        let parent = r.parent;
        let sql = format!(
            "INSERT INTO configuration (active, {COLUMNS}, state, sensitivity) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, \
             ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?18, ?19, ?20, ?21, ?22, ?23, ?24, ?25, ?26, ?27, ?28, \
             ?29)"
        );
        let mut statement = self.wrap(self.connection.prepare_cached(&sql))?;
        self.wrap(statement.execute(params![
            active as i64,
            r.index[0],
            r.index[1],
            r.index[2],
            r.tag.name(),
            r.round,
            parent.map(|p| p[0]),
            parent.map(|p| p[1]),
            parent.map(|p| p[2]),
            r.failure,
            number(r.energy_j),
            number(r.force_n[0]),
            number(r.force_n[1]),
            number(r.force_n[2]),
            number(s[(0, 0)]),
            number(s[(1, 1)]),
            number(s[(2, 2)]),
            number(s[(0, 1)]),
            number(s[(0, 2)]),
            number(s[(1, 2)]),
            r.residual_n,
            number(r.min_jacobian),
            solved.then_some(r.inverted),
            number(r.volume_m3),
            r.iterations,
            r.increments,
            r.seconds,
            seed.map(|s| &s.state),
            seed.map(|s| &s.sensitivity),
        ]))?;
        Ok(())
    }

    /// What a child of `index` starts from; the displacement is the grid's.
    pub fn seed(
        &self,
        active: usize,
        index: GridIndex,
        displacement_m: [f64; 3],
    ) -> Result<Seed, StoreError> {
        let stored = self.wrap(
            self.connection
                .prepare_cached(
                    "SELECT state, sensitivity FROM configuration WHERE active = ?1 AND i = ?2 AND j = ?3 AND k = ?4",
                )
                .and_then(|mut statement| {
                    statement
                        .query_row(params![active as i64, index[0], index[1], index[2]], |row| {
                            Ok(StoredSeed { state: row.get(0)?, sensitivity: row.get(1)? })
                        })
                        .optional()
                }),
        )?;
        stored
            .and_then(|stored| stored.unpack(displacement_m))
            .ok_or_else(|| self.corrupt(format!("no usable state at grid point {index:?}")))
    }

    /// Displacement of every node of one configuration, m (f32 as stored).
    pub fn displacements(&self, active: usize, index: GridIndex) -> Result<Vec<[f32; 3]>, StoreError> {
        let nodes = self.wrap(self.connection.query_row(
            "SELECT length(nodes_m) / 24 FROM mesh",
            [],
            |row| row.get::<_, i64>(0),
        ))? as usize;
        let state: Vec<u8> = self.wrap(
            self.connection
                .prepare_cached(
                    "SELECT state FROM configuration WHERE active = ?1 AND i = ?2 AND j = ?3 AND k = ?4",
                )
                .and_then(|mut statement| {
                    statement
                        .query_row(params![active as i64, index[0], index[1], index[2]], |row| row.get(0))
                }),
        )?;
        let values: Vec<f32> = state.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        let displacements = values.as_chunks().0.get(..nodes).map(<[[f32; 3]]>::to_vec);
        displacements.ok_or_else(|| self.corrupt(format!("the state at grid point {index:?} is too short")))
    }
}

/// A seed as the store keeps it: little-endian f32.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredSeed {
    state: Vec<u8>,
    sensitivity: Vec<u8>,
}

impl StoredSeed {
    /// Rounds `seed` to what is stored.
    pub fn pack(seed: &Seed) -> Self {
        let bytes =
            |values: &[f64]| values.iter().flat_map(|&x| (x as f32).to_le_bytes()).collect::<Vec<u8>>();
        Self {
            state: bytes(&seed.state),
            sensitivity: seed.sensitivity.iter().flat_map(|c| bytes(c)).collect(),
        }
    }

    fn unpack(&self, displacement_m: [f64; 3]) -> Option<Seed> {
        let numbers = |bytes: &[u8]| -> Vec<f64> {
            bytes.as_chunks().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect()
        };
        if self.state.is_empty() || self.sensitivity.len() != 3 * self.state.len() {
            return None;
        }
        let mut columns = self.sensitivity.chunks_exact(self.state.len()).map(numbers);
        let sensitivity = [columns.next()?, columns.next()?, columns.next()?];
        Some(Seed { pose: Pose::translation(displacement_m), state: numbers(&self.state), sensitivity })
    }
}

fn configure(connection: &Connection) -> rusqlite::Result<()> {
    // WAL: readers on other threads while one writes. NORMAL: a power cut may lose the last commits, a kill none.
    connection.pragma_update(None, "journal_mode", "WAL")?;
    connection.pragma_update(None, "synchronous", "NORMAL")?;
    connection.busy_timeout(std::time::Duration::from_secs(5))
}

fn read_record(row: &rusqlite::Row<'_>, tag: ConfigTag) -> rusqlite::Result<Record> {
    let parent: [Option<i32>; 3] = [row.get(5)?, row.get(6)?, row.get(7)?];
    let number = |column: usize| row.get::<_, Option<f64>>(column).map(|x| x.unwrap_or(f64::NAN));
    let (xx, yy, zz) = (number(13)?, number(14)?, number(15)?);
    let (xy, xz, yz) = (number(16)?, number(17)?, number(18)?);
    Ok(Record {
        index: [row.get(0)?, row.get(1)?, row.get(2)?],
        tag,
        round: row.get(4)?,
        parent: match parent {
            [Some(i), Some(j), Some(k)] => Some([i, j, k]),
            _ => None,
        },
        failure: row.get(8)?,
        energy_j: number(9)?,
        force_n: [number(10)?, number(11)?, number(12)?],
        stiffness_n_m: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
        residual_n: number(19)?,
        min_jacobian: number(20)?,
        inverted: row.get::<_, Option<u32>>(21)?.unwrap_or(0),
        volume_m3: number(22)?,
        iterations: row.get(23)?,
        increments: row.get::<_, Option<u32>>(24)?.unwrap_or(0),
        seconds: row.get(25)?,
    })
}

/// Version of the numbers: crate version and instruction set (other instructions round differently).
fn solver_version() -> String {
    format!("{} {}", env!("CARGO_PKG_VERSION"), instruction_set())
}

/// faer picks its kernels at run time by these features.
fn instruction_set() -> String {
    #[cfg(target_arch = "x86_64")]
    {
        if std::is_x86_feature_detected!("avx512f") {
            return "x86_64+avx512f".into();
        }
        if std::is_x86_feature_detected!("avx2") && std::is_x86_feature_detected!("fma") {
            return "x86_64+avx2+fma".into();
        }
    }
    std::env::consts::ARCH.into()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

fn unhex(text: &str) -> Option<[u8; 32]> {
    let mut bytes = [0; 32];
    for (byte, pair) in bytes.iter_mut().zip(text.as_bytes().as_chunks::<2>().0) {
        *byte = u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok()?;
    }
    (text.len() == 64).then_some(bytes)
}
