//! The cases of the report: bodies with a law, each on several grids.

use std::path::Path;
use std::sync::Arc;

use palpate_core::Method;
use palpate_precompute::held_out::Draw;
use palpate_precompute::pipeline::Analysis;
use palpate_precompute::scene::Scene;
use toml::{Table, Value};

use super::args::Args;
use super::outputs;
use crate::analysis;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Folder};

/// One body with its law, fixed set and active node.
#[derive(Debug)]
pub(super) struct Family {
    /// Name of the scene.
    pub name: String,
    /// The scene with the one active node.
    pub bench: Arc<Analysis>,
    /// Its TOML table, from which other scenes are made.
    table: Table,
    /// All active nodes of the scene.
    all_active: Value,
}

/// A family on one grid.
#[derive(Debug)]
pub(super) struct Case {
    /// Base name of its files.
    pub name: String,
    /// Number of grid points within the ball, without rest.
    pub points: u32,
    /// Its scene.
    pub bench: Arc<Analysis>,
}

/// All cases of the report.
#[derive(Debug)]
pub(super) struct Plan {
    /// The bodies.
    pub families: Vec<Family>,
    /// Number of grid points and of cells along the radius.
    pub grids: Vec<(u32, u32)>,
    /// Methods.
    pub methods: Vec<Method>,
    /// Folder for the page and its tables.
    pub out: Folder,
    /// Folder of the solutions.
    pub work: Folder,
    /// Worker threads.
    pub threads: usize,
    /// Whether this is a quick run.
    pub small: bool,
}

/// Scene and mesh of the bundled organ.
const ORGAN: &str = "liver-small";
const ORGAN_FILES: [(&str, &str); 2] = [
    ("toml", include_str!("../../../../assets/liver-small.toml")),
    ("msh", include_str!("../../../../assets/liver-small.msh")),
];

/// Changes of every scene.
struct Wish<'a> {
    /// The active node; the first if `None`.
    active: Option<&'a str>,
    /// r_G; the scene's if `None`.
    radius_m: Option<f64>,
}

/// r_G of the bundled organ for a quick run, m.
const SMALL_RADIUS_M: f64 = 0.02;

/// Maximum number of cells along the radius.
const MAX_CELLS: u32 = 20;

/// Number of grid points of a ball with this number of cells along its radius, without rest: 514 for 5,
/// 14,146 for 15.
fn points_of(cells: u32) -> u32 {
    let n = cells as i32;
    let mut points = 0;
    for i in -n..=n {
        for j in -n..=n {
            points += (-n..=n).filter(|k| i * i + j * j + k * k <= n * n).count() as u32;
        }
    }
    points - 1
}

fn grids(asked: &[u32]) -> Result<Vec<(u32, u32)>, Failure> {
    let known: Vec<(u32, u32)> = (1..=MAX_CELLS).map(|cells| (points_of(cells), cells)).collect();
    let mut grids = Vec::new();
    for &points in asked {
        let Some(&grid) = known.iter().find(|(n, _)| *n == points) else {
            let names: Vec<String> = known.iter().map(|(n, _)| n.to_string()).collect();
            return Err(Failure::input(format!(
                "--grids {points}: no ball of grid points has so many; choose from {}",
                names.join(", ")
            )));
        };
        grids.push(grid);
    }
    grids.sort_unstable();
    grids.dedup();
    Ok(grids)
}

impl Plan {
    /// The plan of the arguments. Reads scenes and builds their bodies, but solves nothing.
    pub(super) fn new(args: &Args, threads: usize) -> Result<Self, Failure> {
        let asked: &[u32] = match (&args.grids[..], args.small) {
            ([], true) => &[32, 122],
            ([], false) => &[514, 1418, 4168, 14146],
            (given, _) => given,
        };
        let grids = grids(asked)?;
        let mut methods = args.methods.clone();
        methods.sort_by_key(|method| Method::ALL.iter().position(|m| m == method));
        methods.dedup();
        // Checked before a folder is created.
        let radius_m = match args.radius_mm {
            Some(mm) if !(mm > 0.0 && mm.is_finite()) => {
                return Err(Failure::input(format!(
                    "--radius-mm {mm}: give a positive number of millimetres"
                )));
            }
            Some(mm) => Some(1e-3 * mm),
            // With a coarse grid over all of its 50 mm, the bundled organ has a branch jump within a cell.
            None => (args.small && args.scenes.is_empty()).then_some(SMALL_RADIUS_M),
        };
        let wish = Wish { active: args.active.as_deref(), radius_m };
        let given = args.scenes.iter().map(|path| Family::load(path, &wish));
        let mut families = given.collect::<Result<Vec<_>, _>>()?;
        for (n, family) in families.iter().enumerate() {
            if families[..n].iter().any(|other| other.name == family.name) {
                return Err(Failure::input(format!(
                    "{}: a second scene with the name `{}`; give each a `name` of its own",
                    family.bench.path.display(),
                    family.name
                )));
            }
        }
        let (out, work) = folders(args)?;
        if families.is_empty() {
            families = bundled(&work, &wish)?;
        }
        Ok(Self { families, grids, methods, out, work, threads, small: args.small })
    }

