//! Small Gmsh files, valid and damaged.

mod binary;

use std::path::Path;

use crate::error::InputError;
use crate::mesh::{LengthUnit, TetMesh};

/// Two tets with a common face, non-contiguous tags, a named surface and a named volume.
const V22: &str = "\
$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
2
2 7 \"held here\"
3 9 \"liver\"
$EndPhysicalNames
$Nodes
5
10 0 0 0
20 1 0 0
5 0 1 0
40 0 0 1
77 1 1 1
$EndNodes
$Elements
5
1 15 2 0 1 10
2 2 2 7 1 10 20 5
3 1 2 3 1 10 40
100 4 2 9 1 10 20 5 40
200 4 2 9 1 20 5 40 77
$EndElements
$NodeData
1
\"anything at all\"
$EndNodeData
";

const V41: &str = "\
$MeshFormat
4.1 0 8
$EndMeshFormat
$Comments
made by hand
$EndComments
$PhysicalNames
2
2 7 \"held here\"
3 9 \"liver\"
$EndPhysicalNames
$Entities
1 1 1 1
4 0 0 0 0
1 0 0 0 0 0 1 1 3 0
1 0 0 0 1 1 0 1 -7 0
1 0 0 0 1 1 1 1 9 0
$EndEntities
$Nodes
2 5 5 77
2 1 1 3
10
20
5
0 0 0 0.5 0.5
1 0 0 0.5 0.5
0 1 0 0.5 0.5
3 1 0 2
40
77
0 0 1
1 1 1
$EndNodes
$Elements
3 4 2 200
2 1 2 1
2 10 20 5
1 1 1 1
3 10 40
3 1 4 2
100 10 20 5 40
200 20 5 40 77
$EndElements
";

fn read(text: &str) -> Result<TetMesh, InputError> {
    super::read(Path::new("body.msh"), text.as_bytes())?.finish(LengthUnit::Metre)
}

/// The error of a text in which `from` is replaced by `to`; `from` must occur.
fn broken(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "nothing to break: {from:?}");
    read(&text.replacen(from, to, 1)).expect_err("planted fault").to_string()
}

#[track_caller]
fn assert_says(error: &str, place: &str, what: &str, fix: &str) {
    assert!(error.starts_with(&format!("{place}: ")), "{error}");
    let (problem, remedy) = error.split_once("; ").expect("a problem and a fix");
    assert!(problem.contains(what), "{error}");
    assert!(remedy.contains(fix), "{error}");
    assert!(!error.contains('\n'));
}

#[test]
fn both_versions_give_the_same_mesh_in_file_order() {
    for text in [V22, V41, &V22.replace('\n', "\r\n"), &V41.replace('\n', "\r\n")] {
        let mesh = read(text).expect("sound");
        assert_eq!(mesh.nodes_m[2], [0.0, 1.0, 0.0], "tag 5 is the third node of the file");
        assert_eq!(mesh.tets, [[0, 1, 2, 3], [1, 2, 3, 4]]);
        assert_eq!(mesh.node_groups["held here"], [0, 1, 2]);
        assert_eq!(
            mesh.node_groups["curve 3"],
            [0, 3],
            "a group without a name is named by dimension and tag"
        );
        assert_eq!(mesh.node_groups["liver"], [0, 1, 2, 3, 4]);
        assert_eq!(mesh.tet_groups["liver"], [0, 1]);
        assert_eq!(mesh.node_groups.len(), 3, "physical tag 0 defines no group");
        assert_eq!(mesh.tet_groups.len(), 1);
    }
}

#[test]
fn lengths_are_scaled_to_metres() {
    let text = V22.replacen("77 1 1 1", "77 1.125 2.25 3.25", 1);
    let raw = super::read(Path::new("body.msh"), text.as_bytes()).expect("sound");
    let mesh = raw.finish(LengthUnit::Millimetre).expect("sound");
    // The same bits as from a file in metres; a multiplication by 1e-3 would change all three values.
    assert_eq!(mesh.nodes_m[4], [0.001125, 0.00225, 0.00325]);
}

#[test]
fn an_element_repeated_for_each_of_its_groups_is_one_tet() {
    let text =
        V22.replace("$Elements\n5", "$Elements\n6").replace("200 4 2 9", "150 4 2 8 1 10 20 5 40\n200 4 2 9");
    let mesh = read(&text).expect("version 2.2 writes an element once for each physical group");
    assert_eq!(mesh.tets.len(), 2);
    assert_eq!(mesh.tet_groups["liver"], [0, 1]);
    assert_eq!(mesh.tet_groups["volume 8"], [0]);
    assert_eq!(mesh.node_groups["volume 8"], [0, 1, 2, 3]);

    let twice = text.replace("150 4 2 8", "150 4 2 9");
    let error = read(&twice).expect_err("the same element twice in one group").to_string();
    assert_says(&error, "body.msh:23", "element 150 has the same four vertices as element 100", "remove one");
}

