//! Reader of VTK legacy files (`.vtk`), ASCII and binary; the cells are shared with the reader of `.vtu`.
//!
//! The crate vtkio is not used: its legacy parser stops at unknown attributes, its XML parser panics on a
//! piece without points and cannot read raw appended data, which ParaView writes, and neither reports the
//! line of an error. Tets have type 10, or all have type 24 (ten nodes) with straight edges; their mid-edge
//! nodes are dropped (see `mid_edge.rs`: node indices count vertices only). Reading stops after CELL_TYPES
//! unless the cell data are wanted, see `vtk/attributes.rs`.

mod attributes;

use std::path::Path;

use super::cell_data::CellData;
use super::lines::excerpt;
use super::mid_edge;
use super::raw::{Origin, RawMesh};
use crate::error::InputError;

pub(super) const DAMAGED: &str = "the file is damaged or truncated: export it again";

/// Points of either format, with the relative rounding error of their number type.
pub(super) struct Points {
    points: Vec<[f64; 3]>,
    rounding: f64,
}

impl Points {
    pub(super) fn new(coordinates: &[f64], scalar: Scalar) -> Self {
        let rounding =
            if scalar == (Scalar::Float { size: 4 }) { f64::from(f32::EPSILON) / 2.0 } else { 0.0 };
        Self { points: coordinates.as_chunks::<3>().0.to_vec(), rounding }
    }
}

/// Decoded cells of either VTK format.
#[derive(Default)]
pub(super) struct Cells {
    /// VTK cell types.
    pub(super) types: Vec<u8>,
    /// End index of each cell in `nodes`.
    pub(super) ends: Vec<usize>,
    pub(super) nodes: Vec<u32>,
    /// Line of each cell; empty if the format has no lines of cells.
    pub(super) lines: Vec<usize>,
}

impl Cells {
    /// The tets of the cells. Cells of lower dimension are dropped, because VTK has no groups.
    pub(super) fn into_raw(self, file: &Path, points: Points) -> Result<RawMesh, InputError> {
        let Points { points, rounding } = points;
        let edge_order = Some(mid_edge::VTK_ORDER);
        let mut raw = RawMesh { rounding, edge_order, ..RawMesh::new(file, file) };
        raw.node_origins = (0..points.len() as u64).map(|tag| Origin { tag, line: None }).collect();
        raw.nodes = points;
        let mut start = 0;
        for (index, (&cell_type, &end)) in self.types.iter().zip(&self.ends).enumerate() {
            let line = self.lines.get(index).copied();
            let error = |what: String, fix: &str| InputError { line, ..InputError::new(file, what, fix) };
            let nodes = self
                .nodes
                .get(start..end)
                .ok_or_else(|| error(format!("cell {index} reaches beyond the connectivity"), DAMAGED))?;
            start = end;
            match cell_type {
                10 | 24 => {
                    let (count, shape) = if cell_type == 10 { (4, "tetra") } else { (10, "quadratic tetra") };
                    if nodes.len() != count {
                        let what = format!("cell {index} is a {shape} with {} nodes", nodes.len());
                        return Err(error(what, DAMAGED));
                    }
                    raw.push_tet(nodes, Origin { tag: index as u64, line }, &[])?;
                }
                1..=6 | 21 | 22 => {}
                23 | 25..=37 | 51..=81 => {
                    let what = format!(
                        "cell {index} is of an order or shape that is not read (VTK type {cell_type})"
                    );
                    let fix =
                        "mesh the body with tetrahedra only, and save with order 1 or as quadratic tetras";
                    return Err(error(what, fix));
                }
                other => {
                    let what = format!("cell {index} is a {} (VTK type {other})", shape(other));
                    return Err(error(what, "mesh the body with tetrahedra only"));
                }
            }
        }
        Ok(raw)
    }
}

fn shape(cell_type: u8) -> &'static str {
    match cell_type {
        7 => "polygon",
        8 => "pixel",
        9 => "quad",
        11 => "voxel",
        12 => "hexahedron",
        13 => "wedge",
        14 => "pyramid",
        42 => "polyhedron",
        _ => "cell of unknown shape",
    }
}

