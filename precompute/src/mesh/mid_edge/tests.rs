//! One body of ten-node tets in every format, valid and damaged; the same assertions for each reader.

use std::path::{Path, PathBuf};

use crate::mesh::tetrahedral::EDGES;
use crate::mesh::{LengthUnit, TetMesh};

/// The edges in the order of each format, defined independently of the readers' tables.
const VTK: [(usize, usize); 6] = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)];
const GMSH: [(usize, usize); 6] = [(0, 1), (1, 2), (0, 2), (0, 3), (2, 3), (1, 3)];
const TETGEN: [(usize, usize); 6] = [(2, 3), (0, 3), (0, 1), (1, 2), (1, 3), (0, 2)];

#[derive(Debug, Clone, Copy, PartialEq)]
enum Format {
    Gmsh22,
    Gmsh41,
    Vtk,
    Vtu,
    TetGen,
}

const FORMATS: [Format; 5] = [Format::Gmsh22, Format::Gmsh41, Format::Vtk, Format::Vtu, Format::TetGen];

/// Two tets with a common face. The vertices are nodes 0, 1, 3, 6 and 10 of 14; mid-edge nodes lie between
/// them.
#[derive(Clone)]
struct Body {
    nodes: Vec<[f64; 3]>,
    /// Index of each vertex in the file.
    vertices: Vec<usize>,
    tets: Vec<[usize; 4]>,
    /// Whether each tet is written with its mid-edge nodes.
    second_order: [bool; 2],
    /// Replacement of a tet's mid-edge node: (tet, local edge in the format's order, node).
    replaced: Option<(usize, usize, usize)>,
    scalar: &'static str,
}

impl Body {
    fn new() -> Self {
        let corners = [[0.0; 3], [3.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 7.0], [3.0, 5.0, 7.0]];
        let tets = vec![[0, 1, 2, 3], [1, 2, 3, 4]];
        let mut body = Self {
            nodes: Vec::new(),
            vertices: Vec::new(),
            tets,
            second_order: [true; 2],
            replaced: None,
            scalar: "64",
        };
        for (last, corner) in corners.iter().enumerate() {
            body.vertices.push(body.nodes.len());
            body.nodes.push(*corner);
            for (first, start) in corners.iter().enumerate().take(last) {
                if body.tets.iter().any(|t| t.contains(&first) && t.contains(&last)) {
                    body.nodes.push(std::array::from_fn(|axis| 0.5 * (start[axis] + corner[axis])));
                }
            }
        }
        body
    }

    fn middle(&self, a: usize, b: usize) -> usize {
        let end = |v: usize| self.nodes[self.vertices[v]];
        let middle: [f64; 3] = std::array::from_fn(|axis| 0.5 * (end(a)[axis] + end(b)[axis]));
        let near = |x: &[f64; 3]| (0..3).all(|axis| (x[axis] - middle[axis]).abs() < 0.1);
        self.nodes.iter().position(near).expect("every edge has its node")
    }

    /// Indices of a tet's nodes in the file.
    fn tet(&self, tet: usize, order: [(usize, usize); 6]) -> Vec<usize> {
        let corners = self.tets[tet];
        let mut nodes: Vec<usize> = corners.iter().map(|&v| self.vertices[v]).collect();
        if self.second_order[tet] {
            nodes.extend(order.iter().map(|&(a, b)| self.middle(corners[a], corners[b])));
            if let Some((_, edge, node)) = self.replaced.filter(|&(t, ..)| t == tet) {
                nodes[4 + edge] = node;
            }
        }
        nodes
    }

    fn mesh(&self) -> TetMesh {
        let nodes = self.vertices.iter().map(|&v| self.nodes[v]).collect();
        let tets = self.tets.iter().map(|tet| tet.map(|v| v as u32)).collect();
        TetMesh::new(nodes, tets).expect("sound")
    }
}

fn words<T: ToString>(items: impl IntoIterator<Item = T>) -> String {
    items.into_iter().map(|item| item.to_string()).collect::<Vec<_>>().join(" ")
}