#[test]
fn faults_of_the_mesh_name_the_files_own_tag_and_line() {
    let error = broken(V22, "100 4 2 9 1 10 20 5 40", "100 4 2 9 1 20 10 5 40");
    assert_says(&error, "body.msh:22", "element 100 has negative volume -1.667e-1 m3", "swap any two");
    let both = V22.replace("1 10 20 5 40", "1 20 10 5 40").replace("1 20 5 40 77", "1 5 20 40 77");
    let error = read(&both).expect_err("planted").to_string();
    assert_says(
        &error,
        "body.msh:22",
        "and so has every other tet",
        "swap the first two vertices of every tet",
    );
    let error = broken(V41, "200 20 5 40 77", "200 20 5 40 5");
    assert_says(&error, "body.msh:42", "element 200 has zero volume", "mesh the body again");
    let error = broken(V22, "1 1 1\n$EndNodes", "1 nan 1\n$EndNodes");
    assert_says(&error, "body.msh:15", "node 77 has a coordinate that is not finite", "repair");
    let error = broken(V41, "1 1 1\n$EndNodes", "1 -inf 1\n$EndNodes");
    assert_says(&error, "body.msh:32", "node 77 has a coordinate that is not finite", "repair");
    let error = broken(V22, "200 4 2 9 1 20 5 40 77", "200 1 2 9 1 20 77");
    assert_says(&error, "body.msh:15", "node 77 belongs to no tetrahedron", "remove it");
    let error = broken(V22, "200 4 2 9 1 20 5 40 77", "200 4 2 9 1 20 5 40 78");
    assert_says(
        &error,
        "body.msh:23",
        "element 200 names node 78, which is not in $Nodes",
        "export it again",
    );
    let flat = V22
        .replace(" 4 2 9 1 10 20 5 40", " 2 2 9 1 10 20 5")
        .replace("4 2 9 1 20 5 40 77", "2 2 9 1 20 5 40");
    assert_says(
        &read(&flat).expect_err("planted").to_string(),
        "body.msh",
        "no tetrahedra",
        "mesh the volume",
    );
}

#[test]
fn other_elements_are_refused_by_name() {
    let error = broken(V22, "200 4 2 9 1 20 5 40 77", "200 5 2 9 1 10 20 5 40 77 10 20 5");
    assert_says(&error, "body.msh:23", "element 200 is a hexahedron", "tetrahedra only");
    let error = broken(V22, "200 4 2 9 1 20 5 40 77", "200 29 2 9 1 20 5 40 77");
    assert_says(
        &error,
        "body.msh:23",
        "element 200 is of an order or shape that is not read (Gmsh type 29)",
        "order 1 or 2",
    );
    let error = broken(V41, "3 1 4 2\n100", "3 1 6 2\n100");
    assert_says(&error, "body.msh:41", "element 100 is a prism", "tetrahedra only");
    let error = broken(V41, "3 1 4 2\n100", "3 1 4000 2\n100");
    assert_says(&error, "body.msh:41", "of unknown shape (Gmsh type 4000)", "tetrahedra only");
}

#[test]
fn counts_that_do_not_match_are_found_where_they_show() {
    let error = broken(V22, "$Nodes\n5", "$Nodes\n6");
    assert_says(&error, "body.msh:16", "expected a node tag, found `$EndNodes`", "counts do not match");
    let error = broken(V22, "$Nodes\n5", "$Nodes\n4");
    assert_says(&error, "body.msh:15", "expected $EndNodes, found `77 1 1 1`", "count does not match");
    let error = broken(V22, "20 1 0 0", "20 1 0");
    assert_says(&error, "body.msh:12", "expected z after `20 1 0`", "export it again");
    let error = broken(V22, "20 1 0 0", "20 1 0 0 0");
    assert_says(&error, "body.msh:12", "1 value too many", "export it again");
    let error = broken(V22, "20 1 0 0", "20 1 zero 0");
    assert_says(&error, "body.msh:12", "expected y, found `zero`", "export it again");
    let error = broken(V22, "200 4 2 9 1 20 5 40 77", "200 4 2 9 1 20 5 40");
    assert_says(&error, "body.msh:23", "expected a vertex after", "export it again");
    let error = broken(V41, "2 5 5 77", "2 6 5 77");
    assert_says(&error, "body.msh:20", "announces 6 nodes and its blocks contain 5", "counts do not match");
    let error = broken(V41, "3 4 2 200", "3 7 2 200");
    assert_says(
        &error,
        "body.msh:35",
        "announces 7 elements and its blocks contain 4",
        "counts do not match",
    );
    let error = broken(V22, "5 0 1 0", "10 0 1 0");
    assert_says(&error, "body.msh:13", "node 10 occurs twice in the file (first as number 1)", "renumber");
    // A count that exceeds the memory must be refused before an allocation.
    let error = broken(V22, "$Nodes\n5", "$Nodes\n1000000000000000000");
    assert_says(&error, "body.msh:16", "expected a node tag, found `$EndNodes`", "counts do not match");
}

