//! Pictures of an organ at rest, pressed, pulled and in a fault: the expected objects are at the expected
//! places.
//!
//! If PALPATE_PICTURES is set to a directory, the pictures are written there. If PALPATE_WRITE_REFERENCE is
//! set too, the reference picture is rewritten.

use crate::synthetic;
use palpate_core::format::{Fingertip, Tool};
use palpate_core::{AlignedBytes, Config, Controller, Fault, Method, Organ, Phase, State, vec3};
use palpate_host::device::Device;
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::rt::TickRecord;
use palpate_viewer::frames::still;
use palpate_viewer::{Help, Image, Live, Renderer, RendererConfig, Verdict};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// Records that lead to a picture.
struct Shot {
    record: TickRecord,
    live: Live,
}

/// Runs the simulated hand up to each of these ticks.
fn shots(organ: &Organ<'_>, at: &[u64]) -> Vec<Shot> {
    let controller = Controller::new(organ, Config::new(Method::Tricubic)).expect("has the method");
    let mut hand = SimulatedHand::new(organ, SimulatedConfig::default());
    let (mut state, mut force, mut live) = (State::new(), [0.0; 3], Live::new());
    state.arm();
    let mut found = Vec::new();
    for tick in 0..=at.iter().copied().max().unwrap_or(0) {
        let now_us = tick * 1_000;
        let sample = hand.exchange(now_us, force).expect("never fails");
        let command = controller.tick(&mut state, now_us, sample.as_ref());
        force = command.hand_force_n;
        let record = TickRecord {
            tick,
            t_us: now_us,
            sample,
            compute_ns: 2_400,
            // A mostly idle machine with an occasional delay.
            lateness_ns: if tick % 700 == 300 { 180_000 } else { 2_000 + 40 * (tick % 13) },
            ..TickRecord::of(&command)
        };
        live.push(&record);
        if at.contains(&tick) {
            found.push(Shot { record, live: live.clone() });
        }
    }
    found
}

fn draw(organ: &Organ<'_>, picture: RendererConfig, shot: &mut Shot) -> Image {
    Renderer::new(organ, Method::Tricubic.name(), picture).render(organ, &shot.record, &mut shot.live).clone()
}

fn save(image: &Image, name: &str) {
    if let Some(directory) = std::env::var_os("PALPATE_PICTURES") {
        let path = Path::new(&directory).join(name);
        std::fs::write(path, still(image).expect("a picture")).expect("the directory is writable");
    }
}

fn blob() -> AlignedBytes {
    synthetic::organ(&synthetic::Shape { subdivisions: 4, ..synthetic::Shape::default() })
}

/// Counts the pixels of one hue: its channel is clearly larger than the others.
fn count(image: &Image, is: impl Fn(i32, i32, i32) -> bool) -> usize {
    image
        .pixels()
        .iter()
        .filter(|&&pixel| is((pixel >> 16 & 255) as i32, (pixel >> 8 & 255) as i32, (pixel & 255) as i32))
        .count()
}

fn yellow(r: i32, g: i32, b: i32) -> bool {
    r > 200 && g > 140 && r - b > 60
}

fn red(r: i32, g: i32, b: i32) -> bool {
    r > 60 && r > 2 * g && r > 2 * b
}

fn cyan(r: i32, g: i32, b: i32) -> bool {
    b > 150 && g > 130 && b - r > 60
}

#[test]
fn displacement_and_force_are_visible() {
    let blob = blob();
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let mut found = shots(&organ, &[100, 1_050, 4_900]);
    let images: Vec<Image> =
        found.iter_mut().map(|shot| draw(&organ, RendererConfig::still(), shot)).collect();
    for (image, name) in images.iter().zip(["free.png", "pressed.png", "pulled.png"]) {
        save(image, name);
    }
    let engaged: Vec<Option<u16>> = found.iter().map(|shot| shot.record.engaged).collect();
    assert_eq!(engaged, [None, Some(0), Some(0)]);
    let rest = &images[0];
    assert!(count(rest, red) > 20_000, "the organ at rest is red: {}", count(rest, red));
    for (image, name) in images[1..].iter().zip(["pressed", "pulled"]) {
        assert!(count(image, yellow) > count(rest, yellow) + 1_000, "{name} {}", count(image, yellow));
        assert!(count(image, cyan) > count(rest, cyan) + 1_000, "{name} {}", count(image, cyan));
    }
}