impl Format {
    fn order(self) -> [(usize, usize); 6] {
        match self {
            Self::Gmsh22 | Self::Gmsh41 => GMSH,
            Self::Vtk | Self::Vtu => VTK,
            Self::TetGen => TETGEN,
        }
    }

    /// Writes the body. Returns the file to read and, for formats with lines, the line (or its start) of each
    /// tet.
    fn write(self, folder: &Path, body: &Body, order: [(usize, usize); 6]) -> (PathBuf, [Option<String>; 2]) {
        let points: Vec<String> = body.nodes.iter().map(words).collect();
        let n = points.len();
        let tets = [0, 1].map(|tet| body.tet(tet, order));
        let tag = |node: &usize| 10 * node + 1;
        // The triangle of vertices 0, 1, 2 with its mid-edge nodes, and a point group of one mid-edge node.
        let [a, b, c] = [0, 1, 2].map(|v| tag(&body.vertices[v]));
        let [ab, bc, ca] = [(0, 1), (1, 2), (0, 2)].map(|(x, y)| tag(&body.middle(x, y)));
        let kind = |tet: usize, four: u32, ten: u32| if body.second_order[tet] { ten } else { four };
        let head = "$PhysicalNames\n3\n0 4 \"middle\"\n2 7 \"base\"\n3 9 \"liver\"\n$EndPhysicalNames\n";
        let (name, text, rows) = match self {
            Self::Gmsh22 => {
                let rows = [0, 1].map(|t| {
                    format!("{} {} 2 9 1 {}", 100 * (t + 1), kind(t, 4, 11), words(tets[t].iter().map(tag)))
                });
                let nodes: String = (0..n).map(|i| format!("{} {}\n", tag(&i), points[i])).collect();
                let text = format!(
                    "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n{head}$Nodes\n{n}\n{nodes}$EndNodes\n$Elements\n4\n\
                     1 15 2 4 1 {ab}\n2 9 2 7 1 {a} {b} {c} {ab} {bc} {ca}\n{}\n{}\n$EndElements\n",
                    rows[0], rows[1]
                );
                ("body.msh", text, rows.map(Some))
            }
            Self::Gmsh41 => {
                let rows = [0, 1].map(|t| format!("{} {}", 100 * (t + 1), words(tets[t].iter().map(tag))));
                let tags: String = (0..n).map(|i| format!("{}\n", tag(&i))).collect();
                let blocks: String =
                    (0..2).map(|t| format!("3 1 {} 1\n{}\n", kind(t, 4, 11), rows[t])).collect();
                let text = format!(
                    "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n{head}$Entities\n1 0 1 1\n1 0 0 0 1 4\n\
                     1 0 0 0 1 1 0 1 7 0\n1 0 0 0 1 1 1 1 9 0\n$EndEntities\n$Nodes\n1 {n} 1 999\n3 1 0 {n}\n{tags}{}\n\
                     $EndNodes\n$Elements\n4 4 1 200\n0 1 15 1\n1 {ab}\n2 1 9 1\n2 {a} {b} {c} {ab} {bc} {ca}\n\
                     {blocks}$EndElements\n",
                    points.join("\n")
                );
                ("body.msh", text, rows.map(Some))
            }
            Self::Vtk => {
                let rows = [0, 1].map(|t| format!("{} {}", tets[t].len(), words(&tets[t])));
                let text = format!(
                    "# vtk DataFile Version 4.2\nby hand\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {n} {}\n{}\n\
                     CELLS 2 {}\n{}\n{}\nCELL_TYPES 2\n{} {}\n",
                    if body.scalar == "32" { "float" } else { "double" },
                    points.join("\n"),
                    2 + tets[0].len() + tets[1].len(),
                    rows[0],
                    rows[1],
                    kind(0, 10, 24),
                    kind(1, 10, 24)
                );
                ("body.vtk", text, rows.map(Some))
            }
            Self::Vtu => {
                let array = |name: &str, scalar: &str, data: String| {
                    format!(
                        "<DataArray type=\"{scalar}\" Name=\"{name}\" format=\"ascii\">{data}</DataArray>\n"
                    )
                };
                let (first, second) = (tets[0].len(), tets[0].len() + tets[1].len());
                let text = format!(
                    "<VTKFile type=\"UnstructuredGrid\" byte_order=\"LittleEndian\"><UnstructuredGrid>\n\
                     <Piece NumberOfPoints=\"{n}\" NumberOfCells=\"2\"><Points>\n{}</Points>\n<Cells>{}{}{}</Cells>\n\
                     </Piece></UnstructuredGrid></VTKFile>\n",
                    array("Points", &format!("Float{}", body.scalar), points.join("\n")),
                    array("connectivity", "Int64", words(tets.iter().flatten())),
                    array("offsets", "Int64", format!("{first} {second}")),
                    array("types", "UInt8", format!("{} {}", kind(0, 10, 24), kind(1, 10, 24)))
                );
                ("body.vtu", text, [None, None])
            }
            Self::TetGen => {
                let rows = [0, 1].map(|t| format!("{} {} 1", t, words(&tets[t])));
                let marker = |i: usize| match i {
                    _ if i == body.vertices[0] || i == body.vertices[1] => 1,
                    _ if i == body.middle(0, 1) => 1,
                    _ if i == body.middle(1, 2) => 2,
                    _ => 0,
                };
                let nodes: String = (0..n).map(|i| format!("{i} {} {}\n", points[i], marker(i))).collect();
                std::fs::write(folder.join("body.node"), format!("{n} 3 0 1\n{nodes}")).expect("written");
                let text = format!("2 {} 1\n{}\n{}\n", tets[0].len(), rows[0], rows[1]);
                ("body.ele", text, rows.map(Some))
            }
        };
        let path = folder.join(name);
        std::fs::write(&path, &text).expect("written");
        (path, rows)
    }

