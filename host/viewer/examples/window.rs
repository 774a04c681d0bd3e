//! Opens a window on a synthetic organ, like `palpate run` without a blob.
//!
//!     cargo run --release -p palpate-viewer --example window -- [sim|mouse] [SECONDS] [FOLDER]
//!
//! The device is a simulated hand or the mouse. Screenshots are written to the folder.
//! tests/viewer/check-window runs it on a virtual X server.

#[path = "../../tests/common/synthetic.rs"]
mod synthetic;

use core::sync::atomic::AtomicBool;
use palpate_core::{Config, Method, Organ, vec3};
use palpate_host::device::mouse::{MouseConfig, mouse};
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::{Device, SessionOptions, run_session};
use palpate_viewer::{RendererConfig, Screen, View};

fn main() -> Result<(), Box<dyn core::error::Error>> {
    let mut words = std::env::args().skip(1);
    let device = words.next().unwrap_or_else(|| "sim".into());
    let seconds = words.next().map(|word| word.parse()).transpose()?;
    let screenshots = words.next().unwrap_or_else(|| "palpate-frames".into()).into();

    let blob = synthetic::organ(&synthetic::Shape { subdivisions: 4, ..Default::default() });
    let organ: Organ<'_> = Organ::read(&blob)?;
    let space = &organ.spaces[0];
    let start_m = vec3::add(space.active.rest_position_m, vec3::scale(space.active.outward_normal, 0.03));
    let (handle, mouse) = mouse(start_m, MouseConfig::default());
    let (device, mouse): (Box<dyn Device>, _) = match device.as_str() {
        "sim" => (Box::new(SimulatedHand::new(&organ, SimulatedConfig::default())), None),
        "mouse" => (Box::new(mouse), Some(handle)),
        other => return Err(format!("no device `{other}`; choose sim or mouse").into()),
    };
    let view = View::Window { screenshots, picture: RendererConfig::live(), mouse };
    let options = SessionOptions { seconds, ..SessionOptions::default() };
    let (organs, config) = ([&organ], Config::new(Method::Tricubic));
    let mut screen = Screen::open(&organs, config.method_name(), &view)?;
    let summary = run_session(&organs, config, device, &options, &AtomicBool::new(false), &mut screen)?;
    println!("{summary}\n{}", screen.finish()?);
    Ok(())
}
