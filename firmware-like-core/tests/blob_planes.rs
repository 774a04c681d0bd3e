//! Planes that the reader refuses, each by its name.

use crate::common::{Draft, Recipe};
use palpate_core::flags::{BRANCH_JUMP, CELL, SMOOTH};
use palpate_core::format::{DisplacementHeader, PlaneRef};
use palpate_core::{BlobError, Organ, PlaneError, PlaneProblem};

fn small() -> Recipe {
    Recipe { radius_m: 0.01, slopes: 2, outlier: Some([0, -1, 0]), ..Recipe::default() }
}

fn spoiled(spoil: impl FnOnce(&mut Draft)) -> BlobError {
    Organ::<2>::read(&small().blob_with(spoil)).expect_err("the blob is bad")
}

fn plane(plane: &'static str, problem: PlaneProblem) -> BlobError {
    BlobError::Plane { space: Some(0), error: PlaneError { plane, problem } }
}

fn surface(plane: &'static str, problem: PlaneProblem) -> BlobError {
    BlobError::Plane { space: None, error: PlaneError { plane, problem } }
}

/// The problem of the plane that was refused.
fn problem(error: BlobError) -> PlaneProblem {
    match error {
        BlobError::Plane { error, .. } => error.problem,
        other => panic!("{other}"),
    }
}

#[test]
fn planes_out_of_place() {
    let last = |draft: &mut Draft| {
        let offset = (draft.area.bytes.len() as u32).next_multiple_of(64);
        draft.spaces[0].flags = PlaneRef { offset, ..draft.spaces[0].flags };
    };
    assert!(matches!(problem(spoiled(last)), PlaneProblem::OutOfBounds { .. }));
    for wild in [PlaneRef { offset: 0, len: u32::MAX }, PlaneRef { offset: u32::MAX - 63, len: u32::MAX }] {
        let error = spoiled(|draft| draft.spaces[0].force_n = Some(wild));
        assert!(matches!(problem(error), PlaneProblem::OutOfBounds { .. }), "{error}");
    }
    let error = spoiled(|draft| draft.spaces[0].flags.offset += 8);
    assert!(matches!(problem(error), PlaneProblem::Misaligned { .. }), "{error}");
    let need = small().lattice().slots();
    let shorter = |draft: &mut Draft| draft.spaces[0].flags.len -= 1;
    assert_eq!(spoiled(shorter), plane("flags", PlaneProblem::Length { have: need - 1, need }));
    let shorter = |draft: &mut Draft| draft.spaces[0].force_n.as_mut().expect("packed").len -= 1;
    assert_eq!(spoiled(shorter), plane("force", PlaneProblem::Length { have: need - 1, need }));
    let shorter = |draft: &mut Draft| draft.spaces[0].rbf_cubic.as_mut().expect("packed").weights[0].len -= 1;
    assert_eq!(spoiled(shorter), plane("rbf-cubic", PlaneProblem::Length { have: 15, need: 16 }));
}

/// Every plane of the displacements one element shorter and longer, and a wrong number of slopes.
#[test]
fn displacement_planes_that_do_not_fit_together() {
    type Of = fn(&mut DisplacementHeader) -> &mut PlaneRef;
    let planes: [(&str, Of); 7] = [
        ("displacement row", |d| &mut d.row),
        ("displacement modes", |d| &mut d.modes),
        // The number of modes differs from that in the plane of the modes.
        ("displacement modes", |d| &mut d.scale),
        ("displacement coefficients", |d| &mut d.coefficients),
        ("displacement outlier scale", |d| &mut d.outlier_row),
        ("displacement outlier scale", |d| &mut d.outlier_scale),
        ("displacement outliers", |d| &mut d.outliers),
    ];
    for (what, of) in planes {
        for by in [-1, 1] {
            let error = spoiled(|draft| {
                // Padding behind the last plane, so that a longer one is within the file.
                draft.area.bytes.extend([0; 64]);
                let plane = of(draft.spaces[0].displacement.as_mut().expect("packed"));
                plane.len = plane.len.strict_add_signed(by);
            });
            // An additional outlier takes its row from the padding.
            let outlier = ["displacement outlier scale", "displacement outlier row"];
            let expected = matches!(error, BlobError::Plane { error, .. }
                if error.plane == what || (outlier.contains(&what) && outlier.contains(&error.plane)));
            assert!(expected, "{what} {by}: {error}");
        }
    }
    // With three slopes a row has twelve numbers, but the table has seven rows of nine. Four slopes need four
    // modes.
    let slopes =
        |slopes| spoiled(|draft| draft.spaces[0].displacement.as_mut().expect("packed").slopes = slopes);
    assert_eq!(slopes(3), plane("displacement coefficients", PlaneProblem::Length { have: 63, need: 60 }));
    assert_eq!(slopes(4), plane("displacement scale", PlaneProblem::Length { have: 3, need: 4 }));
    assert!(
        matches!(slopes(u32::MAX), BlobError::Plane { error, .. } if error.plane == "displacement scale")
    );
    // Scales that are finite, but whose sum is too large.
    let error = spoiled(|draft| {
        let scale = draft.spaces[0].displacement.expect("packed").scale;
        draft.area.plane(scale, 4)[4..8].copy_from_slice(&1.0_f32.to_le_bytes());
    });
    assert_eq!(error, plane("displacement scale", PlaneProblem::Value { index: 1 }));
    // A small number of the wrong sign: a scale is a size.
    let negative = |of: fn(&DisplacementHeader) -> PlaneRef| {
        spoiled(|draft| {
            let scale = of(&draft.spaces[0].displacement.expect("packed"));
            let last = scale.len as usize * 4 - 4;
            draft.area.plane(scale, 4)[last..].copy_from_slice(&(-1e-9_f32).to_le_bytes());
        })
    };
    assert_eq!(negative(|d| d.scale), plane("displacement scale", PlaneProblem::Value { index: 2 }));
    let outlier = plane("displacement outlier scale", PlaneProblem::Value { index: 0 });
    assert_eq!(negative(|d| d.outlier_scale), outlier);
}

