//! A session with all kinds of events is recorded; its replay gives the same bits.

use core::sync::atomic::AtomicBool;
use palpate_core::{Config, Fault, Method, Organ, Phase, Sample, Vec3};
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::model::{self, TouchMemory};
use palpate_host::rt::{Clock, Controls, HapticLoop, LoopConfig, Outputs, TickRecord, VirtualClock};
use palpate_host::{BlobFile, Device, DeviceError, DeviceErrorKind, DeviceInfo};
use palpate_record::replay::{Pace, ReplaySummary};
use palpate_record::{Header, Recording, TickWriter, replay};

/// Holes, branch jumps and every method.
const BLOB: &[u8] = include_bytes!("../../../firmware-like-core/golden/organ-514.blob");
const TICKS: u64 = 4_000;

/// A hand on a bad link: silence, errors, a press of the arming button, a position that is not finite.
struct BadLink {
    hand: SimulatedHand,
    calls: u64,
}

impl Device for BadLink {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let sample = self.hand.exchange(now_us, hand_force_n)?;
        self.calls += 1;
        let sample = sample.map(|sample| Sample {
            t_us: now_us.saturating_sub(137),
            // The arming button, pressed and released.
            buttons: sample.buttons & !2 | u32::from((20..40).contains(&self.calls)) << 1,
            ..sample
        });
        match self.calls {
            700..702 | 900..930 => Ok(None),
            1_200..1_206 => Err(DeviceError::new(DeviceErrorKind::Timeout)),
            3_400 => Ok(sample.map(|sample| Sample { position_m: [f32::NAN, 0.0, f32::INFINITY], ..sample })),
            _ => Ok(sample),
        }
    }

    fn stop(&mut self) {}

    fn info(&self) -> DeviceInfo {
        DeviceInfo {
            name: "bad link".into(),
            self_arming: false,
            max_force_n: 8.0,
            max_stiffness_n_m: 1e3,
            resolution_m: 3.0e-5,
        }
    }
}

struct Session {
    header: Header,
    records: Vec<TickRecord>,
}

