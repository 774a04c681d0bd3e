//! Limits of the motion and of the torque.

use palpate_link::clamp_torque;
use palpate_link::{
    Device, DeviceFault, DeviceMessage, DeviceProfile, HostMessage, Phase, ProfileError, VERSION, message,
};

use super::bench::{Bench, profile};

#[test]
fn overspeed_is_a_fault_only_while_enabled() {
    let mut bench = Bench::linked();
    bench.inputs.encoders = [1000, 0, 0];
    bench.step(100);
    bench.enable();
    bench.step(100);
    assert_eq!(bench.device.phase(), Phase::Enabled);
    bench.inputs.encoders = [1021, 0, 0];
    bench.step(100);
    assert_eq!(bench.device.phase(), Phase::Faulted(DeviceFault::Overspeed));
}

#[test]
fn an_invalid_profile_is_refused() {
    let mut bad = profile();
    bad.info.watchdog_us = 20_001;
    assert!(matches!(Device::new(bad), Err(ProfileError::Info(_))));
    let slow = DeviceProfile { max_speed_counts_per_s: 999, ..profile() };
    assert_eq!(Device::new(slow), Err(ProfileError::MaxSpeed { max_speed_counts_per_s: 999 }));
}

#[test]
fn a_missing_axis_gets_no_torque() {
    let mut bench = Bench::linked();
    let mut profile = profile();
    profile.info.dof = 2;
    bench.device = Device::new(profile).expect("two axes");
    bench.session = 0;
    bench.step(0);
    match bench.receive(HostMessage::Hello { version: VERSION, nonce: 1 }) {
        Some(DeviceMessage::HelloAck { session, .. }) => (bench.session, bench.seq) = (session, 0),
        other => panic!("{other:?}"),
    }
    bench.enable();
    bench.command([100, -200, i32::MIN], 3000);
    bench.inputs.encoders[2] = i32::MIN;
    assert_eq!(bench.step(100).torque_unm, [100, -200, 0]);
}

#[test]
fn a_clamped_torque_is_reported() {
    let mut bench = Bench::enabled();
    let flags = |answer| match answer {
        Some(DeviceMessage::State { flags, .. }) => flags & message::CLAMPED,
        other => panic!("{other:?}"),
    };
    assert_eq!(flags(bench.command([500_000, -400_000, 250_000], 3000)), 0);
    assert_eq!(bench.step(0).torque_unm, [500_000, -400_000, 250_000]);
    assert_eq!(flags(bench.command([0, -800_000, 250_000], 3000)), message::CLAMPED);
    assert_eq!(bench.step(0).torque_unm, [0, -400_000, 125_000]);
    assert_eq!(flags(bench.command([i32::MIN; 3], 3000)), message::CLAMPED);
    assert_eq!(bench.step(0).torque_unm, [-250_000; 3]);
    assert_eq!(clamp_torque([i32::MIN, 0, i32::MAX], [u32::MAX; 3]), ([-i32::MAX, 0, i32::MAX], true));
}
