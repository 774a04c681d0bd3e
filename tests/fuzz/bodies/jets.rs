//! The body of the fuzz target of the jets, also run by the tests of the core: arbitrary frames, touches and
//! states of the solver.

use palpate_core::format::CHECKSUM;
use palpate_core::{Coverage, Field, Jet, JetError, JetMemory, NodeWeight, Solver, Touch, vec3};

/// A frame is refused, or has the bytes of its jet; the force and the energy are finite for any jets and any
/// touch; a table never exceeds its size.
///
/// A step is a kind and 51 words. The kind tells what is done with them: a frame with the words from its third
/// one, sealed with a checksum or as it is; or a touch, beside a partner or not; or a release.
pub(crate) fn jets(data: &[u8]) {
    let mut memory = JetMemory::<3, 8>::new();
    let (mut now_us, mut rest, mut is_gone) = (0_u64, data, false);
    let mut model = 0;
    while let Some((&[kind, body @ ..], after)) = rest.split_first_chunk::<205>() {
        rest = after;
        let words: [u32; 51] =
            std::array::from_fn(|n| u32::from_le_bytes(std::array::from_fn(|byte| body[4 * n + byte])));
        match kind % 8 {
            0..4 => {
                if let Some(jet) = frame(kind, &body) {
                    let known = memory.jets(jet.contact);
                    let is_kept = memory.insert(&jet);
                    let then = memory.jets(jet.contact);
                    // A jet of an earlier model is accepted without effect.
                    let is_old = jet.model < model;
                    model = model.max(jet.model);
                    assert!(then <= 8 && (!is_kept || is_old || then >= 1), "{known} {then}");
                    assert!(is_kept && !is_old || then == known, "refused: {jet:?}");
                }
            }
            4..7 => {
                now_us = now_us.wrapping_add(u64::from(words[0] >> (words[1] % 32)));
                if kind == 255 {
                    now_us = words[0].into();
                }
                let [x, y, z] = [2, 3, 4].map(|n| f32::from_bits(words[n]));
                let near = |x: u32| (x >> 8) as f32 / 16_777_216.0 * 0.06 - 0.03;
                let displacement_m =
                    if kind & 8 == 0 { [words[2], words[3], words[4]].map(near) } else { [x, y, z] };
                let weight = |n: usize| NodeWeight {
                    space: (words[5] >> (8 * n) & 3) as u16,
                    weight: (words[6] >> (8 * n) & 255) as f32 / 255.0,
                };
                let weights = [weight(0), weight(1), weight(2)];
                let beside =
                    [words[7], words[8], words[9]].map(if kind & 64 == 0 { near } else { f32::from_bits });
                memory.partner((kind & 32 != 0).then_some(beside));
                let hip_m = if kind & 16 == 0 { displacement_m } else { [z, x, y] };
                let touch = Touch { now_us, weights, displacement_m, hip_m, half_axis_m: None };
                let found = memory.force(&touch).expect("jets always have an answer");
                assert!(vec3::is_finite(found.force_n), "{touch:?}: {found:?}");
                if !vec3::is_finite(displacement_m) {
                    assert_eq!(found.coverage, Coverage::Extrapolated);
                }
                for space in 0..4 {
                    let energy_j = memory.energy_j(space, displacement_m);
                    assert!(energy_j.is_some_and(f32::is_finite), "{touch:?}: {energy_j:?}");
                }
            }
            _ => {
                memory.released(now_us);
                let states = [Solver::Alive, Solver::Silent, Solver::Gone];
                let state = states[usize::from(kind >> 3) % 3];
                is_gone = state == Solver::Gone;
                memory.solver(state);
            }
        }
        assert!(!memory.is_lost() || is_gone, "only a solver that is gone is lost");
    }
}

/// The jet of the bytes, put into a frame as far as `kind` says.
fn frame(kind: u8, body: &[u8; 204]) -> Option<Jet> {
    let mut frame = [0; Jet::FRAME_LEN];
    frame[..204].copy_from_slice(body);
    if kind & 1 == 0 {
        frame[..8].copy_from_slice(&Jet::default().encode()[..8]);
        frame[15] = 0;
        frame[172..].fill(0);
        if frame[14] & 32 == 0 {
            frame[112..172].fill(0);
        }
    }
    if kind & 2 == 0 {
        let checksum = CHECKSUM.checksum(&frame[..204]);
        frame[204..].copy_from_slice(&checksum.to_le_bytes());
    }
    match Jet::decode(&frame) {
        Ok(jet) => {
            assert_eq!(jet.encode(), frame);
            assert!(jet.trust_m > 0.0 && vec3::is_finite(jet.force_n) && vec3::is_finite(jet.control_m));
            Some(jet)
        }
        Err(JetError::Length { have }) => {
            assert_ne!(have, Jet::FRAME_LEN);
            None
        }
        Err(_) => None,
    }
}
