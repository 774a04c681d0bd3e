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

const SCENE: &str = "scenes/nodules.toml";
/// Groups of the nodules in the scene.
const NODULES: [&str; 3] = ["nodule-3", "nodule-7", "nodule-12"];
/// Force of the push, N.
const FORCE_N: f64 = 1.0;

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
    let named = |active| Place::named(&inclusion.with, active);
    let places: Vec<Place> = scene.active.iter().filter_map(named).collect();
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
        "nodule.nodules",
        "Nodules of 14 mm, ten times as stiff, 3, 7 and 12 mm under the skin",
        "Detectability: the change of the force by the nodule at the depth of 1 N, over 7 % of the force (at least \
         20 mN). Above 1 a finger feels it. \u{201c}beside\u{201d} has no nodule below.",
        "place",
        vec!["finite elements".into()],
    );
    table.others = Others::Declared;
    for (place, found) in places.iter().zip(&found) {
        let compared = found.compared.as_ref();
        let value = |of: &dyn Fn(&palpate_precompute::map::Compared) -> f64| compared.map_or(f64::NAN, of);
        let name = &place.active.name;
        let mut row = |part: &str, unit: &str, value: f64| {
            let (key, name) = (format!("{name}.{part}"), format!("{name}: {unit}"));
            table.rows.push(Row::new(key, name, Best::None, vec![value]));
        };
        row("detectability", "detectability", value(&|c| c.detectability(&JND)));
        row("depth_mm", "depth, mm", value(&|c| 1e3 * c.depth_m));
        row("force_n", "force with the nodule, N", value(&|c| c.force_n));
        row("without_n", "force without it, N", value(&|c| c.without_n));
    }
    Ok(finished(
        context,
        KEY,
        "Can a nodule be felt?",
        &[
            "A fingertip of 10 mm presses until 1 N, over each of three nodules and beside them. A system whose force error \
           is larger than the change by a nodule hides it.",
        ],
        &[
            "palpate bench public --only nodule",
            "palpate map assets/scenes/nodules.toml --inclusion nodule-3 --inclusion nodule-7 --inclusion nodule-12",
        ],
        start.elapsed().as_secs_f64(),
        vec![table],
    ))
}
