//! Reader of Gmsh `.msh` files, versions 2.2 and 4.1, text and binary.
//!
//! No crate reads both versions and reports the line of an error. Sections without a mesh (`$Periodic`,
//! `$NodeData`, ...) are skipped up to their `$End...`, as the format requires.
//!
//! Elements: tets of 4 nodes, or of 10 nodes with straight edges, whose mid-edge nodes are dropped (see
//! `mid_edge.rs`: node indices count vertices only). Points, lines and triangles of either order contribute
//! their vertices to groups.
//!
//! Groups: every physical group becomes a group of the same name. A group without a name is called `point 7`,
//! `curve 7`, `surface 7` or `volume 7` by its tag. Groups with the same name and different dimensions are
//! merged.

mod elements;
mod kind;
mod tokens;

use std::collections::HashMap;
use std::path::Path;

use super::lines::{DAMAGED, Line, excerpt};
use super::mid_edge;
use super::raw::{Origin, RawMesh};
use crate::error::{InputError, count};
use tokens::{Binary, TRUNCATED, Text, Tokens};

const SAVE: &str = "save it with version 4.1 or 2.2 (Gmsh: `-format msh41`)";

/// The sections that a mesh needs, each once.
const NEEDED: [&str; 2] = ["Nodes", "Elements"];

/// Reads a whole file. [`RawMesh::finish`] does the checks that all formats share.
pub(super) fn read(file: &Path, bytes: &[u8]) -> Result<RawMesh, InputError> {
    if is_binary(bytes) {
        return Reader::new(file, Binary::new(file, bytes)).read();
    }
    // A group name in another encoding must not prevent reading the mesh.
    let text = String::from_utf8_lossy(bytes);
    Reader::new(file, Text::new(file, &text)).read()
}

/// Whether the second word of the format's line is 1.
fn is_binary(bytes: &[u8]) -> bool {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(256)]);
    let mut lines = head.lines().map(str::trim).filter(|line| !line.is_empty());
    lines.next() == Some("$MeshFormat")
        && lines.next().and_then(|format| format.split_whitespace().nth(1)) == Some("1")
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Version {
    V22,
    V41,
}

struct Reader<'a, T> {
    file: &'a Path,
    tokens: T,
    version: Version,
    raw: RawMesh,
    names: HashMap<(usize, i64), String>,
    /// Physical groups of each entity (version 4.1): (dimension, entity tag) -> physical tags.
    entities: HashMap<(usize, i64), Vec<i64>>,
    node_of_tag: HashMap<u64, u32>,
    /// First tet with these vertices. Version 2.2 repeats an element for each of its physical groups.
    tet_of_vertices: HashMap<[u32; 4], (u32, Vec<String>)>,
}

impl<'a, T: Tokens> Reader<'a, T> {
    fn new(file: &'a Path, tokens: T) -> Self {
        Self {
            file,
            tokens,
            version: Version::V41,
            raw: RawMesh { edge_order: Some(mid_edge::GMSH_ORDER), ..RawMesh::new(file, file) },
            names: HashMap::new(),
            entities: HashMap::new(),
            node_of_tag: HashMap::new(),
            tet_of_vertices: HashMap::new(),
        }
    }

    fn read(mut self) -> Result<RawMesh, InputError> {
        self.format()?;
        let mut seen: Vec<String> = Vec::new();
        while let Some(line) = self.tokens.line() {
            let Some(section) = line.strip_prefix('$').filter(|name| !name.starts_with("End")) else {
                let what = format!("expected the start of a section, found `{}`", excerpt(&line));
                return Err(self.error(what, DAMAGED));
            };
            if NEEDED.contains(&section) && seen.iter().any(|name| name == section) {
                let what = format!("a second {line} section");
                return Err(self.error(what, "keep one mesh per file: export it again"));
            }
            seen.push(section.to_owned());
            match section {
                "PhysicalNames" => self.physical_names()?,
                "Entities" if self.version == Version::V41 => self.entities()?,
                "PartitionedEntities" => {
                    let fix = "save it unpartitioned (Gmsh: Mesh > Unpartition)";
                    return Err(self.error("the mesh is partitioned", fix));
                }
                "Nodes" => self.nodes()?,
                "Elements" if !seen.iter().any(|name| name == "Nodes") => {
                    return Err(self.error("$Elements precedes $Nodes", "export the mesh again"));
                }
                "Elements" => self.elements()?,
                _ => {
                    self.skip(section)?;
                    continue;
                }
            }
            self.close(section)?;
        }
        match NEEDED.into_iter().find(|section| !seen.iter().any(|name| name == section)) {
            None => Ok(self.raw),
            Some(section) => {
                let what = format!("the file has no ${section} section");
                Err(InputError::new(self.file, what, "it is truncated or holds no mesh: export it again"))
            }
        }
    }

