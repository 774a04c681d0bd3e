//! The reader: accepts what was written, refuses everything else, never panics.

mod common;

use common::{Aligned, Draft, Recipe, sign};
use palpate_core::blob::format::{self, DisplacementHeader, PlaneRef};
use palpate_core::blob::{BlobError, PlaneProblem};
use palpate_core::grid::LatticeError;
use palpate_core::profile::{Limits, MicrocontrollerOrgan};
use palpate_core::rbf::RbfError;
use palpate_core::table::TableError;
use palpate_core::{Method, Organ};

type Small<'a> = Organ<'a, 2>;

fn small() -> Recipe {
    Recipe { radius_m: 0.01, slopes: 2, outlier: Some([0, -1, 0]), ..Recipe::default() }
}

fn refusal(blob: &Aligned) -> BlobError {
    Small::read(blob.bytes()).expect_err("the blob is bad")
}

fn spoiled(spoil: impl FnOnce(&mut Draft)) -> BlobError {
    refusal(&small().blob_with(spoil))
}

#[test]
fn a_good_blob_gives_back_what_went_in() {
    let blob = Recipe { nodes: vec![[0.0; 3], [0.1, 0.0, 0.02]], ..small() }.blob();
    let organ = Small::read(blob.bytes()).expect("good");
    assert_eq!((organ.scene.as_str(), organ.law.as_str(), organ.max_force_n), ("test", "potential", 8.0));
    assert_eq!((organ.mesh_hash, organ.spaces.len()), ([7; 32], 2));
    let space = &organ.spaces[1];
    assert_eq!((space.name.as_str(), space.node, space.rest_position_m), ("A2", 11, [0.1, 0.0, 0.02]));
    assert_eq!(space.outward_normal, [0.0, 0.0, 1.0]);
    assert!(Method::OF_LATTICE.into_iter().all(|method| space.has(method)));
    assert_eq!(organ.surface.node, [10, 11, 12, 13]);
    assert_eq!(organ.surface.position_m[0], [0.0, 0.1, 0.0, 0.0]);
    assert_eq!((organ.surface.triangles.len(), organ.surface.triangles[0]), (4, [0, 2, 1]));
    assert_eq!(organ.surface.fixed, [1, 0, 0, 0]);
}

/// Exhaustive: every bit of the whole file.
#[test]
fn every_flipped_bit_is_found() {
    let mut blob = small().blob();
    for index in 0..blob.bytes().len() {
        for bit in 0..8 {
            blob.bytes_mut()[index] ^= 1 << bit;
            assert!(Small::read(blob.bytes()).is_err(), "byte {index}, bit {bit}");
            blob.bytes_mut()[index] ^= 1 << bit;
        }
    }
    assert!(Small::read(blob.bytes()).is_ok());
}

#[test]
fn every_truncation_is_found() {
    let blob = small().blob();
    for len in 0..blob.bytes().len() {
        let short = Aligned::new(&blob.bytes()[..len]);
        let need = blob.bytes().len() as u64;
        match refusal(&short) {
            BlobError::TooShort { have, .. } => assert_eq!(have, len),
            BlobError::Truncated { have, need: announced } => {
                assert_eq!((have, announced), (len as u64, need))
            }
            other => panic!("{len} bytes: {other}"),
        }
    }
    let mut long = blob.bytes().to_vec();
    long.push(0);
    assert!(matches!(refusal(&Aligned::new(&long)), BlobError::TooLong { .. }));
}

