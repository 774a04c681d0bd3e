//! Reader of Gmsh `.msh` files, versions 2.2 and 4.1, ASCII.
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

mod kind;

use std::collections::HashMap;
use std::path::Path;

use super::lines::{DAMAGED, Line, Lines, Words, excerpt};
use super::mid_edge;
use super::raw::{Origin, RawMesh};
use super::tetrahedral::sorted;
use crate::error::{InputError, count};
use kind::{Kind, kind_of};

const SAVE_ASCII: &str = "save it as ASCII, version 4.1 or 2.2 (Gmsh: `-format msh41`, without `-bin`)";
const DIMENSION_NAMES: [&str; 4] = ["point", "curve", "surface", "volume"];

/// The sections that a mesh needs, each once.
const NEEDED: [&str; 2] = ["Nodes", "Elements"];

/// Reads a whole file. [`RawMesh::finish`] does the checks that all formats share.
pub(super) fn read(file: &Path, bytes: &[u8]) -> Result<RawMesh, InputError> {
    // A group name in another encoding must not prevent reading the mesh.
    let text = String::from_utf8_lossy(bytes);
    let mut lines = Lines::new(file, &text, None);
    let version = read_format(file, &mut lines)?;
    let mut reader = Reader {
        version,
        lines,
        raw: RawMesh { edge_order: Some(mid_edge::GMSH_ORDER), ..RawMesh::new(file, file) },
        names: HashMap::new(),
        entities: HashMap::new(),
        node_of_tag: HashMap::new(),
        tet_of_vertices: HashMap::new(),
    };
    let mut seen = Vec::new();
    while let Some(line) = reader.lines.next_line() {
        let Some(section) = line.text.strip_prefix('$').filter(|name| !name.starts_with("End")) else {
            let what = format!("expected the start of a section, found `{}`", excerpt(line.text));
            return Err(line.error(what, DAMAGED));
        };
        if NEEDED.contains(&section) && seen.contains(&section) {
            let what = format!("a second {} section", line.text);
            return Err(line.error(what, "keep one mesh per file: export it again"));
        }
        seen.push(section);
        match section {
            "PhysicalNames" => reader.physical_names()?,
            "Entities" if version == Version::V41 => reader.entities()?,
            "PartitionedEntities" => {
                return Err(
                    line.error("the mesh is partitioned", "save it unpartitioned (Gmsh: Mesh > Unpartition)")
                );
            }
            "Nodes" => reader.nodes()?,
            "Elements" if !seen.contains(&"Nodes") => {
                return Err(line.error("$Elements precedes $Nodes", "export the mesh again"));
            }
            "Elements" => reader.elements()?,
            _ => {
                skip(line, section, &mut reader.lines)?;
                continue;
            }
        }
        close(section, &mut reader.lines)?;
    }
    match NEEDED.iter().find(|section| !seen.contains(section)) {
        None => Ok(reader.raw),
        Some(section) => {
            let what = format!("the file has no ${section} section");
            Err(InputError::new(file, what, "it is truncated or holds no mesh: export it again"))
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Version {
    V22,
    V41,
}

fn read_format(file: &Path, lines: &mut Lines<'_>) -> Result<Version, InputError> {
    let head = lines.next_line().filter(|line| line.text == "$MeshFormat").ok_or_else(|| {
        InputError::at(
            file,
            1,
            "not a Gmsh file: it does not start with $MeshFormat",
            "export the mesh again",
        )
    })?;
    let line = lines.expect_line("the format version").map_err(|_| {
        head.error("the file ends inside $MeshFormat", "it is truncated: export or copy it again")
    })?;
    let mut words = line.words();
    let version: f64 = words.number("the format version")?;
    let file_type: u32 = words.number("the file type (0 = ASCII)")?;
    if file_type != 0 {
        return Err(line.error("the file is binary Gmsh", SAVE_ASCII));
    }
    let version = match version {
        v if (2.0..3.0).contains(&v) => Version::V22,
        4.1 => Version::V41,
        v => return Err(line.error(format!("Gmsh format {v} is not supported"), SAVE_ASCII)),
    };
    close("MeshFormat", lines)?;
    Ok(version)
}

fn close(section: &str, lines: &mut Lines<'_>) -> Result<(), InputError> {
    let end = format!("$End{section}");
    let line = lines.expect_line(&end)?;
    if line.text == end {
        return Ok(());
    }
    Err(line.error(
        format!("expected {end}, found `{}`", excerpt(line.text)),
        "the section's count does not match its lines, or its end is missing: export the mesh again",
    ))
}

fn skip(start: Line<'_>, section: &str, lines: &mut Lines<'_>) -> Result<(), InputError> {
    let end = format!("$End{section}");
    while let Some(line) = lines.next_line() {
        if line.text == end {
            return Ok(());
        }
    }
    Err(start
        .error(format!("section ${section} has no {end}"), "the file is truncated: export or copy it again"))
}

struct Reader<'a> {
    version: Version,
    lines: Lines<'a>,
    raw: RawMesh,
    names: HashMap<(usize, i64), String>,
    /// Physical groups of each entity (version 4.1): (dimension, entity tag) -> physical tags.
    entities: HashMap<(usize, i64), Vec<i64>>,
    node_of_tag: HashMap<u64, u32>,
    /// First tet with these vertices. Version 2.2 repeats an element for each of its physical groups.
    tet_of_vertices: HashMap<[u32; 4], (u32, Vec<String>)>,
}

impl Reader<'_> {
    fn physical_names(&mut self) -> Result<(), InputError> {
        let n: usize =
            self.lines.expect_line("the number of names")?.words().number("the number of names")?;
        for _ in 0..n {
            let line = self.lines.expect_line("a physical name")?;
            let mut words = line.words();
            let dimension = dimension(&mut words)?;
            let tag: i64 = words.number("a physical tag")?;
            // The name can contain blanks, so the quotes delimit it.
            let name =
                line.text.split_once('"').and_then(|(_, rest)| rest.rsplit_once('"')).map(|(name, _)| name);
            let name = name.ok_or_else(|| line.error("a physical name has no quotes", DAMAGED))?;
            self.names.insert((dimension, tag), name.to_owned());
        }
        Ok(())
    }

    /// Reads the physical groups of each entity; the geometry is skipped.
    fn entities(&mut self) -> Result<(), InputError> {
        let counts: Vec<usize> =
            self.lines.expect_line("the entity counts")?.words().exactly(4, "an entity count")?;
        for (dimension, &n) in counts.iter().enumerate() {
            for _ in 0..n {
                let line = self.lines.expect_line("an entity")?;
                let mut words = line.words();
                let tag: i64 = words.number("an entity tag")?;
                // A point has a position; the other entities have a bounding box.
                for _ in 0..if dimension == 0 { 3 } else { 6 } {
                    words.number::<f64>("a coordinate of the entity")?;
                }
                let groups: usize = words.number("the number of physical groups")?;
                let physical: Result<_, _> = (0..groups).map(|_| words.number("a physical tag")).collect();
                self.entities.insert((dimension, tag), physical?);
            }
        }
        Ok(())
    }

    fn nodes(&mut self) -> Result<(), InputError> {
        let header = self.lines.expect_line("the number of nodes")?;
        match self.version {
            Version::V22 => {
                let n: usize = header.words().exactly(1, "the number of nodes")?[0];
                for _ in 0..n {
                    let line = self.lines.expect_line("a node")?;
                    let mut words = line.words();
                    let tag = words.number("a node tag")?;
                    let position = words.position()?;
                    words.end()?;
                    self.push_node(line, tag, position)?;
                }
            }
            Version::V41 => {
                let [blocks, total] = counts(header, "node")?;
                for _ in 0..blocks {
                    self.node_block()?;
                }
                agree(header, total, self.raw.nodes.len(), "node")?;
            }
        }
        Ok(())
    }

    fn node_block(&mut self) -> Result<(), InputError> {
        let line = self.lines.expect_line("a block of nodes")?;
        let mut words = line.words();
        let dimension = dimension(&mut words)?;
        let _entity: i64 = words.number("an entity tag")?;
        let parametric: u32 = words.number("the parametric flag")?;
        let n: usize = words.number("the number of nodes in the block")?;
        words.end()?;
        let mut tags = Vec::new();
        for _ in 0..n {
            let line = self.lines.expect_line("a node tag")?;
            tags.push(line.words().exactly::<u64>(1, "a node tag")?[0]);
        }
        for tag in tags {
            let line = self.lines.expect_line("a node's coordinates")?;
            let mut words = line.words();
            let position = words.position()?;
            // Parametric coordinates u, v, w (as many as the entity's dimension) can follow.
            if parametric == 0 || words.left() != dimension {
                words.end()?;
            }
            self.push_node(line, tag, position)?;
        }
        Ok(())
    }

    fn push_node(&mut self, line: Line<'_>, tag: u64, position: [f64; 3]) -> Result<(), InputError> {
        let index = self.raw.nodes.len() as u32;
        if let Some(first) = self.node_of_tag.insert(tag, index) {
            let what = format!("node {tag} occurs twice in the file (first as number {})", first + 1);
            return Err(
                line.error(what, "renumber the mesh (Gmsh: Tools > Renumber) or remove one of the two")
            );
        }
        self.raw.nodes.push(position);
        self.raw.node_origins.push(Origin { tag, line: Some(line.number) });
        Ok(())
    }

    fn elements(&mut self) -> Result<(), InputError> {
        let header = self.lines.expect_line("the number of elements")?;
        match self.version {
            Version::V22 => {
                let n: usize = header.words().exactly(1, "the number of elements")?[0];
                for _ in 0..n {
                    self.element_22()?;
                }
            }
            Version::V41 => {
                let [blocks, total] = counts(header, "element")?;
                let mut found = 0;
                for _ in 0..blocks {
                    found += self.element_block()?;
                }
                agree(header, total, found, "element")?;
            }
        }
        Ok(())
    }

    /// An element: tag, type, number of tags, tags (the first is the physical group, 0 for none), vertices.
    fn element_22(&mut self) -> Result<(), InputError> {
        let mut words = self.lines.expect_line("an element")?.words();
        let tag = words.number("an element tag")?;
        let element_type = words.number("an element type")?;
        let tag_count: usize = words.number("the number of tags")?;
        let tags = (0..tag_count).map(|_| words.number("a tag")).collect::<Result<Vec<i64>, _>>()?;
        let physical: Vec<i64> = tags.first().copied().filter(|&p| p != 0).into_iter().collect();
        self.push_element(&mut words, tag, element_type, &physical)
    }

    fn element_block(&mut self) -> Result<usize, InputError> {
        let line = self.lines.expect_line("a block of elements")?;
        let mut words = line.words();
        let dimension = dimension(&mut words)?;
        let entity: i64 = words.number("an entity tag")?;
        let element_type = words.number("an element type")?;
        let n = words.number("the number of elements in the block")?;
        words.end()?;
        let physical = self.entities.get(&(dimension, entity)).cloned().unwrap_or_default();
        for _ in 0..n {
            let mut words = self.lines.expect_line("an element")?.words();
            let tag = words.number("an element tag")?;
            self.push_element(&mut words, tag, element_type, &physical)?;
        }
        Ok(n)
    }

    fn push_element(
        &mut self,
        words: &mut Words<'_>,
        tag: u64,
        element_type: u32,
        physical: &[i64],
    ) -> Result<(), InputError> {
        let line = words.line;
        match kind_of(element_type) {
            Kind::Tet { nodes } => {
                let nodes = self.nodes_of(words, tag, nodes)?;
                let groups = self.group_names(3, physical);
                self.push_tet(line, tag, &nodes, groups)
            }
            Kind::Lower { dimension, vertices, nodes } => {
                let nodes = self.nodes_of(words, tag, nodes)?;
                for group in self.group_names(dimension, physical) {
                    self.raw.node_groups.entry(group).or_default().extend(&nodes[..vertices]);
                }
                Ok(())
            }
            Kind::HigherOrder => Err(line.error(
                format!("element {tag} is of an order or shape that is not read (Gmsh type {element_type})"),
                "mesh the body with tetrahedra only, and save with order 1 or 2",
            )),
            Kind::Refused(shape) => Err(line.error(
                format!("element {tag} is a {shape} (Gmsh type {element_type})"),
                "mesh the body with tetrahedra only",
            )),
        }
    }

    fn nodes_of(&self, words: &mut Words<'_>, tag: u64, n: usize) -> Result<Vec<u32>, InputError> {
        let line = words.line;
        let look_up = |node: u64| {
            self.node_of_tag.get(&node).copied().ok_or_else(|| {
                line.error(
                    format!("element {tag} names node {node}, which is not in $Nodes"),
                    "the file is damaged: export it again",
                )
            })
        };
        words.exactly(n, "a vertex")?.into_iter().map(look_up).collect()
    }

    fn push_tet(
        &mut self,
        line: Line<'_>,
        tag: u64,
        nodes: &[u32],
        groups: Vec<String>,
    ) -> Result<(), InputError> {
        let next = self.raw.tets.len() as u32;
        let vertices = [nodes[0], nodes[1], nodes[2], nodes[3]];
        let (index, known) = self.tet_of_vertices.entry(sorted(vertices)).or_insert((next, Vec::new()));
        if *index == next {
            self.raw.push_tet(nodes, Origin { tag, line: Some(line.number) }, &groups)?;
        } else if groups.is_empty() || groups.iter().any(|group| known.contains(group)) {
            let first = self.raw.tet_origins[*index as usize].tag;
            let what = format!("element {tag} has the same four vertices as element {first}");
            return Err(line.error(what, "remove one of the two"));
        } else {
            for group in &groups {
                self.raw.tet_groups.entry(group.clone()).or_default().push(*index);
                self.raw.node_groups.entry(group.clone()).or_default().extend(vertices);
            }
        }
        known.extend(groups);
        Ok(())
    }

    /// A negative tag denotes the same group with reversed orientation.
    fn group_names(&self, dimension: usize, physical: &[i64]) -> Vec<String> {
        let name = |tag: i64| match self.names.get(&(dimension, tag)) {
            Some(name) => name.clone(),
            None => format!("{} {tag}", DIMENSION_NAMES[dimension]),
        };
        physical.iter().map(|tag| name(tag.abs())).collect()
    }
}

fn dimension(words: &mut Words<'_>) -> Result<usize, InputError> {
    let dimension: usize = words.number("a dimension (0 to 3)")?;
    if dimension > 3 {
        let what = format!("expected a dimension from 0 to 3, found {dimension}");
        return Err(words.line.error(what, DAMAGED));
    }
    Ok(dimension)
}

/// Reads the header of a 4.1 section: number of blocks, number of items, lowest and highest tag.
fn counts(header: Line<'_>, noun: &str) -> Result<[usize; 2], InputError> {
    let wanted = format!("the counts of {noun} blocks and {noun}s");
    let numbers: Vec<usize> = header.words().exactly(4, &wanted)?;
    Ok([numbers[0], numbers[1]])
}

fn agree(header: Line<'_>, promised: usize, found: usize, noun: &str) -> Result<(), InputError> {
    if promised == found {
        return Ok(());
    }
    let what = format!("the section announces {} and its blocks contain {found}", count(promised, noun));
    Err(header.error(what, DAMAGED))
}

#[cfg(test)]
mod tests;
