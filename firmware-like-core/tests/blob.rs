//! The reader accepts what was written, refuses everything else, and never panics. Planes are in
//! `blob_planes.rs`.

use crate::common::{Draft, Random, Recipe, sign};
use palpate_core::{AlignedBytes, BlobError, LatticeError, Limits, Method, Organ, format};

type Small<'a> = Organ<'a, 2>;

fn small() -> Recipe {
    Recipe { radius_m: 0.01, slopes: 2, outlier: Some([0, -1, 0]), ..Recipe::default() }
}

fn refusal(blob: &AlignedBytes) -> BlobError {
    Small::read(blob).expect_err("the blob is bad")
}

fn spoiled(spoil: impl FnOnce(&mut Draft)) -> BlobError {
    refusal(&small().blob_with(spoil))
}

#[test]
fn a_blob_contains_what_was_written() {
    let blob = Recipe { nodes: vec![[0.0; 3], [0.1, 0.0, 0.02]], ..small() }.blob();
    let organ = Small::read(&blob).expect("good");
    assert_eq!((organ.scene.as_str(), organ.law.as_str(), organ.max_force_n), ("test", "potential", 8.0));
    assert_eq!((organ.mesh_hash, organ.spaces.len()), ([7; 32], 2));
    let space = &organ.spaces[1];
    let active = &space.active;
    assert_eq!((active.name.as_str(), active.node, active.rest_position_m), ("A2", 11, [0.1, 0.0, 0.02]));
    assert_eq!(active.outward_normal, [0.0, 0.0, 1.0]);
    assert!(Method::OF_LATTICE.into_iter().all(|method| space.has(method)));
    assert_eq!(organ.surface.node, [10, 11, 12, 13]);
    assert_eq!(organ.surface.position_m[0], [0.0, 0.1, 0.0, 0.0]);
    assert_eq!((organ.surface.triangles.len(), organ.surface.triangles[0]), (4, [0, 2, 1]));
    assert_eq!(organ.surface.fixed, [1, 0, 0, 0]);
}

/// Flips every bit of the file, one at a time.
#[test]
fn every_flipped_bit_is_found() {
    let mut blob = small().blob();
    for index in 0..blob.len() {
        for bit in 0..8 {
            blob[index] ^= 1 << bit;
            assert!(Small::read(&blob).is_err(), "byte {index}, bit {bit}");
            blob[index] ^= 1 << bit;
        }
    }
    assert!(Small::read(&blob).is_ok());
}

#[test]
fn every_truncation_is_found() {
    let blob = small().blob();
    for len in 0..blob.len() {
        let short = AlignedBytes::from(&blob[..len]);
        let need = blob.len() as u64;
        match refusal(&short) {
            BlobError::TooShort { have, .. } => assert_eq!(have, len),
            BlobError::Truncated { have, need: announced } => {
                assert_eq!((have, announced), (len as u64, need))
            }
            other => panic!("{len} bytes: {other}"),
        }
    }
    let mut long = blob.to_vec();
    long.push(0);
    assert!(matches!(refusal(&AlignedBytes::from(&long)), BlobError::TooLong { .. }));
}

/// With a correct checksum: a header with any byte changed to several values is refused or read.
#[test]
fn a_signed_but_wrong_header_never_panics() {
    let blob = small().blob();
    let header_len = u32::from_le_bytes(blob[12..16].try_into().expect("four bytes")) as usize;
    let mut refused = 0;
    for index in 0..24 + header_len {
        for value in [0, 1, 2, 3, 0x7f, 0x80, 0xff, blob[index] ^ 1, blob[index].wrapping_add(64)] {
            let mut wrong = blob.clone();
            wrong[index] = value;
            sign(&mut wrong);
            match Small::read(&wrong) {
                Err(_) => refused += 1,
                // A changed name or position may be accepted; then every query still has a finite answer.
                Ok(organ) => {
                    for space in &organ.spaces {
                        for d in [[0.0; 3], [0.004, -0.003, 0.006], [1e30, 0.0, f32::NAN]] {
                            let mut moved = [[0.0; 3]; 4];
                            space.displacement_into(d, &mut moved);
                            assert!(moved.as_flattened().iter().all(|x| x.is_finite()));
                        }
                        for method in Method::OF_LATTICE {
                            for d in [[0.0; 3], [0.004, -0.003, 0.006], [1e30, 0.0, f32::NAN]] {
                                let answer = space.force(method, d);
                                assert!(
                                    answer.is_none_or(|answer| answer.force_n.iter().all(|h| h.is_finite()))
                                );
                            }
                        }
                    }
                }
            }
        }
    }
    assert!(refused > 700, "only {refused} were refused");
}

