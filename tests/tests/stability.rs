//! The closed loop of hand, device and controller on every bundled scene and several devices: it does not
//! oscillate and adds no energy, and a minute of random palpation ends without a fault. One case oscillates
//! without the stiffness cap.
//!
//! The test makes the blobs from the bundled scenes on coarse grids. The stiffness of a body at rest and at
//! its reach is that of its solved configurations, for any number of configurations in between.

#[path = "../../host/tests/common/closed_loop.rs"]
mod closed_loop;

use std::path::{Path, PathBuf};

use closed_loop::{Cap, Disturbance, MAX_GIVEN_J, RELAXED, frictionless, hold, palpate};
use palpate_core::{Method, Organ, Phase};
use palpate_host::BlobFile;
use palpate_host::device::hand::HandConfig;
use palpate_host::device::profile::Profile;
use palpate_precompute::scene::{ElementOrder, Scene};
use palpate_precompute::spec::SpaceGrid;
use palpate_tests::coarse_blob::coarse_blob;

/// The forces are exact gradients of an energy, so that energy gained or lost around a closed path is not due
/// to the method.
const METHOD: Method = Method::Energy;

/// A small, cheap device with a slow link; a serial arm; a stiff parallel device; a soft, light device.
const DEVICES: [&str; 4] = ["falcon", "polhem", "omega", "touch"];

/// Depths of the holds, in the model, m.
const DEPTHS_M: [f32; 3] = [0.003, 0.008, 0.018];

fn bundled_scenes() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets");
    let entries = std::fs::read_dir(folder).expect("the folder of bundled scenes is readable");
    let mut scenes: Vec<PathBuf> = entries.map(|entry| entry.expect("readable").path()).collect();
    scenes.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    scenes.sort();
    assert!(scenes.len() >= 2, "{scenes:?}");
    scenes
}

/// A blob of every active node of a scene on a grid of 20 mm, with two cells along the radius, or one where a
/// solve takes long.
fn blob(path: &Path) -> BlobFile {
    let scene = Scene::load(path).expect("sound").resolve().expect("sound");
    let is_fast = scene.order == ElementOrder::Linear && scene.mesh.nodes_m.len() < 1_000;
    let cells = if is_fast { 2.0 } else { 1.0 };
    let grid = SpaceGrid::new(0.02, 0.02 * cells).expect("the grid is valid");
    coarse_blob(&scene, grid, &[METHOD])
}

/// After a knock the motion of the hand at rest is less than an encoder step, with or without friction.
fn check_no_oscillation(organ: &Organ<'_>, device: &str, profile: &Profile) {
    let quantum_m = profile.mechanism.encoder_quantum_m.expect("every bundled profile has an encoder step");
    for (friction, profile) in [("", profile.clone()), (" without friction", frictionless(profile))] {
        let (mut most_m, mut most_free_m, mut most_hold_j, mut most_cycle_j) =
            (0.0_f32, 0.0_f32, f64::MIN, f64::MIN);
        let mut stiffest_n_m = 0.0;
        let mut share = 1.0;
        for (space, depth_m) in
            (0..organ.spaces.len()).flat_map(|space| DEPTHS_M.map(|depth_m| (space, depth_m)))
        {
            let run = |cap, knock| hold(organ, METHOD, space, depth_m, (RELAXED, &profile), cap, knock);
            let (quiet, knocked) = (run(Cap::On, Disturbance::Never), run(Cap::On, Disturbance::Once));
            let free = run(Cap::Off, Disturbance::Once);
            let case =
                || format!("{} on {device}{friction}, space {space}, {depth_m} m", organ.scene.as_str());
            // Energy of one encoder step at the largest force.
            let step_j = f64::from(quantum_m * knocked.peak_n);
            for held in [quiet, knocked] {
                assert_eq!(held.phase, Phase::Active, "{}: {held:?}", case());
                assert!(held.peak_n <= profile.max_force_n, "{}: {held:?}", case());
                assert!(held.peak_to_peak_m < quantum_m, "{}: {held:?}", case());
                assert!(held.hold_j < step_j, "{}: {held:?}", case());
            }
            // After a press and release the hand gains no further energy, with the friction of its device.
            assert!(quiet.cycle_j < step_j || !friction.is_empty(), "{}: {quiet:?}", case());
            assert!(quiet.peak_n > 0.05 || depth_m < 0.01, "{}: contact force too small, {quiet:?}", case());
            most_m = most_m.max(quiet.peak_to_peak_m).max(knocked.peak_to_peak_m);
            most_free_m = most_free_m.max(free.peak_to_peak_m);
            most_hold_j = most_hold_j.max(quiet.hold_j).max(knocked.hold_j);
            most_cycle_j = most_cycle_j.max(quiet.cycle_j);
            (stiffest_n_m, share) = (quiet.stiffest_n_m, quiet.share);
        }
        println!(
            "{} on {device}{friction}: {stiffest_n_m:.0} N/m at the hand, cap {:.0}, forces x {share:.2}; peak to peak {:.1} um \
             with the cap, {:.1} um without (a step is {:.0} um); {most_hold_j:+.0e} J in a second of rest, {most_cycle_j:+.0e} J \
             in a press",
            organ.scene.as_str(),
            profile.cap().n_m,
            1e6 * most_m,
            1e6 * most_free_m,
            1e6 * quantum_m
        );
    }
}

