//! The inputs of a store in its table `meta`, and their comparison with those of a run.

use rusqlite::{OptionalExtension, params};
use serde::de::DeserializeOwned;

use super::error::StoreFault;
use super::{Store, StoreError};
use crate::spec::{Charts, ContactSurface, DisplacementBound, Lattice, Sampling, SpaceGrid, Tool};

/// Layout of the file. A store of another layout is refused.
const LAYOUT: &str = "5";

/// Increased whenever the bits of the solver or the course of a search change.
const SOLVER_REVISION: u32 = 12;

/// Inputs of a store. A resumed run must have the same.
#[derive(Debug, Clone, PartialEq)]
pub struct StoreIdentity {
    /// Name of the scene.
    pub scene_name: String,
    /// Canonical text of the scene.
    pub scene: String,
    /// Hash of all content of scene and mesh that changes numbers.
    pub content_hash: String,
    /// Hash of the mesh alone.
    pub mesh_hash: [u8; 32],
    /// Name of the constitutive law.
    pub law: String,
    /// f_max of the scene, N.
    pub max_force_n: f64,
    /// Definition of the positions.
    pub sampling: Sampling,
    /// Unit outward normal of each active node at rest.
    pub normals: Vec<[f64; 3]>,
    /// Displacements of each active node that adaptive sampling solves first, m.
    pub visited_m: Vec<Vec<[f64; 3]>>,
    /// Contact points of a tool with a size; `None` for a point tool.
    pub contacts: Option<ContactSurface>,
    /// The charts of a sphere's field; `None` for another tool.
    pub charts: Option<Charts>,
    /// Whether the scene requests displacements for rendering.
    pub visual: bool,
    /// Error bound of these displacements.
    pub displacement_bound: DisplacementBound,
}

/// Keys of the table `meta` that may change between runs because no number depends on them.
const REFRESHED: [&str; 5] = ["scene_name", "scene", "visual", "displacement_rms_m", "displacement_max_m"];

impl StoreIdentity {
    /// The rows of the table `meta`.
    pub(super) fn meta(&self) -> Vec<(&'static str, String)> {
        let sampling = &self.sampling;
        let scattered = sampling.scattered().map(|scattered| serde_json::json!(scattered).to_string());
        let contacts = self.contacts.as_ref().map(|contacts| serde_json::json!(contacts).to_string());
        let charts = self.charts.as_ref().map(|charts| serde_json::json!(charts).to_string());
        let is_visited = self.visited_m.iter().any(|visited| !visited.is_empty());
        let visited = is_visited.then(|| serde_json::json!(self.visited_m).to_string());
        let normals: Vec<String> = self.normals.as_flattened().iter().map(|x| format!("{x:?}")).collect();
        vec![
            ("layout", LAYOUT.to_string()),
            ("solver", solver_version()),
            ("scene_name", self.scene_name.clone()),
            ("scene", self.scene.clone()),
            ("content_hash", self.content_hash.clone()),
            ("mesh_hash", blake3::Hash::from_bytes(self.mesh_hash).to_string()),
            ("law", self.law.clone()),
            ("max_force_n", format!("{:?}", self.max_force_n)),
            ("spacing_m", format!("{:?}", sampling.unit_m())),
            ("radius_m", format!("{:?}", sampling.radius_m())),
            ("visual", self.visual.to_string()),
            ("displacement_rms_m", format!("{:?}", self.displacement_bound.rms_m)),
            ("displacement_max_m", format!("{:?}", self.displacement_bound.max_m)),
            ("complete_cells", sampling.lattice().is_some_and(|l| l.complete_cells).to_string()),
            ("increments", sampling.increments().map_or(String::new(), |n| n.to_string())),
            ("scattered", scattered.unwrap_or_default()),
            ("normals", normals.join(" ")),
            ("contacts", contacts.unwrap_or_default()),
            ("charts", charts.unwrap_or_default()),
            ("visited", visited.unwrap_or_default()),
        ]
    }

    /// The tool.
    pub fn tool(&self) -> Tool {
        match (&self.contacts, &self.charts) {
            (Some(contacts), _) => Tool::Fingertip(contacts.fingertip),
            (None, Some(charts)) => Tool::Sphere(charts.sphere),
            (None, None) => Tool::Point,
        }
    }

    /// The value at an active node of a field given at the mesh nodes; `node` is its node.
    pub fn at_active(&self, active: usize, node: u32, field: impl Fn(u32) -> [f64; 3]) -> [f64; 3] {
        let contact = self.contacts.as_ref().and_then(|contacts| contacts.points.get(active));
        contact.map_or_else(|| field(node), |point| point.interpolate(&field))
    }
}

impl Store {
    /// Updates the properties that may change between runs.
    pub(super) fn refresh(&self, identity: &StoreIdentity) -> Result<(), StoreError> {
        for (key, value) in identity.meta().into_iter().filter(|(key, _)| REFRESHED.contains(key)) {
            let sql = "INSERT INTO meta VALUES (?1, ?2) ON CONFLICT (key) DO UPDATE SET value = ?2 WHERE value <> ?2";
            self.wrap(self.connection.execute(sql, params![key, value]))?;
        }
        Ok(())
    }

    pub(super) fn check(&self, identity: &StoreIdentity, active: &[(String, u32)]) -> Result<(), StoreError> {
        self.expect_inputs(identity)?;
        let stored = self.active()?;
        if stored == active {
            return Ok(());
        }
        let what = "set of active nodes";
        Err(StoreFault::Mismatch { what, stored: format!("{stored:?}"), wanted: format!("{active:?}") }
            .at(&self.path))
    }