    /// An error at the current line.
    fn error(&self, what: impl Into<String>, fix: impl Into<String>) -> InputError {
        self.error_at(self.tokens.at(), what, fix)
    }

    fn error_at(&self, line: Option<usize>, what: impl Into<String>, fix: impl Into<String>) -> InputError {
        InputError { line, ..InputError::new(self.file, what, fix) }
    }

    /// The next line of text; an error at the end of the file names `wanted`.
    fn line(&mut self, wanted: &str) -> Result<String, InputError> {
        let last = self.tokens.at();
        let what = || format!("the file ends where {wanted} should follow");
        self.tokens.line().ok_or_else(|| self.error_at(last, what(), TRUNCATED))
    }

    /// Reads the words of a line of text.
    fn words_of<'l>(&'l self, text: &'l str) -> super::lines::Words<'l> {
        Line::new(self.file, self.tokens.at(), text).words()
    }

    /// A count that is a line of text also in a binary file.
    fn count_line(&mut self, wanted: &str) -> Result<usize, InputError> {
        let line = self.line(wanted)?;
        Ok(self.words_of(&line).exactly(1, wanted)?[0])
    }

    fn format(&mut self) -> Result<(), InputError> {
        if self.tokens.line().is_none_or(|line| line != "$MeshFormat") {
            let what = "not a Gmsh file: it does not start with $MeshFormat";
            return Err(InputError::at(self.file, 1, what, "export the mesh again"));
        }
        let head = self.tokens.at();
        let Some(line) = self.tokens.line() else {
            return Err(self.error_at(head, "the file ends inside $MeshFormat", TRUNCATED));
        };
        let mut words = self.words_of(&line);
        let version: f64 = words.number("the format version")?;
        let file_type: u32 = words.number("the file type (0 = ASCII, 1 = binary)")?;
        let data_size: u32 = if T::IS_BINARY { words.number("the data size")? } else { 8 };
        if file_type > 1 {
            return Err(self.error(format!("Gmsh file type {file_type} is neither 0 nor 1"), SAVE));
        }
        if data_size != 8 {
            return Err(self.error(format!("numbers of {data_size} bytes are not read"), SAVE));
        }
        self.version = match version {
            v if (2.0..3.0).contains(&v) => Version::V22,
            4.1 => Version::V41,
            v => return Err(self.error(format!("Gmsh format {v} is not supported"), SAVE)),
        };
        self.tokens.byte_order()?;
        self.close("MeshFormat")
    }

    fn close(&mut self, section: &str) -> Result<(), InputError> {
        let end = format!("$End{section}");
        let line = self.line(&end)?;
        if line == end {
            return Ok(());
        }
        Err(self.error(
            format!("expected {end}, found `{}`", excerpt(&line)),
            "the section's count does not match its lines, or its end is missing: export the mesh again",
        ))
    }

    fn skip(&mut self, section: &str) -> Result<(), InputError> {
        let (start, end) = (self.tokens.at(), format!("$End{section}"));
        if self.tokens.skip(&end) {
            return Ok(());
        }
        let what = format!("section ${} has no {}", excerpt(section), excerpt(&end));
        Err(self.error_at(start, what, "the file is truncated: export or copy it again"))
    }

    fn physical_names(&mut self) -> Result<(), InputError> {
        for _ in 0..self.count_line("the number of names")? {
            let line = self.line("a physical name")?;
            let mut words = self.words_of(&line);
            let dimension = words.number("a dimension (0 to 3)")?;
            let tag: i64 = words.number("a physical tag")?;
            let dimension = self.at_most_three(dimension)?;
            // The name can contain blanks, so the quotes delimit it.
            let name = line.split_once('"').and_then(|(_, rest)| rest.rsplit_once('"')).map(|(name, _)| name);
            let name = name.ok_or_else(|| self.error("a physical name has no quotes", DAMAGED))?;
            self.names.insert((dimension, tag), name.to_owned());
        }
        Ok(())
    }

    /// Reads the physical groups of each entity; the geometry is skipped.
    fn entities(&mut self) -> Result<(), InputError> {
        self.tokens.record("the entity counts")?;
        let mut counts = [0_usize; 4];
        for count in &mut counts {
            *count = self.tokens.size("an entity count")?;
        }
        self.tokens.end()?;
        for (dimension, n) in counts.into_iter().enumerate() {
            for _ in 0..n {
                self.entity(dimension)?;
            }
        }
        Ok(())
    }

