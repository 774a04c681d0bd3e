//! Every function called as from C: valid arguments succeed, invalid ones give a status and zero force.

use std::ffi::CStr;
use std::mem::MaybeUninit;
use std::ptr;

use palpate_c::*;

/// Memory as a C program provides it, aligned to 16 bytes.
fn memory(bytes: usize) -> &'static mut [u8] {
    bytemuck::cast_slice_mut(vec![0x5a5a_u128; bytes.div_ceil(16)].leak())
}

fn golden() -> &'static mut [u8] {
    let bytes = include_bytes!("../../golden/organ-514.blob");
    let (blob, _) = memory(bytes.len()).split_at_mut(bytes.len());
    blob.copy_from_slice(bytes);
    blob
}

fn open(place: &mut [u8], blob: &[u8]) -> Result<&'static PalpateOrgan, PalpateProblem> {
    let (mut organ, mut problem) = (MaybeUninit::new(ptr::dangling()), MaybeUninit::uninit());
    // SAFETY: each pointer and length belong to one slice.
    let status = unsafe {
        palpate_organ_open(
            place.as_mut_ptr(),
            place.len(),
            blob.as_ptr(),
            blob.len(),
            Some(&mut organ),
            Some(&mut problem),
        )
    };
    // SAFETY: the call writes both, whatever its status; the organ lies in leaked memory.
    let (organ, problem) = unsafe { (organ.assume_init().as_ref(), problem.assume_init()) };
    assert_eq!(problem.status, status);
    assert_eq!(organ.is_some(), status == PalpateStatus::Ok);
    organ.ok_or(problem)
}

fn organ() -> &'static PalpateOrgan {
    open(memory(palpate_organ_size()), golden()).expect("the golden blob is good")
}

/// The status of a call and the value that it wrote.
fn written<T>(call: impl FnOnce(&mut MaybeUninit<T>) -> PalpateStatus) -> (PalpateStatus, T) {
    let mut out = MaybeUninit::uninit();
    let status = call(&mut out);
    // SAFETY: every call below writes its result, also if it fails.
    (status, unsafe { out.assume_init() })
}

/// Opens a controller in leaked memory of its own.
#[allow(clippy::mut_from_ref, reason = "in memory of its own, not in the organ's")]
fn controller(
    organ: &'static PalpateOrgan,
    config: &PalpateConfig,
) -> Result<&'static mut PalpateController, PalpateStatus> {
    let place = memory(palpate_controller_size());
    let mut controller = MaybeUninit::uninit();
    // SAFETY: the pointer and the length belong to one slice.
    let status = unsafe {
        palpate_controller_open(
            place.as_mut_ptr(),
            place.len(),
            Some(organ),
            Some(config),
            Some(&mut controller),
            None,
        )
    };
    // SAFETY: the call has written it, and it lies in leaked memory.
    unsafe { controller.assume_init().as_mut() }.ok_or(status)
}

fn what(problem: &PalpateProblem) -> String {
    problem.what.iter().take_while(|c| **c != 0).map(|&c| c as u8 as char).collect()
}

#[test]
fn blobs_are_refused_with_their_reason() {
    let refused = |place: &mut [u8], blob: &[u8]| open(place, blob).expect_err("refused");
    let size = palpate_organ_size();
    assert_eq!(refused(&mut memory(size)[..size - 1], golden()).status, PalpateStatus::Memory);
    assert_eq!(refused(&mut memory(size + 16)[4..], golden()).status, PalpateStatus::Memory);
    let place = memory(size);
    let cut = refused(place, &golden()[..1000]);
    assert_eq!((cut.status, cut.have, cut.need), (PalpateStatus::Truncated, 1000, golden().len() as u64));
    assert_eq!(refused(place, &golden()[..10]).status, PalpateStatus::TooShort);
    assert_eq!(refused(place, &[0; 100]).status, PalpateStatus::BadMagic);
    let blob = golden();
    blob[3000] ^= 1;
    assert_eq!(refused(place, blob).status, PalpateStatus::Checksum);
    let shifted = memory(blob.len() + 16);
    shifted[4..4 + blob.len()].copy_from_slice(golden());
    assert_eq!(refused(place, &shifted[4..4 + blob.len()]).status, PalpateStatus::Misaligned);
    // SAFETY: null pointers are permitted.
    let nothing = unsafe {
        palpate_organ_open(place.as_mut_ptr(), size, ptr::null(), 10, Some(&mut MaybeUninit::uninit()), None)
    };
    assert_eq!(nothing, PalpateStatus::NullArgument);
    // SAFETY: null pointers are permitted, and the other pointers belong to slices of these lengths.
    let nowhere = unsafe { palpate_organ_open(ptr::null_mut(), size, blob.as_ptr(), blob.len(), None, None) };
    assert_eq!(nowhere, PalpateStatus::NullArgument);
}

