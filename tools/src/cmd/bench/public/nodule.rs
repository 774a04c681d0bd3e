//! Detectability of nodules under the skin: by finite elements, by every method, and live.

use std::path::Path;
use std::sync::Mutex;
use std::time::Instant;

use nalgebra::Vector3;
use palpate_core::{Method, NodeWeight, Touch};
use palpate_precompute::live::LiveSolver;
use palpate_precompute::map::{Compared, Goal, JND, MapError, Mapped, Place, Work};
use palpate_precompute::pack::{PackOptions, pack};
use palpate_precompute::pipeline::{Analysis, Run};
use palpate_precompute::space::Store;

use super::figures::{Best, Others, Row, Section, Table};
use super::interrupted;
use super::ours::LIVE;
use super::run::{Context, finished};
use super::scenes;
use crate::cmd::bench::live::simulation::Beside;
use crate::failure::Failure;
use crate::files::Folder;
use crate::progress::WorkProgress;
use crate::{analysis, blob};

/// Name of the section.
pub(super) const KEY: &str = "nodule";

/// Its table.
pub(super) const TABLE: &str = "nodule.nodules";
/// Its first column.
pub(super) const COLUMN: &str = "finite elements";
/// The scene, in the folder of the assets.
pub(super) const SCENE: &str = "scenes/nodules.toml";
/// Folders of the questions: the body with nodules, and with the surrounding material in their place.
pub(super) const FOLDERS: [&str; 2] = ["nodules", "nodules-without"];
/// Places of the scene.
const PLACES: [&str; 4] = ["shallow", "beside", "middle", "deep"];
/// Figures of a place: key and name.
const PARTS: [(&str, &str); 4] = [
    ("detectability", "detectability"),
    ("depth_mm", "depth, mm"),
    ("force_n", "force with the nodule, N"),
    ("without_n", "force without it, N"),
];
/// Beginning of the names of the groups of the nodules, and the group round them.
const NODULE: &str = "nodule-";
const TISSUE: &str = "tissue";
/// Force of the push, N.
const FORCE_N: f64 = 1.0;

/// Keys of the rows.
pub(super) fn rows() -> Vec<String> {
    PLACES.iter().flat_map(|place| PARTS.map(|(part, _)| format!("{place}.{part}"))).collect()
}

/// Writes both scenes.
pub(super) fn write_scenes(assets: &Path, folders: &[Folder; 2]) -> Result<(), Failure> {
    let from = assets.join(SCENE);
    scenes::write_scene(&from, "stiff nodules under the skin", &folders[0], |_| Ok(()))?;
    scenes::write_scene(&from, "the same body without its nodules", &folders[1], |scene| {
        let missing = || Failure::input(format!("{}: no material of the group {TISSUE}", from.display()));
        let materials = scene.get_mut("material").and_then(toml::Value::as_array_mut).ok_or_else(missing)?;
        let group =
            |material: &toml::Value| material.get("group").and_then(|group| group.as_str().map(String::from));
        let of_tissue = |material: &&toml::Value| group(material).as_deref() == Some(TISSUE);
        let tissue = materials.iter().find(of_tissue).cloned().ok_or_else(missing)?;
        for material in materials {
            if let Some(name) = group(material).filter(|name| name.starts_with(NODULE)) {
                *material = tissue.clone();
                material.as_table_mut().map(|table| table.insert("group".into(), name.into()));
            }
        }
        Ok(())
    })
}