/// With a correct checksum: random bytes anywhere.
#[test]
fn signed_noise_never_panics() {
    let blob = small().blob();
    let mut random = Random(99);
    for _ in 0..3000 {
        let mut wrong = blob.clone();
        for _ in 0..3 {
            let index = ((random.next() + 1.0) * 0.5 * wrong.len() as f32) as usize % wrong.len();
            wrong[index] = (random.next() * 127.0) as i8 as u8;
        }
        sign(&mut wrong);
        let _ = Small::read(&wrong);
    }
}

#[test]
fn not_a_blob() {
    assert!(matches!(refusal(&AlignedBytes::default()), BlobError::TooShort { have: 0, .. }));
    assert_eq!(refusal(&AlignedBytes::from(&[0; 4096])), BlobError::BadMagic);
}

#[test]
fn a_buffer_at_an_odd_address() {
    let blob = small().blob();
    let mut shifted = vec![0_u8; 4];
    shifted.extend(&*blob);
    let shifted = AlignedBytes::from(&shifted);
    assert_eq!(Small::read(&shifted[4..]), Err(BlobError::Misaligned));
}

#[test]
fn other_versions_are_refused() {
    let newer = BlobError::NewerVersion { found: format::VERSION + 1 };
    let mut blob = small().blob();
    for (found, refused) in [
        (format::VERSION + 1, newer),
        (format::VERSION - 1, BlobError::UnknownVersion { found: format::VERSION - 1 }),
        (0, BlobError::UnknownVersion { found: 0 }),
    ] {
        blob[8..12].copy_from_slice(&found.to_le_bytes());
        // Another layout may have its length and its checksum elsewhere: its version is named nevertheless.
        assert_eq!(refusal(&blob), refused);
        assert_eq!(refusal(&AlignedBytes::from(&blob[..1000])), refused);
    }
}

#[test]
fn more_spaces_than_fit() {
    let blob = Recipe { nodes: vec![[0.0; 3]; 3], ..small() }.blob();
    assert_eq!(refusal(&blob), BlobError::Capacity { what: "spaces", space: None, need: 3, limit: 2 });
    assert!(Organ::<3>::read(&blob).is_ok());
    // The header has fewer records than the count states.
    assert_eq!(spoiled(|draft| draft.preamble.space_count = 2), BlobError::Header);
    assert_eq!(spoiled(|draft| draft.preamble.space_count = 0), BlobError::Header);
    assert!(matches!(
        spoiled(|draft| draft.preamble.space_count = u32::MAX),
        BlobError::Capacity { need: 0xffff_ffff, .. }
    ));
}

#[test]
fn more_of_a_table_than_a_profile_holds() {
    let blob = small().blob();
    let refused = |limits: &Limits| Small::read_within(&blob, limits);
    let capacity = |what, need, limit| Err(BlobError::Capacity { what, space: Some(0), need, limit });
    // 125 slots, 7 centres and padding, 4 vertices and triangles, 3 modes: all fit exactly.
    let fitting = Limits { spaces: 2, slots: 125, centres: 16, vertices: 4, triangles: 4, modes: 3 };
    assert!(refused(&fitting).is_ok());
    let none = BlobError::Capacity { what: "spaces", space: None, need: 1, limit: 0 };
    assert_eq!(refused(&Limits { spaces: 0, ..fitting }), Err(none));
    assert_eq!(refused(&Limits { slots: 124, ..fitting }), capacity("grid slots", 125, 124));
    assert_eq!(refused(&Limits { centres: 15, ..fitting }), capacity("RBF centres", 16, 15));
    assert_eq!(refused(&Limits { modes: 2, ..fitting }), capacity("displacement modes", 3, 2));
    let surface = |what| BlobError::Capacity { what, space: None, need: 4, limit: 3 };
    assert_eq!(refused(&Limits { triangles: 3, ..fitting }), Err(surface("surface triangles")));
    assert_eq!(refused(&Limits { vertices: 3, ..fitting }), Err(surface("surface vertices")));
    assert_eq!(
        surface("surface vertices").to_string(),
        "4 surface vertices of the organ are more than this build holds (3): pack fewer, or build with a larger profile"
    );
    // The profile of a microcontroller accepts forces only.
    assert_eq!(refused(&Limits::MICROCONTROLLER), capacity("displacement modes", 3, 0));
    let forces = Recipe { displacement: false, ..small() }.blob();
    assert!(Small::read_within(&forces, &Limits::MICROCONTROLLER).is_ok());
}