    fn read(self, body: &Body) -> Result<TetMesh, String> {
        self.read_in(body, self.order()).map_err(|(error, _)| error)
    }

    /// Reads the body. An error is returned with its expected position for either tet: file, line if any, and
    /// tag.
    fn read_in(self, body: &Body, order: [(usize, usize); 6]) -> Result<TetMesh, (String, [String; 2])> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (path, rows) = self.write(folder.path(), body, order);
        let text = std::fs::read_to_string(&path).expect("just written");
        let file = path.file_name().expect("it has one").to_string_lossy().into_owned();
        let places = [0, 1].map(|tet: usize| {
            let line = rows[tet].as_ref().map(|row| {
                let at = text.lines().position(|line| line == row).expect("the row is in the file");
                format!(":{}", at + 1)
            });
            let tag = match self {
                Self::Gmsh22 | Self::Gmsh41 => 100 * (tet + 1),
                _ => tet,
            };
            format!("{file}{}: element {tag} ", line.unwrap_or_default())
        });
        crate::mesh::read(&path, LengthUnit::Metre).map_err(|error| {
            let error = error.to_string();
            assert!(!error.contains('\n') && error.contains("; "), "{error}");
            (error.replace(&format!("{}/", folder.path().display()), ""), places)
        })
    }

    /// The name of the node in the file.
    fn name(self, node: usize) -> usize {
        match self {
            Self::Gmsh22 | Self::Gmsh41 => 10 * node + 1,
            _ => node,
        }
    }

    #[track_caller]
    fn assert_says(self, body: &Body, tet: usize, words: &[&str]) {
        let (error, places) = self.read_in(body, self.order()).expect_err("planted fault");
        assert!(error.starts_with(&places[tet]), "{self:?}: {error} is not at {}", places[tet]);
        for word in words {
            assert!(error.contains(word), "{self:?}: `{word}` is not in: {error}");
        }
    }
}