/// Floats of every float plane, replaced by NaN, infinity and a number that would overflow, one at a time.
#[test]
fn every_float_that_is_not_finite_is_found() {
    let mut planes = Vec::new();
    small().blob_with(|draft| {
        let space = &draft.spaces[0];
        planes.extend(draft.preamble.surface.position_m.map(|plane| (plane, 4)));
        // The number of floats.
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
        // In a large plane every 211th element, which includes every position in a node.
        for index in (0..reference.len as usize).step_by(if reference.len > 4000 { 211 } else { 1 }) {
            for bad in [f64::NAN, f64::NEG_INFINITY, 1e30] {
                let error = spoiled(|draft| {
                    let element = &mut draft.area.plane(reference, size)[index * size..][..size];
                    if size == 4 {
                        element.copy_from_slice(&(bad as f32).to_le_bytes());
                    } else {
                        element.copy_from_slice(&bad.to_le_bytes());
                    }
                });
                assert!(matches!(problem(error), PlaneProblem::Value { .. }), "{error}");
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
        draft.area.plane(triangles, 12)[12..16].copy_from_slice(&4_u32.to_le_bytes());
    });
    assert_eq!(error, surface("triangles", PlaneProblem::OutOfRange { index: 1 }));
    let error = spoiled(|draft| {
        let fixed = draft.preamble.surface.fixed;
        draft.area.plane(fixed, 1)[3] = 2;
    });
    assert_eq!(error, surface("fixed", PlaneProblem::OutOfRange { index: 3 }));
    let rows = small().solved_points().len() as u32;
    let error = spoiled(|draft| {
        let row = draft.spaces[0].displacement.expect("packed").row;
        draft.area.plane(row, 4)[8..12].copy_from_slice(&rows.to_le_bytes());
    });
    assert_eq!(error, plane("displacement row", PlaneProblem::OutOfRange { index: 2 }));
    let error = spoiled(|draft| {
        let row = draft.spaces[0].displacement.expect("packed").outlier_row;
        draft.area.plane(row, 4).copy_from_slice(&rows.to_le_bytes());
    });
    assert_eq!(error, plane("displacement outlier row", PlaneProblem::OutOfRange { index: 0 }));
    let slots = small().lattice().slots() as u32;
    let error = spoiled(|draft| {
        let row = draft.spaces[0].hermite.expect("packed").row;
        draft.area.plane(row, 4)[8..12].copy_from_slice(&slots.to_le_bytes());
    });
    assert_eq!(error, plane("hermite row", PlaneProblem::OutOfRange { index: 2 }));
}

#[test]
fn flags_and_the_rest_point() {
    let rest = small().lattice().slot([0; 3]).expect("in the box");
    let error = spoiled(|draft| {
        let flags = draft.spaces[0].flags;
        draft.area.plane(flags, 1)[0] |= CELL;
    });
    assert_eq!(error, plane("flags", PlaneProblem::Flags { slot: 0 }));
    let error = spoiled(|draft| {
        let flags = draft.spaces[0].flags;
        draft.area.plane(flags, 1).fill(SMOOTH);
    });
    assert_eq!(error, plane("flags", PlaneProblem::RestPoint));
    let error = spoiled(|draft| {
        let flags = draft.spaces[0].flags;
        draft.area.plane(flags, 1)[0] |= BRANCH_JUMP;
    });
    assert_eq!(error, plane("flags", PlaneProblem::Flags { slot: 0 }), "its corners are not smooth");
    let error = spoiled(|draft| {
        let force = draft.spaces[0].force_n.expect("packed");
        draft.area.plane(force, 12)[rest * 12 + 4..][..4].copy_from_slice(&1e-3_f32.to_le_bytes());
    });
    assert_eq!(error, plane("force", PlaneProblem::RestPoint));
    // W, h_z, h_y and h_x in a node of 36 floats, whose row is that of the slot in this blob.
    for place in [0, 1, 4, 12] {
        let error = spoiled(|draft| {
            let nodes = draft.spaces[0].hermite.expect("packed").nodes;
            draft.area.plane(nodes, 144)[rest * 144 + 4 * place..][..4]
                .copy_from_slice(&1e-3_f32.to_le_bytes());
        });
        assert_eq!(error, plane("hermite nodes", PlaneProblem::RestPoint), "{place}");
    }
}