    /// Number of held-out solutions for each space of a ball of this radius.
    pub(super) fn draw(&self, radius_m: f64) -> Draw {
        let full = Draw { step_m: radius_m / 50.0, regular_m: Some(radius_m), uniform: 600, ..Draw::PAPER };
        if self.small {
            return Draw { step_m: radius_m / 10.0, random: 4, random_steps: 20, uniform: 60, ..full };
        }
        full
    }
}

/// The folders of the report. Bundled scenes are written into the second one; given scenes are only read.
fn folders(args: &Args) -> Result<(Folder, Folder), Failure> {
    let mut files = Files::new(args.replace);
    args.scenes.iter().try_for_each(|scene| files.read_scene(scene))?;
    let out = files.folder("--out", &args.out, outputs::kind_of)?;
    let work = files.folder("--out", &args.out.join("work"), |name| match name.rsplit_once('.')?.1 {
        "space" => Some(FileKind::Space),
        "blob" => Some(FileKind::Blob),
        "json" => Some(FileKind::Json),
        "toml" if args.scenes.is_empty() => Some(FileKind::Toml),
        "msh" if args.scenes.is_empty() => Some(FileKind::Mesh),
        _ => None,
    })?;
    Ok((out, work))
}

/// The bundled organ with the paper's two laws.
fn bundled(work: &Folder, wish: &Wish<'_>) -> Result<Vec<Family>, Failure> {
    for (extension, text) in ORGAN_FILES {
        work.file(&format!("{ORGAN}.{extension}")).put(text.as_bytes())?;
    }
    let incompressible = Family::load(&work.path().join(format!("{ORGAN}.toml")), wish)?;
    // The same modulus at small strain: E = 6 (C10 + C01).
    let law = [("law", "st-venant-kirchhoff".into()), ("young_pa", 15480.0.into()), ("poisson", 0.49.into())];
    let compressible = incompressible.with_law(&format!("{ORGAN}-stvk"), &law)?;
    Ok(vec![incompressible, compressible])
}

impl Family {
    /// The scene at `path` with the named active node, or the first if none is named.
    fn load(path: &Path, wish: &Wish<'_>) -> Result<Self, Failure> {
        let whole = analysis::load(path)?;
        let own_m = whole.sampling()?.radius_m();
        let chosen = whole.active(wish.active)?.1.clone();
        let mut table: Table = toml::from_str(&whole.scene.text).map_err(Failure::input)?;
        // An arbitrary number of cells, replaced when a grid is chosen.
        grid_of(&mut table, wish.radius_m.unwrap_or(own_m), 1);
        let mut node = Table::from_iter([
            ("name".to_string(), Value::from(chosen.name.as_str())),
            ("node".to_string(), Value::from(i64::from(chosen.node))),
        ]);
        if !chosen.patch.is_empty() {
            let patch = chosen.patch.iter().map(|&n| Value::from(i64::from(n))).collect();
            node.insert("patch".into(), Value::Array(patch));
        }
        let all_active = table.insert("active".into(), Value::Array(vec![node.into()]));
        let all_active = all_active.unwrap_or_else(|| Value::Array(Vec::new()));
        // Only forces are compared. Displacements for display would dominate the size of their tables.
        table.insert("needs".into(), Table::from_iter([("visual".to_string(), Value::from(false))]).into());
        Self::of(&whole, table, all_active)
    }