#[test]
fn every_bundled_scene_is_stable_in_any_hand() {
    for scene in bundled_scenes() {
        let file = blob(&scene);
        let organ: Organ<'_> = Organ::read(file.bytes()).expect("a valid blob");
        for (seed, device) in (1..).zip(DEVICES) {
            let profile = Profile::bundled(device).expect("bundled");
            check_no_oscillation(&organ, device, &profile);
            let usual = HandConfig::default();
            let found = palpate(&organ, METHOD, (usual, &profile), (seed, 60.0), Cap::On);
            println!(
                "{} on {device}: a minute of random palpation, {} contacts, largest force {:.2} N, largest energy of a contact {:+.1e} J",
                organ.scene.as_str(),
                found.contacts,
                found.peak_n,
                found.max_given_j
            );
            assert_eq!(found.phase, Phase::Active, "{device}: {found:?}");
            assert!(found.contacts >= 10 && found.engaged_ticks > 10_000, "{device}: {found:?}");
            assert!(found.peak_n <= profile.max_force_n, "{device}: {found:?}");
            assert!(found.max_given_j < MAX_GIVEN_J, "{device}: {found:?}");
        }
        if organ.scene.as_str() == "liver-small" {
            check_oscillation_without_the_cap(&organ);
        }
    }
}

/// The same organ at scale 4 for two fingers on a light device, where only the stiffness cap prevents an
/// oscillation.
fn check_oscillation_without_the_cap(organ: &Organ<'_>) {
    let mut profile = frictionless(&Profile::bundled("touch").expect("bundled"));
    profile.workspace.scale *= 4.0;
    let quantum_m = profile.mechanism.encoder_quantum_m.expect("the profile has an encoder step");
    let run = |cap| hold(organ, METHOD, 0, 0.008, (HandConfig::LIGHT, &profile), cap, Disturbance::Once);
    let (with, without) = (run(Cap::On), run(Cap::Off));
    println!(
        "liver-small, four times as large, two fingers on touch: {:.0} N/m at the hand; {:.3} mm with the cap (forces x {:.2}), {:.3} mm \
         without",
        with.stiffest_n_m,
        1e3 * with.peak_to_peak_m,
        with.share,
        1e3 * without.peak_to_peak_m
    );
    assert!(with.phase == Phase::Active && with.peak_to_peak_m < quantum_m, "{with:?}");
    assert!(
        without.peak_to_peak_m > 20.0 * quantum_m,
        "{without:?}: the case must oscillate without the cap"
    );
}