#[test]
fn queries_give_an_answer_or_a_status() {
    let organ = organ();
    let (status, info) = written(|out| palpate_organ_info(Some(organ), Some(out)));
    assert_eq!((status, info.spaces, info.certified), (PalpateStatus::Ok, 1, true));
    let (_, space) = written(|out| palpate_space_info(Some(organ), 0, Some(out)));
    assert_eq!((space.methods, space.node, space.displacements), (0x7f, 199, false));

    let d = [0.01, -0.02, 0.005];
    for method in 0..7 {
        let (status, force) = written(|out| palpate_force(Some(organ), 0, method, Some(&d), Some(out)));
        let (_, estimate) = written(|out| palpate_estimate(Some(organ), 0, method, Some(&d), Some(out)));
        assert!(status == PalpateStatus::Ok && force.reaction_n != [0.0; 3]);
        assert_eq!(force.reaction_n, estimate.reaction_n);
        assert_eq!(estimate.has_energy, method == 6);
        assert!(estimate.stiffness_n_m[0][0] > 1.0);
    }
    let refused = |organ, space, method, d, want| {
        let (status, force) = written(|out| palpate_force(organ, space, method, d, Some(out)));
        assert_eq!((status, force.reaction_n, force.coverage), (want, [0.0; 3], PalpateCoverage::None));
        let (status, estimate) = written(|out| palpate_estimate(organ, space, method, d, Some(out)));
        assert_eq!((status, estimate.reaction_n), (want, [0.0; 3]));
    };
    refused(None, 0, 6, Some(&d), PalpateStatus::NullArgument);
    refused(Some(organ), 0, 6, None, PalpateStatus::NullArgument);
    refused(Some(organ), 1, 6, Some(&d), PalpateStatus::NoSuchSpace);
    refused(Some(organ), 0, 7, Some(&d), PalpateStatus::MissingMethod);
    refused(Some(organ), 0, 8, Some(&d), PalpateStatus::NoSuchMethod);
    assert_eq!(palpate_force(Some(organ), 0, 6, Some(&d), None), PalpateStatus::NullArgument);

    let (_, surface) = written(|out| palpate_surface(Some(organ), Some(out)));
    assert_eq!((surface.vertices, info.vertices), (347, 347));
    let mut moved = vec![[1.0_f32; 3]; 347];
    // SAFETY: the pointer and the length belong to one slice.
    let none = unsafe { palpate_displacements(Some(organ), 0, Some(&d), moved.as_mut_ptr(), moved.len()) };
    assert_eq!((none, moved.iter().all(|u| *u == [0.0; 3])), (PalpateStatus::NoDisplacements, true));
    // SAFETY: null pointers are permitted.
    let nowhere = unsafe { palpate_displacements(Some(organ), 0, Some(&d), ptr::null_mut(), 3) };
    assert_eq!(nowhere, PalpateStatus::NullArgument);
}