/// Reads a legacy file. [`RawMesh::finish`] does the checks that all formats share.
pub(super) fn read_legacy(file: &Path, bytes: &[u8], with_cell_data: bool) -> Result<RawMesh, InputError> {
    let mut cursor = Cursor { file, bytes, at: 0, line: 1, binary: false };
    let version = cursor.line("the version")?;
    if !version.to_lowercase().starts_with("# vtk datafile") {
        return Err(
            cursor.error("not a VTK legacy file: no `# vtk DataFile Version` on line 1", "export it again")
        );
    }
    cursor.raw_line();
    let encoding = cursor.line("ASCII or BINARY")?.to_uppercase();
    let dataset = cursor.line("DATASET")?.to_uppercase();
    if dataset.split_whitespace().ne(["DATASET", "UNSTRUCTURED_GRID"]) {
        let what = format!("expected DATASET UNSTRUCTURED_GRID, found `{dataset}`");
        return Err(cursor.error(what, "export the volume mesh as an unstructured grid"));
    }
    cursor.binary = match encoding.as_str() {
        "ASCII" => false,
        "BINARY" => true,
        other => return Err(cursor.error(format!("expected ASCII or BINARY, found `{other}`"), DAMAGED)),
    };
    let mut points = None;
    let mut cells = None;
    loop {
        let header = cursor.line("POINTS, CELLS or CELL_TYPES")?;
        let words: Vec<&str> = header.split_whitespace().collect();
        match (words[0].to_uppercase().as_str(), &words[1..]) {
            ("POINTS", [n, scalar]) => points = Some(cursor.points(n, scalar)?),
            ("CELLS", [n, size]) => cells = Some(cursor.cells(n, size)?),
            ("CELL_TYPES", [n]) => {
                let n = cursor.count(n)?;
                let types = cursor.numbers(n, "int", "a cell type")?;
                let (Some(points), Some(mut cells)) = (points, cells) else {
                    return Err(cursor.error("CELL_TYPES precedes POINTS or CELLS", DAMAGED));
                };
                if n != cells.ends.len() {
                    let what = format!("{n} cell types for {} cells", cells.ends.len());
                    return Err(cursor.error(what, DAMAGED));
                }
                cells.types = cell_types(&types);
                let mut raw = cells.into_raw(file, points)?;
                if with_cell_data {
                    let arrays = cursor.cell_arrays(n)?;
                    raw.cell_data = Some(CellData { arrays, cell_of_tet: cells_of_tets(&raw) });
                }
                return Ok(raw);
            }
            ("METADATA", _) => cursor.skip_metadata(),
            ("FIELD", [_, n]) => cursor.fields(n, |_| {})?,
            _ => {
                let what = format!("expected POINTS, CELLS or CELL_TYPES, found `{}`", excerpt(&header));
                return Err(cursor.error(what, DAMAGED));
            }
        }
    }
}

#[derive(Clone, Copy)]
struct Cursor<'a> {
    file: &'a Path,
    bytes: &'a [u8],
    at: usize,
    /// 1-based line of the last byte before `at`.
    line: usize,
    binary: bool,
}

