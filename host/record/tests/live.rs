//! A live session is recorded with its jets and its organ; its replay gives the same bits.

#[path = "../../tests/common/fake_solver.rs"]
mod fake_solver;

use core::sync::atomic::AtomicBool;
use fake_solver::FakeSolver;
use palpate_core::{Config, Coverage, Fault, Organ, Phase, Solver};
use palpate_host::device::palpation::RandomConfig;
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::live::{LiveField, TakenJet, local};
use palpate_host::model::{self, TouchMemory};
use palpate_host::rt::{Clock, Controls, HapticLoop, LoopConfig, Outputs, TickRecord, VirtualClock};
use palpate_host::{BlobFile, Device};
use palpate_record::replay::{Pace, ReplayError, ReplaySummary};
use palpate_record::{Header, Recorder, Recording, RecordingError, TickWriter, replay};

const BLOB: &[u8] = include_bytes!("../../../firmware-like-core/golden/organ-514.blob");
const TICKS: u64 = 6_000;

struct Session {
    header: Header,
    records: Vec<TickRecord>,
    jets: Vec<TakenJet>,
}

/// Touches in which the solver lags, is silent and ends; damaged frames are among its jets.
fn session() -> Session {
    let file = BlobFile::of(BLOB);
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("a valid blob");
    let (config, timing) = (Config::live(), LoopConfig::default());
    let random = Some(RandomConfig::new(5));
    let hand = SimulatedHand::new(&organ, SimulatedConfig { random, ..SimulatedConfig::default() });
    let header =
        Header::new(&organ, vec![file.blake3()], config, timing, hand.info(), 1_700_000_000_000_000_000);
    let mut memory = TouchMemory::default();
    let controllers = model::controllers(&[&organ], config, &mut memory).expect("no table is needed");
    let (end, for_loop, _view) = local(0);
    let mut solver = FakeSolver::new(end, organ.spaces.len() as u16);
    let (records, mut recorded) = rtrb::RingBuffer::new(TICKS as usize);
    let (taken, mut jets) = rtrb::RingBuffer::new(TICKS as usize);
    let (latest, _newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let live = LiveField::new(for_loop).expect("memory").with_recording(Some(taken));
    let outputs = Outputs { records, latest };
    let mut haptic = HapticLoop::live(controllers[0], live, hand, &clock, timing, &controls, outputs);
    for index in 0..TICKS {
        clock.wait_until(index * 1_000_000, 0);
        clock.advance_ns(index * 7_919 % 40_000);
        // Late by 0.3 s again and again, and at last gone; then the user resets, and it is there again.
        if index % 1_000 < 700 && !(3_000..4_500).contains(&index) {
            solver.turn(clock.now_ns());
        }
        if index % 500 == 250 {
            let mut damaged = fake_solver::jet(0, 9, [0.0; 3]);
            damaged.trust_m = f32::NAN;
            let _ = solver.end.try_send(&damaged);
        }
        if index == 4_600 {
            controls.reset();
            controls.arm();
        }
        haptic.tick(index, 0, index * 1_000_000).expect("the simulated hand never fails");
    }
    let records = core::iter::from_fn(|| recorded.pop().ok()).collect();
    Session { header, records, jets: core::iter::from_fn(|| jets.pop().ok()).collect() }
}

impl Session {
    /// The file, jets before their ticks.
    fn file(&self) -> Vec<u8> {
        let mut writer = TickWriter::live(Vec::new(), &self.header, BLOB).expect("memory");
        let mut jets = self.jets.iter().peekable();
        for record in &self.records {
            while let Some(jet) = jets.next_if(|jet| jet.tick <= record.tick) {
                writer.write_jet(jet).expect("memory");
            }
            writer.write(record).expect("memory");
        }
        writer.finish(None).expect("memory")
    }

    fn replay(&self) -> ReplaySummary {
        replayed(&self.file())
    }
}

fn replayed(file: &[u8]) -> ReplaySummary {
    let mut recording = Recording::open(file).expect("valid");
    // The recording is all that a replay needs.
    let blob = recording.organ().expect("it holds its organ").clone();
    assert_eq!(blob.bytes(), BLOB);
    let organ: Organ<'_> = Organ::read(blob.bytes()).expect("a valid blob");
    let (hashes, go) = ([blob.blake3()], AtomicBool::new(false));
    let mut ignore = |_: &TickRecord| ();
    replay(&[&organ], &hashes, &mut recording, None, &go, &mut ignore, Pace::Unseen)
        .expect("it can be replayed")
}

#[test]
fn a_live_session_is_replayed_with_the_same_bits() {
    let session = session();
    let count = |is: fn(&TickRecord) -> bool| session.records.iter().filter(|record| is(record)).count();
    let live = |record: &TickRecord| record.live.expect("a live tick");
    // It contains what the force depends on.
    assert!(count(|r| r.engaged.is_some() && r.hand_force_n != [0.0; 3]) > 1_000);
    assert!(count(|r| r.coverage == Some(Coverage::Extrapolated)) > 50);
    assert!(count(|r| r.phase == Phase::SafeZero(Fault::Solver)) > 50);
    for state in [Solver::Alive, Solver::Silent, Solver::Gone] {
        assert!(
            session.records.iter().filter(|record| live(record).solver == state).count() > 200,
            "{state:?}"
        );
    }
    let last = live(session.records.last().expect("ticks"));
    assert!(last.hand_overs > 10 && session.jets.len() >= 20, "{last:?}, {} jets", session.jets.len());
    assert_eq!(last.jets as usize, session.jets.len());
    let summary = session.replay();
    assert!(summary.is_identical() && summary.ticks == TICKS, "{summary}");
    assert_eq!((summary.method_name(), summary.touch.hand_overs), ("jets", last.hand_overs));
    assert!(summary.to_string().contains("6000 ticks, all forces bit-identical"), "{summary}");
}

#[test]
fn a_missing_changed_or_late_jet_is_detected() {
    let mut session = session();
    // A jet of the displacement that the tool has in its tick.
    let is_used = |jet: &TakenJet| {
        let decoded = palpate_core::Jet::decode(&jet.frame);
        jet.tick < 2_500 && decoded.is_ok_and(|jet| jet.control_m != [0.0; 3])
    };
    let at = session.jets.iter().position(is_used).expect("a jet in a touch");
    let good = session.jets.clone();

    session.jets.remove(at);
    let summary = session.replay();
    assert!(!summary.is_identical() && summary.lost_jets == 1, "{summary}");
    assert!(summary.ticks < TICKS && summary.to_string().contains("1 jets are missing"), "{summary}");

    // A frame that the replay refuses.
    session.jets = good.clone();
    session.jets[at].frame[40] ^= 1;
    let summary = session.replay();
    assert!(summary.different > 0 && summary.lost_jets == 0, "{summary}");
    assert!(summary.first.is_some_and(|first| first.tick >= good[at].tick), "{summary}");

    // One tick too late.
    session.jets = good.clone();
    session.jets[at].tick += 1;
    let summary = session.replay();
    assert!(!summary.is_identical(), "{summary}");

    // The state of the solver in one tick of a fade.
    session.jets = good;
    let state = session.records[3_300].live.as_mut().expect("a live tick");
    assert_eq!(core::mem::replace(&mut state.solver, Solver::Alive), Solver::Gone);
    assert!(!session.replay().is_identical());
}

#[test]
fn a_live_recording_needs_its_organ_and_takes_no_method() {
    let session = session();
    let without = TickWriter::new(Vec::new(), &session.header).expect("memory").finish(None).expect("memory");
    let refused = Recording::open(without.as_slice()).expect_err("no organ");
    assert!(refused.to_string().contains("organ.blob"), "{refused}");

    let file = session.file();
    let mut recording = Recording::open(file.as_slice()).expect("valid");
    let blob = BlobFile::of(BLOB);
    let organ: Organ<'_> = Organ::read(blob.bytes()).expect("a valid blob");
    let (hashes, go) = ([blob.blake3()], AtomicBool::new(false));
    let method = Some(palpate_core::Method::Trilinear);
    let mut ignore = |_: &TickRecord| ();
    let refused = replay(&[&organ], &hashes, &mut recording, method, &go, &mut ignore, Pace::Unseen);
    assert!(matches!(refused, Err(ReplayError::Live)));

    let too_large = TickWriter::live(Vec::new(), &session.header, &vec![0; 1 << 26]).expect_err("64 MB");
    assert!(matches!(too_large, RecordingError::Organ(_)), "{too_large}");
}

/// The recorder's thread gets ticks and jets by two queues, and keeps their order. A cut file is replayed up to
/// its end.
#[test]
fn the_recorder_writes_every_jet_before_its_tick() {
    let session = session();
    let stream = Shared::default();
    let (recorder, mut queues) =
        Recorder::start_live(stream.clone(), &session.header, BLOB).expect("the header fits");
    let mut jets = session.jets.iter().peekable();
    for record in &session.records {
        while let Some(jet) = jets.next_if(|jet| jet.tick <= record.tick) {
            queues.jets.push(*jet).expect("room");
        }
        queues.ticks.push(*record).expect("room");
        if record.tick % 100 == 0 {
            std::thread::sleep(core::time::Duration::from_micros(300));
        }
    }
    let report = recorder.finish(None);
    assert_eq!((report.ticks, report.dropped), (TICKS, 0), "{report:?}");
    let file = stream.0.lock().expect("no panic").clone();
    let summary = replayed(&file);
    assert!(summary.is_identical() && summary.ticks == TICKS, "{summary}");
    let summary = replayed(&file[..file.len() * 2 / 3]);
    assert!(summary.is_identical() && summary.is_cut && summary.ticks > TICKS / 2, "{summary}");
}

#[derive(Debug, Clone, Default)]
struct Shared(std::sync::Arc<std::sync::Mutex<Vec<u8>>>);

impl std::io::Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().expect("no panic").extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}
