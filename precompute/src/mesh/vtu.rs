//! Reader of VTU, VTK's XML format of an unstructured grid, with text, base64 or raw appended data, plain or
//! zlib.
//!
//! The cells are those of `vtk.rs`, including ten-node tets with straight edges (node indices count vertices
//! only).

use std::io::Read;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use roxmltree::{Document, Node};

use super::cell_data::{CellArray, CellData};
use super::lines::excerpt;
use super::raw::RawMesh;
use super::vtk::{Cells, DAMAGED, Points, Scalar, cell_types, cells_of_tets, integer};
use crate::error::InputError;

/// Reads a file with one piece. [`RawMesh::finish`] does the checks that all formats share.
pub(super) fn read(file: &Path, bytes: &[u8], with_cell_data: bool) -> Result<RawMesh, InputError> {
    let (xml, appended) = split_appended(bytes);
    let text = std::str::from_utf8(&xml)
        .map_err(|_| InputError::new(file, "the XML part of the file is not UTF-8 text", DAMAGED))?;
    let document = Document::parse(text)
        .map_err(|e| InputError::at(file, e.pos().row as usize, format!("not valid XML ({e})"), DAMAGED))?;
    let root = document.root_element();
    let vtu = Vtu {
        file,
        document: &document,
        appended,
        little_endian: root.attribute("byte_order") != Some("BigEndian"),
        header_size: if root.attribute("header_type") == Some("UInt64") { 8 } else { 4 },
        compressed: match root.attribute("compressor") {
            None | Some("") => false,
            Some("vtkZLibDataCompressor") => true,
            Some(other) => {
                let what = format!("the data are compressed with {other}");
                return Err(InputError::new(file, what, "save it uncompressed or with zlib"));
            }
        },
    };
    let grid = match (root.attribute("type"), vtu.child(root, "UnstructuredGrid")) {
        (Some("UnstructuredGrid"), Ok(grid)) => grid,
        (found, _) => {
            let what = format!("not an unstructured grid but {}", found.unwrap_or("of no type"));
            return Err(vtu.error(root, what, "export the volume mesh as an unstructured grid (.vtu)"));
        }
    };
    let piece = vtu.child(grid, "Piece")?;
    let count = grid.children().filter(|node| node.has_tag_name("Piece")).count();
    if count > 1 {
        let what = format!("the grid has {count} pieces");
        return Err(vtu.error(grid, what, "merge them into one (ParaView: Merge Blocks, then save again)"));
    }
    let mut raw = vtu.piece(piece)?;
    if with_cell_data {
        raw.cell_data = Some(CellData { arrays: vtu.cell_arrays(piece)?, cell_of_tet: cells_of_tets(&raw) });
    }
    Ok(raw)
}

/// Separates the bytes of `AppendedData`, because raw data are not XML.
fn split_appended(bytes: &[u8]) -> (Vec<u8>, Option<&[u8]>) {
    let find = |needle: &[u8]| bytes.windows(needle.len()).position(|window| window == needle);
    let find_last = |needle: &[u8]| bytes.windows(needle.len()).rposition(|window| window == needle);
    let (Some(tag), Some(end)) = (find(b"<AppendedData"), find_last(b"</AppendedData")) else {
        return (bytes.to_vec(), None);
    };
    // The data start after the first underscore in the element's content.
    let content = bytes[tag..].iter().position(|&b| b == b'>').map_or(end, |at| tag + at + 1);
    let Some(start) = bytes.get(content..end).and_then(|data| data.iter().position(|&b| b == b'_')) else {
        return (bytes.to_vec(), None);
    };
    let data = &bytes[content + start + 1..end];
    ([&bytes[..content], &bytes[end..]].concat(), Some(data))
}

struct Vtu<'a, 'x> {
    file: &'a Path,
    document: &'a Document<'x>,
    appended: Option<&'a [u8]>,
    little_endian: bool,
    /// Number of bytes of the header integers of binary data.
    header_size: usize,
    compressed: bool,
}