impl Cursor<'_> {
    /// An error at the current position, with the line in an ASCII file.
    fn error(&self, what: impl Into<String>, fix: &str) -> InputError {
        let line = (!self.binary).then_some(self.line);
        InputError { line, ..InputError::new(self.file, what, fix) }
    }

    fn advance(&mut self, length: usize) {
        let to = self.at + length;
        let passed = &self.bytes[self.at.saturating_sub(1)..to.saturating_sub(1)];
        self.line += passed.iter().filter(|&&b| b == b'\n').count();
        self.at = to;
    }

    /// Text up to the next line break; can be empty.
    fn raw_line(&mut self) -> String {
        let rest = &self.bytes[self.at..];
        let end = rest.iter().position(|&b| b == b'\n').map_or(rest.len(), |end| end + 1);
        self.advance(end);
        String::from_utf8_lossy(&rest[..end]).into_owned()
    }

    /// The next non-empty line, trimmed.
    fn line(&mut self, wanted: &str) -> Result<String, InputError> {
        while self.at < self.bytes.len() {
            let line = self.raw_line();
            if !line.trim().is_empty() {
                return Ok(line.trim().to_owned());
            }
        }
        Err(self.error(format!("the file ends where {wanted} should follow"), DAMAGED))
    }

    fn count(&self, word: &str) -> Result<usize, InputError> {
        // Node indices have 32 bits. A larger count is an error and would cause a huge allocation.
        let n: Option<u32> = word.parse().ok();
        n.map(|n| n as usize)
            .ok_or_else(|| self.error(format!("expected a count, found `{}`", excerpt(word)), DAMAGED))
    }

    fn points(&mut self, n: &str, scalar: &str) -> Result<Points, InputError> {
        let n = self.count(n)?;
        let coordinates = self.numbers(3 * n, scalar, "a coordinate")?;
        Ok(Points::new(&coordinates, Scalar::from_legacy(scalar).expect("numbers of this type were read")))
    }

    /// Both layouts: `n v0 .. vn` per cell and, since version 5.1, OFFSETS and CONNECTIVITY.
    fn cells(&mut self, n: &str, size: &str) -> Result<Cells, InputError> {
        let (n, size) = (self.count(n)?, self.count(size)?);
        let start = *self;
        let next = self.line("the cells")?;
        if let ["OFFSETS", scalar] = next.split_whitespace().collect::<Vec<_>>()[..] {
            let offsets = self.numbers(n, scalar, "an offset")?;
            let header = self.line("CONNECTIVITY")?;
            let ["CONNECTIVITY", scalar] = header.split_whitespace().collect::<Vec<_>>()[..] else {
                return Err(
                    self.error(format!("expected CONNECTIVITY, found `{}`", excerpt(&header)), DAMAGED)
                );
            };
            let nodes = self.indices(size, scalar)?;
            // The first offset is 0, so there is one offset more than cells.
            let ends = offsets.iter().skip(1).map(|&end| integer(end).unwrap_or(usize::MAX)).collect();
            return Ok(Cells { ends, nodes, ..Cells::default() });
        }
        *self = start;
        let mut cells = Cells::default();
        for _ in 0..n {
            let per_cell = self.indices(1, "int")?[0] as usize;
            if !self.binary {
                cells.lines.push(self.line);
            }
            if per_cell > size {
                return Err(self.error(format!("a cell with {per_cell} nodes"), DAMAGED));
            }
            let nodes = self.indices(per_cell, "int")?;
            cells.nodes.extend(nodes);
            cells.ends.push(cells.nodes.len());
        }
        if cells.nodes.len() + n != size {
            let what = format!("CELLS announces {size} numbers and contains {}", cells.nodes.len() + n);
            return Err(self.error(what, DAMAGED));
        }
        Ok(cells)
    }

    fn indices(&mut self, n: usize, scalar: &str) -> Result<Vec<u32>, InputError> {
        let numbers = self.numbers(n, scalar, "a node index")?;
        let index =
            |i: f64| integer(i).ok_or_else(|| self.error(format!("{i} is not a node index"), DAMAGED));
        numbers.into_iter().map(index).collect()
    }

    /// Reads `n` numbers of a VTK type: words in an ASCII file, big-endian bytes in a binary file.
    fn numbers(&mut self, n: usize, scalar: &str, wanted: &str) -> Result<Vec<f64>, InputError> {
        let Some(scalar) = Scalar::from_legacy(scalar) else {
            return Err(self.error(format!("unknown number type `{}`", excerpt(scalar)), DAMAGED));
        };
        if !self.binary {
            return (0..n).map(|_| self.word(wanted)).collect();
        }
        let length = n.saturating_mul(scalar.size());
        let Some(bytes) = self.bytes[self.at..].get(..length) else {
            return Err(self.error(format!("the file ends inside a block of {n} numbers"), DAMAGED));
        };
        self.advance(length);
        Ok(bytes.chunks_exact(scalar.size()).map(|b| scalar.decode(b, false)).collect())
    }

    fn word(&mut self, wanted: &str) -> Result<f64, InputError> {
        let rest = &self.bytes[self.at..];
        let start = rest.iter().position(|b| !b.is_ascii_whitespace()).unwrap_or(rest.len());
        let length = rest[start..].iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len() - start);
        self.advance(start + length);
        let word = String::from_utf8_lossy(&rest[start..start + length]);
        word.parse().map_err(|_| match word.as_ref() {
            "" => self.error(format!("the file ends where {wanted} should follow"), DAMAGED),
            other => self.error(format!("expected {wanted}, found `{}`", excerpt(other)), DAMAGED),
        })
    }
}

