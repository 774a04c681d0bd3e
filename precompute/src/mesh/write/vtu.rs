//! Writer of VTU, VTK's XML format of an unstructured grid, for one state of a body.
//!
//! Data are inline base64 with 64-bit headers: well-formed XML that any XML tool can read, a third larger
//! than raw appended bytes. An inconsistent grid is refused before a file is written.

use std::io;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;

use super::escaped;
use crate::files::write_atomically;

/// Kind of all cells of a grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cell {
    /// One point (VTK type 1).
    Vertex,
    /// Three vertices (VTK type 5).
    Triangle,
    /// Four vertices (VTK type 10).
    Tet4,
    /// Four vertices, then the midpoints of the edges 01, 12, 02, 03, 13, 23 (VTK type 24).
    Tet10,
}

impl Cell {
    /// Number of nodes, and the VTK type.
    fn shape(self) -> (usize, u8) {
        match self {
            Self::Vertex => (1, 1),
            Self::Triangle => (3, 5),
            Self::Tet4 => (4, 10),
            Self::Tet10 => (10, 24),
        }
    }
}

/// A named array with `components` numbers per point, cell or tuple, stored tuple by tuple.
#[derive(Debug, Clone, Copy)]
pub struct Field<'a> {
    /// Name with unit, as in `displacement_m`; viewers display it.
    pub name: &'a str,
    /// Numbers per point or cell: 1 for a scalar, 3 for a vector.
    pub components: usize,
    /// Values, tuple by tuple.
    pub values: &'a [f64],
}

/// Content of a file.
#[derive(Debug, Clone, Copy)]
pub struct Grid<'a> {
    /// Node positions at rest, m.
    pub nodes_m: &'a [[f64; 3]],
    /// Kind of the cells.
    pub cell: Cell,
    /// Nodes of the cells, cell by cell.
    pub connectivity: &'a [u32],
    /// Data per node.
    pub point_data: &'a [Field<'a>],
    /// Data per cell.
    pub cell_data: &'a [Field<'a>],
    /// Data of the whole state: one tuple each.
    pub field_data: &'a [Field<'a>],
}

impl Grid<'_> {
    /// Writes the grid atomically; an existing file is replaced.
    pub(super) fn write(&self, path: &Path) -> io::Result<()> {
        write_atomically(path, self.encode()?.as_bytes())
    }

    /// The text of a VTU file. An inconsistent grid is an error of the kind `InvalidInput`.
    pub fn encode(&self) -> io::Result<String> {
        let (per_cell, vtk_type) = self.cell.shape();
        let (points, cells) = (self.nodes_m.len(), self.connectivity.len() / per_cell);
        if !self.connectivity.len().is_multiple_of(per_cell) {
            let indices = self.connectivity.len();
            return Err(inconsistent(format!(
                "{indices} indices are no whole number of cells of {per_cell}"
            )));
        }
        if let Some(at) = self.connectivity.iter().position(|&node| node as usize >= points) {
            let (cell, node) = (at / per_cell, self.connectivity[at]);
            return Err(inconsistent(format!("cell {cell} names node {node}, which does not exist")));
        }
        let mut out = String::from(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" \
             header_type=\"UInt64\">\n<UnstructuredGrid>\n",
        );
        out.push_str("<FieldData>\n");
        for field in self.field_data {
            push_field(&mut out, field, 1, " NumberOfTuples=\"1\"")?;
        }
        out.push_str(&format!(
            "</FieldData>\n<Piece NumberOfPoints=\"{points}\" NumberOfCells=\"{cells}\">\n<PointData>\n"
        ));
        for field in self.point_data {
            push_field(&mut out, field, points, "")?;
        }
        out.push_str("</PointData>\n<CellData>\n");
        for field in self.cell_data {
            push_field(&mut out, field, cells, "")?;
        }
        out.push_str("</CellData>\n<Points>\n");
        push_floats(&mut out, "Points", 3, "", self.nodes_m.as_flattened());
        out.push_str("</Points>\n<Cells>\n");
        let connectivity = self.connectivity.iter().flat_map(|&node| i64::from(node).to_le_bytes());
        push_array(&mut out, "Int64", "connectivity", "", connectivity);
        let ends = (1..=cells).flat_map(|cell| ((cell * per_cell) as i64).to_le_bytes());
        push_array(&mut out, "Int64", "offsets", "", ends);
        push_array(&mut out, "UInt8", "types", "", std::iter::repeat_n(vtk_type, cells));
        out.push_str("</Cells>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n");
        Ok(out)
    }
}

fn inconsistent(what: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, what)
}

fn push_field(out: &mut String, field: &Field<'_>, tuples: usize, more: &str) -> io::Result<()> {
    let (found, due) = (field.values.len(), tuples * field.components);
    if found != due {
        let name = field.name;
        return Err(inconsistent(format!("field `{name}` has {found} values where {due} are due")));
    }
    push_floats(out, field.name, field.components, more, field.values);
    Ok(())
}

fn push_floats(out: &mut String, name: &str, components: usize, more: &str, values: &[f64]) {
    let more = format!(" NumberOfComponents=\"{components}\"{more}");
    push_array(out, "Float64", name, &more, values.iter().flat_map(|value| value.to_le_bytes()));
}

/// Header (number of bytes) and data form one base64 stream, as VTK requires for uncompressed data.
fn push_array(out: &mut String, scalar: &str, name: &str, more: &str, data: impl Iterator<Item = u8>) {
    let mut bytes = vec![0; 8];
    bytes.extend(data);
    let length = (bytes.len() - 8) as u64;
    bytes[..8].copy_from_slice(&length.to_le_bytes());
    out.push_str(&format!(
        "<DataArray type=\"{scalar}\" Name=\"{}\"{more} format=\"binary\">",
        escaped(name)
    ));
    BASE64.encode_string(&bytes, out);
    out.push_str("</DataArray>\n");
}