impl<'a> Vtu<'a, '_> {
    fn row(&self, node: Node<'_, '_>) -> usize {
        self.document.text_pos_at(node.range().start).row as usize
    }

    fn error(&self, node: Node<'_, '_>, what: impl Into<String>, fix: &str) -> InputError {
        InputError::at(self.file, self.row(node), what, fix)
    }

    fn child<'n>(&self, node: Node<'n, 'n>, name: &str) -> Result<Node<'n, 'n>, InputError> {
        node.children()
            .find(|child| child.has_tag_name(name))
            .ok_or_else(|| self.error(node, format!("<{}> has no <{name}>", node.tag_name().name()), DAMAGED))
    }

    fn count(&self, node: Node<'_, '_>, attribute: &str) -> Result<usize, InputError> {
        // Node indices have 32 bits; a larger count is an error.
        let n: Option<u32> = node.attribute(attribute).and_then(|n| n.trim().parse().ok());
        n.map(|n| n as usize)
            .ok_or_else(|| self.error(node, format!("`{attribute}` is not a count"), DAMAGED))
    }

    fn piece(&self, piece: Node<'a, 'a>) -> Result<RawMesh, InputError> {
        let point_count = self.count(piece, "NumberOfPoints")?;
        let cell_count = self.count(piece, "NumberOfCells")?;
        let points = self.child(self.child(piece, "Points")?, "DataArray")?;
        let coordinates = self.numbers(points, 3 * point_count)?;
        let cells = self.child(piece, "Cells")?;
        let array = |name: &str| {
            let named =
                |node: &Node<'_, '_>| node.has_tag_name("DataArray") && node.attribute("Name") == Some(name);
            cells
                .children()
                .find(named)
                .ok_or_else(|| self.error(cells, format!("<Cells> has no `{name}`"), DAMAGED))
        };
        let ends = self.indices(array("offsets")?, cell_count)?;
        let ends: Vec<usize> = ends.into_iter().map(|end| end as usize).collect();
        let nodes = self.indices(array("connectivity")?, ends.last().copied().unwrap_or(0))?;
        let types = cell_types(&self.numbers(array("types")?, cell_count)?);
        let scalar = Scalar::from_xml(points.attribute("type").unwrap_or_default());
        let points = Points::new(&coordinates, scalar.expect("numbers of this type were read"));
        Cells { types, ends, nodes, lines: Vec::new() }.into_raw(self.file, points)
    }

    /// The arrays of numbers in `CellData`.
    fn cell_arrays(&self, piece: Node<'a, 'a>) -> Result<Vec<CellArray>, InputError> {
        let cell_count = self.count(piece, "NumberOfCells")?;
        let is_number =
            |array: &Node<'_, '_>| Scalar::from_xml(array.attribute("type").unwrap_or_default()).is_some();
        let groups = piece.children().filter(|node| node.has_tag_name("CellData"));
        let arrays = groups.flat_map(|data| data.children()).filter(|node| node.has_tag_name("DataArray"));
        let read = |array: Node<'_, '_>| {
            let name = array.attribute("Name").unwrap_or_default().to_owned();
            let components = match array.attribute("NumberOfComponents") {
                Some(_) => self.count(array, "NumberOfComponents")?,
                None => 1,
            };
            let numbers = self.numbers(array, cell_count.saturating_mul(components))?;
            Ok(CellArray { name, components, numbers })
        };
        arrays.filter(is_number).map(read).collect()
    }

    fn indices(&self, array: Node<'_, '_>, n: usize) -> Result<Vec<u32>, InputError> {
        let index = |value: f64| {
            let wrong = || self.error(array, format!("{value} is not a node index"), DAMAGED);
            integer(value).ok_or_else(wrong)
        };
        self.numbers(array, n)?.into_iter().map(index).collect()
    }

    /// Reads the `n` numbers of a `DataArray`.
    fn numbers(&self, array: Node<'_, '_>, n: usize) -> Result<Vec<f64>, InputError> {
        let name = array.attribute("Name").unwrap_or("Points");
        let type_name = array.attribute("type").unwrap_or_default();
        let Some(scalar) = Scalar::from_xml(type_name) else {
            return Err(self.error(array, format!("`{name}` has the unknown type `{type_name}`"), DAMAGED));
        };
        let text = array.text().unwrap_or_default();
        let numbers = match array.attribute("format").unwrap_or("ascii") {
            "ascii" => self.words(array, name, text)?,
            "binary" => self.binary(array, n, scalar, Source::base64(text.as_bytes()))?,
            "appended" => {
                let offset = self.count(array, "offset")?;
                let data = self.appended.and_then(|data| data.get(offset..)).ok_or_else(|| {
                    self.error(array, format!("`{name}` begins beyond the appended data"), DAMAGED)
                })?;
                let element = self.child(self.document.root_element(), "AppendedData")?;
                let source = match element.attribute("encoding") {
                    Some("raw") => Source::raw(data),
                    _ => Source::base64(data),
                };
                self.binary(array, n, scalar, source)?
            }
            other => {
                return Err(self.error(array, format!("`{name}` has the unknown format `{other}`"), DAMAGED));
            }
        };
        if numbers.len() == n {
            return Ok(numbers);
        }
        let what = format!("`{name}` holds {} numbers where {n} are due", numbers.len());
        Err(self.error(array, what, DAMAGED))
    }

    fn words(&self, array: Node<'_, '_>, name: &str, text: &str) -> Result<Vec<f64>, InputError> {
        let first = array.first_child().map_or_else(|| self.row(array), |text| self.row(text));
        let mut numbers = Vec::new();
        for (line, text) in text.lines().enumerate() {
            for word in text.split_ascii_whitespace() {
                numbers.push(word.parse().map_err(|_| {
                    let what = format!("expected a number of `{name}`, found `{}`", excerpt(word));
                    InputError::at(self.file, first + line, what, DAMAGED)
                })?);
            }
        }
        Ok(numbers)
    }

    /// Plain data: number of bytes, data. Compressed data: number of blocks, their size, the size of the last
    /// one if it is partial, the compressed size of each block; then the blocks.
    fn binary(
        &self,
        array: Node<'_, '_>,
        n: usize,
        scalar: Scalar,
        mut source: Source<'_>,
    ) -> Result<Vec<f64>, InputError> {
        let name = array.attribute("Name").unwrap_or("Points");
        let short = || self.error(array, format!("the data of `{name}` end too soon"), DAMAGED);
        let header = Scalar::Int { size: self.header_size, signed: false };
        let count = |source: &mut Source<'_>| -> Result<usize, InputError> {
            let bytes = source.take(self.header_size).ok_or_else(short)?;
            Ok(integer(header.decode(&bytes, self.little_endian)).unwrap_or(usize::MAX))
        };
        // Required number of bytes; limits the allocation.
        let due = n.saturating_mul(scalar.size());
        let bytes = if self.compressed {
            let blocks = count(&mut source)?;
            let _ = (count(&mut source)?, count(&mut source)?);
            let sizes = (0..blocks).map(|_| count(&mut source)).collect::<Result<Vec<_>, _>>()?;
            let mut bytes = Vec::new();
            for size in sizes {
                let block = source.take(size).ok_or_else(short)?;
                let room = (due - bytes.len().min(due)) as u64 + 1;
                let mut decoder = flate2::read::ZlibDecoder::new(&block[..]).take(room);
                decoder.read_to_end(&mut bytes).map_err(|e| {
                    let what = format!("the data of `{name}` cannot be decompressed ({e})");
                    self.error(array, what, DAMAGED)
                })?;
            }
            bytes
        } else {
            let length = count(&mut source)?;
            source.take(length).ok_or_else(short)?
        };
        if bytes.len() != due {
            let what = format!("`{name}` holds {} bytes where {due} are due", bytes.len());
            return Err(self.error(array, what, DAMAGED));
        }
        Ok(bytes.chunks_exact(scalar.size()).map(|b| scalar.decode(b, self.little_endian)).collect())
    }
}

/// Bytes of an array. Base64 is decoded in groups of four characters, so that padding inside the text is
/// accepted: header and data can be one stream or two, and appended arrays follow each other without a
/// separator.
struct Source<'a> {
    data: &'a [u8],
    is_base64: bool,
    decoded: Vec<u8>,
}

impl<'a> Source<'a> {
    fn raw(data: &'a [u8]) -> Self {
        Self { data, is_base64: false, decoded: Vec::new() }
    }

    fn base64(text: &'a [u8]) -> Self {
        Self { data: text.trim_ascii(), is_base64: true, decoded: Vec::new() }
    }

    /// The next `n` bytes, or `None` if fewer are left.
    fn take(&mut self, n: usize) -> Option<Vec<u8>> {
        while self.decoded.len() < n {
            let (next, rest) = self.data.split_at_checked(if self.is_base64 { 4 } else { n })?;
            self.data = rest;
            if self.is_base64 {
                BASE64.decode_vec(next, &mut self.decoded).ok()?;
            } else {
                self.decoded.extend(next);
            }
        }
        let rest = self.decoded.split_off(n);
        Some(std::mem::replace(&mut self.decoded, rest))
    }
}

#[cfg(test)]
mod tests;
