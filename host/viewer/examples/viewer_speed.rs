//! Measures the time to draw a picture of the live viewer on one core, by stage.
//!
//!     cargo run --release -p palpate-viewer --example viewer_speed            # a synthetic organ
//!     cargo run --release -p palpate-viewer --example viewer_speed FILE.blob
//!
//! Without a file: an ellipsoid of 10,242 vertices and 20,480 triangles, pressed and pulled. It prints
//! medians over the frames, in ms, with the process pinned to one core. A window at 30 Hz has 33 ms per
//! frame.

#[path = "../../tests/common/synthetic.rs"]
mod synthetic;

use core::time::Duration;
use palpate_core::{Method, NodeWeight, Organ, vec3};
use palpate_host::BlobFile;
use palpate_host::rt::TickRecord;
use palpate_viewer::renderer::FrameTimes;
use palpate_viewer::{Live, Renderer, RendererConfig};
use std::path::Path;

/// Number of measured frames per picture.
const FRAMES: u32 = 151;

fn main() -> Result<(), Box<dyn core::error::Error>> {
    pin_to_one_core()?;
    match std::env::args_os().nth(1) {
        Some(path) => {
            let file = BlobFile::load(Path::new(&path))?;
            let organ: Organ<'_> = Organ::read(file.bytes())?;
            measure(&organ);
        }
        None => {
            let blob = synthetic::organ(&synthetic::Shape { subdivisions: 5, ..Default::default() });
            let organ: Organ<'_> = Organ::read(&blob)?;
            measure(&organ);
        }
    }
    Ok(())
}

fn pin_to_one_core() -> nix::Result<()> {
    let mut set = nix::sched::CpuSet::new();
    set.set(1.min(std::thread::available_parallelism().map_or(1, usize::from) - 1))?;
    nix::sched::sched_setaffinity(nix::unistd::Pid::from_raw(0), &set)
}

fn measure(organ: &Organ<'_>) {
    let (vertices, triangles) = (organ.surface.node.len(), organ.surface.triangles.len());
    println!(
        "{}: {vertices} vertices, {triangles} triangles, {} active nodes",
        organ.scene,
        organ.spaces.len()
    );
    println!("1280 x 720, ms    deformation  raster  shading  overlay    all    min   max");
    for (name, engaged, depth_m) in
        [("at rest", None, 0.0), ("pressed", Some(0), -0.012), ("pulled", Some(0), 0.025)]
    {
        let mut renderer = Renderer::new(organ, Method::Tricubic.name(), RendererConfig::live());
        let mut live = Live::new();
        let mut times: Vec<FrameTimes> = Vec::new();
        for frame in 0..FRAMES + 3 {
            for tick in 33 * u64::from(frame)..33 * u64::from(frame + 1) {
                live.push(&record(organ, engaged, depth_m, tick));
            }
            renderer.render(organ, &record(organ, engaged, depth_m, 33 * u64::from(frame)), &mut live);
            // The first frames allocate buffers and draw the background.
            if frame >= 3 {
                times.push(renderer.times());
            }
        }
        let parts: [fn(&FrameTimes) -> Duration; 5] =
            [|t| t.deformation, |t| t.raster, |t| t.shading, |t| t.overlay, FrameTimes::total];
        let medians = parts.map(|part| {
            let mut of: Vec<Duration> = times.iter().map(part).collect();
            of.sort();
            1e3 * of[of.len() / 2].as_secs_f64()
        });
        let mut all: Vec<Duration> = times.iter().map(FrameTimes::total).collect();
        all.sort();
        let [min, max] = [all[0], all[all.len() - 1]].map(|time| 1e3 * time.as_secs_f64());
        let [deformation, raster, shading, overlay, all] = medians;
        println!(
            "{name:<17} {deformation:11.2}  {raster:6.2}  {shading:7.2}  {overlay:7.2}  {all:5.1}  {min:5.1}  {max:4.0}"
        );
    }
}

/// A hand with tremor, so that every frame differs.
fn record(organ: &Organ<'_>, engaged: Option<u16>, depth_m: f32, tick: u64) -> TickRecord {
    let space = &organ.spaces[0];
    let tremble = 1.0 + 0.05 * (tick as f32 * 0.05).sin();
    let displacement_m = vec3::scale(space.active.outward_normal, depth_m * tremble);
    let whole = NodeWeight { space: 0, weight: if engaged.is_some() { 1.0 } else { 0.0 } };
    TickRecord {
        tick,
        t_us: 1_000 * tick,
        hip_m: vec3::add(space.active.rest_position_m, displacement_m),
        displacement_m,
        engaged,
        shares: [whole, NodeWeight::default(), NodeWeight::default()],
        reaction_n: vec3::scale(displacement_m, 250.0),
        hand_force_n: vec3::scale(displacement_m, -250.0),
        lateness_ns: 3_000 + 500 * (tick % 7),
        ..TickRecord::EMPTY
    }
}