#[test]
fn every_format_gives_the_vertices_in_file_order() {
    let body = Body::new();
    assert_eq!(
        (body.nodes.len(), &body.vertices[..]),
        (14, &[0, 1, 3, 6, 10][..]),
        "mid-edge nodes are between the vertices"
    );
    for format in FORMATS {
        let mesh = format.read(&body).unwrap_or_else(|error| panic!("{format:?}: {error}"));
        assert_eq!((&mesh.nodes_m, &mesh.tets), (&body.mesh().nodes_m, &body.mesh().tets), "{format:?}");
        let names: Vec<&str> = mesh.node_groups.keys().map(String::as_str).collect();
        match format {
            Format::Gmsh22 | Format::Gmsh41 => {
                assert_eq!(names, ["base", "liver"], "the group of one mid-edge node is removed");
                assert_eq!(mesh.node_groups["base"], [0, 1, 2]);
                assert_eq!(mesh.node_groups["liver"], [0, 1, 2, 3, 4]);
                assert_eq!(mesh.tet_groups["liver"], [0, 1]);
            }
            Format::TetGen => {
                assert_eq!(names, ["marker 1", "region 1"]);
                assert_eq!(mesh.node_groups["marker 1"], [0, 1]);
                assert_eq!(mesh.node_groups["region 1"], [0, 1, 2, 3, 4]);
            }
            Format::Vtk | Format::Vtu => assert_eq!(names, Vec::<&str>::new()),
        }
    }
}

#[test]
fn files_of_gmsh_itself_are_read() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/mesh/mid_edge");
    // Files of Gmsh 4.15.2: one tet of 3 x 5 x 7 along the axes, with `setOrder(2)`.
    for name in ["gmsh22.msh", "gmsh41.msh", "gmsh.vtk"] {
        let mesh = crate::mesh::read(&folder.join(name), LengthUnit::Metre).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(mesh.nodes_m, [[0.0; 3], [3.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 7.0]], "{name}");
        assert_eq!(mesh.volume_m3(), 17.5, "{name}");
        if name.ends_with("msh") {
            assert_eq!(mesh.node_groups["base"], [0, 1, 2], "{name}");
            assert_eq!(mesh.node_groups["rim"], [0, 2], "{name}");
        }
    }
}

#[test]
fn a_curved_edge_is_refused_beyond_a_millionth_of_its_length() {
    for format in FORMATS {
        for [a, b] in EDGES {
            // Edges of the second tet, whose vertices are 1, 2, 3, 4.
            let (a, b) = (a + 1, b + 1);
            let sound = Body::new();
            let node = sound.middle(a, b);
            let ends = [a, b].map(|v| sound.nodes[sound.vertices[v]]);
            let length = crate::num::vector::distance(ends[0], ends[1]);
            let moved = |share: f64| {
                let mut body = sound.clone();
                body.nodes[node][2] += share * length;
                body
            };
            assert!(format.read(&moved(0.9e-6)).is_ok(), "{format:?} {a}-{b}");
            let tet = usize::from(b == 4);
            let named = |v: usize| format.name(sound.vertices[v]);
            let edge = format!("edge {}-{} is curved", named(a), named(b));
            let its = format!("its node {} is 1.1e-6 of its length", format.name(node));
            format.assert_says(&moved(1.1e-6), tet, &[&edge, &its, "straight-sided", "order 1"]);
        }
    }
}

#[test]
fn the_edge_order_of_another_format_is_told_from_a_curve() {
    let body = Body::new();
    for format in FORMATS {
        for order in [VTK, GMSH, TETGEN] {
            match format.read_in(&body, order) {
                Ok(mesh) => {
                    assert!(order == format.order() || format == Format::TetGen, "{format:?} {order:?}");
                    assert_eq!(mesh.tets, body.mesh().tets);
                }
                Err((error, places)) => {
                    assert!(order != format.order() && format != Format::TetGen, "{format:?}: {error}");
                    assert!(error.starts_with(&places[0]), "{error}");
                    assert!(
                        error.contains("but it is that of") && error.contains("of another format"),
                        "{error}"
                    );
                }
            }
        }
    }
}

