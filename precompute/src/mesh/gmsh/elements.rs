//! The elements of a Gmsh file and their groups.

use super::kind::{Kind, kind_of};
use super::tokens::Tokens;
use super::{Reader, Version};
use crate::error::{InputError, count};
use crate::mesh::lines::DAMAGED;
use crate::mesh::raw::Origin;
use crate::mesh::tetrahedral::sorted;

const DIMENSION_NAMES: [&str; 4] = ["point", "curve", "surface", "volume"];

impl<T: Tokens> Reader<'_, T> {
    pub(super) fn elements(&mut self) -> Result<(), InputError> {
        match self.version {
            Version::V22 => {
                let n = self.count_line("the number of elements")?;
                let mut found = 0;
                while found < n {
                    found += self.elements_22(n - found)?;
                }
                Ok(())
            }
            Version::V41 => {
                let header = self.counts("element")?;
                let mut found = 0;
                for _ in 0..header.blocks {
                    found += self.element_block()?;
                }
                self.agree(header, found, "element")
            }
        }
    }

    /// Elements of version 2.2; returns their number. In a text file one element: tag, type, number of tags,
    /// tags (the first is the physical group, 0 for none), vertices. In a binary file type, number of elements
    /// and number of tags; then tag, tags and vertices of each.
    fn elements_22(&mut self, left: usize) -> Result<usize, InputError> {
        self.tokens.record("an element")?;
        let first = if T::IS_BINARY { None } else { Some(self.tokens.int("an element tag")?) };
        let element_type = self.tokens.int("an element type")?;
        let n = if T::IS_BINARY { self.tokens.int("the number of elements in the block")? } else { 1 };
        let tag_count: usize = self.tokens.int("the number of tags")?;
        if n > left {
            let what = format!("a block of {} where {left} are due", count(n, "element"));
            return Err(self.error(what, DAMAGED));
        }
        for _ in 0..n {
            let tag = first.map_or_else(|| self.tokens.int("an element tag"), Ok)?;
            let mut physical = Vec::new();
            for at in 0..tag_count {
                let group: i64 = self.tokens.int("a tag")?;
                physical.extend(Some(group).filter(|&group| at == 0 && group != 0));
            }
            self.push_element(tag, element_type, &physical)?;
        }
        Ok(n)
    }

    fn element_block(&mut self) -> Result<usize, InputError> {
        self.tokens.record("a block of elements")?;
        let dimension = self.dimension()?;
        let entity: i64 = self.tokens.int("an entity tag")?;
        let element_type = self.tokens.int("an element type")?;
        let n = self.tokens.size("the number of elements in the block")?;
        self.tokens.end()?;
        let physical = self.entities.get(&(dimension, entity)).cloned().unwrap_or_default();
        for _ in 0..n {
            self.tokens.record("an element")?;
            let tag = self.tokens.size("an element tag")?;
            self.push_element(tag, element_type, &physical)?;
        }
        Ok(n)
    }

    fn push_element(&mut self, tag: u64, element_type: u32, physical: &[i64]) -> Result<(), InputError> {
        match kind_of(element_type) {
            Kind::Tet { nodes } => {
                let nodes = self.nodes_of(tag, nodes)?;
                let groups = self.group_names(3, physical);
                self.push_tet(tag, &nodes, groups)
            }
            Kind::Lower { dimension, vertices, nodes } => {
                let nodes = self.nodes_of(tag, nodes)?;
                for group in self.group_names(dimension, physical) {
                    self.raw.node_groups.entry(group).or_default().extend(&nodes[..vertices]);
                }
                Ok(())
            }
            Kind::HigherOrder => Err(self.error(
                format!("element {tag} is of an order or shape that is not read (Gmsh type {element_type})"),
                "mesh the body with tetrahedra only, and save with order 1 or 2",
            )),
            Kind::Refused(shape) => Err(self.error(
                format!("element {tag} is a {shape} (Gmsh type {element_type})"),
                "mesh the body with tetrahedra only",
            )),
        }
    }

    /// The nodes of an element, which end its record.
    fn nodes_of(&mut self, tag: u64, n: usize) -> Result<Vec<u32>, InputError> {
        let mut tags: Vec<u64> = Vec::new();
        for _ in 0..n {
            tags.push(match self.version {
                Version::V22 => self.tokens.int("a vertex")?,
                Version::V41 => self.tokens.size("a vertex")?,
            });
        }
        self.tokens.end()?;
        let look_up = |node: u64| {
            self.node_of_tag.get(&node).copied().ok_or_else(|| {
                self.error(
                    format!("element {tag} names node {node}, which is not in $Nodes"),
                    "the file is damaged: export it again",
                )
            })
        };
        tags.into_iter().map(look_up).collect()
    }

    fn push_tet(&mut self, tag: u64, nodes: &[u32], groups: Vec<String>) -> Result<(), InputError> {
        let line = self.tokens.at();
        let next = self.raw.tets.len() as u32;
        let vertices = [nodes[0], nodes[1], nodes[2], nodes[3]];
        let (index, known) = self.tet_of_vertices.entry(sorted(vertices)).or_insert((next, Vec::new()));
        if *index == next {
            self.raw.push_tet(nodes, Origin { tag, line }, &groups)?;
        } else if groups.is_empty() || groups.iter().any(|group| known.contains(group)) {
            let first = self.raw.tet_origins[*index as usize].tag;
            let what = format!("element {tag} has the same four vertices as element {first}");
            return Err(self.error(what, "remove one of the two"));
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