/// The cell of each tet: a tet's tag is the position of its cell.
pub(super) fn cells_of_tets(raw: &RawMesh) -> Vec<usize> {
    raw.tet_origins.iter().map(|origin| origin.tag as usize).collect()
}

/// A number of a file as an integer, if it is one of this type.
pub(super) fn integer<I: TryFrom<i64>>(number: f64) -> Option<I> {
    (number.fract() == 0.0).then_some(number as i64).and_then(|n| I::try_from(n).ok())
}

/// VTK cell types. Types above 255 do not exist; 255 is refused as an unknown type.
pub(super) fn cell_types(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().map(|&number| integer(number).unwrap_or(u8::MAX)).collect()
}

/// The number types of VTK files.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    Int { size: usize, signed: bool },
    Float { size: usize },
}

impl Scalar {
    /// Type names of legacy files. `long` has 8 bytes, as on every 64-bit platform except Windows.
    /// `vtkIdType` is written as a 4-byte integer, independent of its size in memory.
    fn from_legacy(name: &str) -> Option<Self> {
        let name = name.to_lowercase();
        let signed = !name.starts_with("unsigned_");
        Some(match name.trim_start_matches("unsigned_") {
            "float" => Self::Float { size: 4 },
            "double" => Self::Float { size: 8 },
            "char" => Self::Int { size: 1, signed },
            "short" => Self::Int { size: 2, signed },
            "int" | "vtkidtype" | "vtktypeint32" => Self::Int { size: 4, signed },
            "long" | "vtktypeint64" => Self::Int { size: 8, signed },
            _ => return None,
        })
    }

    /// Type names of XML files: `Float64`, `UInt8`, ...
    pub(super) fn from_xml(name: &str) -> Option<Self> {
        let bits_of = |prefix: &str| name.strip_prefix(prefix).and_then(|bits| bits.parse::<usize>().ok());
        let scalar = match (bits_of("Float"), bits_of("Int"), bits_of("UInt")) {
            (Some(bits @ (32 | 64)), _, _) => Self::Float { size: bits / 8 },
            (_, Some(bits @ (8 | 16 | 32 | 64)), _) => Self::Int { size: bits / 8, signed: true },
            (_, _, Some(bits @ (8 | 16 | 32 | 64))) => Self::Int { size: bits / 8, signed: false },
            _ => return None,
        };
        Some(scalar)
    }

    pub(super) fn size(self) -> usize {
        match self {
            Self::Int { size, .. } | Self::Float { size } => size,
        }
    }

    /// Decodes a number from its `size()` bytes. Every node index is exact as an f64.
    pub(super) fn decode(self, bytes: &[u8], little_endian: bool) -> f64 {
        let mut word = [0u8; 8];
        let size = self.size();
        word[..size].copy_from_slice(bytes);
        if !little_endian {
            word[..size].reverse();
        }
        let bits = u64::from_le_bytes(word);
        match self {
            Self::Float { size: 4 } => f64::from(f32::from_bits(bits as u32)),
            Self::Float { .. } => f64::from_bits(bits),
            Self::Int { signed: false, .. } => bits as f64,
            Self::Int { size, .. } => {
                // The two shifts extend the sign bit to the upper bits.
                let unused = 64 - 8 * size as u32;
                ((bits << unused) as i64 >> unused) as f64
            }
        }
    }
}

#[cfg(test)]
mod tests;