fn with_organ<T>(then: impl FnOnce(&Organ<'_>, &str) -> T) -> T {
    let file = BlobFile::of(BLOB);
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("a valid blob");
    then(&organ, &file.blake3())
}

/// A session with late ticks, skipped deadlines and external requests.
fn session(organ: &Organ<'_>, blob: &str, method: Method) -> Session {
    let mut config = Config::new(method);
    config.limits.max_force_n = 3.3;
    let haptic_config = LoopConfig { arm_button: 2, ..LoopConfig::default() };
    let mut hand_config = SimulatedConfig::default();
    // Quick strokes: many contacts between the faults.
    hand_config.strokes.seconds_per_node = 1.0;
    let device = BadLink { hand: SimulatedHand::new(organ, hand_config), calls: 0 };
    let header = Header::new(
        organ,
        vec![blob.into()],
        config,
        haptic_config,
        device.info(),
        1_700_000_000_000_000_000,
    );
    let mut memory = TouchMemory::default();
    let controllers = model::controllers(&[organ], config, &mut memory).expect("has the method");
    let (producer, mut records) = rtrb::RingBuffer::new(TICKS as usize);
    let (latest, _newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let outputs = Outputs { records: producer, latest };
    let mut haptic = HapticLoop::with_models(&controllers, device, &clock, haptic_config, &controls, outputs);
    let mut skipped = 0;
    for index in 0..TICKS {
        // The deadlines during a stall of 3.4 ms.
        if [2_001, 2_002, 2_003].contains(&index) {
            skipped += 1;
            continue;
        }
        match index {
            // After the silence has latched a fault.
            1_000 => controls.reset(),
            1_001 | 1_600 | 3_600 => controls.arm(),
            1_500 => controls.disarm(),
            3_500 => {
                controls.reset();
                controls.arm();
            }
            _ => {}
        }
        let deadline_ns = index * 1_000_000;
        clock.wait_until(deadline_ns, 0);
        // Not a whole number of us, and always different.
        clock.advance_ns(index * 7_919 % 40_000 + if index == 2_000 { 3_400_000 } else { 0 });
        haptic.tick(index, 0, deadline_ns).expect("the errors of the link are transient");
    }
    let records = core::iter::from_fn(|| records.pop().ok())
        .map(|record| TickRecord { skipped_periods: if record.tick > 2_000 { skipped } else { 0 }, ..record })
        .collect();
    Session { header, records }
}

impl Session {
    fn file(&self) -> Vec<u8> {
        let mut writer = TickWriter::new(Vec::new(), &self.header).expect("memory");
        self.records.iter().for_each(|record| writer.write(record).expect("memory"));
        writer.finish(None).expect("memory")
    }

    fn replay(&self, organ: &Organ<'_>, blob: &str, method: Option<Method>) -> ReplaySummary {
        let file = self.file();
        let mut recording = Recording::open(file.as_slice()).expect("valid");
        let go = AtomicBool::new(false);
        replay(&[organ], &[blob.into()], &mut recording, method, &go, &mut |_: &TickRecord| (), Pace::Unseen)
            .expect("it can be replayed")
    }
}

#[test]
fn every_method_is_replayed_with_the_same_bits() {
    with_organ(|organ, blob| {
        for method in Method::OF_LATTICE {
            let session = session(organ, blob, method);
            let records = &session.records;
            // The session contains every kind of fault.
            let count = |is: fn(&TickRecord) -> bool| records.iter().filter(|record| is(record)).count();
            assert_eq!(records.len() as u64, TICKS - 3);
            assert!(count(|r| r.phase == Phase::Disarmed) > 100);
            assert!(count(|r| r.phase == Phase::SafeZero(Fault::Stale)) > 50);
            assert!(count(|r| r.phase == Phase::SafeZero(Fault::NotFinite)) > 50);
            assert!(count(|r| r.engaged.is_some()) > 500);
            assert!(count(|r| r.clamped) > 50 && count(|r| r.sample.is_none()) == 38);
            assert!(count(|r| r.applied.arm) == 4 && count(|r| r.applied.reset) == 2);
            let summary = session.replay(organ, blob, None);
            assert!(summary.is_identical(), "{}: {summary}", method.name());
            assert_eq!((summary.ticks, summary.method), (TICKS - 3, Some(method)));
            assert!(summary.touch.peak_reaction_n > 1.0, "{summary}");
            assert!(summary.to_string().contains("3997 ticks, all forces bit-identical"), "{summary}");
        }
    });
}

#[test]
fn a_changed_bit_of_a_sample_request_or_force_is_detected() {
    with_organ(|organ, blob| {
        let mut session = session(organ, blob, Method::Energy);
        let touched =
            session.records.iter().position(|r| r.tick > 2_200 && r.engaged.is_some() && !r.clamped);
        let at = touched.expect("a contact after the stall");
        let good = session.records[at];

        let sample = session.records[at].sample.as_mut().expect("the tick has a sample");
        sample.position_m[2] = f32::from_bits(sample.position_m[2].to_bits() ^ 1);
        let summary = session.replay(organ, blob, None);
        assert_eq!(summary.first.map(|first| first.tick), Some(good.tick), "{summary}");
        assert!(!summary.is_identical() && summary.to_string().contains("the first is tick"), "{summary}");

        session.records[at] = good;
        session.records[at].hand_force_n[0] = f32::from_bits(good.hand_force_n[0].to_bits() ^ 1);
        let summary = session.replay(organ, blob, None);
        assert_eq!((summary.different, summary.first.map(|first| first.tick)), (1, Some(good.tick)));

        session.records[at] = good;
        let disarmed = session.records.iter().position(|r| r.applied.disarm).expect("one");
        session.records[disarmed].applied.disarm = false;
        let summary = session.replay(organ, blob, None);
        assert_eq!(summary.first.map(|first| first.tick), Some(1_500), "{summary}");
    });
}

#[test]
fn another_method_replays_the_same_stroke_with_other_forces() {
    with_organ(|organ, blob| {
        let session = session(organ, blob, Method::Energy);
        let summary = session.replay(organ, blob, Some(Method::Trilinear));
        let largest = summary.largest.expect("the methods differ").size_n();
        assert!(largest > 1e-4 && largest < 6.7, "{summary}");
        assert_eq!((summary.ticks, summary.recorded_method), (TICKS - 3, Some(Method::Energy)));
        let text = summary.to_string();
        assert!(text.contains("recorded with energy, replayed with trilinear"), "{text}");
    });
}

#[test]
fn a_replay_ends_at_missing_records_and_reports_them() {
    with_organ(|organ, blob| {
        let mut session = session(organ, blob, Method::Hybrid);
        session.records.drain(1_800..1_805);
        let summary = session.replay(organ, blob, None);
        assert_eq!((summary.ticks, summary.different, summary.lost), (1_800, 0, 5));
        assert!(
            !summary.is_identical() && summary.to_string().contains("5 records are missing"),
            "{summary}"
        );
    });
}
