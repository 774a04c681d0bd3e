//! The whole picture of a pressed and a pulled organ: right things in the right places, and fast enough.
//!
//! With PALPATE_PICTURES set to a directory the pictures are left there to be looked at.

#[path = "common/synthetic.rs"]
mod synthetic;

use nix::time::{ClockId, clock_gettime};
use palpate_core::{Config, Controller, Method, Organ, State};
use palpate_host::device::Device;
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::rt::TickRecord;
use palpate_host::viewer::frames::write_png;
use palpate_host::viewer::{Image, Live, Renderer, RendererConfig};
use std::path::Path;
use std::time::Instant;

/// Runs the simulated hand up to each of these ticks and draws what is there.
fn pictures(organ: &Organ<'_>, picture: RendererConfig, at: &[u64]) -> Vec<(TickRecord, Image, f64)> {
    let controller = Controller::new(organ, Config::new(Method::Tricubic)).expect("has the method");
    let mut hand = SimulatedHand::new(organ, SimulatedConfig::default());
    let mut renderer = Renderer::new(organ, Method::Tricubic, picture);
    let (mut state, mut force, mut live) = (State::new(), [0.0; 3], Live::new());
    state.arm();
    let mut found = Vec::new();
    for tick in 0..=at.iter().copied().max().unwrap_or(0) {
        let now_us = tick * 1_000;
        let sample = hand.exchange(now_us, force).expect("never fails");
        let begun = Instant::now();
        let command = controller.tick(&mut state, now_us, sample.as_ref());
        force = command.hand_force_n;
        let record = TickRecord {
            tick,
            t_us: now_us,
            sample,
            compute_ns: begun.elapsed().as_nanos() as u64,
            device_ns: None,
            lateness_ns: 400,
            ..TickRecord::of(&command)
        };
        live.take(&record);
        if at.contains(&tick) {
            // The second drawing is the one that counts: buffers exist, the background is made.
            renderer.render(organ, &record, &mut live);
            let begun_ms = cpu_ms();
            let image = renderer.render(organ, &record, &mut live).clone();
            found.push((record, image, cpu_ms() - begun_ms));
        }
    }
    found
}

/// CPU time of this thread: what drawing costs, whatever else the machine is doing.
fn cpu_ms() -> f64 {
    let time = clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).expect("every Linux has it");
    time.tv_sec() as f64 * 1e3 + time.tv_nsec() as f64 * 1e-6
}

fn leave(image: &Image, name: &str) {
    if let Some(directory) = std::env::var_os("PALPATE_PICTURES") {
        let path = Path::new(&directory).join(name);
        write_png(image, &path, &mut Vec::new()).expect("the directory is writable");
    }
}

/// Pixels that are clearly of one hue: the channel stands out from both others.
fn count(image: &Image, is: impl Fn(i32, i32, i32) -> bool) -> usize {
    image
        .pixels()
        .iter()
        .filter(|&&pixel| is((pixel >> 16 & 255) as i32, (pixel >> 8 & 255) as i32, (pixel & 255) as i32))
        .count()
}

#[test]
fn the_organ_glows_where_it_is_displaced_and_the_force_is_drawn() {
    let blob = synthetic::organ(&synthetic::Shape { subdivisions: 4, ..synthetic::Shape::default() });
    let organ: Organ<'_> = Organ::read(bytemuck::cast_slice(&blob)).expect("a sound blob");
    let found = pictures(&organ, RendererConfig::still(), &[100, 1_050, 4_900]);
    for ((_, image, milliseconds), name) in found.iter().zip(["free.png", "pressed.png", "pulled.png"]) {
        println!("{name}: {milliseconds:.1} ms");
        leave(image, name);
    }
    let [(free, rest, _), (pressed, dented, _), (pulled, raised, _)] = &found[..] else {
        panic!("three pictures")
    };
    assert!(free.engaged.is_none() && pressed.engaged == Some(0) && pulled.engaged == Some(0));
    let yellow = |r: i32, g: i32, b: i32| r > 200 && g > 140 && r - b > 60;
    let red = |r: i32, g: i32, b: i32| r > 60 && r > 2 * g && r > 2 * b;
    let cyan = |r: i32, g: i32, b: i32| b > 150 && g > 130 && b - r > 60;
    assert!(count(rest, red) > 20_000, "the organ at rest is red: {}", count(rest, red));
    for (image, name) in [(dented, "pressed"), (raised, "pulled")] {
        assert!(count(image, yellow) > count(rest, yellow) + 1_000, "{name} {}", count(image, yellow));
        assert!(count(image, cyan) > count(rest, cyan) + 1_000, "{name} {}", count(image, cyan));
    }
}

/// A window needs its picture within a period of 30 Hz. The bound is generous for shared and unoptimised machines; the
/// figure is printed.
#[test]
fn a_live_picture_is_drawn_in_time() {
    let blob = synthetic::organ(&synthetic::Shape { subdivisions: 4, ..synthetic::Shape::default() });
    let organ: Organ<'_> = Organ::read(bytemuck::cast_slice(&blob)).expect("a sound blob");
    let found = pictures(&organ, RendererConfig::live(), &[900, 1_000, 1_050]);
    let best = found.iter().map(|(_, _, milliseconds)| *milliseconds).fold(f64::INFINITY, f64::min);
    println!("1280 x 720, 5120 triangles: {best:.1} ms");
    leave(&found[2].1, "live.png");
    let bound = if cfg!(debug_assertions) { 3_000.0 } else { 100.0 };
    assert!(best < bound, "{best:.1} ms");
}