/// Measures the section.
pub(super) fn section(
    folders: &[Folder; 2],
    work: &Folder,
    context: &Context<'_>,
) -> Result<Section, Failure> {
    let start = Instant::now();
    let path = folders[0].path().join(scenes::SCENE);
    let [with, without] = [0, 1].map(|n: usize| analysis::load(&folders[n].path().join(scenes::SCENE)));
    let bodies = [with?, without?];
    let places = places(&bodies[0], &path)?;
    let compared = by_finite_elements(&bodies, &places, &path, context)?;
    let mut columns = vec![COLUMN.to_owned()];
    let mut values = vec![compared.clone()];
    let depths_m: Vec<f64> = compared.iter().map(|c| c.map_or(f64::NAN, |c| c.depth_m)).collect();
    let [of_methods, of_methods_without] = {
        let of = |n: usize| by_methods(&bodies[n], FOLDERS[n], work, &places, &depths_m, context);
        [of(0)?, of(1)?]
    };
    for ((method, with_n), without_n) in Method::ALL.iter().zip(of_methods).zip(of_methods_without) {
        columns.push(method.name().to_owned());
        values.push(joined(&compared, &with_n, &without_n));
    }
    let live =
        [live(&bodies[0], &places, &depths_m, context)?, live(&bodies[1], &places, &depths_m, context)?];
    columns.push(LIVE.to_owned());
    values.push(joined(&compared, &live[0], &live[1]));
    let mut table = Table::new(
        TABLE,
        "Nodules of 14 mm, ten times as stiff, 3, 7 and 12 mm under the skin",
        "Detectability: the change of the force by the nodule at the depth at which finite elements give 1 N, over 7 % of the \
         force (at least 20 mN). Above 1 a finger feels it. \u{201c}beside\u{201d} has no nodule below.",
        "place",
        columns,
    );
    table.others = Others::Declared;
    for (n, place) in places.iter().enumerate() {
        let of = |part: &dyn Fn(&Compared) -> f64| -> Vec<f64> {
            values.iter().map(|column| column[n].as_ref().map_or(f64::NAN, part)).collect()
        };
        let parts = [
            of(&|c| c.detectability(&JND)),
            of(&|c| 1e3 * c.depth_m),
            of(&|c| c.force_n),
            of(&|c| c.without_n),
        ];
        let place = &place.active.name;
        for ((part, name), values) in PARTS.into_iter().zip(parts) {
            let (key, name) = (format!("{place}.{part}"), format!("{place}: {name}"));
            table.rows.push(Row::new(key, name, Best::None, values));
        }
    }
    table.without_empty_columns();
    Ok(finished(
        context,
        KEY,
        "Can a nodule be felt?",
        &[
            "A fingertip of 10 mm presses until 1 N, over each of three nodules and beside them. A system whose force error \
             is larger than the change by a nodule hides it.",
            "The methods have tables of adaptive sampling of both bodies at the places themselves. \u{201c}live\u{201d} solves the vertices \
             of the skin round a place and blends them, as under a hand: some mN, which show beside the nodules.",
            "All have the same mesh, on which a nodule is 24 to 34 tetrahedra. It is up to a third more detectable there than \
             on a fine mesh.",
        ],
        &[
            "palpate map OUT/questions/nodules/scene.toml --inclusion nodule-3 --inclusion nodule-7 --inclusion nodule-12",
        ],
        start.elapsed().as_secs_f64(),
        vec![table],
    ))
}

fn places(with: &Analysis, path: &Path) -> Result<Vec<Place>, Failure> {
    let named = |name: &&str| {
        let active = with.scene.active.iter().find(|active| active.name == **name);
        active.and_then(|active| Place::named(&with.scene, active)).ok_or_else(|| {
            let what =
                format!("{}: has no place {name}; give the bundled assets with --assets", path.display());
            Failure::input(what)
        })
    };
    PLACES.iter().map(named).collect()
}

fn by_finite_elements(
    bodies: &[Analysis; 2],
    places: &[Place],
    path: &Path,
    context: &Context<'_>,
) -> Result<Vec<Option<Compared>>, Failure> {
    let failed = |error: MapError| match error {
        MapError::Interrupted => interrupted(),
        error => Failure::work(format!("{}: {error}", path.display())),
    };
    let [with, without] = bodies;
    let mapped = Mapped::new(&with.scene, Some(&without.scene)).map_err(|e| failed(e.into()))?;
    let max_depth_m = with.scene.grid.as_ref().map_or(0.01, |grid| grid.radius_m());
    let goal = Goal { force_n: FORCE_N, max_depth_m };
    let progress = Mutex::new(WorkProgress::new("nodules", "places"));
    let show = |done: usize| {
        if let Ok(mut progress) = progress.lock() {
            progress.steps("push with and without", done, places.len());
        }
    };
    let work = Work { threads: context.threads, stop: context.stop, done: &show };
    let found = mapped.all(places, &goal, work).map_err(failed)?;
    if let Ok(progress) = progress.into_inner() {
        progress.finish();
    }
    Ok(found.into_iter().map(|found| found.compared).collect())
}

