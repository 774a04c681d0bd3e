//! Selection of fixed and active nodes in scene files.

use super::*;

#[test]
fn fixed_nodes_in_every_way() {
    let bench = Bench::new();
    let fixed = |line: &str| bench.with("group = \"left\"", line).expect("sound").fixed;
    assert_eq!(fixed("nodes = [9, 3, 3, 0]"), [0, 3, 9]);
    assert_eq!(fixed("box = { min = [-1, -1, 0.29], max = [0.01, 1, 1] }"), [3, 7, 11, 15]);
    assert_eq!(fixed("file = \"sets.json\"\nkey = \"F1\""), [0, 1, 2, 3, 5]);

    let refuses = |to, place, what, fix| bench.refuses("group = \"left\"", to, place, what, fix);
    refuses("", "block.toml:11", "selects no nodes", "`nodes`, `group`, `box`, or `file`");
    refuses("nodes = [1]\ngroup = \"left\"", "block.toml:11", "in several ways", "keep one of");
    refuses("nodes = []", "block.toml:12", "the fixed set is empty", "at least three");
    refuses(
        "nodes = [\n1,\n64]",
        "block.toml:14",
        "node 64 is out of range: the mesh has 64 nodes",
        "0 to 63 (0-based",
    );
    refuses("nodes = [-1]", "block.toml:12", "node -1 is out of range", "0 to 63");
    refuses("group = \"lft\"", "block.toml:12", "no group of nodes named \"lft\"", "did you mean \"left\"?");
    refuses(
        "group = \"ceiling\"",
        "block.toml:12",
        "no group of nodes named",
        "use one of: all, corner, left, right",
    );
    refuses(
        "box = { min = [1, 0, 0], max = [0, 1, 1] }",
        "block.toml:12",
        "the box is empty",
        "swap the corners",
    );
    refuses(
        "box = { min = [1, 1, 1], max = [2, 2, 2] }",
        "block.toml:12",
        "set is empty",
        "to [0.3, 0.3, 0.3] in metres",
    );
    refuses(
        "box = { min = [0, 0], max = [1, 1, 1] }",
        "block.toml:12",
        "a list of 3 is expected here, not a list of 2",
        "correct the value",
    );
    refuses(
        "box = { min = [0, 0, 0, 9], max = [1, 1, 1] }",
        "block.toml:12",
        "a list of 3 is expected here, not a list of 4",
        "correct the value",
    );
    // A number in what is left over.
    refuses(
        "box = { min = [0, 0, 0], max = [1, 1, 1, 2_a] }",
        "block.toml:12",
        "not valid TOML",
        "correct the syntax",
    );
    refuses("file = \"sets.json\"", "block.toml:11", "both `file` and `key`", "add the other");
    refuses(
        "file = \"no.json\"\nkey = \"F1\"",
        "block.toml:12",
        "cannot read the sets",
        "relative to the scene",
    );
    refuses(
        "file = \"sets.json\"\nkey = \"F2\"",
        "block.toml:13",
        "no list named \"F2\"",
        "use one of: F1, bad, none",
    );
    refuses(
        "file = \"sets.json\"\nkey = \"none\"",
        "block.toml:13",
        "the fixed set is empty",
        "at least three",
    );
    refuses(
        "file = \"sets.json\"\nkey = \"bad\"",
        "sets.json",
        "entry 1 of \"bad\" (64) is not a node",
        "0 to 63",
    );
    bench.write("broken.json", "{\n\"F1\": [1,]\n}");
    refuses("file = \"broken.json\"\nkey = \"F1\"", "broken.json:2", "not valid JSON", "correct the syntax");
    bench.write("list.json", "[1, 2]");
    refuses("file = \"list.json\"\nkey = \"F1\"", "list.json:1", "not a JSON object", "write {\"F1\"");
}