/// Behind a correct checksum: every byte of the header changed to several values must be refused or read, never panic.
#[test]
fn a_signed_but_wrong_header_never_panics() {
    let blob = small().blob();
    let header_len = u32::from_le_bytes(blob.bytes()[12..16].try_into().expect("four bytes")) as usize;
    let mut refused = 0;
    for index in 0..format::PREFIX_LEN + header_len {
        for value in
            [0, 1, 2, 3, 0x7f, 0x80, 0xff, blob.bytes()[index] ^ 1, blob.bytes()[index].wrapping_add(64)]
        {
            let mut wrong = blob.clone();
            wrong.bytes_mut()[index] = value;
            sign(wrong.bytes_mut());
            match Small::read(wrong.bytes()) {
                Err(_) => refused += 1,
                // A name or a position may be another one; then every query still has a finite answer.
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

/// Behind a correct checksum: random bytes anywhere.
#[test]
fn signed_noise_never_panics() {
    let blob = small().blob();
    let mut random = common::Random(99);
    for _ in 0..3000 {
        let mut wrong = blob.clone();
        for _ in 0..3 {
            let index =
                ((random.next() + 1.0) * 0.5 * wrong.bytes().len() as f32) as usize % wrong.bytes().len();
            wrong.bytes_mut()[index] = (random.next() * 127.0) as i8 as u8;
        }
        sign(wrong.bytes_mut());
        let _ = Small::read(wrong.bytes());
    }
}

#[test]
fn not_a_blob() {
    assert!(matches!(refusal(&Aligned::new(&[])), BlobError::TooShort { have: 0, .. }));
    assert_eq!(refusal(&Aligned::new(&[0; 4096])), BlobError::BadMagic);
}

#[test]
fn a_buffer_at_an_odd_address() {
    let blob = small().blob();
    let mut shifted = vec![0_u8; 4];
    shifted.extend(blob.bytes());
    let shifted = Aligned::new(&shifted);
    assert_eq!(Small::read(&shifted.bytes()[4..]), Err(BlobError::Misaligned));
}

#[test]
fn versions() {
    assert_eq!(
        spoiled(|draft| draft.version = format::VERSION + 1),
        BlobError::NewerVersion { found: format::VERSION + 1, supported: format::VERSION }
    );
    assert_eq!(spoiled(|draft| draft.version = 0), BlobError::UnknownVersion { found: 0 });
}

#[test]
fn more_spaces_than_fit() {
    let blob = Recipe { nodes: vec![[0.0; 3]; 3], ..small() }.blob();
    assert_eq!(refusal(&blob), BlobError::Capacity { what: "spaces", space: None, need: 3, limit: 2 });
    assert!(Organ::<3>::read(blob.bytes()).is_ok());
    // A count that the header does not hold.
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
    let refused = |limits: &Limits| Small::read_within(blob.bytes(), limits);
    let capacity = |what, need, limit| Err(BlobError::Capacity { what, space: Some(0), need, limit });
    // 125 slots, 7 centres and padding, 4 vertices, 3 modes: each just fits, and one less does not.
    let fitting = Limits { slots: 125, centres: 16, vertices: 4, modes: 3 };
    assert!(refused(&fitting).is_ok());
    assert_eq!(refused(&Limits { slots: 124, ..fitting }), capacity("grid slots", 125, 124));
    assert_eq!(refused(&Limits { centres: 15, ..fitting }), capacity("RBF centres", 16, 15));
    assert_eq!(refused(&Limits { modes: 2, ..fitting }), capacity("displacement modes", 3, 2));
    let vertices = BlobError::Capacity { what: "surface vertices", space: None, need: 4, limit: 3 };
    assert_eq!(refused(&Limits { vertices: 3, ..fitting }), Err(vertices));
    assert_eq!(
        vertices.to_string(),
        "4 surface vertices of the organ are more than this build holds (3): pack fewer, or build with a larger profile"
    );
    // A microcontroller takes forces only, and no more than four organs' nodes.
    assert_eq!(refused(&Limits::MICROCONTROLLER), capacity("displacement modes", 3, 0));
    let forces = Recipe { displacement: false, ..small() }.blob();
    assert!(MicrocontrollerOrgan::read_within(forces.bytes(), &Limits::MICROCONTROLLER).is_ok());
}

#[test]
fn numbers_of_the_header() {
    for bad in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let what = "max_force_n";
        assert_eq!(
            spoiled(|draft| draft.preamble.max_force_n = bad),
            BlobError::Value { what, space: None },
            "{bad}"
        );
    }
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

fn plane(what: &'static str, problem: impl Into<PlaneProblem>) -> BlobError {
    BlobError::Plane { what, space: Some(0), problem: problem.into() }
}

#[test]
fn planes_out_of_place() {
    let last = |draft: &mut Draft| {
        let offset = (draft.area.len() as u32).next_multiple_of(64);
        draft.spaces[0].flags = PlaneRef { offset, ..draft.spaces[0].flags };
    };
    assert!(matches!(spoiled(last), BlobError::Plane { problem: PlaneProblem::OutOfBounds { .. }, .. }));
    for wild in [PlaneRef { offset: 0, len: u32::MAX }, PlaneRef { offset: u32::MAX - 63, len: u32::MAX }] {
        let error = spoiled(|draft| draft.preamble.surface.triangles = wild);
        assert!(
            matches!(error, BlobError::Plane { problem: PlaneProblem::OutOfBounds { .. }, .. }),
            "{error}"
        );
    }
    let error = spoiled(|draft| draft.spaces[0].flags.offset += 8);
    assert!(matches!(error, BlobError::Plane { problem: PlaneProblem::Misaligned { .. }, .. }), "{error}");
    let need = small().lattice().slots();
    let shorter = |draft: &mut Draft| draft.spaces[0].flags.len -= 1;
    assert_eq!(spoiled(shorter), plane("flags", TableError::Length { have: need - 1, need }));
    let shorter = |draft: &mut Draft| draft.spaces[0].force_n.as_mut().expect("packed").len -= 1;
    assert_eq!(spoiled(shorter), plane("force", TableError::Length { have: need - 1, need }));
    let shorter = |draft: &mut Draft| draft.spaces[0].rbf_cubic.as_mut().expect("packed").weights[0].len -= 1;
    assert_eq!(spoiled(shorter), plane("rbf-cubic", RbfError::Length { len: 16 }));
}

/// Every plane of the displacements an element shorter and longer, and a layout that it is not.
#[test]
fn displacement_planes_that_do_not_fit_together() {
    type Of = fn(&mut DisplacementHeader) -> &mut PlaneRef;
    let planes: [(&str, Of); 7] = [
        ("displacement row", |d| &mut d.row),
        ("displacement modes", |d| &mut d.modes),
        // Fewer or more modes than the plane of the modes has.
        ("displacement modes", |d| &mut d.scale),
        ("displacement coefficients", |d| &mut d.coefficients),
        ("displacement outlier scale", |d| &mut d.outlier_row),
        ("displacement outlier scale", |d| &mut d.outlier_scale),
        ("displacement outliers", |d| &mut d.outliers),
    ];
    for (what, of) in planes {
        for by in [-1, 1] {
            let error = spoiled(|draft| {
                // The last plane may not reach out of the file by being longer, and what follows a plane must not be NaN.
                draft.area.extend([0; 64]);
                let plane = of(draft.spaces[0].displacement.as_mut().expect("packed"));
                plane.len = plane.len.strict_add_signed(by);
            });
            // An outlier more has a row that is another's or beyond the end: zero, which the padding holds, is not beyond.
            let expected = matches!(error, BlobError::Plane { what: found, problem: PlaneProblem::Table(_), .. }
                if found == what || (what == "displacement outlier scale" && found == "displacement outlier row"));
            assert!(expected, "{what} {by}: {error}");
        }
    }
    // Seven rows of nine numbers are no rows of twelve; nor are there slopes of four modes.
    let slopes =
        |slopes| spoiled(|draft| draft.spaces[0].displacement.as_mut().expect("packed").slopes = slopes);
    assert_eq!(slopes(3), plane("displacement coefficients", TableError::Length { have: 63, need: 60 }));
    assert_eq!(slopes(4), plane("displacement scale", TableError::Length { have: 3, need: 4 }));
    assert!(matches!(slopes(u32::MAX), BlobError::Plane { what: "displacement scale", .. }));
    // Scales that are finite, but whose sum is not sane.
    let error = spoiled(|draft| {
        let scale = draft.spaces[0].displacement.expect("packed").scale;
        draft.plane(scale, 4)[4..8].copy_from_slice(&1.0_f32.to_le_bytes());
    });
    assert_eq!(error, plane("displacement scale", TableError::NotFinite { index: 1 }));
}

/// Floats of every float plane, set to NaN and to infinity, one at a time.
#[test]
fn every_float_that_is_not_finite_is_found() {
    let mut planes = Vec::new();
    small().blob_with(|draft| {
        let space = &draft.spaces[0];
        planes.extend(draft.preamble.surface.position_m.map(|plane| (plane, 4)));
        // As many floats.
        let of = |plane: PlaneRef, each: u32| (PlaneRef { len: plane.len * each, ..plane }, 4);
        planes.extend([of(space.force_n.expect("packed"), 3), of(space.hermite.expect("packed").nodes, 36)]);
        let (linear, cubic) = (space.rbf_linear.expect("packed"), space.rbf_cubic.expect("packed"));
        planes.extend([linear.centres, linear.weights].as_flattened().iter().map(|&plane| (plane, 4)));
        planes.extend([cubic.centres, cubic.weights].as_flattened().iter().map(|&plane| (plane, 8)));
        planes.push((space.displacement.expect("packed").scale, 4));
        planes.push((space.displacement.expect("packed").outlier_scale, 4));
    });
    let mut found = 0;
    for (reference, size) in planes {
        // Of a large plane one in 211, which meets every place in a node.
        for index in (0..reference.len as usize).step_by(if reference.len > 4000 { 211 } else { 1 }) {
            for bad in [f64::NAN, f64::NEG_INFINITY] {
                let error = spoiled(|draft| {
                    let element = &mut draft.plane(reference, size)[index * size..][..size];
                    if size == 4 {
                        element.copy_from_slice(&(bad as f32).to_le_bytes());
                    } else {
                        element.copy_from_slice(&bad.to_le_bytes());
                    }
                });
                assert!(
                    matches!(
                        error,
                        BlobError::Plane {
                            problem: PlaneProblem::Table(TableError::NotFinite { .. })
                                | PlaneProblem::Rbf(RbfError::NotFinite),
                            ..
                        }
                    ),
                    "{error}"
                );
                found += 1;
            }
        }
    }
    assert!(found > 500);
}

#[test]
fn indices_out_of_range() {
    let error = spoiled(|draft| {
        let triangles = draft.preamble.surface.triangles;
        draft.plane(triangles, 12)[12..16].copy_from_slice(&4_u32.to_le_bytes());
    });
    let problem = PlaneProblem::Table(TableError::OutOfRange { index: 1 });
    assert_eq!(error, BlobError::Plane { what: "triangles", space: None, problem });
    let error = spoiled(|draft| {
        let fixed = draft.preamble.surface.fixed;
        draft.plane(fixed, 1)[3] = 2;
    });
    let problem = PlaneProblem::Table(TableError::OutOfRange { index: 3 });
    assert_eq!(error, BlobError::Plane { what: "fixed", space: None, problem });
    let rows = small().solved_points().len() as u32;
    let error = spoiled(|draft| {
        let row = draft.spaces[0].displacement.expect("packed").row;
        draft.plane(row, 4)[8..12].copy_from_slice(&rows.to_le_bytes());
    });
    assert_eq!(error, plane("displacement row", TableError::OutOfRange { index: 2 }));
    let error = spoiled(|draft| {
        let row = draft.spaces[0].displacement.expect("packed").outlier_row;
        draft.plane(row, 4).copy_from_slice(&rows.to_le_bytes());
    });
    assert_eq!(error, plane("displacement outlier row", TableError::OutOfRange { index: 0 }));
    let slots = small().lattice().slots() as u32;
    let error = spoiled(|draft| {
        let row = draft.spaces[0].hermite.expect("packed").row;
        draft.plane(row, 4)[8..12].copy_from_slice(&slots.to_le_bytes());
    });
    assert_eq!(error, plane("hermite nodes", TableError::OutOfRange { index: 2 }));
}

#[test]
fn flags_and_the_rest_point() {
    let rest = small().lattice().rest_slot();
    let error = spoiled(|draft| {
        let flags = draft.spaces[0].flags;
        draft.plane(flags, 1)[0] |= palpate_core::flags::CELL;
    });
    assert_eq!(error, plane("flags", PlaneProblem::Flags { slot: 0 }));
    let error = spoiled(|draft| {
        let flags = draft.spaces[0].flags;
        draft.plane(flags, 1).fill(palpate_core::flags::SMOOTH);
    });
    assert_eq!(error, BlobError::RestPoint { space: 0 });
    let error = spoiled(|draft| {
        let flags = draft.spaces[0].flags;
        draft.plane(flags, 1)[0] |= palpate_core::flags::FOLD;
    });
    assert_eq!(error, plane("flags", PlaneProblem::Flags { slot: 0 }), "its corners are not smooth");
    let error = spoiled(|draft| {
        let force = draft.spaces[0].force_n.expect("packed");
        draft.plane(force, 12)[rest * 12 + 4..][..4].copy_from_slice(&1e-3_f32.to_le_bytes());
    });
    assert_eq!(error, BlobError::RestPoint { space: 0 });
    // W, h_z, h_y and h_x in a node of 36 floats, which stands at the slot's own row in this blob.
    for place in [0, 1, 4, 12] {
        let error = spoiled(|draft| {
            let nodes = draft.spaces[0].hermite.expect("packed").nodes;
            draft.plane(nodes, 144)[rest * 144 + 4 * place..][..4].copy_from_slice(&1e-3_f32.to_le_bytes());
        });
        assert_eq!(error, BlobError::RestPoint { space: 0 }, "{place}");
    }
}

/// A message is one line and says what to do.
#[test]
fn messages_say_the_mend() {
    let blob = small().blob();
    let mut damaged = blob.clone();
    damaged.bytes_mut()[200] ^= 1;
    let message = refusal(&damaged).to_string();
    assert!(message.starts_with("checksum mismatch: the file is damaged (stored "), "{message}");
    assert!(message.ends_with("make it again with `palpate pack`"), "{message}");
    for error in [
        spoiled(|draft| draft.version = 9),
        spoiled(|draft| draft.spaces[0].spacing_m = 0.0),
        spoiled(|draft| draft.spaces[0].flags.offset += 8),
        refusal(&Aligned::new(&blob.bytes()[..100])),
        refusal(&Aligned::new(b"solid")),
    ] {
        let message = error.to_string();
        assert!(message.len() > 40 && !message.contains('\n'), "{message}");
    }
}

/// The layout as `blob::format` documents it, read by hand: what a reader in another language relies on.
#[test]
fn layout_version_3_byte_by_byte() {
    let blob = Recipe { rbf: false, hermite: false, displacement: false, ..small() }.blob();
    let bytes = blob.bytes();
    let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    assert_eq!(&bytes[..8], b"PALPATE\0");
    assert_eq!(u32_at(8), 3);
    let header_len = u32_at(12) as usize;
    assert_eq!(u64::from_le_bytes(bytes[16..24].try_into().expect("eight bytes")), bytes.len() as u64);
    // Strings are a length and their bytes; floats four bytes.
    assert_eq!(&bytes[24..39], b"\x04test\x09potential");
    assert_eq!(&bytes[39..43], 8.0_f32.to_le_bytes());
    assert_eq!(bytes[43..75], [7; 32]);
    // The surface: node at 0 with 4 elements, then x, y, z at 64, 128, 192 (postcard integers, seven bits a byte).
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