/// Counts the pixels that each key of the window, and a fault, changes in the picture.
#[test]
fn every_layer_is_visible() {
    let blob = blob();
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let mut shot = shots(&organ, &[1_050]).pop().expect("one");
    let mut renderer = Renderer::new(&organ, Method::Tricubic.name(), RendererConfig::live());
    let plain = renderer.render(&organ, &shot.record, &mut shot.live).clone();
    let differing = |image: &Image| image.pixels().iter().zip(plain.pixels()).filter(|(a, b)| a != b).count();
    assert_eq!(
        differing(renderer.render(&organ, &shot.record, &mut shot.live)),
        0,
        "drawing is deterministic"
    );

    renderer.layers_mut().ghost = false;
    let without = differing(renderer.render(&organ, &shot.record, &mut shot.live));
    assert!(without > 1_000, "the ghost is not visible: {without}");
    renderer.layers_mut().ghost = true;

    renderer.layers_mut().reach = true;
    let reach = renderer.render(&organ, &shot.record, &mut shot.live).clone();
    save(&reach, "reach.png");
    assert!(differing(&reach) > 2_000, "the reachable region is not visible: {}", differing(&reach));
    renderer.layers_mut().reach = false;

    renderer.layers_mut().side = false;
    let without = differing(renderer.render(&organ, &shot.record, &mut shot.live));
    assert!(without > 20_000, "the side view is not visible: {without}");
    renderer.layers_mut().side = true;

    renderer.layers_mut().help = Help::KeysAndHand;
    let help = renderer.render(&organ, &shot.record, &mut shot.live).clone();
    save(&help, "help.png");
    assert!(differing(&help) > 20_000, "the help is not visible: {}", differing(&help));
    renderer.layers_mut().help = Help::Absent;

    let fault = TickRecord { phase: Phase::SafeZero(Fault::Overspeed), ..shot.record };
    let fault = renderer.render(&organ, &fault, &mut shot.live).clone();
    save(&fault, "fault.png");
    let warning = |r: i32, g: i32, b: i32| r > 220 && (90..140).contains(&g) && (80..130).contains(&b);
    assert!(count(&fault, warning) > count(&plain, warning) + 100, "the warning is not visible");

    renderer.camera_mut().orbit(0.8, 0.3);
    renderer.camera_mut().pan(glam::Vec2::new(60.0, 20.0), 720);
    assert!(differing(renderer.render(&organ, &shot.record, &mut shot.live)) > 50_000);
    renderer.reset_view();
    assert_eq!(
        differing(renderer.render(&organ, &shot.record, &mut shot.live)),
        0,
        "the initial view is restored"
    );
}

/// The pad of a fingertip is visible where it presses, and the words are those of a finger.
#[test]
fn a_fingertip_is_drawn_as_a_pad() {
    let blob = blob();
    let mut organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let mut shot = shots(&organ, &[1_050]).pop().expect("one");
    let ball = draw(&organ, RendererConfig::live(), &mut shot);
    let mut drawn = |radius_m| {
        organ.tool = Tool::Fingertip(Fingertip { radius_m, stiffness_n_m: 400.0 });
        let image = draw(&organ, RendererConfig::live(), &mut shot);
        save(&image, "fingertip.png");
        // The organ, without text and side view.
        (0..720 * 1280)
            .filter(|at| (at % 1280) < 830 && at / 1280 < 540)
            .filter(|&at| {
                let (x, y) = (at % 1280, at / 1280);
                image.pixel(x, y) != ball.pixel(x, y)
            })
            .count()
    };
    let (small, large) = (drawn(0.006), drawn(0.012));
    assert!(small > 1_000 && large > small + 2_000, "{small} {large}");
}

/// The verdict on the touched place is written in its colour, and the most severe one of the places counts.
#[test]
fn the_verdict_on_the_touched_place_is_visible() {
    let blob = blob();
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let mut shot = shots(&organ, &[1_050]).pop().expect("one");
    assert_eq!(shot.record.engaged, Some(0));
    let mut drawn = |verdicts: Vec<Verdict>| {
        let mut renderer = Renderer::new(&organ, Method::Tricubic.name(), RendererConfig::live());
        renderer.set_verdicts(vec![verdicts]);
        let image = renderer.render(&organ, &shot.record, &mut shot.live).clone();
        // The row of the panel.
        image
            .pixels()
            .chunks(1280)
            .take(240)
            .skip(216)
            .flat_map(|row| row[1_130..1_250].to_vec())
            .collect::<Vec<u32>>()
    };
    let [green, yellow, red] = [Verdict::Green, Verdict::Yellow, Verdict::Red].map(|one| drawn(vec![one]));
    let has = |row: &[u32], is: fn(i32, i32, i32) -> bool| {
        row.iter().any(|p| is((p >> 16 & 255) as i32, (p >> 8 & 255) as i32, (p & 255) as i32))
    };
    assert!(has(&green, |r, g, _| g > 180 && g - r > 50) && !has(&green, |r, g, _| r - g > 60));
    assert!(has(&red, |r, g, _| r > 200 && r - g > 80));
    assert!(has(&yellow, |r, g, b| r > 190 && g > 150 && r - b > 90));
    // Another place's verdict does not count; without one it is unknown.
    assert_eq!(drawn(vec![Verdict::Green, Verdict::Red]), green);
    assert_eq!(drawn(Vec::new()), drawn(vec![Verdict::Unknown]));
    assert!(drawn(Vec::new()) != green && drawn(Vec::new()) != red);
}

