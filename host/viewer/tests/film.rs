//! A headless session recorded as a film, as by `palpate run --headless --gif`.
//!
//! If PALPATE_PICTURES is set to a directory, ten seconds are written there as `film.gif`, at the command's
//! size and rate.

use crate::synthetic;
use core::sync::atomic::AtomicBool;
use palpate_core::{Config, Method, Organ};
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::rt::LoopEnd;
use palpate_host::sys::RtRequest;
use palpate_host::{SessionOptions, run_session};
use palpate_viewer::{RendererConfig, Screen, View, ViewerError};
use std::fs::File;
use std::path::PathBuf;

#[test]
fn a_headless_session_becomes_a_film_of_its_duration() {
    let blob = synthetic::organ(&synthetic::Shape { subdivisions: 4, ..synthetic::Shape::default() });
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let directory = tempfile::tempdir().expect("a temporary directory");
    let (file, seconds, picture) = match std::env::var_os("PALPATE_PICTURES") {
        Some(kept) => {
            let picture = RendererConfig { width: 800, height: 450, samples: 2 };
            (PathBuf::from(kept).join("film.gif"), 10.0, picture)
        }
        None => {
            (directory.path().join("film.gif"), 1.5, RendererConfig { width: 320, height: 180, samples: 1 })
        }
    };
    let hand = SimulatedHand::new(&organ, SimulatedConfig::default());
    let options =
        SessionOptions { seconds: Some(seconds), real_time: RtRequest::none(), ..SessionOptions::default() };
    let config = Config::new(Method::Tricubic);
    let (organs, go) = ([&organ], AtomicBool::new(false));
    let view = View::Gif { file: file.clone(), rate_hz: 12.5, picture };
    let mut screen = Screen::open(&organs, config.method, &view).expect("a film");
    run_session(&organs, config, hand, &options, &go, &mut screen).expect("it runs");
    let frames = screen.finish().expect("a whole film");

    let mut decoder =
        gif::DecodeOptions::new().read_info(File::open(&file).expect("written")).expect("a GIF");
    assert_eq!(
        (usize::from(decoder.width()), usize::from(decoder.height())),
        (picture.width, picture.height)
    );
    let mut delays_cs = Vec::new();
    while let Some(frame) = decoder.read_next_frame().expect("valid") {
        delays_cs.push(u32::from(frame.delay));
    }
    assert!(delays_cs.len() >= 3 && delays_cs.len() as u64 == frames.written, "{delays_cs:?}");
    // The delay of the last frame is half a second. The others sum to the time between the first and the last
    // tick.
    let between_cs: u32 = delays_cs[..delays_cs.len() - 1].iter().sum();
    assert!(f64::from(between_cs) <= 100.0 * seconds + 2.0 * delays_cs.len() as f64, "{delays_cs:?}");
}

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
    let mut screen = Screen::open(&organs, config.method, &view).expect("a folder");
    let summary = session(&mut screen);
    assert_eq!(summary.end, LoopEnd::Completed);
    let frames = screen.finish().expect("written");
    let found = std::fs::read_dir(&directory).expect("there").count() as u64;
    assert!(frames.written >= 2 && found == frames.written, "{frames}: {found} files");

    // Without the folder the first picture ends the session. The screen keeps its error.
    let mut screen = Screen::open(&organs, config.method, &view).expect("a folder");
    std::fs::remove_dir_all(&directory).expect("it is there");
    let summary = session(&mut screen);
    assert_eq!(summary.end, LoopEnd::Stopped);
    assert!(matches!(screen.finish(), Err(ViewerError::Frame(_))));
}
