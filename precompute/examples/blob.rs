//! A blob is made and queried: interpolated and finite-element force along a push, 1 to 4 mm deep.
//!
//! `cargo run --release -p palpate-precompute --example blob -- assets/scenes/palpation.toml`

use std::error::Error;
use std::path::PathBuf;

use palpate_core::{AlignedBytes, Method, Organ, vec3};
use palpate_precompute::fem::Solver;
use palpate_precompute::pipeline::{Analysis, Run, certified_blob};

fn main() -> Result<(), Box<dyn Error>> {
    let scene = PathBuf::from(std::env::args_os().nth(1).ok_or("usage: blob SCENE.toml")?);
    let space = std::env::temp_dir().join(format!("palpate-example-{}.space", std::process::id()));
    let analysis = Analysis::load(&scene)?;
    analysis.solve_all(&space, Run::run_to_end())?;
    let blob = AlignedBytes::from(&certified_blob(&space, &[Method::Energy], Some(20), Run::run_to_end())?);
    std::fs::remove_file(&space)?;

    let organ: Organ = Organ::read(&blob)?;
    let interpolated = organ.spaces.first().ok_or("the organ has no active node")?;
    let inward = vec3::scale(interpolated.active.outward_normal, -1.0);
    let (_, node) = analysis.active(Some(&*interpolated.active.name))?;
    let mut solver = Solver::new(analysis.problem(node));
    let mut configuration = solver.rest()?;
    println!("depth mm   interpolated N   finite elements N   difference mN");
    for depth_mm in 1..=4_u8 {
        let displacement_m = vec3::scale(inward, 1e-3 * f32::from(depth_mm));
        let sample =
            interpolated.force(Method::Energy, displacement_m).ok_or("the blob has no table of energy")?;
        configuration = solver.advance(&configuration.seed, displacement_m.map(f64::from))?;
        let exact_n = configuration.jet().force_n.map(|n| n as f32);
        let difference_n = vec3::norm(vec3::sub(sample.force_n, exact_n));
        println!(
            "{depth_mm:8}   {:14.4}   {:17.4}   {:13.2}",
            vec3::norm(sample.force_n),
            vec3::norm(exact_n),
            1e3 * difference_n
        );
    }
    Ok(())
}
