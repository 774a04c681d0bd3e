//! A headless session written as numbered pictures, as by `palpate run --headless`.

use crate::synthetic;
use core::sync::atomic::AtomicBool;
use palpate_core::{Config, Method, Organ};
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::rt::LoopEnd;
use palpate_host::sys::RtRequest;
use palpate_host::{SessionOptions, run_session};
use palpate_viewer::{RendererConfig, Screen, View, ViewerError};

#[test]
fn a_headless_session_writes_numbered_frames() {
    let blob = synthetic::organ(&synthetic::Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let folder = tempfile::tempdir().expect("a temporary directory");
    let directory = folder.path().join("frames");
    let options =
        SessionOptions { seconds: Some(1.2), real_time: RtRequest::none(), ..SessionOptions::default() };
    let picture = RendererConfig { width: 320, height: 180, samples: 1 };
    let view = View::Frames { directory: directory.clone(), rate_hz: 20.0, picture };
    let (organs, go) = ([&organ], AtomicBool::new(false));
    let config = Config::new(Method::Hybrid);
    let session = |screen: &mut Screen<'_, '_, _>| {
        let hand = SimulatedHand::new(&organ, SimulatedConfig::default());
        run_session(&organs, config, hand, &options, &go, screen).expect("it runs")
    };
    let mut screen = Screen::open(&organs, config.method_name(), &view).expect("a folder");
    let summary = session(&mut screen);
    assert_eq!(summary.end, LoopEnd::Completed);
    let frames = screen.finish().expect("written");
    let found = std::fs::read_dir(&directory).expect("there").count() as u64;
    assert!(frames.written >= 2 && found == frames.written, "{frames}: {found} files");

    // Without the folder the first picture ends the session. The screen keeps its error.
    let mut screen = Screen::open(&organs, config.method_name(), &view).expect("a folder");
    std::fs::remove_dir_all(&directory).expect("it is there");
    let summary = session(&mut screen);
    assert_eq!(summary.end, LoopEnd::Stopped);
    assert!(matches!(screen.finish(), Err(ViewerError::Frame(_))));
}