#[test]
fn truncation_anywhere_is_one_clear_line() {
    for text in [V22, V41] {
        // Every file that is cut before the end of $Elements must be refused; the rest of the file is not
        // needed.
        let needed = text.find("$EndElements").expect("there") + "$EndElements".len();
        for end in 0..needed {
            let error = read(&text[..end]).expect_err("a truncated file").to_string();
            assert!(error.starts_with("body.msh") && error.contains("; "), "cut at {end}: {error}");
            assert!(!error.contains('\n'));
        }
    }
    let error = broken(V22, "$EndElements\n$NodeData", "$NodeData");
    assert_says(&error, "body.msh:24", "expected $EndElements, found `$NodeData`", "its end is missing");
    let error = broken(V22, "$EndNodeData", "");
    assert_says(&error, "body.msh:25", "section $NodeData has no $EndNodeData", "truncated");
    let cut = &V41[..V41.find("0 1 0 0.5").expect("there")];
    let error = read(cut).expect_err("truncated").to_string();
    assert_says(&error, "body.msh:26", "the file ends where a node's coordinates should follow", "truncated");
}

#[test]
fn formats_that_are_not_read_say_which_to_save() {
    let error = broken(V41, "4.1 0 8", "4.1 1 8");
    assert_says(&error, "body.msh", "expected the mark 1 of the byte order", "export it again");
    let error = broken(V41, "4.1 0 8", "4.1 2 8");
    assert_says(&error, "body.msh:2", "file type 2 is neither 0 nor 1", "4.1 or 2.2");
    let error = broken(V41, "4.1 0 8", "4 0 8");
    assert_says(&error, "body.msh:2", "Gmsh format 4 is not supported", "4.1 or 2.2");
    let error = broken(V22, "$MeshFormat\n", "");
    assert_says(&error, "body.msh:1", "does not start with $MeshFormat", "export");
    let error = broken(V41, "$Entities", "$PartitionedEntities\n$EndPartitionedEntities\n$Entities");
    assert_says(&error, "body.msh:12", "partitioned", "unpartitioned");
    let error = broken(V22, "$Elements\n", "$Ends\n$EndEnds\n");
    assert_says(&error, "body.msh:17", "expected the start of a section, found `$Ends`", "damaged");
    let nodes = &V22[V22.find("$Nodes").expect("there")..V22.find("$Elements").expect("there")];
    let error = broken(V22, "$Elements", &format!("{nodes}$Elements"));
    assert_says(&error, "body.msh:17", "a second $Nodes section", "one mesh per file");
    let error = read(&V22.replacen(nodes, "", 1)).expect_err("planted").to_string();
    assert_says(&error, "body.msh:9", "$Elements precedes $Nodes", "export");
    let error = broken(V22, "2 7 \"held here\"", "2 7 held here");
    assert_says(&error, "body.msh:6", "no quotes", "export it again");
    let error = broken(V22, "2 7 \"held here\"", "4 7 \"held here\"");
    assert_says(&error, "body.msh:6", "expected a dimension from 0 to 3, found 4", "export it again");
}

#[test]
fn rubbish_is_refused_and_never_panics() {
    // Every single byte of a small file is replaced: the result is a valid mesh or an error of one line.
    for text in [V22, V41] {
        for at in 0..text.len() {
            for byte in [b' ', b'9', b'-', b'$', b'\n', 0xff] {
                let mut bytes = text.as_bytes().to_vec();
                bytes[at] = byte;
                if let Err(error) =
                    super::read(Path::new("body.msh"), &bytes).and_then(|raw| raw.finish(LengthUnit::Metre))
                {
                    let error = error.to_string();
                    assert!(error.starts_with("body.msh") && !error.contains('\n'), "{error}");
                }
            }
        }
    }
}
