//! The scenes of the questions, made from the bundled ones, and their description for other programs.

use std::path::Path;

use palpate_core::Method;
use palpate_precompute::fem::{Fingertip, PadProfile};
use palpate_precompute::scene::ResolvedScene;

use super::questions::VERSION;
use crate::failure::Failure;
use crate::files::Folder;
use crate::output;

/// Name of the scene file in the folder of an organ.
pub(super) const SCENE: &str = "scene.toml";
/// Name of its mesh.
const MESH: &str = "mesh.msh";

/// A scene of the questions.
#[derive(Debug)]
pub(super) struct OrganScene {
    /// Name of its folder.
    pub(super) name: &'static str,
    /// The bundled scene that it is made from, in the folder of the assets.
    pub(super) from: &'static str,
    /// Its `[grid]`; that of the bundled scene if empty.
    grid: &'static str,
    /// The same of a quick run.
    quick_grid: &'static str,
    /// Methods of its blob.
    pub(super) methods: &'static [Method],
    /// What it is, for the page.
    pub(super) about: &'static str,
    /// What its reference forces are those of.
    pub(super) reference: &'static str,
}

/// The two organs: the paper's kind of tool and table, and a tool with a size on quadratic elements.
pub(super) const ORGANS: [OrganScene; 2] = [
    OrganScene {
        name: "point",
        from: "liver-small.toml",
        grid: "radius_m = 0.025\nspacing_m = 0.005\n",
        quick_grid: "radius_m = 0.025\nspacing_m = 0.0125\n",
        methods: &Method::OF_LATTICE,
        about: "a node of the liver phantom (498 nodes, 1,795 linear tetrahedra, incompressible Mooney-Rivlin) is moved \
                by up to 25 mm; the tables come from a lattice of five cells along the radius, the paper's coarsest (quick: two)",
        reference: "The reference is the force of this mesh: that of a held node depends on the mesh and has no limit under refinement.",
    },
    OrganScene {
        name: "fingertip",
        from: "scenes/palpation.toml",
        grid: "",
        quick_grid: "",
        methods: &Method::ALL,
        about: "a fingertip of 15 mm presses the same phantom (quadratic elements) by up to 10 mm; the tables come from \
                adaptive sampling",
        reference: "The reference is the force of this mesh; a finer one gives another force.",
    },
];

impl OrganScene {
    /// Writes scene, mesh and the description for other programs into its folder.
    pub(super) fn write(&self, assets: &Path, folder: &Folder, quick: bool) -> Result<(), Failure> {
        write_scene(&assets.join(self.from), self.about, folder, |scene| {
            scene.insert("name".into(), self.name.into());
            if let Some(active) = scene.get_mut("active").and_then(toml::Value::as_array_mut) {
                active.truncate(1);
            }
            if let Some(needs) = scene.get_mut("needs").and_then(toml::Value::as_table_mut) {
                needs.remove("visual");
            }
            let grid = if quick { self.quick_grid } else { self.grid };
            if !grid.is_empty() {
                let grid: toml::Table = toml::from_str(grid).map_err(Failure::work)?;
                scene.insert("grid".into(), grid.into());
            }
            Ok(())
        })
    }
}

/// Writes a changed copy of a bundled scene with its mesh into a folder.
pub(super) fn write_scene(
    from: &Path,
    about: &str,
    folder: &Folder,
    change: impl FnOnce(&mut toml::Table) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let read = |path: &Path| std::fs::read(path).map_err(|error| Failure::file(path, &error));
    let text = String::from_utf8(read(from)?).map_err(Failure::work)?;
    let bundled = |error: &dyn std::fmt::Display| {
        Failure::input(format!("{}: {error}; give the bundled assets with --assets", from.display()))
    };
    let mut scene: toml::Table = toml::from_str(&text).map_err(|error| bundled(&error.message()))?;
    let mesh = scene.get_mut("mesh").and_then(toml::Value::as_table_mut);
    let mesh = mesh.ok_or_else(|| bundled(&"has no [mesh]"))?;
    let file = mesh.insert("file".into(), MESH.into());
    let file = file.as_ref().and_then(toml::Value::as_str).ok_or_else(|| bundled(&"has no mesh file"))?;
    let beside = from.parent().unwrap_or(Path::new(""));
    folder.file(MESH).put(&read(&beside.join(file))?)?;
    change(&mut scene)?;
    let name = from.file_name().unwrap_or_default().to_string_lossy();
    let head = format!(
        "# A scene of the public benchmark, questions version {VERSION}: {about}.\n# Units: m, N, Pa. Made from {name}.\n\n"
    );
    let text = head + &toml::to_string(&scene).map_err(Failure::work)?;
    folder.file(SCENE).put(text.as_bytes())
}

/// Writes the body as tables: nodes, tetrahedra, fixed nodes, and the touched place.
pub(super) fn write_body(scene: &ResolvedScene, folder: &Folder) -> Result<(), Failure> {
    let mut nodes = output::Csv::new(["node", "x_m", "y_m", "z_m", "fixed"])?;
    for (node, [x, y, z]) in scene.mesh.nodes_m.iter().enumerate() {
        let fixed = u8::from(scene.fixed.binary_search(&(node as u32)).is_ok());
        nodes.row((node, x, y, z, fixed))?;
    }
    folder.file("nodes.csv").put(&nodes.finish()?)?;
    let mut tets = output::Csv::new(["tet", "a", "b", "c", "d"])?;
    for (tet, [a, b, c, d]) in scene.mesh.tets.iter().enumerate() {
        tets.row((tet, a, b, c, d))?;
    }
    folder.file("tets.csv").put(&tets.finish()?)?;
    let mut place = output::Csv::new(["node", "x_m", "y_m", "z_m", "nx", "ny", "nz"])?;
    let skin = palpate_precompute::mesh::Surface::of(&scene.mesh);
    for active in &scene.active {
        let ([x, y, z], [nx, ny, nz]) =
            (active.place_m(&scene.mesh), active.normal(&skin).unwrap_or([f64::NAN; 3]));
        place.row((active.node, x, y, z, nx, ny, nz))?;
    }
    folder.file("place.csv").put(&place.finish()?)
}

