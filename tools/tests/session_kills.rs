//! Sessions that record a touch on a device with motors, ended by SIGKILL at random moments: the device has zero
//! force, the recording is readable and replays with the same bits, the input is intact, and the next session
//! starts. `tests/kills` runs it with other seeds.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use palpate_core::vec3;
use palpate_precompute::mesh::Surface;
use palpate_precompute::scene::Scene;

use crate::guard::{Device, Session, files, profile_at};
use crate::space_faults::Draws;
use crate::{number_of, quiet, text};

/// `PALPATE_KILLS` gives another number, and `PALPATE_SEED` other moments.
const KILLS: u64 = 8;
const SCENE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/liver-small.toml");
/// A chunk of a recording holds one second of ticks, which a kill loses; the rest is for the queue and for a busy
/// machine.
const MAX_LOST_TICKS: u64 = 1_000 + 500;
/// Longest time until the force is zero: the guard's limit is 10 ms. A busy machine may run the guard or this test
/// later in a few of the kills, but never as late as the second.
const USUAL_ZERO: Duration = Duration::from_millis(30);
const MAX_ZERO: Duration = Duration::from_millis(500);
/// How long the force must stay zero.
const ZERO_HOLD: Duration = Duration::from_millis(100);
/// Longest time until a session exchanges with its device.
const MAX_START: Duration = Duration::from_secs(30);

/// What a session touches: the command with its input, and the profile.
struct Touched {
    command: Vec<String>,
    input: PathBuf,
    profile: PathBuf,
}

impl Touched {
    fn blob(folder: &Path) -> Self {
        let (input, profile) = files(folder);
        Self { command: vec!["run".into(), text(&input).into(), "--uncertified".into()], input, profile }
    }

    /// The bundled organ, with the device above its first active node.
    fn live(folder: &Path) -> Self {
        let scene = Scene::load(SCENE.as_ref()).and_then(|scene| scene.resolve()).expect("bundled");
        let node = scene.active[0].node;
        let f32s = |x: [f64; 3]| x.map(|x| x as f32);
        let normal = Surface::of(&scene.mesh).normal(node).expect("on the skin");
        let place_m = scene.mesh.nodes_m[node as usize];
        let profile = folder.join("live.toml");
        std::fs::write(&profile, profile_at("polhem", f32s(place_m), f32s(normal))).expect("written");
        Self { command: vec!["live".into(), SCENE.into()], input: SCENE.into(), profile }
    }

    fn words(&self) -> Vec<&str> {
        self.command.iter().map(String::as_str).collect()
    }

    fn start(&self, device: &Device, recording: &Path) -> Session {
        device.session(&self.words(), &self.profile, &["--record", text(recording)])
    }
}

/// Counts over the kills.
#[derive(Debug, Default)]
struct Counts {
    /// Kills with a force on the hand.
    with_force: u64,
    /// Kills before the first chunk of the recording.
    unrecorded: u64,
    replayed_ticks: u64,
    most_lost: u64,
    slowest_zero: Duration,
    /// Zero force later than `USUAL_ZERO`.
    late_zeros: u64,
    /// Sessions that ended, or lost contact, before their kill.
    ended: u64,
}