#[test]
fn four_and_ten_nodes_do_not_mix() {
    for format in FORMATS {
        for (second_order, said) in [
            ([false, true], "has 10 nodes, and the elements before it have 4"),
            ([true, false], "has 4 nodes, and the elements before it have 10"),
        ] {
            let body = Body { second_order, ..Body::new() };
            if format == Format::TetGen {
                // The header contains the count, so a row of another length is damage.
                assert!(format.read(&body).expect_err("planted fault").starts_with("body.ele:3: "));
            } else {
                format.assert_says(&body, 1, &[said, "with one order, 1 or 2"]);
            }
        }
    }
}

#[test]
fn a_mid_edge_node_that_is_a_vertex_missing_or_not_finite_is_refused() {
    for format in FORMATS {
        let sound = Body::new();
        let vertex = Body { replaced: Some((1, 2, sound.vertices[0])), ..sound.clone() };
        format.assert_says(&vertex, 1, &["which is a vertex as well", "conforming"]);
        let missing = Body { replaced: Some((1, 2, 14)), ..sound.clone() };
        format.assert_says(
            &missing,
            1,
            &["names node", "export"][..if format == Format::TetGen { 1 } else { 2 }],
        );
        let mut broken = sound.clone();
        let node = sound.middle(1, 2);
        broken.nodes[node][1] = f64::NAN;
        // The body finds its mid-edge nodes by position; restore the lost node by index in both tets.
        let error = format.read_nan(&broken, &sound);
        let said = format!("node {} has a coordinate that is not finite", format.name(node));
        assert!(error.contains(&said), "{format:?}: {error}");
    }
}

impl Format {
    /// The error of a file in which one coordinate of a valid body is NaN.
    fn read_nan(self, broken: &Body, sound: &Body) -> String {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (path, _) = self.write(folder.path(), sound, self.order());
        let node = (0..sound.nodes.len()).find(|&i| broken.nodes[i][1].is_nan()).expect("one is broken");
        let [x, y, z] = sound.nodes[node];
        let holder = if self == Self::TetGen { folder.path().join("body.node") } else { path.clone() };
        let text = std::fs::read_to_string(&holder).expect("written");
        let (from, to) = (format!("{x} {y} {z}"), format!("{x} nan {z}"));
        assert_eq!(text.matches(&from).count(), 1, "{self:?}");
        std::fs::write(&holder, text.replace(&from, &to)).expect("written");
        crate::mesh::read(&path, LengthUnit::Metre).expect_err("planted fault").to_string()
    }
}

#[test]
fn singles_may_be_off_by_their_rounding() {
    // Far from the origin an f32 has an error of about 1e-5 of these edges; with the tolerance for f64 the
    // edges would count as curved.
    for format in [Format::Vtk, Format::Vtu] {
        let mut body = Body::new();
        for x in body.nodes.iter_mut().flatten() {
            *x = f64::from((0.7 * *x + 1000.3) as f32);
        }
        let refused = format.read(&body).expect_err("as doubles");
        assert!(refused.contains("is curved"), "{refused}");
        body.scalar = "32";
        assert_eq!(format.read(&body).expect("as singles").tets, body.mesh().tets);
        let node = body.middle(1, 2);
        body.nodes[node][0] += 1e-3;
        assert!(format.read(&body).expect_err("a millimetre").contains("is curved"));
    }
}

#[test]
fn rubbish_and_truncation_never_panic() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for format in FORMATS {
        let (path, _) = format.write(folder.path(), &Body::new(), format.order());
        let sound = std::fs::read(&path).expect("just written");
        let judge = |bytes: &[u8]| {
            std::fs::write(&path, bytes).expect("written");
            match crate::mesh::read(&path, LengthUnit::Metre) {
                Ok(mesh) => mesh.check().expect("what is read is sound"),
                Err(error) => assert!(!error.to_string().contains('\n') && !error.fix.is_empty()),
            }
        };
        for at in 0..sound.len() {
            judge(&sound[..at]);
            for byte in *b" 9-\n" {
                let mut damaged = sound.clone();
                damaged[at] = byte;
                judge(&damaged);
            }
        }
    }
}