#[cfg(test)]
mod tests {
    use roxmltree::{Document, Node};

    use super::*;
    use crate::mesh::testing::cube;
    use crate::mesh::{LengthUnit, TetMesh};

    fn grid(mesh: &TetMesh) -> Grid<'_> {
        Grid {
            nodes_m: &mesh.nodes_m,
            cell: Cell::Tet4,
            connectivity: mesh.tets.as_flattened(),
            point_data: &[],
            cell_data: &[],
            field_data: &[],
        }
    }

    fn read_back(grid: &Grid<'_>) -> (TetMesh, String) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("state.vtu");
        grid.write(&path).expect("written");
        assert_eq!(
            std::fs::read_dir(folder.path()).expect("it is there").count(),
            1,
            "no temporary file stays"
        );
        let mesh = crate::mesh::read(&path, LengthUnit::Metre).expect("our own reader reads it");
        (mesh, std::fs::read_to_string(&path).expect("it is text"))
    }

    /// Values of a named array, decoded independently of the reader.
    fn floats(document: &Document<'_>, parent: &str, name: &str) -> (u32, Vec<f64>) {
        let is = |node: &Node<'_, '_>| {
            node.attribute("Name") == Some(name)
                && node.parent().is_some_and(|parent_node| parent_node.has_tag_name(parent))
        };
        let array = document.descendants().find(is).unwrap_or_else(|| panic!("no {parent}/{name}"));
        assert_eq!((array.attribute("type"), array.attribute("format")), (Some("Float64"), Some("binary")));
        let bytes = BASE64.decode(array.text().expect("data")).expect("base64");
        let (header, data) = bytes.split_at(8);
        assert_eq!(u64::from_le_bytes(header.try_into().expect("8 bytes")), data.len() as u64);
        let components = array.attribute("NumberOfComponents").expect("stated").parse().expect("a number");
        (components, data.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect())
    }

    #[test]
    fn our_reader_and_an_xml_parser_find_every_bit() {
        let mesh = cube(2, 0.1);
        let values: Vec<f64> = (0..3 * mesh.nodes_m.len()).map(|i| 1.0 / (i as f64 - 40.5)).collect();
        let per_cell: Vec<f64> = (0..mesh.tets.len()).map(|i| (i as f64).sqrt()).collect();
        let name = "a <name> & \"more\"";
        let (back, text) = read_back(&Grid {
            point_data: &[Field { name: "displacement_m", components: 3, values: &values }],
            cell_data: &[Field { name, components: 1, values: &per_cell }],
            field_data: &[Field {
                name: "reaction_n",
                components: 3,
                values: &[1.0, -2.5, f64::MIN_POSITIVE],
            }],
            ..grid(&mesh)
        });
        assert_eq!(back, mesh);
        let document = Document::parse(&text).expect("well-formed XML");
        assert_eq!(document.root_element().attribute("header_type"), Some("UInt64"));
        assert_eq!(floats(&document, "PointData", "displacement_m"), (3, values));
        assert_eq!(floats(&document, "CellData", name), (1, per_cell));
        assert_eq!(floats(&document, "FieldData", "reaction_n"), (3, vec![1.0, -2.5, f64::MIN_POSITIVE]));
    }

    #[test]
    fn ten_node_tets_go_out_in_vtks_order() {
        let nodes = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let middle = |a: usize, b: usize| std::array::from_fn(|axis| 0.5 * (nodes[a][axis] + nodes[b][axis]));
        let mut all: Vec<[f64; 3]> = nodes.to_vec();
        all.extend([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)].map(|(a, b)| middle(a, b)));
        let tets = [[0, 1, 2, 3, 4, 5, 6, 7, 8, 9]];
        let none = TetMesh::default();
        let connectivity = &tets.as_flattened();
        let grid = Grid { nodes_m: &all, cell: Cell::Tet10, connectivity, ..grid(&none) };
        // The reader checks that each mid-edge node is in the middle of its edge.
        let (back, text) = read_back(&grid);
        assert_eq!((back.nodes_m, back.tets), (nodes.to_vec(), vec![[0, 1, 2, 3]]));
        let document = Document::parse(&text).expect("well-formed XML");
        assert_eq!(floats(&document, "Points", "Points").1, all.as_flattened());
    }

    #[test]
    fn what_does_not_fit_together_is_refused_and_leaves_no_file() {
        let mesh = cube(1, 0.1);
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("state.vtu");
        let refused = |grid: &Grid<'_>| {
            let error = grid.write(&path).expect_err("planted fault").to_string();
            assert_eq!(std::fs::read_dir(folder.path()).expect("it is there").count(), 0);
            error
        };
        let short = [Field { name: "u", components: 3, values: &[0.0; 23] }];
        assert!(refused(&Grid { point_data: &short, ..grid(&mesh) }).contains("`u` has 23 values where 24"));
        assert!(refused(&Grid { cell_data: &short, ..grid(&mesh) }).contains("where 18 are due"));
        assert!(refused(&Grid { field_data: &short, ..grid(&mesh) }).contains("where 3 are due"));
        let error = refused(&Grid { nodes_m: &mesh.nodes_m[..7], ..grid(&mesh) });
        assert!(error.contains("cell 0 names node 7"), "{error}");
        let nowhere = folder.path().join("none/state.vtu");
        let error = grid(&mesh).write(&nowhere).expect_err("no such folder");
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
    }
}
