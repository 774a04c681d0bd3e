//! Small legacy files, ASCII and binary, with the old and the new layout of the cells.

use std::path::Path;

use super::read_legacy;
use crate::error::InputError;
use crate::mesh::{CellData, LengthUnit, RegionFault, TetMesh};

const OLD: &str = "\
# vtk DataFile Version 4.2
by hand
ASCII
DATASET UNSTRUCTURED_GRID
FIELD FieldData 2
REMARK 1 1 string
made by hand
TIME 1 1 double
0.5
POINTS 5 double
0 0 0 1 0 0
0 1 0
0 0 1 1 1 1
METADATA
INFORMATION 0

CELLS 3 14
4 0 1 2 3
3 0 1 2
4 1 2 3 4
CELL_TYPES 3
10
5
10
CELL_DATA 3
SCALARS anything string 1
";

const NEW: &str = "\
# vtk DataFile Version 5.1
by hand
ASCII
DATASET UNSTRUCTURED_GRID
POINTS 5 float
0 0 0 1 0 0 0 1 0
0 0 1 1 1 1
CELLS 4 11
OFFSETS vtktypeint64
0 4 7 11
CONNECTIVITY vtktypeint64
0 1 2 3 0 1 2
1 2 3 4
CELL_TYPES 3
10 5 10
";

const POINTS: [f64; 15] = [0., 0., 0., 1., 0., 0., 0., 1., 0., 0., 0., 1., 1., 1., 1.];

fn read(bytes: &[u8]) -> Result<TetMesh, InputError> {
    read_legacy(Path::new("body.vtk"), bytes, false)?.finish(LengthUnit::Metre)
}

/// The same body in binary form; big-endian, as VTK writes it.
fn binary(new_layout: bool) -> Vec<u8> {
    let mut out = b"# vtk DataFile Version 5.1\nby hand\nBINARY\nDATASET UNSTRUCTURED_GRID\n".to_vec();
    let ints = |numbers: &[i32]| numbers.iter().flat_map(|n| n.to_be_bytes()).collect::<Vec<u8>>();
    let longs = |numbers: &[i64]| numbers.iter().flat_map(|n| n.to_be_bytes()).collect::<Vec<u8>>();
    if new_layout {
        // The two highest bits give the size of a string's length: 11 for 6 bits, 10 for 14 bits.
        out.extend(b"FIELD FieldData 2\nREMARK 1 2 string\n\xc3abc\x80\x02de\nMETADATA\nINFORMATION 0\n\n");
        out.extend(b"TIME 1 1 double\n\x3f\xe0\0\0\0\0\0\0\n");
        out.extend(b"POINTS 5 float\n");
        out.extend(POINTS.iter().flat_map(|&x| (x as f32).to_be_bytes()));
        out.extend(b"\nCELLS 4 11\nOFFSETS vtktypeint64\n");
        out.extend(longs(&[0, 4, 7, 11]));
        out.extend(b"\nCONNECTIVITY vtktypeint64\n");
        out.extend(longs(&[0, 1, 2, 3, 0, 1, 2, 1, 2, 3, 4]));
    } else {
        out.extend(b"POINTS 5 double\n");
        out.extend(POINTS.iter().flat_map(|x| x.to_be_bytes()));
        out.extend(b"\nCELLS 3 14\n");
        out.extend(ints(&[4, 0, 1, 2, 3, 3, 0, 1, 2, 4, 1, 2, 3, 4]));
    }
    out.extend(b"\nCELL_TYPES 3\n");
    out.extend(ints(&[10, 5, 10]));
    out.extend(b"\nCELL_DATA 3\n");
    out
}

#[test]
fn text_and_binary_old_and_new_give_the_same_mesh() {
    let mesh = read(OLD.as_bytes()).expect("sound");
    assert_eq!(mesh.tets, [[0, 1, 2, 3], [1, 2, 3, 4]]);
    assert_eq!(mesh.nodes_m[1], [1.0, 0.0, 0.0]);
    for bytes in [NEW.as_bytes().to_vec(), binary(false), binary(true)] {
        assert_eq!(read(&bytes).expect("sound"), mesh);
    }
}

#[track_caller]
fn assert_says(from: &str, to: &str, place: &str, what: &str, fix: &str) {
    let text = if OLD.contains(from) { OLD } else { NEW };
    assert!(text.contains(from), "nothing to break: {from:?}");
    let error = read(text.replacen(from, to, 1).as_bytes()).expect_err("planted fault").to_string();
    assert!(error.starts_with(&format!("{place}: ")), "{error}");
    let (problem, remedy) = error.split_once("; ").expect("a problem and a fix");
    assert!(problem.contains(what) && remedy.contains(fix), "{error}");
}