#[test]
fn numbers_of_the_header() {
    for bad in [0.0, -1.0, f32::NAN] {
        let what = "max_force_n";
        assert_eq!(
            spoiled(|draft| draft.preamble.max_force_n = bad),
            BlobError::Value { what, space: None },
            "{bad}"
        );
    }
    // A scene without a device has no force limit.
    let unlimited = small().blob_with(|draft| draft.preamble.max_force_n = f32::INFINITY);
    assert_eq!(Small::read(&unlimited).expect("good").max_force_n, f32::INFINITY);
    let value = |what| BlobError::Value { what, space: Some(0) };
    assert_eq!(spoiled(|draft| draft.spaces[0].rest_position_m[1] = f32::NAN), value("rest_position_m"));
    assert_eq!(spoiled(|draft| draft.spaces[0].outward_normal = [0.0; 3]), value("outward_normal"));
    assert_eq!(spoiled(|draft| draft.spaces[0].outward_normal = [1e30, 0.0, 0.0]), value("outward_normal"));
    assert_eq!(spoiled(|draft| draft.spaces[0].outward_normal[0] = f32::INFINITY), value("outward_normal"));
    for bad in [0.0, -0.01, f32::NAN] {
        let error = spoiled(|draft| draft.spaces[0].spacing_m = bad);
        assert!(
            matches!(error, BlobError::Lattice { space: 0, error: LatticeError::Size { .. } }),
            "{error}"
        );
    }
    let error = spoiled(|draft| draft.spaces[0].spacing_m = 1e-6);
    assert!(matches!(error, BlobError::Lattice { space: 0, error: LatticeError::TooFine { .. } }), "{error}");
}

/// Contact points are the vertices of a surface that names spaces.
#[test]
fn a_contact_surface_names_existing_spaces() {
    let with = |spaces: [u32; 3], triangles: [[u32; 3]; 1]| {
        let recipe = Recipe { nodes: vec![[0.0; 3]; 2], ..small() };
        recipe.blob_with(|draft| {
            let area = &mut draft.area;
            draft.preamble.contact = format::SurfaceHeader {
                node: area.push(&spaces),
                position_m: [0.0_f32, 0.1, 0.2].map(|x| area.push(&[x, 0.5 * x, 0.1 - x])),
                triangles: area.push(&triangles),
                fixed: area.push(&[0_u8; 3]),
            };
        })
    };
    let blob = with([1, 0, 1], [[0, 1, 2]]);
    let organ = Small::read(&blob).expect("good");
    assert_eq!((organ.contact.node, organ.contact.triangles), (&[1, 0, 1][..], &[[0, 1, 2]][..]));
    let error = refusal(&with([1, 0, 2], [[0, 1, 2]]));
    assert!(matches!(error, BlobError::Plane { space: None, .. }), "{error}");
    assert!(error.to_string().contains("contact space"), "{error}");
    let error = refusal(&with([1, 0, 1], [[0, 1, 3]]));
    assert!(error.to_string().contains("triangles"), "{error}");
    let tip = format::Fingertip { radius_m: 0.01, stiffness_n_m: 500.0 };
    let known = small().blob_with(|draft| draft.preamble.tool = palpate_core::format::Tool::Fingertip(tip));
    assert_eq!(Small::read(&known).expect("good").tool, palpate_core::format::Tool::Fingertip(tip));
    for bad in [0.0, f32::NAN, f32::INFINITY] {
        let tips =
            [format::Fingertip { radius_m: bad, ..tip }, format::Fingertip { stiffness_n_m: bad, ..tip }];
        for tip in tips {
            let refused = spoiled(|draft| draft.preamble.tool = palpate_core::format::Tool::Fingertip(tip));
            assert_eq!(refused, BlobError::Value { what: "fingertip", space: None });
        }
    }
}

