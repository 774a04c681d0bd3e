//! Random hosts, wires and mechanisms: invariants for any input.

use palpate_link::clamp_torque;
use palpate_link::{DeviceMessage, HostMessage, Outputs, Phase, VERSION};
use proptest::prelude::*;

use super::bench::{Bench, LIMIT_UNM};

/// The possible actions of a host, a wire and a mechanism.
#[derive(Debug, Clone)]
enum Act {
    Hello(u16),
    Send {
        kind: u8,
        session_ahead: u32,
        seq_ahead: i32,
        late_us: u32,
        torque_unm: [i32; 3],
        valid_for_us: u16,
    },
    Step {
        after_us: i64,
        homed: bool,
        fault: bool,
        moved: i32,
    },
}

fn any_act() -> impl Strategy<Value = Act> {
    let send = (0..4_u8, 0..20_u32, -2..40_i32, 0..6000_u32, any::<[i32; 3]>(), 0..9000_u16).prop_map(
        |(kind, other, ahead, late_us, torque_unm, valid_for_us)| Act::Send {
            kind,
            session_ahead: u32::from(other == 0),
            seq_ahead: if ahead <= 0 { ahead } else { 1 },
            late_us: late_us.saturating_sub(4000),
            torque_unm,
            valid_for_us,
        },
    );
    let step = (0..300_i64, prop::bool::weighted(0.97), prop::bool::weighted(0.01), -25..25_i32).prop_map(
        |(after_us, homed, fault, moved)| Act::Step {
            after_us: if after_us == 0 { -1 } else { after_us * 10 },
            homed,
            fault,
            moved: if moved.abs() > 22 { moved } else { moved / 8 },
        },
    );
    let hello = (0..20_u16).prop_map(|version| Act::Hello(if version == 0 { 2 } else { VERSION }));
    prop_oneof![1 => hello, 8 => send, 10 => step]
}

/// Applies actions and checks the invariants after each. Returns the number of torques and of latched faults.
fn play(acts: &[Act]) -> (u32, u32) {
    let mut bench = Bench::new();
    let (mut torques, mut faults) = (0, 0);
    // Whether the user has permitted a torque: the device is enabled, in a session without a fault.
    let mut allowed = false;
    for act in acts {
        let before = bench.device.phase();
        let mut new_session = false;
        match *act {
            Act::Hello(version) => {
                let answer = bench.receive(HostMessage::Hello { version, nonce: 7 });
                if let Some(DeviceMessage::HelloAck { session, .. }) = answer {
                    bench.session = session;
                    bench.seq = 0;
                }
                allowed = false;
                new_session = version == VERSION;
            }
            Act::Send { kind, session_ahead, seq_ahead, late_us, torque_unm, valid_for_us } => {
                let session = bench.session.wrapping_add(session_ahead);
                let seq = bench.seq.wrapping_add_signed(seq_ahead);
                if session_ahead == 0 && seq_ahead > 0 {
                    bench.seq = seq;
                }
                let message = match kind {
                    0 => HostMessage::Enable { session, seq },
                    1 if seq % 4 == 0 => HostMessage::Disable { session, seq },
                    1 if seq % 4 == 1 => HostMessage::Home { session, seq },
                    _ => {
                        let t_host_us = (bench.now_us as u32).wrapping_sub(late_us);
                        HostMessage::Command { session, seq, t_host_us, torque_unm, valid_for_us }
                    }
                };
                let answer = bench.receive(message);
                if matches!(message, HostMessage::Enable { .. }) && bench.answer_is(answer, true) {
                    allowed = true;
                }
                assert!(session_ahead == 0 || answer.is_none(), "another session is not answered");
                assert!(bench.device.phase() != Phase::Enabled || allowed);
            }
            Act::Step { after_us, homed, fault, moved } => {
                bench.now_us = bench.now_us.wrapping_add_signed(after_us);
                bench.inputs.homed = homed;
                bench.inputs.fault = fault;
                bench.inputs.encoders[0] = bench.inputs.encoders[0].wrapping_add(moved);
                let Outputs { torque_unm, home } = bench.step(0);
                assert_eq!(home, bench.device.phase() == Phase::Homing);
                assert!(
                    torque_unm.iter().zip(LIMIT_UNM).all(|(torque, limit)| torque.unsigned_abs() <= limit)
                );
                if torque_unm != [0; 3] {
                    torques += 1;
                    assert!(bench.device.phase() == Phase::Enabled && allowed && homed && !fault);
                }
            }
        }
        let after = bench.device.phase();
        if let Phase::Faulted(_) = after {
            allowed = false;
        }
        if let Phase::Faulted(_) = before {
            assert!(after == before || new_session, "a fault is cleared by a handshake only");
        } else if let Phase::Faulted(_) = after {
            faults += 1;
        }
    }
    (torques, faults)
}

proptest! {
    #[test]
    fn nothing_resumes_without_a_handshake(acts in prop::collection::vec(any_act(), 1..300)) {
        play(&acts);
    }

    #[test]
    fn clamping_keeps_the_direction(torque in any::<[i32; 3]>(), limit in prop::array::uniform3(1..=i32::MAX as u32)) {
        let (clamped, shortened) = clamp_torque(torque, limit);
        prop_assert!(clamped.iter().zip(limit).all(|(torque, limit)| torque.unsigned_abs() <= limit));
        let within = torque.iter().zip(limit).all(|(torque, limit)| torque.unsigned_abs() <= limit);
        prop_assert_eq!(shortened, !within);
        if within {
            prop_assert_eq!(clamped, torque);
        } else {
            prop_assert!(clamped.iter().zip(limit).any(|(torque, limit)| torque.unsigned_abs() == limit));
        }
        for (i, j) in [(0, 1), (1, 2), (2, 0)] {
            // Each component is rounded by less than one.
            let across = |a: usize, b: usize| i128::from(clamped[a]) * i128::from(torque[b]);
            let room = i128::from(torque[i].unsigned_abs().max(torque[j].unsigned_abs()));
            prop_assert!((across(i, j) - across(j, i)).abs() <= room, "{:?} {:?}", torque, clamped);
            prop_assert!(i64::from(clamped[i]) * i64::from(torque[i]) >= 0);
        }
    }
}

/// The random actions must enable, move and fault the device, otherwise they would prove nothing.
#[test]
fn the_random_actions_reach_torques_and_faults() {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;
    let mut runner = TestRunner::deterministic();
    let acts = prop::collection::vec(any_act(), 20_000).new_tree(&mut runner).expect("acts").current();
    let (torques, faults) = play(&acts);
    assert!(torques > 500 && faults > 200, "{torques} torques, {faults} faults");
}