#[test]
fn a_controller_renders_faults_and_is_reset() {
    let organ = organ();
    let (_, space) = written(|out| palpate_space_info(Some(organ), 0, Some(out)));
    let (status, mut config) = written(|out| palpate_config(6, Some(out)));
    assert_eq!(status, PalpateStatus::Ok);
    assert_eq!(palpate_config(9, Some(&mut MaybeUninit::uninit())), PalpateStatus::NoSuchMethod);
    assert_eq!(
        controller(organ, &PalpateConfig { max_force_n: f32::NAN, ..config }).err(),
        Some(PalpateStatus::Config)
    );
    assert_eq!(
        controller(organ, &PalpateConfig { method: 9, ..config }).err(),
        Some(PalpateStatus::NoSuchMethod)
    );
    config.ramp_s = 0.0;
    let mut bad = MaybeUninit::uninit();
    let place = memory(palpate_controller_size());
    let negative = PalpateConfig { max_slew_n_per_s: -1.0, ..config };
    // SAFETY: the pointer and the length belong to one slice.
    unsafe {
        palpate_controller_open(
            place.as_mut_ptr(),
            place.len(),
            Some(organ),
            Some(&negative),
            Some(&mut MaybeUninit::uninit()),
            Some(&mut bad),
        );
    }
    // SAFETY: the call writes the problem if it is asked for.
    assert_eq!(what(unsafe { bad.assume_init_ref() }), "max_slew_n_per_s");

    let controller = controller(organ, &config).expect("a good configuration");
    let mut now_us = 0;
    let mut tick = |controller: Option<&mut PalpateController>, depth_m: Option<f32>| {
        now_us += 1000;
        let sample = depth_m.map(|depth_m| PalpateSample {
            t_us: now_us,
            position_m: std::array::from_fn(|i| space.rest_position_m[i] - depth_m * space.outward_normal[i]),
            buttons: 0,
        });
        written(|out| palpate_tick(controller, now_us, sample.as_ref(), Some(out))).1
    };
    let words = vec![0; palpate_surface_words(Some(organ))].leak();
    assert!(words.len() > 1000 && palpate_surface_words(None) == 0);
    // SAFETY: the pointers belong to slices of these lengths; null is permitted.
    let tried = unsafe {
        [
            palpate_controller_on_surface(None, words.as_mut_ptr(), words.len()),
            palpate_controller_on_surface(Some(controller), ptr::null_mut(), words.len()),
            palpate_controller_on_surface(Some(controller), words.as_mut_ptr(), words.len() - 1),
            palpate_controller_on_surface(Some(controller), words.as_mut_ptr(), words.len()),
        ]
    };
    let [null, memory, ok] = [PalpateStatus::NullArgument, PalpateStatus::Memory, PalpateStatus::Ok];
    assert_eq!(tried, [null, memory, memory, ok]);
    assert_eq!(tick(Some(controller), Some(-0.001)).phase, PalpatePhase::Disarmed);
    assert!(palpate_arm(Some(controller)));
    for step in 0..100 {
        tick(Some(controller), Some(0.0001 * step as f32 - 0.001));
    }
    let pressed = tick(Some(controller), Some(0.009));
    let outward: f32 = (0..3).map(|i| pressed.hand_force_n[i] * space.outward_normal[i]).sum();
    assert!(outward > 0.5 && pressed.engaged == 0 && pressed.phase == PalpatePhase::Active, "{pressed:?}");
    let faulted = tick(Some(controller), Some(f32::NAN));
    assert_eq!((faulted.phase, faulted.fault), (PalpatePhase::SafeZero, PalpateFault::NotFinite));
    assert_eq!(faulted.hand_force_n, [0.0; 3]);
    assert!(!palpate_arm(Some(controller)), "a fault is latched");
    palpate_reset(Some(controller));
    assert!(palpate_arm(Some(controller)));
    palpate_disarm(Some(controller));
    assert_eq!(tick(Some(controller), Some(0.0)).phase, PalpatePhase::Disarmed);

    let nobody = tick(None, Some(0.009));
    assert_eq!((nobody.phase, nobody.hand_force_n), (PalpatePhase::SafeZero, [0.0; 3]));
    assert!(!palpate_arm(None));
    palpate_disarm(None);
    palpate_reset(None);
}

#[test]
fn every_status_has_its_own_text() {
    let text = |status: i32| {
        // SAFETY: the text of a status is a constant of the library.
        unsafe { CStr::from_ptr(palpate_status_text(status)) }.to_str().expect("ASCII")
    };
    let lines: std::collections::BTreeSet<&str> = (0..=21).map(text).collect();
    assert_eq!(lines.len(), 22);
    assert_eq!((text(22), text(-1)), (text(99), text(99)));
    assert!(!lines.contains(text(22)));
}