#[test]
fn active_nodes_in_every_way() {
    let bench = Bench::new();
    let scene = bench.with("node = 63", "group = \"right\"").expect("sound");
    assert_eq!(scene.active.len(), 16 + 1);
    assert_eq!(scene.active[0], ActiveNode::node("A1-48".into(), 48));
    // Every mesh has a surface, even without a group of that name.
    let surface = bench.with("node = 63", "group = \"surface\"").expect("sound");
    let all = bench.with("node = 63", "group = \"all\"").expect("sound");
    assert_eq!(surface.active, all.active);
    let scene = bench.with("node = 63", "group = \"all\"").expect("sound");
    // 64 nodes minus 16 fixed nodes minus 8 inner nodes.
    assert_eq!(scene.active.len(), 40 + 1);
    let single = SCENE.replacen("[[active]]", "[active]", 1).replacen("[[active]]\nname = \"A2\"", "", 1);
    let single = single.replacen("nearest = [0.31, 0.1, 0.1]", "", 1);
    assert_eq!(bench.resolve(&single).expect("one table is accepted").active.len(), 1);

    let refuses = |to, place, what, fix| bench.refuses("node = 63", to, place, what, fix);
    refuses("node = 64", "block.toml:15", "node 64 is out of range", "0 to 63");
    refuses("node = 5", "block.toml:15", "\"A1\" (node 5) is in the fixed set", "choose a free node");
    refuses("node = 21", "block.toml:15", "(node 21) is inside the body", "`nearest` = [0.1");
    refuses("nearest = [0, 0.1, 0.1]", "block.toml:15", "(node 5) is in the fixed set", "choose a free node");
    refuses(
        "nearest = [30, 10, 10]",
        "block.toml:15",
        "m from the body, which is 0.520 m across",
        "in metres",
    );
    refuses("nearest = [nan, 1, 1]", "block.toml:15", "is not finite", "correct the value");
    refuses("group = \"left\"", "block.toml:15", "no free surface node", "not fixed");
    refuses("group = \"top\"", "block.toml:15", "no group of nodes named \"top\"", "use one of: all, corner");
    refuses("", "block.toml:13", "\"A1\" has no position", "give `node`, `nearest`, `point` or `group`");
    refuses("node = 63\ngroup = \"right\"", "block.toml:13", "has several positions", "keep one of");
    bench.refuses("\"A2\"", "\"A1\"", "block.toml:17", "two active nodes are named \"A1\"", "its own name");
    let none = SCENE.replacen("name = \"block\"", "active = []", 1);
    let none = none.replacen("[[active]]\nname = \"A1\"\nnode = 63\n[[active]]\nname = \"A2\"\n", "", 1);
    let error = bench.resolve(&none.replacen("nearest = [0.31, 0.1, 0.1]\n", "", 1)).unwrap_err().to_string();
    assert!(error.contains("block.toml:1: the scene has no active node; add an [[active]]"), "{error}");
}

#[test]
fn a_body_that_nothing_holds_is_refused_and_oddities_are_told() {
    let bench = Bench::new();
    let warning_of = |from: &str, to: &str| bench.with(from, to).expect("can be solved").warnings.join("\n");
    let line = warning_of("group = \"left\"", "nodes = [0, 1, 2]");
    assert!(line.contains("a piece of the body is held by 3 fixed nodes on one line"), "{line}");
    let rigid = warning_of("group = \"left\"", "box = { min = [0, 0, 0], max = [0.1, 0.1, 0.1] }");
    assert_eq!(rigid, "6 tets have all four vertices fixed and cannot deform");
    let negative = warning_of("c01_pa = 1280.0", "c01_pa = -100.0");
    assert!(negative.contains("`c01_pa` = -100 is negative"), "{negative}");
    let twice = warning_of("node = 63", "node = 53");
    assert!(twice.contains("\"A1\" and \"A2\" are both node 53"), "{twice}");
    let wide = warning_of("radius_m = 0.05", "radius_m = 0.6");
    assert!(wide.contains("radius 0.6 m is larger than the body, 0.520 m across"), "{wide}");

    // A second cube at a distance of 1 m from the first.
    let (first, mut tets) = (cube(3, 30.0), cube(3, 30.0).tets);
    let mut nodes = first.nodes_m.clone();
    nodes.extend(first.nodes_m.iter().map(|x| [x[0] + 100.0, x[1], x[2]]));
    tets.extend(first.tets.iter().map(|tet| tet.map(|node| node + 64)));
    bench.write("cube.msh", &gmsh(&TetMesh::new(nodes, tets).expect("sound")));
    let what = "the mesh has 2 separate pieces, and the one of node 64 (64 nodes) has no fixed node";
    bench.refuses("[fixed]", "[fixed]", "block.toml:11", what, "fix nodes of it, or remove the piece");
    let held = warning_of("group = \"left\"", "nodes = [0, 1, 4, 64, 65, 68]");
    assert!(held.contains("2 separate pieces"), "{held}");

    // Two tets that share only an edge.
    let mut hinge = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    hinge.extend([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]);
    let hinge = TetMesh::new(hinge, vec![[0, 1, 2, 3], [0, 1, 4, 5]]).expect("sound");
    bench.write("cube.msh", &gmsh(&hinge));
    let text = SCENE.replacen("node = 63", "node = 5", 1).replacen("[0.31, 0.1, 0.1]", "[0, 0, -0.01]", 1);
    let hinged =
        bench.resolve(&text.replacen("group = \"left\"", "nodes = [0, 2, 3]", 1)).expect("can be solved");
    assert!(
        hinged.warnings.join("\n").contains("not a closed manifold (1 bad edge"),
        "{:?}",
        hinged.warnings
    );
}