/// Normal forces at the depths by every method of tables of one body, N; not a number where it has no answer.
fn by_methods(
    body: &Analysis,
    name: &str,
    work: &Folder,
    places: &[Place],
    depths_m: &[f64],
    context: &Context<'_>,
) -> Result<Vec<Vec<f64>>, Failure> {
    let run = Run { threads: context.threads, stop: context.stop };
    let space = work.path().join(format!("{name}.space"));
    let store = body.store(&space)?;
    let mut progress = WorkProgress::new(name, "positions");
    let all: Vec<usize> = (0..body.scene.active.len()).collect();
    body.solve(&all, &store, run, |p| progress.spaces(p))?;
    drop(store);
    progress.phase("fitting the tables of every method");
    let options = PackOptions { methods: &Method::ALL, use_intermediate_states: true, threads: run.threads };
    let packed = pack(&Store::open(&space)?, &options)?.bytes()?;
    let file = work.file(&format!("{name}.blob"));
    file.put(&packed)?;
    progress.finish();
    let loaded = blob::load(file.path())?;
    let organ = blob::organ(file.path(), &loaded)?;
    let force_n = |method: Method, place: &Place, depth_m: f64| {
        let space = organ.spaces.iter().find(|space| space.active.name.as_str() == place.active.name)?;
        let found = space.force(method, place.inward.map(|n| (depth_m * n) as f32))?;
        Some(normal_n(found.force_n, place))
    };
    let of = |method: &Method| {
        let forces = places.iter().zip(depths_m);
        forces.map(|(place, &depth_m)| force_n(*method, place, depth_m).unwrap_or(f64::NAN)).collect()
    };
    Ok(Method::ALL.iter().map(of).collect())
}

/// Normal forces at the depths by the jets of a live solver that has finished there, N: those of the vertices round a
/// place, blended as in a session.
fn live(
    body: &Analysis,
    places: &[Place],
    depths_m: &[f64],
    context: &Context<'_>,
) -> Result<Vec<f64>, Failure> {
    let failed = |what: &str| Failure::work(format!("{}: {what}", body.path.display()));
    let of = |(place, &depth_m): (&Place, &f64)| {
        context.go_on()?;
        let mut solver = LiveSolver::new(&body.scene).map_err(|error| failed(&error.to_string()))?;
        let at = place.active.contact.ok_or_else(|| failed("a place is no point of the skin"))?;
        let d_m = place.inward.map(|n| depth_m * n);
        let displacement_m = d_m.map(|x| x as f32);
        let mut sum_n = 0.0;
        for (node, weight) in at.triangle.into_iter().zip(at.weights).filter(|(_, weight)| *weight > 0.0) {
            let contact = solver.skin().contacts.iter().position(|contact| contact.node == node);
            let contact = contact.ok_or_else(|| failed("a place is not on the free skin"))?;
            let mut beside = Beside::new(&mut solver, contact as u16, d_m.into(), 1.0);
            let touch = Touch {
                now_us: 0,
                weights: [NodeWeight::default(); 3],
                displacement_m,
                hip_m: displacement_m,
                half_axis_m: None,
            };
            sum_n += weight * normal_n(beside.force(&touch, 1e-3).force_n, place);
        }
        Ok(sum_n)
    };
    places.iter().zip(depths_m).map(of).collect()
}

fn normal_n(force_n: [f32; 3], place: &Place) -> f64 {
    Vector3::from(force_n.map(f64::from)).dot(&Vector3::from(place.inward))
}

/// The comparisons of another system at the same depths.
fn joined(exact: &[Option<Compared>], with_n: &[f64], without_n: &[f64]) -> Vec<Option<Compared>> {
    let of = |((exact, &force_n), &without_n): ((&Option<Compared>, &f64), &f64)| {
        let answers = force_n.is_finite() && without_n.is_finite();
        exact.filter(|_| answers).map(|exact| Compared { force_n, without_n, ..exact })
    };
    exact.iter().zip(with_n).zip(without_n).map(of).collect()
}