/// The description of the folder of questions. The fingertip is that of its organ.
pub(super) fn readme(tip: Fingertip) -> String {
    let organs: String = ORGANS.iter().map(|organ| format!("{}/: {}.\n", organ.name, organ.about)).collect();
    let Fingertip { radius_m, stiffness_pa_m, profile } = tip;
    let profile = match profile {
        PadProfile::Quartic => "(1 - r^2/a^2)^2",
        PadProfile::Hertz => "sqrt(1 - r^2/a^2)",
    };
    format!(
        "Questions of `palpate bench public`, version {VERSION}. All numbers are in m, N, Pa and s.\n\n{organs}\n\
         Each of these folders has\n\
         scene.toml, mesh.msh   law, constants, fixed nodes and tool, as Palpate reads them\n\
         nodes.csv, tets.csv    the body; fixed nodes do not move; corners of a tetrahedron are nodes from 0\n\
         place.csv              the touched place and its outward normal\n\
         positions.csv          displacements d of the place; h is the force of the tool on the body by finite elements\n\
         loops.csv, hands.csv   displacements once in a millisecond, in their order; `counted` 0 is the way to a loop\n\n\
         The reference h solves this discrete problem:\n\
         body       at rest without load, no inertia, no body force. With F = I + grad u, the integral of\n\
         \x20          C10 (I1 - 3) + C01 (I2 - 3) + (2 C10 + 4 C01 + q)(1 - J) is stationary in u and q.\n\
         point      Tetrahedra of 4 nodes, one integration point; q is continuous and linear (P1/P1), without stabilisation.\n\
         \x20          The three components of the node of place.csv are prescribed as d; h is their reaction.\n\
         fingertip  Straight-sided tetrahedra of 10 nodes, 14 integration points (degree 5); q is continuous and linear\n\
         \x20          (P2/P1, Taylor-Hood). A mid-edge node is fixed if both ends of its edge are.\n\
         \x20          A rigid finger, displaced by d, holds the skin by springs of stiffness k w(r) per undeformed area:\n\
         \x20          k = {stiffness_pa_m:e} Pa/m, w = {profile} for r < a, else 0; a = {radius_m} m; r is the distance from place.csv.\n\
         \x20          h is the integral of k w (d - u) over the boundary triangles within a that are connected to the place and\n\
         \x20          have a free corner, each cut into four, with Dunavant's six points of degree 4 in each.\n\n\
         Z-width: the largest stiffness K at which a held device comes to rest after a knock, over the rates 500 Hz to 4 kHz.\n\
         device     the bundled profile: effective mass, damping and friction, encoder step, delays, largest force\n\
         hand       a mass of 0.05 kg on a spring of 150 N/m with a damping ratio of 0.2; no tremor, no reaction\n\
         hold       from 3 mm above the surface pressed with 1 N, 0.4 s to approach, 0.4 s at rest, then a knock of\n\
         \x20          0.5 N for 5 ms, and 3 s of observation; hand and mechanism are integrated with steps of 50 us\n\
         organ      that of point/, stiffer by a factor g: forces, limits and margins are multiplied by g; K = g k, with\n\
         \x20          the felt stiffness k at rest along the normal of place.csv\n\
         still      the peak-to-peak motion in the last 0.25 s of the first or third second is at most the larger of 3\n\
         \x20          encoder steps and 20 um, or in the third below 80 % of that in the second; and the device\n\
         \x20          gives the hand at most 5 mJ in the first second\n\
         K is found by a scan upwards and bisection.\n\n\
         Nodules: nodules/scene.toml and mesh.msh; nodules-without/ has the constants of the tissue in their place. At each\n\
         place the tool presses along the normal until the force with the nodule is 1 N; Palpate's methods are asked at the\n\
         depth where it is 1 N by finite elements. Detectability is the difference of both forces over the larger of 0.02 N\n\
         and 7 % of the force without, the just noticeable difference.\n\n\
         Cost, first touch and ticks: a force query alone; the seconds from the start of the program to the first force;\n\
         wall times of ticks of a loop of 1 kHz without the device, along a hand that palpates at random.\n\n\
         The references h in positions.csv are given so that a system can check itself. Do not use them for the answers.\n\n\
         A system answers in a folder of its own, with the same folders: positions.csv with\n\
         position,fx_n,fy_n,fz_n, and loops.csv and hands.csv with way,tick,fx_n,fy_n,fz_n: its force on the body.\n\
         system.toml has `about`, and figures that it states, under the names of figures.csv:\n\n\
         about = \"program, version, machine\"\n\
         [figures.\"cost.point\"]\n\
         query_ns = 250\n\
         [figures.\"nodule.nodules\"]\n\
         \"shallow.detectability\" = 3\n\n\
         Then `palpate bench public --answers NAME=FOLDER` fills its column. What is missing stays empty.\n"
    )
}