    fn entity(&mut self, dimension: usize) -> Result<(), InputError> {
        let tokens = &mut self.tokens;
        tokens.record("an entity")?;
        let tag: i64 = tokens.int("an entity tag")?;
        // A point has a position; the other entities have a bounding box.
        for _ in 0..if dimension == 0 { 3 } else { 6 } {
            tokens.real("a coordinate of the entity")?;
        }
        let groups: usize = tokens.size("the number of physical groups")?;
        let physical = (0..groups).map(|_| tokens.int("a physical tag")).collect::<Result<_, _>>()?;
        // Entities of lower dimension on the boundary; some writers leave them out of a text file.
        if dimension > 0 && tokens.is_more() {
            for _ in 0..tokens.size::<usize>("the number of boundary entities")? {
                tokens.int::<i64>("the tag of a boundary entity")?;
            }
        }
        self.entities.insert((dimension, tag), physical);
        Ok(())
    }

    fn nodes(&mut self) -> Result<(), InputError> {
        match self.version {
            Version::V22 => {
                for _ in 0..self.count_line("the number of nodes")? {
                    self.tokens.record("a node")?;
                    let tag = self.tokens.int("a node tag")?;
                    let position = self.position()?;
                    self.tokens.end()?;
                    self.push_node(tag, position)?;
                }
                Ok(())
            }
            Version::V41 => {
                let header = self.counts("node")?;
                for _ in 0..header.blocks {
                    self.node_block()?;
                }
                self.agree(header, self.raw.nodes.len(), "node")
            }
        }
    }

    fn node_block(&mut self) -> Result<(), InputError> {
        self.tokens.record("a block of nodes")?;
        let dimension = self.dimension()?;
        let _entity: i64 = self.tokens.int("an entity tag")?;
        let parametric: u32 = self.tokens.int("the parametric flag")?;
        let n: usize = self.tokens.size("the number of nodes in the block")?;
        self.tokens.end()?;
        let mut tags = Vec::new();
        for _ in 0..n {
            self.tokens.record("a node tag")?;
            tags.push(self.tokens.size("a node tag")?);
            self.tokens.end()?;
        }
        for tag in tags {
            self.tokens.record("a node's coordinates")?;
            let position = self.position()?;
            // Parametric coordinates u, v, w (as many as the entity's dimension) can follow.
            if parametric != 0 && self.tokens.is_more() {
                for _ in 0..dimension {
                    self.tokens.real("a parametric coordinate")?;
                }
            }
            self.tokens.end()?;
            self.push_node(tag, position)?;
        }
        Ok(())
    }

    fn push_node(&mut self, tag: u64, position: [f64; 3]) -> Result<(), InputError> {
        let index = self.raw.nodes.len() as u32;
        if let Some(first) = self.node_of_tag.insert(tag, index) {
            let what = format!("node {tag} occurs twice in the file (first as number {})", first + 1);
            return Err(
                self.error(what, "renumber the mesh (Gmsh: Tools > Renumber) or remove one of the two")
            );
        }
        self.raw.nodes.push(position);
        self.raw.node_origins.push(Origin { tag, line: self.tokens.at() });
        Ok(())
    }

    fn position(&mut self) -> Result<[f64; 3], InputError> {
        Ok([self.tokens.real("x")?, self.tokens.real("y")?, self.tokens.real("z")?])
    }

    fn dimension(&mut self) -> Result<usize, InputError> {
        let dimension = self.tokens.int("a dimension (0 to 3)")?;
        self.at_most_three(dimension)
    }

    fn at_most_three(&self, dimension: usize) -> Result<usize, InputError> {
        if dimension > 3 {
            let what = format!("expected a dimension from 0 to 3, found {dimension}");
            return Err(self.error(what, DAMAGED));
        }
        Ok(dimension)
    }

    /// Reads the header of a 4.1 section: number of blocks, number of items, lowest and highest tag.
    fn counts(&mut self, noun: &str) -> Result<Counts, InputError> {
        let wanted = format!("the counts of {noun} blocks and {noun}s");
        self.tokens.record(&wanted)?;
        let line = self.tokens.at();
        let mut numbers = [0; 4];
        for number in &mut numbers {
            *number = self.tokens.size(&wanted)?;
        }
        self.tokens.end()?;
        Ok(Counts { blocks: numbers[0], items: numbers[1], line })
    }

    fn agree(&self, header: Counts, found: usize, noun: &str) -> Result<(), InputError> {
        if header.items == found {
            return Ok(());
        }
        let announced = count(header.items, noun);
        let what = format!("the section announces {announced} and its blocks contain {found}");
        Err(self.error_at(header.line, what, DAMAGED))
    }
}

/// The header of a section of version 4.1.
#[derive(Clone, Copy)]
struct Counts {
    blocks: usize,
    items: usize,
    line: Option<usize>,
}

#[cfg(test)]
mod tests;
