//! Reader of TetGen's `.node` and `.ele` files.
//!
//! Numbers start at 0 or 1; the number of the first node decides, as in TetGen. A boundary marker m of a node
//! becomes the node group `marker m`, and a region attribute r of a tet the group `region r`; 0 means none.
//!
//! Ten-node tets (`-o2`) are accepted if their edges are straight; their mid-edge nodes are dropped (see
//! `mid_edge.rs`: node indices count vertices only). Each mid-edge node is assigned to the edge with the
//! nearest middle, because the order of the edges differs between writers: TetGen (in the Python package
//! tetgen 0.8.4) writes 23 03 01 12 13 02.

use std::path::Path;

use super::lines::{DAMAGED, Line, Lines, Words};
use super::raw::{Origin, RawMesh};
use crate::error::InputError;

const RENUMBER: &str = "number the lines one after the other from 0 or 1, or export again";

/// Loads the `.node` and the `.ele` file; `path` is either of them.
pub(super) fn load(path: &Path) -> Result<[Vec<u8>; 2], InputError> {
    let load = |extension: &str| {
        let file = path.with_extension(extension);
        std::fs::read(&file).map_err(|error| InputError {
            fix: "keep the .node and the .ele file of a mesh side by side".into(),
            ..InputError::unreadable(&file, &error)
        })
    };
    Ok([load("node")?, load("ele")?])
}

/// Reads the content of both files. Errors name them by `path`, which can be either.
pub(super) fn read(path: &Path, node: &[u8], ele: &[u8]) -> Result<RawMesh, InputError> {
    let (node_file, tet_file) = (path.with_extension("node"), path.with_extension("ele"));
    let (node_text, tet_text) = (String::from_utf8_lossy(node), String::from_utf8_lossy(ele));
    let mut raw = RawMesh::new(&node_file, &tet_file);
    let base = nodes(&mut raw, Lines::new(&node_file, &node_text, Some('#')))?;
    tets(&mut raw, Lines::new(&tet_file, &tet_text, Some('#')), base)?;
    Ok(raw)
}

/// Header: number of points, dimension, number of attributes, marker flag. Returns the number of the first
/// node.
fn nodes(raw: &mut RawMesh, mut lines: Lines<'_>) -> Result<u64, InputError> {
    let header = lines.expect_line("the number of nodes")?;
    let mut words = header.words();
    let n: u64 = words.number("the number of nodes")?;
    let dimension: u32 = words.number("the dimension")?;
    let attributes: usize = optional(&mut words, "the number of attributes")?;
    let markers: usize = optional(&mut words, "the boundary marker flag")?;
    if n == 0 {
        return Err(
            header.error("the file holds no nodes", "give the nodes in this file, not in a .poly or .smesh")
        );
    }
    if dimension != 3 {
        return Err(header.error(format!("the mesh has {dimension} dimensions"), "export a 3-D mesh"));
    }
    let mut base = 0;
    for index in 0..n {
        let line = lines.expect_line("a node")?;
        let mut words = line.words();
        let tag: u64 = words.number("a node number")?;
        if index == 0 {
            if tag > 1 {
                return Err(line.error(format!("the first node has the number {tag}"), RENUMBER));
            }
            base = tag;
        }
        in_sequence(line, "node", tag, base + index)?;
        let position = words.position()?;
        for _ in 0..attributes {
            words.number::<f64>("an attribute")?;
        }
        let marker: i64 = if markers > 0 { words.number("a boundary marker")? } else { 0 };
        words.end()?;
        raw.nodes.push(position);
        raw.node_origins.push(Origin { tag, line: line.number });
        if marker != 0 {
            raw.node_groups.entry(format!("marker {marker}")).or_default().push(index as u32);
        }
    }
    nothing_more(&mut lines, "node")?;
    Ok(base)
}

/// Header: number of tets, nodes per tet, attribute flag.
fn tets(raw: &mut RawMesh, mut lines: Lines<'_>, base: u64) -> Result<(), InputError> {
    let header = lines.expect_line("the number of tetrahedra")?;
    let mut words = header.words();
    let n: u64 = words.number("the number of tetrahedra")?;
    let per_tet: usize = words.number("the number of nodes per tetrahedron")?;
    let attributes: usize = optional(&mut words, "the number of attributes")?;
    if per_tet != 4 && per_tet != 10 {
        return Err(header.error(
            format!("the tetrahedra have {per_tet} nodes each"),
            "save the mesh with 4 nodes per tetrahedron, or with 10 (TetGen's -o2)",
        ));
    }
    for index in 0..n {
        let line = lines.expect_line("a tetrahedron")?;
        let mut words = line.words();
        let tag: u64 = words.number("a tetrahedron's number")?;
        in_sequence(line, "tetrahedron", tag, base + index)?;
        let mut nodes = [0; 10];
        for node in &mut nodes[..per_tet] {
            let number: u64 = words.number("a vertex")?;
            let found = number.checked_sub(base).filter(|&node| node < raw.nodes.len() as u64);
            *node = found.ok_or_else(|| {
                let what = format!("element {tag} names node {number}, which is not in the .node file");
                line.error(what, "take both files from the same run of TetGen")
            })? as u32;
        }
        let mut groups = Vec::new();
        for _ in 0..attributes {
            let region: f64 = words.number("a region attribute")?;
            if region != 0.0 {
                groups.push(format!("region {region}"));
            }
        }
        words.end()?;
        raw.push_tet(&nodes[..per_tet], Origin { tag, line: line.number }, &groups)?;
    }
    nothing_more(&mut lines, "tetrahedron")
}