/// Kills a session and checks what it leaves behind.
fn killed(touched: &Touched, device: &Device, session: Session, recording: &Path, counts: &mut Counts) {
    let solver = children(session.pid());
    let before = device.felt();
    session.signal(Signal::SIGKILL);
    let began = Instant::now();
    counts.with_force += u64::from(before.force_n != vec3::ZERO);
    while device.felt().force_n != vec3::ZERO {
        assert!(
            began.elapsed() < MAX_ZERO,
            "a force {:?} after the session: {:?}",
            began.elapsed(),
            device.felt()
        );
        std::thread::sleep(Duration::from_micros(200));
    }
    counts.late_zeros += u64::from(began.elapsed() > USUAL_ZERO);
    counts.slowest_zero = counts.slowest_zero.max(began.elapsed());
    drop(session.end());
    let requests = device.felt().requests;
    while began.elapsed() < counts.slowest_zero + ZERO_HOLD {
        assert_eq!(device.felt().force_n, vec3::ZERO, "a force returned after the session");
        std::thread::sleep(Duration::from_micros(500));
    }
    for process in solver {
        while kill(process, None).is_ok() && !is_zombie(process) {
            assert!(began.elapsed() < MAX_START, "process {process} outlives its session");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
    check_recording(touched, recording, requests, counts);
}

/// The processes whose parent is `parent`: guard and solver.
fn children(parent: Pid) -> Vec<Pid> {
    let listed =
        std::fs::read_to_string(format!("/proc/{parent}/task/{parent}/children")).unwrap_or_default();
    listed.split_whitespace().filter_map(|pid| pid.parse().ok().map(Pid::from_raw)).collect()
}

/// An orphan that has ended and that its new parent has not reaped yet.
fn is_zombie(process: Pid) -> bool {
    std::fs::read_to_string(format!("/proc/{process}/stat")).is_ok_and(|stat| stat.contains(") Z "))
}

/// At most the last second is missing, and the rest replays with the same bits.
fn check_recording(touched: &Touched, recording: &Path, requests: u64, counts: &mut Counts) {
    let inspected = palpate(&["inspect", text(recording), "--json"]);
    let said = String::from_utf8_lossy(&inspected.stderr).into_owned();
    let figures: serde_json::Value = serde_json::from_slice(&inspected.stdout).unwrap_or_default();
    let ticks = figures["ticks"].as_u64().unwrap_or(0);
    let lost = requests.saturating_sub(ticks);
    counts.most_lost = counts.most_lost.max(lost);
    assert!(lost <= MAX_LOST_TICKS, "{requests} requests, {ticks} recorded ticks: {said}");
    if ticks == 0 {
        // No header yet, or no tick: an error of one line, or an empty recording.
        assert!(inspected.status.success() || said.lines().count() == 1, "{said}");
        counts.unrecorded += 1;
        return;
    }
    assert!(figures["cut"] == true && figures["lost"] == 0, "{figures:#}");
    let (replay, words) = (format!("replay:{}", text(recording)), touched.words());
    let replayed = palpate(&[&words[..], &["--device", &replay, "--headless", "--frame-rate", "0"]].concat());
    let told = String::from_utf8_lossy(&replayed.stdout);
    let bits = format!("{ticks} ticks, all forces bit-identical");
    assert!(
        replayed.status.success() && told.contains(&bits),
        "{told}{}",
        String::from_utf8_lossy(&replayed.stderr)
    );
    counts.replayed_ticks += ticks;
}

/// A command to its end, while this test holds back those of others.
fn palpate(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_palpate")).args(arguments).output().expect("it runs")
}

/// Whether the session exchanges with the device.
fn exchanges(device: &Device, more: u64) -> bool {
    let (began, before) = (Instant::now(), device.felt().requests);
    while began.elapsed() < MAX_START {
        if device.felt().requests >= before + more {
            return true;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    false
}

/// Kills sessions: of each device one in contact and, as it starts again there, one that is not armed.
fn kills(touched: &Touched, folder: &Path) {
    let _quiet = quiet();
    let (wanted, mut draws) = (number_of("PALPATE_KILLS", KILLS), Draws(number_of("PALPATE_SEED", 5)));
    let (began, input) = (Instant::now(), std::fs::read(&touched.input).expect("there"));
    let mut counts = Counts::default();
    let mut done = 0;
    while done < wanted {
        assert!(counts.ended <= 2 * wanted + 4, "sessions end before they are killed: {counts:?}");
        let device = Device::new();
        let recording = folder.join(format!("{done}.mcap"));
        let mut session = touched.start(&device, &recording);
        assert!(exchanges(&device, 10), "no session: {}", String::from_utf8_lossy(&session.end().stderr));
        // Most are killed while the hand pushes.
        let in_contact = draws.unit() < 0.8;
        let is_ready = !in_contact || device.leans();
        std::thread::sleep(Duration::from_secs_f64(if in_contact { 1.6 } else { 0.6 } * draws.unit()));
        if !is_ready || in_contact && !device.leans() || session.has_ended() {
            // The loop has faulted on a busy machine.
            if !session.has_ended() {
                session.signal(Signal::SIGKILL);
            }
            drop(session.end());
            // The next one records to the same name.
            let _ = std::fs::remove_file(&recording);
            counts.ended += 1;
            continue;
        }
        killed(touched, &device, session, &recording, &mut counts);
        done += 1;
        if done < wanted {
            let (again, before) = (folder.join(format!("{done}.mcap")), device.felt().requests);
            let session = touched.start(&device, &again);
            assert!(
                exchanges(&device, 10),
                "no next session: {}",
                String::from_utf8_lossy(&session.end().stderr)
            );
            std::thread::sleep(Duration::from_secs_f64(0.3 * draws.unit()));
            // Its first chunk is not full, so nothing of it needs to be there.
            assert!(device.felt().requests < before + MAX_LOST_TICKS);
            session.signal(Signal::SIGKILL);
            drop(session.end());
            assert_eq!(device.felt().force_n, vec3::ZERO, "a session that is not armed has no force");
            let inspected = palpate(&["inspect", text(&again)]);
            let said = String::from_utf8_lossy(&inspected.stderr);
            assert!(inspected.status.success() || said.lines().count() == 1, "{said}");
            done += 1;
        }
        assert!(std::fs::read(&touched.input).expect("there") == input, "the input has changed");
    }
    println!(
        "{done} kills of `palpate {}` ({:.1} s): {counts:?}",
        touched.command[0],
        began.elapsed().as_secs_f64()
    );
    assert!(10 * counts.late_zeros <= wanted + 9, "the force is late: {counts:?}");
    assert!(wanted < KILLS || counts.with_force > 0 && counts.replayed_ticks > 0, "{counts:?}");
}

#[test]
fn a_killed_run_leaves_no_force_and_a_readable_recording() {
    let folder = tempfile::tempdir().expect("a folder");
    kills(&Touched::blob(folder.path()), folder.path());
}

#[test]
fn a_killed_live_session_leaves_no_force_and_a_readable_recording() {
    let folder = tempfile::tempdir().expect("a folder");
    kills(&Touched::live(folder.path()), folder.path());
}