#[test]
fn faults_name_line_and_cell() {
    assert_says("4 0 1 2 3", "4 1 0 2 3", "body.vtk:18", "element 0 has negative volume", "swap any two");
    assert_says("4 1 2 3 4\n", "4 1 2 3 9\n", "body.vtk:20", "element 2 names node 9", "export it again");
    assert_says("4 1 2 3 4\n", "4 1 2 3 -4\n", "body.vtk:20", "-4 is not a node index", "export it again");
    assert_says(
        "0 1 0\n",
        "0 one 0\n",
        "body.vtk:12",
        "expected a coordinate, found `one`",
        "export it again",
    );
    assert_says("0 1 0\n", "0 nan 0\n", "body.vtk", "node 2 has a coordinate that is not finite", "repair");
    assert_says(
        "POINTS 5",
        "POINTS 6",
        "body.vtk:14",
        "expected a coordinate, found `METADATA`",
        "export it",
    );
    assert_says("POINTS 5", "POINTS 4", "body.vtk:13", "expected POINTS, CELLS or CELL_TYPES", "export it");
    assert_says("double\n0 0", "complex\n0 0", "body.vtk:10", "unknown number type `complex`", "export it");
    assert_says(
        "CELLS 3 14",
        "CELLS 3 15",
        "body.vtk:20",
        "announces 15 numbers and contains 14",
        "export it",
    );
    assert_says("CELL_TYPES 3", "CELL_TYPES 2", "body.vtk:23", "2 cell types for 3 cells", "export it");
    assert_says("10\n5\n10", "10\n5\n12", "body.vtk:20", "cell 2 is a hexahedron", "tetrahedra only");
    assert_says(
        "10\n5\n10",
        "10\n5\n24",
        "body.vtk:20",
        "cell 2 is a quadratic tetra with 4 nodes",
        "export it again",
    );
    assert_says(
        "10\n5\n10",
        "10\n5\n71",
        "body.vtk:20",
        "cell 2 is of an order or shape that is not read (VTK type 71)",
        "order 1 or as quadratic tetras",
    );
    assert_says("10\n5\n10", "10\n10\n10", "body.vtk:19", "cell 1 is a tetra with 3 nodes", "export it");
    assert_says("10 5 10", "10 5 900", "body.vtk", "cell 2 is a cell of unknown shape", "tetrahedra only");
    assert_says("0 4 7 11", "0 4 7 12", "body.vtk", "cell 2 reaches beyond the connectivity", "export it");
    assert_says(
        "UNSTRUCTURED_GRID",
        "POLYDATA",
        "body.vtk:4",
        "found `DATASET POLYDATA`",
        "unstructured grid",
    );
    assert_says("ASCII", "EBCDIC", "body.vtk:4", "found `EBCDIC`", "export it again");
    assert_says("# vtk DataFile", "# DataFile", "body.vtk:1", "not a VTK legacy file", "export it again");
    assert_says("CELLS 3 14", "CELL_TYPES 3\n10\n5\n10\nCELLS 3 14", "body.vtk:20", "precedes", "export it");
    assert_says("POINTS 5", "POINTS 99999999999", "body.vtk:10", "expected a count", "export it again");
}

#[test]
fn truncation_anywhere_is_one_clear_line() {
    let needed = OLD.rfind("10\n").expect("there") + 1;
    for end in 0..needed {
        let error = read(&OLD.as_bytes()[..end]).expect_err("truncated").to_string();
        assert!(error.starts_with("body.vtk:") && !error.contains('\n'), "{error}");
    }
    for bytes in [binary(false), binary(true)] {
        let needed = bytes.len() - b"\nCELL_DATA 3\n".len();
        assert!(read(&bytes[..needed]).is_ok());
        for end in 0..needed {
            let error = read(&bytes[..end]).expect_err("truncated").to_string();
            assert!(error.starts_with("body.vtk") && error.contains("; "), "{error}");
        }
    }
}

#[test]
fn rubbish_is_refused_and_never_panics() {
    for bytes in [OLD.as_bytes().to_vec(), NEW.as_bytes().to_vec(), binary(false), binary(true)] {
        for at in 0..bytes.len() {
            for byte in [b' ', b'9', b'-', b'\n', 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] = byte;
                if let Err(error) = read(&damaged) {
                    assert!(!error.to_string().contains('\n'));
                }
            }
        }
    }
}

/// Attributes of the three cells and five points; the numbers of `part` are 2, 9, 1.
const ATTRIBUTES: &str = "\
POINT_DATA 5
SCALARS height float
LOOKUP_TABLE default
0 0 1 0.5 1
TENSORS stress double
0 1 2 3 4 5 6 7 8 0 1 2 3 4 5 6 7 8 0 1 2 3 4 5 6 7 8 0 1 2 3 4 5 6 7 8 0 1 2 3 4 5 6 7 8
CELL_DATA 3
SCALARS part int 1
LOOKUP_TABLE own
2 9 1
LOOKUP_TABLE own 1
0 0 1 1
COLOR_SCALARS rgb 3
0 0 1 0 1 0 1 0 0
VECTORS axis float
1 0 0 1 0 0 1 0 0
FIELD FieldData 3
body%20part 1 3 double
2 9 1.0
METADATA
INFORMATION 0

