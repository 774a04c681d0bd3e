//! The closed loop of hand, device and controller on every bundled scene and several devices: it does not shake, it gives no energy away,
//! and a minute of palpation at random ends without a fault. One case shakes as soon as the stiffness cap is taken away.
//!
//! Forces come from blobs made here of the bundled scenes, on coarse grids: the stiffness of a body at rest and at its reach is that of its
//! solved configurations, however many there are between them.

#[path = "../../host/tests/common/closed_loop.rs"]
mod closed_loop;

use std::path::{Path, PathBuf};

use closed_loop::{Cap, Disturbance, MAX_GIVEN_J, RELAXED, frictionless, hold, palpate};
use palpate_core::{Method, Organ, Phase};
use palpate_host::BlobFile;
use palpate_host::device::hand::HandConfig;
use palpate_host::device::profile::Profile;
use palpate_precompute::configuration_space::SpaceGrid;
use palpate_precompute::scene::Scene;
use palpate_tests::coarse_blob::coarse_blob;

/// Exact gradients of an energy: what the tables gain or lose round a closed way is not the method's.
const METHOD: Method = Method::Energy;

/// A small, cheap device with a slow link; a serial arm; a stiff parallel one; a soft, light one.
const DEVICES: [&str; 4] = ["falcon", "polhem", "omega", "touch"];

/// Depths at which the hand holds still, in the model, m.
const DEPTHS_M: [f32; 3] = [0.003, 0.008, 0.018];

fn bundled_scenes() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets");
    let entries = std::fs::read_dir(folder).expect("the bundled scenes are there");
    let mut scenes: Vec<PathBuf> = entries.map(|entry| entry.expect("readable").path()).collect();
    scenes.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    scenes.sort();
    assert!(scenes.len() >= 2, "{scenes:?}");
    scenes
}

/// A blob of every active node of a scene, on a grid of 20 mm: two cells along the radius, one for a large mesh.
fn blob(path: &Path) -> BlobFile {
    let scene = Scene::load(path).expect("sound").resolve().expect("sound");
    let cells = if scene.mesh.nodes_m.len() < 1_000 { 2.0 } else { 1.0 };
    let grid = SpaceGrid::new(0.02, 0.02 * cells).expect("the grid is valid");
    coarse_blob(&scene, grid, METHOD)
}

/// A knock and nothing else may be seen of the hand: its motion at rest is less than a step of the encoder, with or without friction.
fn does_not_shake(organ: &Organ<'_>, device: &str, profile: &Profile) {
    let quantum_m = profile.mechanism.encoder_quantum_m.expect("every bundled profile states it");
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
            // The energy that a step of the encoder is worth at the largest force.
            let step_j = f64::from(quantum_m * knocked.peak_n);
            for held in [quiet, knocked] {
                assert_eq!(held.phase, Phase::Active, "{}: {held:?}", case());
                assert!(held.peak_n <= profile.max_force_n, "{}: {held:?}", case());
                assert!(held.peak_to_peak_m < quantum_m, "{}: {held:?}", case());
                assert!(held.hold_j < step_j, "{}: {held:?}", case());
            }
            // Pressed and let go: with the friction of its device the hand gets nothing back beyond that.
            assert!(quiet.cycle_j < step_j || !friction.is_empty(), "{}: {quiet:?}", case());
            assert!(quiet.peak_n > 0.05 || depth_m < 0.01, "{}: hardly touched, {quiet:?}", case());
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
fn every_bundled_scene_is_stable_in_every_hand_that_rests_on_the_handle() {
    for scene in bundled_scenes() {
        let file = blob(&scene);
        let organ: Organ<'_> = Organ::read(file.bytes()).expect("a sound blob");
        for (seed, device) in (1..).zip(DEVICES) {
            let profile = Profile::bundled(device).expect("bundled");
            does_not_shake(&organ, device, &profile);
            let usual = HandConfig::default();
            let found = palpate(&organ, METHOD, (usual, &profile), (seed, 60.0), Cap::On);
            println!(
                "{} on {device}: a minute at random, {} touches, {:.2} N at most, {:+.1e} J at most in a touch",
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
            shakes_without_the_cap(&organ);
        }
    }
}

/// The same organ four times as large for two fingers on a light device: the cap is all that stands between it and shaking.
fn shakes_without_the_cap(organ: &Organ<'_>) {
    let mut profile = frictionless(&Profile::bundled("touch").expect("bundled"));
    profile.workspace.scale *= 4.0;
    let quantum_m = profile.mechanism.encoder_quantum_m.expect("it is stated");
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
    assert!(without.peak_to_peak_m > 20.0 * quantum_m, "{without:?}: this test could not fail");
}