/// A surface with 200 active nodes: all are drawn as dots, none is named, and the organ stays visible.
#[test]
fn many_active_nodes_do_not_cover_the_organ() {
    let blob = blob();
    let mut organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let few = shots(&organ, &[100]).pop().expect("one");
    let mut few_image = Shot { record: few.record, live: few.live.clone() };
    let few_image = draw(&organ, RendererConfig::live(), &mut few_image);
    let [x, y, z] = organ.surface.position_m;
    for vertex in
        (0..organ.surface.node.len()).filter(|i| i % 11 == 3 && organ.surface.fixed[*i] == 0).take(197)
    {
        let mut space = organ.spaces[0].clone();
        space.active.node = organ.surface.node[vertex];
        space.active.rest_position_m = [x[vertex], y[vertex], z[vertex]];
        let axes_m = synthetic::Shape::default().half_axes_m;
        let normal = core::array::from_fn(|axis| space.active.rest_position_m[axis] / axes_m[axis].powi(2));
        space.active.outward_normal = vec3::normalize_or_zero(normal);
        assert!(organ.spaces.push(space).is_ok());
    }
    assert!(organ.spaces.len() > 150);
    let mut shot = Shot { record: few.record, live: few.live };
    let image = draw(&organ, RendererConfig::live(), &mut shot);
    save(&image, "many.png");
    let white = |r: i32, g: i32, b: i32| r > 150 && g > 145 && b > 135;
    // In the area of the organ (the text is white too), each of the dots on this side begins a white run on one row
    // or two; the highlight begins one per row.
    let runs = |image: &Image| -> usize {
        let is_white =
            |pixel: &u32| white((pixel >> 16 & 255) as i32, (pixel >> 8 & 255) as i32, (pixel & 255) as i32);
        let rows = image.pixels().chunks(1280).skip(90).take(470).map(|row| &row[330..900]);
        rows.map(|row| row.windows(2).filter(|pair| !is_white(&pair[0]) && is_white(&pair[1])).count()).sum()
    };
    let [many, few] = [&image, &few_image].map(runs);
    assert!(many > few + 70 && many < few + 400, "{many} {few}");
    assert!(count(&image, red) > 40_000, "{}", count(&image, red));
}

/// Path of the reference picture: a pressed organ, small enough for a repository.
fn reference() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reference/pressed.png")
}

/// Mean difference per channel, of 255, in the worst of 8 by 6 tiles.
fn worst_tile(a: &Image, b: &Image) -> f32 {
    let (columns, rows) = (8, 6);
    let mut sums = vec![(0.0_f32, 0_u32); columns * rows];
    for (index, (a, b)) in a.pixels().iter().zip(b.pixels()).enumerate() {
        let (x, y) = (index % 640 * columns / 640, index / 640 * rows / 360);
        let channel = |shift: u32| ((a >> shift & 255) as f32 - (b >> shift & 255) as f32).abs();
        let tile = &mut sums[y * columns + x];
        *tile = (tile.0 + channel(16) + channel(8) + channel(0), tile.1 + 3);
    }
    sums.iter().map(|(sum, count)| sum / *count as f32).fold(0.0, f32::max)
}

/// Compares with a picture checked by a person. Drawing is deterministic up to the last bits of the vector
/// instructions.
#[test]
fn the_picture_matches_the_reference() {
    const TOLERANCE: f32 = 0.4;
    let blob = blob();
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let small = RendererConfig { width: 640, height: 360, samples: 2 };
    let mut found = shots(&organ, &[100, 1_050]);
    let image = draw(&organ, small, &mut found[1]);
    if std::env::var_os("PALPATE_WRITE_REFERENCE").is_some() {
        std::fs::write(reference(), still(&image).expect("a picture")).expect("writable");
    }
    let expected = read(&reference());
    assert_eq!((expected.width(), expected.height()), (640, 360));
    let error = worst_tile(&image, &expected);
    assert!(error < TOLERANCE, "{error} of 255 in the worst tile");

    // The comparison must detect another state of the organ, a missing legend, and two exchanged colours.
    let other_state = worst_tile(&draw(&organ, small, &mut found[0]), &expected);
    let mut bare = image.clone();
    bare.fill_rect(595, 215, 30, 105, 0x14_191f, 1.0);
    let mut exchanged = image.clone();
    for pixel in exchanged.pixels_mut() {
        *pixel = (*pixel & 0xff_0000) | (*pixel & 0xff) << 8 | (*pixel >> 8 & 0xff);
    }
    let faults = [other_state, worst_tile(&bare, &expected), worst_tile(&exchanged, &expected)];
    assert!(faults.iter().all(|error| *error > 3.0 * TOLERANCE), "{faults:?}");
}

fn read(path: &Path) -> Image {
    let file = File::open(path).expect("the reference is in the repository");
    let mut reader = png::Decoder::new(BufReader::new(file)).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("small")];
    let info = reader.next_frame(&mut bytes).expect("a frame");
    let mut image = Image::new(info.width as usize, info.height as usize);
    for (pixel, rgb) in image.pixels_mut().iter_mut().zip(bytes.chunks_exact(3)) {
        *pixel = u32::from_be_bytes([0, rgb[0], rgb[1], rgb[2]]);
    }
    image
}
