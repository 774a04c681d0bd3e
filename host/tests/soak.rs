//! Half an hour of random palpation on a simulated device, in virtual time: no drift and no growth of memory.
//!
//! The same in real time:
//! `palpate run FILE.blob --device sim:random:1 --profile falcon --headless --seconds 1800`

use crate::synthetic;
use palpate_core::{Method, Organ, Phase, vec3};
use palpate_host::Device;
use palpate_host::device::palpation::RandomConfig;
use palpate_host::device::profile::Profile;
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::model::{self, TouchMemory};
use palpate_host::rt::{Clock, Controls, HapticLoop, LoopConfig, Outputs, TickRecord, VirtualClock};
use palpate_host::settings::controller_config;

/// 1.8 million ticks; a sixth of that without optimisation.
const MINUTES: u64 = if cfg!(debug_assertions) { 5 } else { 30 };

/// Statistics of a minute.
#[derive(Debug, Clone, Copy, Default)]
struct Minute {
    contacts: u64,
    engaged_ticks: u64,
    /// Work of the command on the hand in the model, sum of F . dx, J.
    work_j: f64,
    peak_n: f32,
}

/// Selects one statistic.
type Statistic = fn(&Minute) -> f64;

/// Resident memory of this process, kB; `None` if the system does not report it.
fn resident_kb() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.split_whitespace().next()?.parse().ok()
}

#[test]
fn half_an_hour_without_drift_or_memory_growth() {
    let this = std::env::current_exe().expect("a test has a file");
    let alone = ["--ignored", "--exact", "soak::memory_of_this_process", "--nocapture"];
    let output = std::process::Command::new(this).args(alone).output().expect("it starts");
    let text = [output.stdout, output.stderr].concat();
    let text = String::from_utf8_lossy(&text);
    print!("{text}");
    assert!(output.status.success() && text.contains("1 passed"), "{text}");
}

#[test]
#[ignore = "the memory of other tests would be counted; the test above starts it alone"]
fn memory_of_this_process() {
    let shape = synthetic::Shape { stiffness_n_m: 400.0, patch: 40, ..synthetic::Shape::default() };
    let blob = synthetic::organ(&shape);
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let profile = Profile::bundled("falcon").expect("bundled");
    let random = Some(RandomConfig::new(1));
    let mut hand =
        SimulatedHand::new(&organ, SimulatedConfig { random, ..SimulatedConfig::for_profile(&profile) });
    let config = controller_config(&[&organ], Method::Trilinear, &hand.info(), Some(&profile));
    let mut memory = TouchMemory::default();
    let controller = model::controllers(&[&organ], config, &mut memory).expect("has the method")[0];
    let (records, mut drained) = rtrb::RingBuffer::new(1_024);
    let (latest, _newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let loop_config = LoopConfig { period_us: profile.period_us(), ..LoopConfig::default() };
    let outputs = Outputs { records, latest };
    let mut haptic = HapticLoop::new(controller, &mut hand, &clock, loop_config, &controls, outputs);

    let mut minutes = Vec::with_capacity(MINUTES as usize);
    let mut before = TickRecord::EMPTY;
    let mut resident_after_a_minute = None;
    for minute in 0..MINUTES {
        let mut sum = Minute::default();
        for tick in minute * 60_000..(minute + 1) * 60_000 {
            let deadline_ns = tick * 1_000_000;
            clock.wait_until(deadline_ns, 0);
            haptic.tick(tick, 0, deadline_ns).expect("the simulated hand never fails");
            let record = drained.pop().expect("one record a tick");
            assert_eq!((record.tick, record.phase), (tick, Phase::Active), "{record:?}");
            let size_n = vec3::norm(record.hand_force_n);
            assert!(vec3::is_finite(record.hip_m) && size_n <= profile.max_force_n, "{record:?}");
            sum.contacts += u64::from(record.engaged.is_some() && before.engaged.is_none());
            sum.engaged_ticks += u64::from(record.engaged.is_some());
            sum.work_j += f64::from(vec3::dot(before.hand_force_n, vec3::sub(record.hip_m, before.hip_m)));
            sum.peak_n = sum.peak_n.max(size_n);
            before = record;
        }
        minutes.push(sum);
        resident_after_a_minute = resident_after_a_minute.or_else(resident_kb);
    }
    let resident_kb_at_the_end = resident_kb();
    drop(haptic);
    println!(
        "{MINUTES} minutes; first {:?}, last {:?}; memory {resident_after_a_minute:?} kB after one, \
         {resident_kb_at_the_end:?} kB at the end; {:?}",
        minutes[0],
        minutes[minutes.len() - 1],
        hand.work()
    );

    // The hand works on the organ in every minute, and gets back less than it gives: some grasps release a
    // displaced organ.
    for sum in &minutes {
        assert!(sum.contacts >= 8 && sum.engaged_ticks > 10_000, "{sum:?}");
        // A contact across the boundary of two minutes returns in the second what it stored in the first: a
        // few mJ.
        assert!(sum.work_j < 2e-3 && sum.work_j > -1.0, "{sum:?}");
    }
    assert!(
        minutes.iter().map(|sum| sum.work_j).sum::<f64>() < -0.1,
        "energy is lost when a grasp is released"
    );
    // There is no trend: both halves agree within the random variation of some three hundred contacts.
    let halves = minutes.split_at(minutes.len() / 2);
    let mean = |half: &[Minute], of: Statistic| half.iter().map(of).sum::<f64>() / half.len() as f64;
    let of: [(&str, Statistic); 3] = [
        ("contacts", |m| m.contacts as f64),
        ("ticks in contact", |m| m.engaged_ticks as f64),
        ("work", |m| m.work_j),
    ];
    for (what, of) in of {
        let (first, second) = (mean(halves.0, of), mean(halves.1, of));
        println!("{what} per minute: {first:.4} in the first half, {second:.4} in the second");
        assert!((second / first - 1.0).abs() < 0.3, "{what}: {first}, then {second}");
    }
    if let (Some(early_kb), Some(late_kb)) = (resident_after_a_minute, resident_kb_at_the_end) {
        assert!(late_kb < early_kb + 256, "{early_kb} kB after a minute, {late_kb} kB at the end");
    }
}
