//! Detectability of nodules under the skin.

use std::path::Path;
use std::sync::Mutex;
use std::time::Instant;

use palpate_precompute::map::{Goal, Inclusion, JND, MapError, Mapped, Place, Work};
use palpate_precompute::scene::Scene;

use super::figures::{Best, Others, Row, Section, Table};
use super::interrupted;
use super::run::{Context, finished};
use crate::failure::Failure;
use crate::progress::WorkProgress;

/// Name of the section.
pub(super) const KEY: &str = "nodule";

/// Its table.
pub(super) const TABLE: &str = "nodule.nodules";
/// Its column.
pub(super) const COLUMN: &str = "finite elements";
/// The scene, in the folder of the assets.
pub(super) const SCENE: &str = "scenes/nodules.toml";
/// Places of the scene.
const PLACES: [&str; 4] = ["shallow", "beside", "middle", "deep"];
/// Figures of a place: key and name.
const PARTS: [(&str, &str); 4] = [
    ("detectability", "detectability"),
    ("depth_mm", "depth, mm"),
    ("force_n", "force with the nodule, N"),
    ("without_n", "force without it, N"),
];
/// Groups of the nodules in the scene.
const NODULES: [&str; 3] = ["nodule-3", "nodule-7", "nodule-12"];
/// Force of the push, N.
const FORCE_N: f64 = 1.0;

/// Keys of the rows.
pub(super) fn rows() -> Vec<String> {
    PLACES.iter().flat_map(|place| PARTS.map(|(part, _)| format!("{place}.{part}"))).collect()
}

/// Measures the section.
pub(super) fn section(assets: &Path, context: &Context<'_>) -> Result<Section, Failure> {
    let start = Instant::now();
    let path = assets.join(SCENE);
    let scene = Scene::load(&path)?.resolve()?;
    let failed = |error: MapError| match error {
        MapError::Interrupted => interrupted(),
        error => Failure::work(format!("{}: {error}", path.display())),
    };
    let inclusion = Inclusion::of_groups(&scene, &NODULES.map(String::from)).map_err(|e| failed(e.into()))?;
    let mapped = Mapped::new(&inclusion.with, Some(&inclusion.without)).map_err(|e| failed(e.into()))?;
    let named = |name: &&str| {
        let active = scene.active.iter().find(|active| active.name == **name);
        active.and_then(|active| Place::named(&inclusion.with, active)).ok_or_else(|| {
            Failure::input(format!(
                "{}: has no place {name}; give the bundled assets with --assets",
                path.display()
            ))
        })
    };
    let places = PLACES.iter().map(named).collect::<Result<Vec<Place>, Failure>>()?;
    let max_depth_m = scene.grid.as_ref().map_or(0.01, |grid| grid.radius_m());
    let goal = Goal { force_n: FORCE_N, max_depth_m };
    let progress = Mutex::new(WorkProgress::new("nodules", "places"));
    let show = |done: usize| {
        if let Ok(mut progress) = progress.lock() {
            progress.steps("push with and without", done, places.len());
        }
    };
    let found = mapped
        .all(&places, &goal, Work { threads: context.threads, stop: context.stop, done: &show })
        .map_err(failed)?;
    if let Ok(progress) = progress.into_inner() {
        progress.finish();
    }
    let mut table = Table::new(
        TABLE,
        "Nodules of 14 mm, ten times as stiff, 3, 7 and 12 mm under the skin",
        "Detectability: the change of the force by the nodule at the depth of 1 N, over 7 % of the force (at least \
         20 mN). Above 1 a finger feels it. \u{201c}beside\u{201d} has no nodule below.",
        "place",
        vec![COLUMN.into()],
    );
    table.others = Others::Declared;
    for (place, found) in places.iter().zip(&found) {
        let compared = found.compared.as_ref();
        let values = compared
            .map_or([f64::NAN; 4], |c| [c.detectability(&JND), 1e3 * c.depth_m, c.force_n, c.without_n]);
        let place = &place.active.name;
        for ((part, name), value) in PARTS.into_iter().zip(values) {
            let (key, name) = (format!("{place}.{part}"), format!("{place}: {name}"));
            table.rows.push(Row::new(key, name, Best::None, vec![value]));
        }
    }
    Ok(finished(
        context,
        KEY,
        "Can a nodule be felt?",
        &[
            "A fingertip of 10 mm presses until 1 N, over each of three nodules and beside them. A system whose force error \
           is larger than the change by a nodule hides it.",
            "The figures are those of finite elements of the body, not of a method or of live; another system states its own.",
        ],
        &[
            "palpate bench public --only nodule",
            "palpate map assets/scenes/nodules.toml --inclusion nodule-3 --inclusion nodule-7 --inclusion nodule-12",
        ],
        start.elapsed().as_secs_f64(),
        vec![table],
    ))
}