    /// Refuses a store of another layout, solver, scene or mesh.
    pub(in crate::space) fn expect_inputs(&self, identity: &StoreIdentity) -> Result<(), StoreError> {
        self.expect_layout()?;
        let (stored, wanted) = (self.meta("solver")?, solver_version());
        if stored != wanted {
            return Err(self.mismatch("version of the solver", &stored, &wanted));
        }
        self.expect_content(identity)
    }

    pub(super) fn expect_layout(&self) -> Result<(), StoreError> {
        let stored = self.meta("layout")?;
        if stored == LAYOUT { Ok(()) } else { Err(self.mismatch("file layout", &stored, LAYOUT)) }
    }

    /// A difference between the file and this run, each side at most 40 characters long.
    pub(super) fn mismatch(&self, what: &'static str, stored: &str, wanted: &str) -> StoreError {
        let short = |s: &str| s.chars().take(40).collect::<String>();
        StoreFault::Mismatch { what, stored: short(stored), wanted: short(wanted) }.at(&self.path)
    }

    /// Value of a `meta` key.
    pub fn meta(&self, key: &str) -> Result<String, StoreError> {
        self.optional(key)?.ok_or_else(|| self.corrupt(format!("no `{key}` in its meta table")))
    }

    pub(super) fn optional(&self, key: &str) -> Result<Option<String>, StoreError> {
        let sql = "SELECT value FROM meta WHERE key = ?1";
        self.wrap(self.connection.query_row(sql, [key], |row| row.get(0)).optional())
    }

    pub(super) fn parsed<T: std::str::FromStr>(&self, key: &str) -> Result<T, StoreError> {
        self.parse(key, &self.meta(key)?)
    }

    fn parse<T: std::str::FromStr>(&self, key: &str, text: &str) -> Result<T, StoreError> {
        text.parse().map_err(|_| self.corrupt(format!("its {key} is `{text}`")))
    }

    /// Records the peak memory of a run that solved something, bytes. The largest value of all runs is kept.
    pub fn note_peak(&self, bytes: u64) -> Result<(), StoreError> {
        let bytes = bytes.max(self.peak()?.unwrap_or(0)).to_string();
        let sql = "INSERT INTO meta VALUES ('peak_bytes', ?1) ON CONFLICT (key) DO UPDATE SET value = ?1";
        self.wrap(self.connection.execute(sql, params![bytes])).map(|_| ())
    }

    /// Largest peak memory of all runs, bytes, if recorded.
    pub fn peak(&self) -> Result<Option<u64>, StoreError> {
        self.optional("peak_bytes")?.map(|text| self.parse("peak_bytes", &text)).transpose()
    }

    /// The inputs of the store.
    pub fn identity(&self) -> Result<StoreIdentity, StoreError> {
        Ok(StoreIdentity {
            scene_name: self.meta("scene_name")?,
            scene: self.meta("scene")?,
            content_hash: self.meta("content_hash")?,
            mesh_hash: *blake3::Hash::from_hex(self.meta("mesh_hash")?)
                .map_err(|_| self.corrupt("mesh_hash is not a hash"))?
                .as_bytes(),
            law: self.meta("law")?,
            max_force_n: self.parsed("max_force_n")?,
            sampling: self.sampling()?,
            normals: self.normals()?,
            visited_m: self.json("visited")?.unwrap_or_default(),
            contacts: self.json("contacts")?,
            charts: self.json("charts")?,
            visual: self.parsed("visual")?,
            displacement_bound: DisplacementBound {
                rms_m: self.parsed("displacement_rms_m")?,
                max_m: self.parsed("displacement_max_m")?,
            },
        })
    }

    /// Unit outward normal of each active node at rest.
    fn normals(&self) -> Result<Vec<[f64; 3]>, StoreError> {
        let text = self.meta("normals")?;
        let numbers: Result<Vec<f64>, _> = text.split_whitespace().map(str::parse).collect();
        let numbers = numbers.map_err(|_| self.corrupt(format!("its normals are `{text}`")))?;
        Ok(numbers.as_chunks().0.to_vec())
    }

    /// A value that is kept as JSON; `None` if it is empty. Spaces of earlier versions lack some of them.
    fn json<T: DeserializeOwned>(&self, key: &'static str) -> Result<Option<T>, StoreError> {
        let text = self.optional(key)?.filter(|text| !text.is_empty());
        let read = |text: String| serde_json::from_str(&text);
        text.map(read).transpose().map_err(|_| self.corrupt(format!("its {key} cannot be read")))
    }

    /// Definition of the positions.
    fn sampling(&self) -> Result<Sampling, StoreError> {
        let scattered = self.meta("scattered")?;
        if !scattered.is_empty() {
            let read = serde_json::from_str(&scattered).map(Sampling::Scattered);
            return read.map_err(|_| self.corrupt(format!("its scattered positions are `{scattered}`")));
        }
        let grid = SpaceGrid::new(self.parsed("spacing_m")?, self.parsed("radius_m")?);
        Ok(Sampling::Lattice(Lattice {
            grid: grid.map_err(|error| self.corrupt(format!("its grid is refused: {error}")))?,
            complete_cells: self.parsed("complete_cells")?,
            increments: match self.meta("increments")?.as_str() {
                "" => None,
                _ => Some(self.parsed("increments")?),
            },
        }))
    }
}

/// Version of the numbers: crate version, solver revision and instruction set. Other instructions round
/// differently.
pub fn solver_version() -> String {
    format!("{}.{SOLVER_REVISION} {}", env!("CARGO_PKG_VERSION"), instruction_set())
}

/// faer selects its kernels at run time by these features.
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