density 1 3 float
1.5 2.5 3.5
label 1 3 string
a
b
c
";

fn cell_data(bytes: &[u8]) -> Result<CellData, InputError> {
    let raw = read_legacy(Path::new("body.vtk"), bytes, true)?;
    Ok(raw.cell_data.expect("VTK files have cell data"))
}

fn with_attributes(attributes: &str) -> String {
    OLD.replacen("CELL_DATA 3\nSCALARS anything string 1\n", attributes, 1)
}

/// The binary file with the same numbers of the cells.
fn binary_with_attributes(new_layout: bool) -> Vec<u8> {
    let mut out = binary(new_layout);
    out.truncate(out.len() - "CELL_DATA 3\n".len());
    out.extend(b"POINT_DATA 5\nVECTORS at float\n");
    out.extend(POINTS.iter().flat_map(|&x| (x as f32).to_be_bytes()));
    out.extend(b"\nCELL_DATA 3\nSCALARS part short 1\nLOOKUP_TABLE own\n");
    out.extend([2_i16, 9, 1].iter().flat_map(|n| n.to_be_bytes()));
    out.extend(b"\nLOOKUP_TABLE own 2\n\0\x0a\x0a\xff\xff\x0a\x0a\xff\nCOLOR_SCALARS rgb 1\n\x0a\x0a\x0a\n");
    out.extend(b"FIELD FieldData 2\nbody%20part 1 3 double\n");
    out.extend([2.0_f64, 9.0, 1.0].iter().flat_map(|x| x.to_be_bytes()));
    out.extend(b"\nlabel 1 3 string\n\xc1a\xc1b\xc1c\n");
    out
}

#[test]
fn numbers_of_the_cells_are_read_from_text_and_binary() {
    let text = with_attributes(ATTRIBUTES);
    let parts = [("1".to_owned(), vec![1]), ("2".to_owned(), vec![0])];
    let data = cell_data(text.as_bytes()).expect("sound");
    assert_eq!(data.names(), ["part", "rgb", "axis", "body part", "density"]);
    assert_eq!(data.regions("axis"), Err(RegionFault::Components(3)));
    assert_eq!(data.regions("density"), Err(RegionFault::Fraction { cell: 0, number: 1.5 }));
    let no_table = with_attributes(&ATTRIBUTES.replacen("LOOKUP_TABLE own\n", "", 1));
    for bytes in [
        text.into_bytes(),
        no_table.into_bytes(),
        binary_with_attributes(false),
        binary_with_attributes(true),
    ] {
        let data = cell_data(&bytes).expect("sound");
        assert_eq!(data.regions("part"), Ok(parts.clone().into()));
        assert_eq!(data.regions("body part"), Ok(parts.clone().into()));
        assert!(read(&bytes).expect("sound").tet_groups.is_empty(), "only a scene asks for the regions");
    }
    assert_eq!(cell_data(NEW.as_bytes()).expect("sound").names(), [""; 0]);
}

#[test]
fn damaged_attributes_are_refused_by_line() {
    let says = |from: &str, to: &str, place: &str, what: &str| {
        assert!(ATTRIBUTES.contains(from), "nothing to break: {from:?}");
        let text = with_attributes(&ATTRIBUTES.replacen(from, to, 1));
        let error = cell_data(text.as_bytes()).expect_err("planted fault").to_string();
        assert!(error.starts_with(place) && error.contains(what) && error.contains("; "), "{error}");
        assert!(read(text.as_bytes()).is_ok(), "attributes that nobody asks for do not matter");
    };
    says("CELL_DATA 3", "CELL_DATA 4", "body.vtk:31: ", "CELL_DATA of 4 cells, of 3");
    says("2 9 1\n", "2 9\n", "body.vtk:35: ", "expected a value, found `LOOKUP_TABLE`");
    says("VECTORS axis float", "SPINORS axis float", "body.vtk:39: ", "`SPINORS axis float` is not read");
    says("POINT_DATA 5\n", "", "body.vtk:25: ", "`SCALARS height float` is not read");
    says("density 1 3 float\n1.5 2.5 3.5", "density 1 2 float\n1.5 2.5", "body.vtk", "no number for every");
    says("part 1 3 double", "part 1 x double", "body.vtk:42: ", "expected a count");
}

#[test]
fn damaged_binary_attributes_never_panic() {
    for bytes in [with_attributes(ATTRIBUTES).into_bytes(), binary_with_attributes(true)] {
        for at in 0..bytes.len() {
            let _ = cell_data(&bytes[..at]).map_err(|error| assert!(!error.to_string().contains('\n')));
            for byte in [b' ', b'9', b'-', b'\n', b'%', 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] = byte;
                if let Ok(data) = cell_data(&damaged) {
                    data.names().into_iter().for_each(|name| drop(data.regions(name)));
                }
            }
        }
    }
}
