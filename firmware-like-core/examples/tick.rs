//! A hand presses into the first active node of an organ, one tick per millisecond; prints depth and force.
//!
//! `cargo run --release -p palpate-core --example tick -- firmware-like-core/golden/organ-514.blob`

use std::error::Error;

use palpate_core::{AlignedBytes, Config, Controller, Method, Organ, Sample, State, vec3};

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args_os().nth(1).ok_or("usage: tick FILE.blob")?;
    let blob = AlignedBytes::from(&std::fs::read(path)?);
    let organ: Organ = Organ::read(&blob)?;
    let node = &organ.spaces.first().ok_or("the organ has no active node")?.active;
    let controller = Controller::new(&organ, Config::new(Method::Energy))?;
    let mut state = State::new();
    state.arm();
    for tick in 0..=1_000_u64 {
        // From 1 mm above the surface to 10 mm below it and back.
        let height_m = 1e-3 - 1.1e-2 * (std::f32::consts::PI * tick as f32 * 1e-3).sin();
        let position_m = vec3::add(node.rest_position_m, vec3::scale(node.outward_normal, height_m));
        // In a program the device provides the position and receives the force.
        let sample = Sample { t_us: 1_000 * tick, position_m, ..Sample::default() };
        let command = controller.tick(&mut state, sample.t_us, Some(&sample));
        if tick % 100 == 0 {
            let outward_n = vec3::dot(command.hand_force_n, node.outward_normal);
            println!("{tick:4} ms  {:6.2} mm  {outward_n:5.2} N  {:?}", 1e3 * height_m, command.phase);
        }
    }
    Ok(())
}