#[test]
fn a_capsule_is_a_sphere_with_an_axis() {
    use format::{Capsule, Sphere, Tool};
    let sphere = Sphere { radius_m: 0.01, layer_m: 0.001 };
    let capsule = Capsule { sphere, half_axis_m: [0.0, -0.003, 0.004] };
    let known = small().blob_with(|draft| draft.preamble.tool = Tool::Capsule(capsule));
    let tool = Small::read(&known).expect("good").tool;
    assert_eq!((tool, tool.sphere()), (Tool::Capsule(capsule), Some(sphere)));
    assert_eq!(tool.half_axis_m(), Some(capsule.half_axis_m));
    assert!(!tool.grasps());
    for bad in [
        Capsule { half_axis_m: [0.0; 3], ..capsule },
        Capsule { half_axis_m: [f32::NAN, 0.0, 0.0], ..capsule },
        Capsule { sphere: Sphere { radius_m: f32::NAN, ..sphere }, ..capsule },
        Capsule { sphere: Sphere { layer_m: 0.0, ..sphere }, ..capsule },
    ] {
        let refused = spoiled(|draft| draft.preamble.tool = Tool::Capsule(bad));
        assert_eq!(refused, BlobError::Value { what: "capsule", space: None }, "{bad:?}");
    }
}

/// A message is one line with the fix.
#[test]
fn messages_name_the_fix() {
    let blob = small().blob();
    let mut damaged = blob.clone();
    damaged[200] ^= 1;
    let mut newer = blob.clone();
    newer[8] += 1;
    let message = refusal(&damaged).to_string();
    assert!(message.starts_with("checksum mismatch: the file is damaged (stored "), "{message}");
    assert!(message.ends_with("make it again with `palpate pack`"), "{message}");
    for error in [
        refusal(&newer),
        spoiled(|draft| draft.spaces[0].spacing_m = 0.0),
        spoiled(|draft| draft.spaces[0].flags.offset += 8),
        refusal(&AlignedBytes::from(&blob[..100])),
        refusal(&AlignedBytes::from(b"solid")),
    ] {
        let message = error.to_string();
        assert!(message.len() > 40 && !message.contains('\n'), "{message}");
    }
}

/// The documented layout, byte by byte, as a reader in another language uses it.
#[test]
fn the_layout_byte_by_byte() {
    let blob = Recipe { rbf: false, hermite: false, displacement: false, ..small() }.blob();
    let bytes = blob;
    let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    assert_eq!(&bytes[..8], b"PALPATE\0");
    assert_eq!(u32_at(8), 6);
    let header_len = u32_at(12) as usize;
    assert_eq!(u64::from_le_bytes(bytes[16..24].try_into().expect("eight bytes")), bytes.len() as u64);
    // A string is its length and its bytes; a float has four bytes.
    assert_eq!(&bytes[24..39], b"\x04test\x09potential");
    assert_eq!(&bytes[39..43], 8.0_f32.to_le_bytes());
    assert_eq!(bytes[43..75], [7; 32]);
    // The surface: node at 0 with 4 elements, then x, y, z at 64, 128, 192 (postcard integers, seven bits per
    // byte).
    assert_eq!(bytes[75..86], [0, 4, 64, 4, 0x80, 1, 4, 0xc0, 1, 4, 0x80]);
    let start = (24 + header_len).next_multiple_of(64);
    assert!(bytes[24 + header_len..start].iter().all(|&byte| byte == 0));
    assert_eq!([0, 4, 8, 12].map(|at| u32_at(start + at)), [10, 11, 12, 13]);
    // CRC-32 (ISO-HDLC), bit by bit.
    let mut crc = u32::MAX;
    for &byte in &bytes[..bytes.len() - 4] {
        crc ^= u32::from(byte);
        for _ in 0..8 {
            crc = if crc & 1 == 0 { crc >> 1 } else { (crc >> 1) ^ 0xedb8_8320 };
        }
    }
    assert_eq!(u32_at(bytes.len() - 4), !crc);
}