    fn of(whole: &Analysis, table: Table, all_active: Value) -> Result<Self, Failure> {
        let bench = Arc::new(variant(whole, &table)?);
        Ok(Self { name: bench.scene.name.clone(), bench, table, all_active })
    }

    /// The same body with another law, as a separate scene.
    fn with_law(&self, name: &str, law: &[(&str, Value)]) -> Result<Self, Failure> {
        let mut table = self.table.clone();
        let law = law.iter().map(|(key, value)| (key.to_string(), value.clone()));
        table.insert("name".into(), name.into());
        table.insert("material".into(), Table::from_iter(law).into());
        Self::of(&self.bench, table, self.all_active.clone())
    }

    /// Name of the one active node.
    pub(super) fn active(&self) -> &str {
        &self.bench.scene.active[0].name
    }

    /// r_G of the scene, m.
    pub(super) fn radius_m(&self) -> f64 {
        self.bench.scene.grid.map_or(0.0, |grid| grid.radius_m())
    }

    /// The family on a grid of `cells` along its radius.
    pub(super) fn on_grid(&self, (points, cells): (u32, u32)) -> Result<Case, Failure> {
        let mut table = self.table.clone();
        grid_of(&mut table, self.radius_m(), cells);
        let name = file_name(&format!("{}-{points}", self.name));
        Ok(Case { name, points, bench: Arc::new(variant(&self.bench, &table)?) })
    }

    /// The body with all its active nodes, fixed at a group of its mesh, if the mesh has it, or as in the
    /// scene.
    pub(super) fn held_by(&self, group: Option<&str>) -> Result<Option<Analysis>, Failure> {
        let scene = &self.bench.scene;
        let fixed = match group {
            Some(group) => scene.mesh.node_groups.get(group),
            None => Some(&scene.fixed),
        };
        let Some(fixed) = fixed else { return Ok(None) };
        let mut table = self.table.clone();
        table.remove("device");
        table.insert("active".into(), self.all_active.clone());
        resolved(&self.bench, &table, fixed.clone()).map(Some)
    }
}

/// Replaces the characters of a scene's name that a file name must not contain.
fn file_name(name: &str) -> String {
    let plain = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    name.chars().map(plain).collect()
}

fn grid_of(table: &mut Table, radius_m: f64, cells: u32) {
    let grid = table.entry("grid").or_insert_with(|| Table::new().into());
    if let Value::Table(grid) = grid {
        for other in [
            "points",
            "cannot_be_felt",
            "tolerance_n",
            "tolerance_relative",
            "workspace_min_m",
            "workspace_max_m",
        ] {
            grid.remove(other);
        }
        grid.insert("radius_m".into(), radius_m.into());
        grid.insert("spacing_m".into(), (radius_m / f64::from(cells)).into());
    }
}

/// The scene of this table with the mesh and fixed nodes of `whole`.
fn variant(whole: &Analysis, table: &Table) -> Result<Analysis, Failure> {
    resolved(whole, table, whole.scene.fixed.clone())
}

fn resolved(whole: &Analysis, table: &Table, fixed: Vec<u32>) -> Result<Analysis, Failure> {
    let text = toml::to_string(table).map_err(Failure::work)?;
    let scene = Scene::parse(&whole.path, text)?.resolve_in(whole.scene.mesh.clone(), fixed)?;
    Ok(Analysis::of_scene(&whole.path, scene)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_driven_by_its_tolerance_gets_a_grid_too() {
        for own in ["cannot_be_felt = true", "tolerance_n = 0.01\ntolerance_relative = 0.1", "points = 514"] {
            let mut table: Table =
                toml::from_str(&format!("[grid]\nradius_m = 0.05\n{own}")).expect("a table");
            grid_of(&mut table, 0.02, 4);
            let text = toml::to_string(&table).expect("text");
            assert_eq!(text, "[grid]\nradius_m = 0.02\nspacing_m = 0.005\n");
        }
    }

    #[test]
    fn balls_have_the_papers_numbers_of_points() {
        assert_eq!([1, 2, 3, 5, 7, 10, 15].map(points_of), [6, 32, 122, 514, 1418, 4168, 14146]);
        assert_eq!(grids(&[1418, 514, 514]).expect("both are balls"), [(514, 5), (1418, 7)]);
        assert!(grids(&[500]).expect_err("no ball").line().contains("514"));
    }
}