fn optional(words: &mut Words<'_>, wanted: &str) -> Result<usize, InputError> {
    if words.left() == 0 { Ok(0) } else { words.number(wanted) }
}

fn in_sequence(line: Line<'_>, noun: &str, tag: u64, expected: u64) -> Result<(), InputError> {
    if tag == expected {
        return Ok(());
    }
    Err(line.error(format!("expected {noun} {expected}, found {noun} {tag}"), RENUMBER))
}

fn nothing_more(lines: &mut Lines<'_>, noun: &str) -> Result<(), InputError> {
    match lines.next_line() {
        None => Ok(()),
        Some(line) => Err(line.error(format!("a {noun} more than the header announces"), DAMAGED)),
    }
}

#[cfg(test)]
mod tests {
    use crate::mesh::{LengthUnit, TetMesh};

    const NODE: &str =
        "# by hand\n5 3 1 1\n0 0 0 0 0.5 0\n1 1 0 0 0.5 2\n2 0 1 0 0.5 2\n3 0 0 1 0.5 0\n4 1 1 1 0.5 0\n";
    const ELE: &str = "2 4 1\n0 0 1 2 3 1\n1 1 2 3 4 0 # last\n";

    fn read_pair(node: &str, ele: &str, name: &str) -> Result<TetMesh, String> {
        let dir = tempfile::tempdir().expect("a temporary folder");
        std::fs::write(dir.path().join("body.node"), node).expect("written");
        std::fs::write(dir.path().join("body.ele"), ele).expect("written");
        let path = dir.path().join(name);
        let mesh = crate::mesh::read(&path, LengthUnit::Metre);
        mesh.map_err(|e| e.to_string().replace(&format!("{}/", dir.path().display()), ""))
    }

    #[track_caller]
    fn assert_says(result: Result<TetMesh, String>, place: &str, what: &str, fix: &str) {
        let error = result.expect_err("planted fault");
        assert!(error.starts_with(place), "{error}");
        let (problem, remedy) = error.split_once("; ").expect("a problem and a fix");
        assert!(problem.contains(what) && remedy.contains(fix), "{error}");
    }

    #[test]
    fn either_file_name_and_either_base_give_the_mesh() {
        let mesh = read_pair(NODE, ELE, "body.node").expect("sound");
        assert_eq!(mesh.tets, [[0, 1, 2, 3], [1, 2, 3, 4]]);
        assert_eq!(mesh.nodes_m[4], [1.0, 1.0, 1.0]);
        assert_eq!(mesh.node_groups["marker 2"], [1, 2]);
        assert_eq!(mesh.tet_groups["region 1"], [0]);
        assert_eq!(mesh.node_groups["region 1"], [0, 1, 2, 3]);
        let from_one = "5 3\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 1 1 1\n";
        let same = read_pair(from_one, "2 4 0\n1 1 2 3 4\n2 2 3 4 5\n", "body.ele").expect("sound");
        assert_eq!((same.tets, same.nodes_m), (mesh.tets, mesh.nodes_m));
    }

    #[test]
    fn faults_name_the_file_of_the_two_and_its_line() {
        let node = |from: &str, to: &str| read_pair(&NODE.replacen(from, to, 1), ELE, "body.node");
        let ele = |from: &str, to: &str| read_pair(NODE, &ELE.replacen(from, to, 1), "body.node");
        assert_says(node("5 3 1 1", "6 3 1 1"), "body.node:7: ", "the file ends where a node", "truncated");
        assert_says(node("5 3 1 1", "4 3 1 1"), "body.node:7: ", "a node more than the header", "counts");
        assert_says(node("5 3 1 1", "5 2 1 1"), "body.node:2: ", "2 dimensions", "3-D");
        assert_says(node("5 3 1 1", "0 3 1 1"), "body.node:2: ", "no nodes", ".poly");
        assert_says(node("2 0 1 0", "3 0 1 0"), "body.node:5: ", "expected node 2, found node 3", "number");
        assert_says(
            node("0 0 0 0 0.5 0", "7 0 0 0 0.5 0"),
            "body.node:3: ",
            "first node has the number 7",
            "0 or 1",
        );
        assert_says(node("2 0 1 0", "2 0 x 0"), "body.node:5: ", "expected y, found `x`", "export");
        assert_says(
            node("2 0 1 0", "2 0 NaN 0"),
            "body.node:5: ",
            "node 2 has a coordinate that is not",
            "repair",
        );
        assert_says(ele("2 4 1", "3 4 1"), "body.ele:3: ", "ends where a tetrahedron", "truncated");
        assert_says(ele("2 4 1", "1 4 1"), "body.ele:3: ", "a tetrahedron more than", "counts");
        assert_says(ele("2 4 1", "2 8 1"), "body.ele:1: ", "8 nodes each", "-o2");
        assert_says(ele("1 2 3 4 0", "1 2 3 5 0"), "body.ele:3: ", "element 1 names node 5", "same run");
        assert_says(
            ele("0 1 2 3 1", "1 0 2 3 1"),
            "body.ele:2: ",
            "element 0 has negative volume",
            "swap any two",
        );
        assert_says(
            read_pair(NODE, ELE, "other.ele"),
            "other.node: ",
            "cannot read the file",
            "side by side",
        );
    }
}
