//! Small VTU files in every encoding of the reader.

use std::io::Write;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;

use super::read as read_raw;
use crate::error::InputError;
use crate::mesh::{CellData, LengthUnit, RegionFault, TetMesh};

const ASCII: &str = r#"<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian">
<UnstructuredGrid>
<Piece NumberOfPoints="5" NumberOfCells="3">
<PointData></PointData>
<Points>
<DataArray type="Float64" NumberOfComponents="3" format="ascii">
0 0 0 1 0 0
0 1 0
0 0 1 1 1 1
</DataArray>
</Points>
<Cells>
<DataArray type="Int64" Name="connectivity" format="ascii">
0 1 2 3
0 1 2
1 2 3 4
</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">4 7 11</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">10 5 10</DataArray>
</Cells>
</Piece>
</UnstructuredGrid>
</VTKFile>
"#;

fn read(bytes: &[u8]) -> Result<TetMesh, InputError> {
    read_raw(Path::new("body.vtu"), bytes, false)?.finish(LengthUnit::Metre)
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum Where {
    Inline,
    AppendedBase64,
    AppendedRaw,
}

/// The same body in binary data: headers of 4 or 8 bytes, plain or in zlib blocks of 16 bytes.
fn binary(place: Where, zlib: bool, wide: bool, little: bool) -> Vec<u8> {
    let points = [0f64, 0., 0., 1., 0., 0., 0., 1., 0., 0., 0., 1., 1., 1., 1.];
    let bytes_of = |numbers: &[u64], size: usize| -> Vec<u8> {
        let bytes = |n: &u64| {
            if little { n.to_le_bytes()[..size].to_vec() } else { n.to_be_bytes()[8 - size..].to_vec() }
        };
        numbers.iter().flat_map(bytes).collect()
    };
    let arrays = [
        ("Points", "Float64", bytes_of(&points.map(f64::to_bits), 8)),
        ("connectivity", "Int32", bytes_of(&[0, 1, 2, 3, 0, 1, 2, 1, 2, 3, 4], 4)),
        ("offsets", "UInt16", bytes_of(&[4, 7, 11], 2)),
        ("types", "UInt8", vec![10, 5, 10]),
        ("part", "Int16", bytes_of(&[2, 9, 1], 2)),
    ];
    let header = if wide { 8 } else { 4 };
    let mut appended = Vec::new();
    let elements = arrays.map(|(name, scalar, data)| {
        let (head, body) = if zlib {
            let blocks: Vec<Vec<u8>> = data
                .chunks(16)
                .map(|block| {
                    let mut encoder =
                        flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
                    encoder.write_all(block).expect("to memory");
                    encoder.finish().expect("to memory")
                })
                .collect();
            let mut numbers = vec![blocks.len() as u64, 16, (data.len() % 16) as u64];
            numbers.extend(blocks.iter().map(|block| block.len() as u64));
            (bytes_of(&numbers, header), blocks.concat())
        } else {
            (bytes_of(&[data.len() as u64], header), data)
        };
        // A compressed header is a base64 stream of its own; a plain header forms one stream with its data.
        let encoded = match zlib {
            true => BASE64.encode(&head) + &BASE64.encode(&body),
            false => BASE64.encode([head.clone(), body.clone()].concat()),
        };
        let offset = appended.len();
        let (format, text) = match place {
            Where::Inline => ("format=\"binary\"".to_owned(), encoded),
            Where::AppendedBase64 => {
                appended.extend(encoded.bytes());
                (format!("format=\"appended\" offset=\"{offset}\""), String::new())
            }
            Where::AppendedRaw => {
                appended.extend([head, body].concat());
                (format!("format=\"appended\" offset=\"{offset}\""), String::new())
            }
        };
        format!("<DataArray type=\"{scalar}\" Name=\"{name}\" {format}>\n  {text}\n</DataArray>\n")
    });
    let [points, connectivity, offsets, types, part] = elements;
    let order = if little { "LittleEndian" } else { "BigEndian" };
    let width = if wide { "UInt64" } else { "UInt32" };
    let compressor = if zlib { "compressor=\"vtkZLibDataCompressor\"" } else { "" };
    let mut file = format!(
        "<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"{order}\" header_type=\"{width}\" {compressor}>\n\
         <UnstructuredGrid><Piece NumberOfPoints=\"5\" NumberOfCells=\"3\">\n<Points>{points}</Points>\n\
         <Cells>{connectivity}{offsets}{types}</Cells><CellData>{part}</CellData></Piece></UnstructuredGrid>\n"
    )
    .into_bytes();
    if place != Where::Inline {
        let encoding = if place == Where::AppendedRaw { "raw" } else { "base64" };
        file.extend(format!("<AppendedData encoding=\"{encoding}\">\n_").bytes());
        file.extend(appended);
        file.extend(b"\n</AppendedData>\n");
    }
    file.extend(b"</VTKFile>\n");
    file
}

fn every_encoding() -> Vec<Vec<u8>> {
    let mut all = Vec::new();
    for place in [Where::Inline, Where::AppendedBase64, Where::AppendedRaw] {
        for zlib in [false, true] {
            for (wide, little) in [(false, true), (true, true), (true, false)] {
                all.push(binary(place, zlib, wide, little));
            }
        }
    }
    all
}

#[test]
fn every_encoding_gives_the_same_mesh() {
    let mesh = read(ASCII.as_bytes()).expect("sound");
    assert_eq!(mesh.tets, [[0, 1, 2, 3], [1, 2, 3, 4]]);
    assert_eq!(mesh.nodes_m[4], [1.0, 1.0, 1.0]);
    for (index, file) in every_encoding().into_iter().enumerate() {
        assert_eq!(read(&file).unwrap_or_else(|e| panic!("encoding {index}: {e}")), mesh, "encoding {index}");
    }
}

#[track_caller]
fn assert_says(from: &str, to: &str, place: &str, what: &str, fix: &str) {
    assert!(ASCII.contains(from), "nothing to break: {from:?}");
    let error = read(ASCII.replacen(from, to, 1).as_bytes()).expect_err("planted fault").to_string();
    assert!(error.starts_with(&format!("{place}: ")), "{error}");
    let (problem, remedy) = error.split_once("; ").expect("a problem and a fix");
    assert!(problem.contains(what) && remedy.contains(fix), "{error}");
}

#[test]
fn faults_name_line_and_cell() {
    assert_says(
        "\n0 1 0\n",
        "\n0 one 0\n",
        "body.vtu:9",
        "expected a number of `Points`, found `one`",
        "export",
    );
    assert_says(
        "\n0 1 0\n",
        "\n0 1\n",
        "body.vtu:7",
        "`Points` holds 14 numbers where 15",
        "export it again",
    );
    assert_says("\n0 1 2 3\n", "\n1 0 2 3\n", "body.vtu", "element 0 has negative volume", "swap any two");
    assert_says("\n1 2 3 4\n", "\n1 2 3 9\n", "body.vtu", "element 2 names node 9", "export it again");
    assert_says("\n1 2 3 4\n", "\n1 2 3 -4\n", "body.vtu:14", "-4 is not a node index", "export it again");
    assert_says("10 5 10", "10 5 13", "body.vtu", "cell 2 is a wedge", "tetrahedra only");
    assert_says("10 5 10", "25 5 10", "body.vtu", "order or shape that is not read", "order 1");
    assert_says(
        "Name=\"types\"",
        "Name=\"kinds\"",
        "body.vtu:13",
        "<Cells> has no `types`",
        "export it again",
    );
    assert_says("<Points>", "<Dots>", "body.vtu:12", "not valid XML", "export it again");
    assert_says("Float64", "Float80", "body.vtu:7", "unknown type `Float80`", "export it again");
    assert_says("format=\"ascii\"", "format=\"morse\"", "body.vtu:7", "unknown format `morse`", "export it");
    assert_says("NumberOfPoints=\"5\"", "NumberOfPoints=\"-5\"", "body.vtu:4", "is not a count", "export it");
    assert_says(
        "format=\"ascii\"",
        "format=\"appended\" offset=\"0\"",
        "body.vtu:7",
        "beyond the appended",
        "export",
    );
    assert_says("</Piece>", "</Piece><Piece/>", "body.vtu:3", "2 pieces", "merge them");
    let poly = "<VTKFile type=\"PolyData\"";
    assert_says(
        "<VTKFile type=\"UnstructuredGrid\"",
        poly,
        "body.vtu:2",
        "but PolyData",
        "unstructured grid",
    );
    let lz4 = "byte_order=\"LittleEndian\" compressor=\"vtkLZ4DataCompressor\"";
    assert_says(
        "byte_order=\"LittleEndian\"",
        lz4,
        "body.vtu",
        "compressed with vtkLZ4DataCompressor",
        "zlib",
    );
    let error = read(&[b"<VTKFile>", &[0xff][..]].concat()).expect_err("planted").to_string();
    assert!(error.contains("not UTF-8"), "{error}");
}

#[test]
fn truncation_and_rubbish_are_refused_and_never_panic() {
    for file in every_encoding() {
        for end in (0..file.len() - 10).step_by(7) {
            let error = read(&file[..end]).expect_err("truncated").to_string();
            assert!(error.starts_with("body.vtu") && !error.contains('\n'), "{error}");
        }
        for at in (0..file.len()).step_by(3) {
            for byte in [b'A', b'9', 0xff] {
                let mut damaged = file.clone();
                damaged[at] = byte;
                if let Err(error) = read(&damaged) {
                    assert!(!error.to_string().contains('\n'));
                }
            }
        }
    }
}

#[test]
fn a_lie_about_the_length_is_not_believed() {
    // 2^32 - 1 points in a file of a few hundred bytes: refused before an allocation of that size.
    let file = String::from_utf8(binary(Where::Inline, true, false, true)).expect("text");
    let lie = file.replace("NumberOfPoints=\"5\"", "NumberOfPoints=\"4294967295\"");
    let error = read(lie.as_bytes()).expect_err("planted").to_string();
    assert!(error.contains("bytes where"), "{error}");
}

#[test]
fn a_block_that_swells_beyond_what_is_due_is_cut_off() {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(&vec![10; 1 << 20]).expect("to memory");
    let block = encoder.finish().expect("to memory");
    let header: Vec<u8> = [1, 1 << 20, 0, block.len() as u32].iter().flat_map(|n| n.to_le_bytes()).collect();
    let data = format!("format=\"binary\">{}{}<", BASE64.encode(header), BASE64.encode(block));
    let file = ASCII.replacen("byte_order", "compressor=\"vtkZLibDataCompressor\" byte_order", 1).replacen(
        "format=\"ascii\">10 5 10<",
        &data,
        1,
    );
    let error = read(file.as_bytes()).expect_err("a megabyte for three cells").to_string();
    assert!(error.contains("body.vtu:20: `types` holds 4 bytes where 3 are due; "), "{error}");
}

/// The text file with arrays of cells in front of the points.
fn with_arrays(arrays: &str) -> String {
    ASCII.replacen("<Points>", &format!("<CellData Scalars=\"part\">{arrays}</CellData><Points>"), 1)
}

fn cell_data(bytes: &[u8]) -> Result<CellData, InputError> {
    Ok(read_raw(Path::new("body.vtu"), bytes, true)?.cell_data.expect("VTU files have cell data"))
}

#[test]
fn every_encoding_gives_the_numbers_of_the_cells() {
    let text = with_arrays(
        "<DataArray type=\"String\" Name=\"label\" format=\"ascii\">97 0 98 0 99 0</DataArray>\n\
         <DataArray type=\"Float32\" Name=\"part\" format=\"ascii\">2 0.5 1.0</DataArray>\n\
         <DataArray type=\"Float64\" Name=\"v\" NumberOfComponents=\"2\" format=\"ascii\">1 2 3 4 5 6</DataArray>",
    );
    let data = cell_data(text.as_bytes()).expect("sound");
    assert_eq!(data.names(), ["part", "v"]);
    assert_eq!(data.regions("v"), Err(RegionFault::Components(2)));
    let parts = [("1".to_owned(), vec![1]), ("2".to_owned(), vec![0])];
    for bytes in every_encoding().into_iter().chain([text.into_bytes()]) {
        let regions = cell_data(&bytes).expect("sound").regions("part");
        assert_eq!(regions, Ok(parts.clone().into()));
        assert_eq!(read(&bytes).expect("sound").tet_groups.len(), 0, "only a scene asks for the regions");
    }
    assert_eq!(cell_data(ASCII.as_bytes()).expect("sound").names(), [""; 0]);
}

#[test]
fn damaged_numbers_of_cells_are_refused() {
    let short = with_arrays("<DataArray type=\"Int32\" Name=\"part\" format=\"ascii\">1 2</DataArray>");
    let error = cell_data(short.as_bytes()).expect_err("planted fault").to_string();
    assert!(error.starts_with("body.vtu:6: `part` holds 2 numbers where 3 are due; "), "{error}");
    assert!(read(short.as_bytes()).is_ok(), "cell data that nobody asks for do not matter");
    let word = short.replace(">1 2<", ">1 2 x<");
    let error = cell_data(word.as_bytes()).expect_err("planted fault").to_string();
    assert!(error.contains("expected a number of `part`, found `x`"), "{error}");
}
