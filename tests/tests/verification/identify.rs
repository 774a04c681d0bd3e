//! Constants identified from forces that GetFEM computed (`tests/peers/golden_indentation.py`, results committed).

use std::path::Path;

use palpate_precompute::identify::{Data, Force, Identified, Options, identify};
use palpate_precompute::num::{split_mix, unit_interval};
use palpate_precompute::pipeline::Run;
use palpate_precompute::scene::Scene;

const ONE: &[u8] = include_bytes!("../../peers/golden/indentation.csv");
const OTHER_LAW: &[u8] = include_bytes!("../../peers/golden/indentation_neo_hookean.csv");
const TWO: &[u8] = include_bytes!("../../peers/golden/indentation_two_regions.csv");

/// The constants behind the data, Pa.
const TRUTH: [f64; 2] = [1300.0, 1280.0];

fn assets() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets")
}

/// The small organ with a Mooney-Rivlin law, from a guess.
fn organ() -> Scene {
    let text = "[mesh]\nfile = \"liver-small.msh\"\n[material]\nlaw = \"mooney-rivlin\"\nc10_pa = 2000.0\nc01_pa = 600.0\n\
                [fixed]\ngroup = \"F1\"\n[[active]]\nname = \"A1\"\nnode = 199\n";
    Scene::parse(&assets().join("organ.toml"), text.into()).expect("a scene")
}

fn data(bytes: &[u8]) -> Data {
    Data::parse(Path::new("indentation.csv"), bytes, None).expect("a table")
}

/// Every third row, for many fits.
fn third(mut data: Data) -> Data {
    data.rows = data.rows.into_iter().skip(1).step_by(3).collect();
    data
}

/// The forces with noise of this standard deviation, N.
fn noisy(data: &Data, noise_n: f64, seed: u64) -> Data {
    let mut state = seed << 24;
    let mut next = || {
        state += 1;
        unit_interval(split_mix(split_mix(state)))
    };
    // Twelve uniform numbers have the variance one.
    let mut gaussian = || noise_n * ((0..12).map(|_| next()).sum::<f64>() - 6.0);
    let mut data = data.clone();
    for row in &mut data.rows {
        if let Force::Vector(force) = &mut row.force_n {
            force.iter_mut().for_each(|f| *f += gaussian());
        }
    }
    data
}

fn fitted(scene: &Scene, data: &Data, free: &[&str]) -> Identified {
    let options =
        Options { free: free.iter().map(|name| (*name).to_owned()).collect(), ..Options::default() };
    let resolved = scene.resolve().expect("a mesh");
    identify(scene, &resolved, data, &options, Run::run_to_end(), |_| ()).expect("identified")
}

#[test]
fn the_papers_constants_come_back_from_exact_forces() {
    let found = fitted(&organ(), &data(ONE), &["c10_pa", "c01_pa"]);
    for (parameter, truth) in found.parameters.iter().zip(TRUTH) {
        println!("{} = {} Pa", parameter.name, parameter.value);
        assert!((parameter.value / truth - 1.0).abs() < 1e-9, "{parameter:?}");
    }
    assert!(!found.is_misfit && found.rms_share < 1e-9, "{:?}", found.warnings);
}

/// With noise of 1 % of the RMS force the 95 % intervals hold the truth in at least 89 of 100 runs, each.
#[test]
fn intervals_hold_the_truth_in_nine_of_ten_noisy_runs() {
    let (scene, exact) = (organ(), third(data(ONE)));
    let noise_n = 0.012;
    let (mut held, mut alarms) = ([0; 3], 0);
    let (mut sums, mut squares, mut errors) = ([0.0; 2], [0.0; 2], [0.0; 2]);
    for seed in 0..100 {
        let found = fitted(&scene, &noisy(&exact, noise_n, seed), &["c10_pa", "c01_pa"]);
        let is_held = [0, 1].map(|k| {
            let (parameter, truth) = (&found.parameters[k], TRUTH[k]);
            sums[k] += parameter.value - truth;
            squares[k] += (parameter.value - truth).powi(2);
            errors[k] += parameter.standard_error;
            parameter.low <= truth && truth <= parameter.high
        });
        for (count, is_held) in held.iter_mut().zip([is_held[0], is_held[1], is_held[0] && is_held[1]]) {
            *count += i32::from(is_held);
        }
        alarms += i32::from(found.is_misfit);
    }
    println!(
        "held of 100: c10_pa {}, c01_pa {}, both {}; alarms of a wrong model {alarms}",
        held[0], held[1], held[2]
    );
    for k in 0..2 {
        let (bias, spread, stated) = (sums[k] / 100.0, (squares[k] / 100.0).sqrt(), errors[k] / 100.0);
        println!(
            "constant {k}: mean error {bias:.1} Pa, spread {spread:.1} Pa, stated standard error {stated:.1} Pa"
        );
        assert!((0.8..1.25).contains(&(spread / stated)), "the stated error is that of the spread");
    }
    assert!(held[0] >= 89 && held[1] >= 89, "{held:?}");
    assert!(alarms <= 3, "{alarms} alarms");
}

#[test]
fn a_wrong_law_shows_in_the_residuals() {
    let found = fitted(&organ(), &noisy(&third(data(OTHER_LAW)), 0.012, 7), &["c10_pa", "c01_pa"]);
    println!("RMS {:.1} % of the forces, {:?}", 100.0 * found.rms_share, found.warnings);
    assert!(found.is_misfit && found.rms_share > 0.02);
    assert!(found.warnings.iter().any(|warning| warning.contains("residuals are systematic")));
}

/// At small strain only the sum of the two constants is known.
#[test]
fn small_strain_does_not_tell_two_constants_apart() {
    let mut small = noisy(&data(ONE), 0.002, 11);
    small.rows.retain(|row| row.place_m.iter().all(|x| x.abs() < 2.5e-3));
    let found = fitted(&organ(), &small, &["c10_pa", "c01_pa"]);
    println!("{} rows: {:?}", small.rows.len(), found.warnings);
    let warning = found.warnings.iter().find(|warning| warning.contains("hardly tell")).expect("a warning");
    assert!(warning.contains("`c10_pa` and `c01_pa`") && found.correlation[0][1] < -0.95, "{warning}");
}

#[test]
fn two_regions_come_back_from_exact_forces() {
    let text = std::fs::read_to_string(assets().join("scenes/tumour.toml")).expect("a bundled scene");
    let text =
        text.replace("order = 2\n", "").replace("[tool]\nshape = \"fingertip\"\nradius_m = 0.015\n", "");
    let text =
        text.replace("c10_pa = 1300.0", "c10_pa = 1900.0").replace("c10_pa = 13000.0", "c10_pa = 7000.0");
    let scene = Scene::parse(&assets().join("scenes/two.toml"), text).expect("a scene");
    let found = fitted(&scene, &data(TWO), &["tissue.c10_pa", "tumour.c10_pa"]);
    for (parameter, truth) in found.parameters.iter().zip([1300.0, 13000.0]) {
        println!("{} = {} Pa", parameter.name, parameter.value);
        assert!((parameter.value / truth - 1.0).abs() < 1e-7, "{parameter:?}");
    }
}
