//! Tests the command line as a user types it: exit codes, output files, and one clear line for bad input.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use palpate_tests::{mooney_rivlin, nearest_node, soft_beam, write_beam_scene};

use crate::{GRID, MR, palpate, refused, text};

#[test]
fn a_path_is_a_table_with_every_column() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write_beam_scene(folder.path(), MR, GRID, 100.0);
    let csv = folder.path().join("path.csv");
    let moved = folder.path().join("moved.csv");
    let arguments = [
        "path",
        text(&scene),
        "--active",
        "A",
        "--direction=0,0,-1",
        "--step-mm",
        "1",
        "--steps",
        "4",
        "--csv",
        text(&csv),
        "--displacements",
        text(&moved),
    ];
    let output = palpate(&arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let table = std::fs::read_to_string(&csv).expect("the table is written");
    let lines: Vec<&str> = table.lines().collect();
    assert_eq!(
        lines[0],
        "step,dx_m,dy_m,dz_m,fx_n,fy_n,fz_n,energy_j,newton_iterations,residual_n,min_jacobian,inverted,volume_m3,status"
    );
    assert_eq!(lines.len(), 5);
    let last: Vec<&str> = lines[4].split(',').collect();
    assert_eq!((last[0], last[13]), ("4", "ok"));
    let number = |column: usize| last[column].parse::<f64>().expect("a number");
    assert!((number(3) + 0.004).abs() < 1e-15, "the fourth step is at -4 mm");
    assert!(number(6) < -0.05, "pressing down takes a downward force on the body, not {} N", number(6));
    let nodes = soft_beam(mooney_rivlin()).0.nodes_m.len();
    let displacements = std::fs::read_to_string(&moved).expect("the displacements are written");
    assert_eq!(displacements.lines().count(), 1 + 4 * nodes);
}

/// The array of a VTU file that Palpate writes: inline base64 with an 8-byte header.
fn vtu_array(vtu: &Path, parent: &str, name: &str) -> Vec<f64> {
    let text = std::fs::read_to_string(vtu).expect("the step is there");
    let inside = text.split(&format!("<{parent}>")).nth(1).expect("the section");
    let inside = inside.split(&format!("</{parent}>")).next().expect("its end");
    let array = inside.split(&format!("Name=\"{name}\"")).nth(1).expect("the array");
    let data = array.split(['>', '<']).nth(1).expect("data");
    let bytes = base64::Engine::decode(&base64::engine::general_purpose::STANDARD, data).expect("base64");
    bytes[8..].as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect()
}

#[test]
fn a_path_is_a_series_for_paraview() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write_beam_scene(folder.path(), MR, GRID, 100.0);
    let at = |name: &str| folder.path().join(name);
    let (csv, moved, pvd) = (at("path.csv"), at("moved.csv"), at("moved.PVD"));
    for displacements in [&moved, &pvd] {
        let (csv, file) = (text(&csv), text(displacements));
        let steps = ["--step-mm", "1.5", "--steps", "3", "--csv", csv, "--displacements", file];
        let output = palpate(&[&["path", text(&scene), "--direction=0,0,-1"][..], &steps].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    let list = std::fs::read_to_string(&pvd).expect("the list is written");
    let sets: Vec<&str> = list.lines().filter(|line| line.starts_with("<DataSet")).collect();
    assert_eq!(sets.len(), 4, "rest and three steps: {list}");
    let forces = std::fs::read_to_string(&csv).expect("the table");
    let rows = std::fs::read_to_string(&moved).expect("the displacements");
    for (step, set) in sets.iter().enumerate() {
        let file = format!("moved/step_000{step}.vtu");
        let time = 1.5 * step as f64;
        assert!(
            set.contains(&format!("timestep=\"{time:?}\"")) && set.contains(&format!("file=\"{file}\"")),
            "{set}"
        );
        // The project's reader recognises the mesh, and the numbers are those of the tables, to the last bit.
        let shown = palpate(&["inspect", text(&at(&file)), "--json"]);
        let shown: serde_json::Value = serde_json::from_slice(&shown.stdout).expect("JSON");
        assert_eq!(shown["nodes"], soft_beam(mooney_rivlin()).0.nodes_m.len());
        let u = vtu_array(&at(&file), "PointData", "displacement_m");
        let reaction = vtu_array(&at(&file), "FieldData", "reaction_force_n");
        if step == 0 {
            assert!(u.iter().all(|u| *u == 0.0) && reaction.iter().all(|h| h.abs() < 1e-9), "rest");
            continue;
        }
        let start = format!("{step},");
        let of_csv: Vec<f64> = rows
            .lines()
            .filter(|row| row.starts_with(&start))
            .flat_map(|row| row.split(',').skip(2).map(|u| u.parse::<f64>().expect("a number")))
            .collect();
        assert_eq!(u, of_csv);
        assert!(u.iter().any(|u| u.abs() > 0.9e-3), "the beam has moved");
        let row = forces.lines().find(|row| row.starts_with(&start)).expect("the step's row");
        let force: Vec<f64> = row.split(',').skip(4).take(3).map(|h| h.parse().expect("a number")).collect();
        assert_eq!(reaction, force);
    }
    let wrong = at("moved.xlsx");
    let arguments =
        ["path", text(&scene), "--direction=0,0,-1", "--steps", "1", "--displacements", text(&wrong)];
    refused(&arguments, &["moved.xlsx", ".csv or .pvd"]);
    std::fs::write(at("taken"), "a file").expect("the folder can be written");
    let taken = at("taken.pvd");
    let arguments =
        ["path", text(&scene), "--direction=0,0,-1", "--steps", "1", "--displacements", text(&taken)];
    refused(&arguments, &["taken", "give a folder"]);
}

#[test]
fn inspect_measures_meshes_and_scenes() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write_beam_scene(folder.path(), MR, GRID, 100.0);
    let mesh = folder.path().join("beam.msh");
    let show = |arguments: &[&str]| {
        let output = palpate(&[&["inspect"], arguments].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let json = |arguments: &[&str]| -> serde_json::Value {
        serde_json::from_str(&show(&[arguments, &["--json"]].concat())).expect("JSON")
    };
    let beam = soft_beam(mooney_rivlin()).0;
    let figures = json(&[text(&mesh)]);
    assert_eq!((&figures["nodes"], &figures["tets"]), (&beam.nodes_m.len().into(), &beam.tets.len().into()));
    let histogram = figures["min_dihedral_histogram"].as_array().expect("bins");
    assert_eq!(histogram.iter().map(|n| n.as_u64().expect("a count")).sum::<u64>(), beam.tets.len() as u64);
    let in_mm = json(&[text(&mesh), "--unit", "mm"]);
    let ratio = figures["volume_m3"].as_f64().expect("m3") / in_mm["volume_m3"].as_f64().expect("m3");
    assert!((ratio - 1e9).abs() < 1.0, "{ratio}");
    let of_scene = json(&[text(&scene)]);
    assert_eq!(of_scene["mesh"], figures);
    assert_eq!(of_scene["pressure_doubts"]["tets"], beam.tets.len());
    for shown in [text(&mesh), text(&scene)].map(|file| show(&[file, "--verbose"])) {
        assert!(shown.contains("smallest dihedral angle of each tet") && shown.contains("|####"), "{shown}");
        assert!(shown.lines().filter(|l| !l.contains(": ")).all(|l| l.chars().count() <= 80), "{shown}");
    }
    refused(&["inspect", text(&scene), "--unit", "mm"], &["beam.toml", "--unit is for mesh files"]);
    // A ten-node mesh with a curved edge.
    let curved = folder.path().join("curved.vtk");
    let points = "0 0 0 1 0 0 0 1 0 0 0 1 .5 0 .01 .5 .5 0 0 .5 0 0 0 .5 .5 0 .5 0 .5 .5";
    let cells = "CELLS 1 11\n10 0 1 2 3 4 5 6 7 8 9\nCELL_TYPES 1\n24\n";
    let head = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID";
    std::fs::write(&curved, format!("{head}\nPOINTS 10 double\n{points}\n{cells}")).expect("written");
    refused(&["inspect", text(&curved)], &["curved.vtk:8: ", "edge 0-1 is curved", "straight-sided"]);
    // A mesh in millimetres, read in metres.
    let large = folder.path().join("large.vtk");
    let body = "POINTS 4 double\n0 0 0 100 0 0 0 100 0 0 0 100\nCELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n";
    std::fs::write(&large, format!("{head}\n{body}")).expect("written");
    let shown = show(&[text(&large)]);
    assert!(shown.starts_with("warning: the body is 173 m across: is the mesh in mm?"), "{shown}");
    assert!(!show(&[text(&large), "--unit", "mm"]).contains("is the mesh in"));
}

#[test]
fn a_path_that_fails_keeps_its_rows_and_says_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let svk = "law = \"st-venant-kirchhoff\"\nyoung_pa = 15480.0\npoisson = 0.49";
    let scene = write_beam_scene(folder.path(), svk, GRID, 100.0);
    let csv = folder.path().join("path.csv");
    // St. Venant-Kirchhoff has no barrier at J = 0: pressed through the whole beam it must collapse.
    let arguments = [
        "path",
        text(&scene),
        "--direction=-0.2,0,-1",
        "--step-mm",
        "10",
        "--steps",
        "40",
        "--csv",
        text(&csv),
    ];
    let output = palpate(&arguments);
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    let table = std::fs::read_to_string(&csv).expect("the rows so far are written");
    let last = table.lines().last().expect("a row");
    assert!(last.ends_with(",failed"), "{last}");
    assert_eq!(last.split(',').count(), 14, "a failed row has every column: {last}");
    assert!(table.lines().count() > 2, "rows so far are kept:\n{table}");
}

/// The blob with the verdict of its certificate replaced by red, and a valid checksum.
fn red(blob: &[u8]) -> Vec<u8> {
    let (mut bytes, mark) = (blob.to_vec(), b"\"verdict\":\"");
    let found = bytes.windows(mark.len()).position(|window| window == mark);
    let at = found.expect("a certificate with its health") + mark.len();
    let length = bytes[at..].iter().position(|byte| *byte == b'"').expect("it ends") + 1;
    // JSON permits spaces after the string.
    bytes[at..at + length].fill(b' ');
    bytes[at..at + 4].copy_from_slice(b"red\"");
    let end = bytes.len() - 4;
    let sum = palpate_core::format::CHECKSUM.checksum(&bytes[..end]);
    bytes[end..].copy_from_slice(&sum.to_le_bytes());
    bytes
}

#[test]
fn scene_to_blob_to_query() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write_beam_scene(folder.path(), MR, GRID, 100.0);
    let at = |name: &str| folder.path().join(name);
    let (space, blob, points, forces, dump) =
        (at("a.space"), at("a.blob"), at("in.csv"), at("out.csv"), at("dump.csv"));
    let ok = |arguments: &[&str]| {
        let output = palpate(arguments);
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    ok(&["precompute", text(&scene), "--out", text(&space), "--threads", "2"]);
    let again = ok(&["precompute", text(&scene), "--out", text(&space)]);
    assert!(again.contains(" 0 solved now"), "a finished space is not solved again: {again}");
    ok(&["pack", text(&space), "--method", "trilinear,rbf-cubic", "--out", text(&blob)]);
    ok(&["inspect", text(&space), "--csv", text(&dump)]);
    assert_eq!(
        std::fs::read_to_string(&dump).expect("the dump").lines().count(),
        1 + 125,
        "the cube of two cells"
    );
    // A red blob drives no motors, before any device is opened; without motors it is a warning.
    let red_blob = at("red.blob");
    std::fs::write(&red_blob, red(&std::fs::read(&blob).expect("the blob"))).expect("written");
    let session = ["--headless", "--frame-rate", "0", "--seconds", "0.1", "--uncertified"];
    let on = |device| palpate(&[&["run", text(&red_blob), "--device", device][..], &session].concat());
    for device in ["polhem:/dev/no-such-port", "falcon", "link:/dev/no-such-port", "touch:/no-such-port.so"] {
        let refused = on(device);
        let said = String::from_utf8_lossy(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{said}");
        assert!(said.contains("A is red") && said.contains("a red blob drives no motors"), "{said}");
        assert!(said.lines().count() == 1 && !said.contains("no-such-port"), "{said}");
    }
    // The health of a blob without a certificate is not known.
    let unknown_blob = at("unknown.blob");
    ok(&[
        "pack",
        text(&space),
        "--method",
        "trilinear,rbf-cubic",
        "--no-certificate",
        "--out",
        text(&unknown_blob),
    ]);
    let device = ["run", text(&unknown_blob), "--device", "polhem:/dev/no-such-port"];
    let unsound = palpate(&[&device[..], &session].concat());
    let said = String::from_utf8_lossy(&unsound.stderr);
    assert!(unsound.status.code() == Some(2) && said.contains("drives no motors"), "{said}");
    assert!(said.lines().count() == 1 && !said.contains("no-such-port"), "{said}");
    let warned = on("sim");
    assert!(String::from_utf8_lossy(&warned.stderr).contains("warning"), "{warned:?}");
    // The blob contains its errors against finite elements, at positions that were solved for the certificate
    // and that no fit has used.
    let shown: serde_json::Value =
        serde_json::from_str(&ok(&["inspect", text(&blob), "--json"])).expect("JSON");
    let certificate = &shown["certificate"]["spaces"][0];
    assert_eq!(certificate["active"], "A");
    let methods = certificate["methods"].as_array().expect("methods");
    assert_eq!(methods.len(), 4);
    for method in methods {
        let uniform = &method["uniform"];
        let number = |key: &str| uniform[key].as_f64().expect("a number");
        assert_eq!(uniform["count"], 299, "{method}");
        assert!(number("mean_n") > 1e-6 && number("mean_n") < number("p95_n"), "{method}");
        assert!(number("p95_n") <= number("p99_n") && number("p99_n") <= number("max_n"), "{method}");
        assert!(number("max_n") < 0.05, "a hundred newtons a metre over a cell of 5 mm: {method}");
    }
    assert!(methods[0]["method"] == "trilinear" && methods[3]["method"] == "rbf-cubic");
    let mean = |n: usize| methods[n]["uniform"]["mean_n"].as_f64().expect("a number");
    assert!(mean(3) < mean(0), "the order of the methods is right: {methods:?}");
    assert!(ok(&["inspect", text(&blob), "--verbose"]).contains("certificate of A: 125 configurations"));
    // One lattice table serves three methods.
    assert_eq!(
        shown["spaces"][0]["methods"],
        serde_json::json!(["trilinear", "tricubic", "hybrid", "rbf-cubic"])
    );
    std::fs::write(&points, "x_m,y_m,z_m\n0,0,0\n0.005,0,0\n1,0,0\n").expect("the folder can be written");
    ok(&["query", text(&blob), "--method", "trilinear", "--points", text(&points), "--csv", text(&forces)]);
    let answers = std::fs::read_to_string(&forces).expect("the answers");
    let rows: Vec<Vec<&str>> = answers.lines().map(|l| l.split(',').collect()).collect();
    assert_eq!(rows[0], ["x_m", "y_m", "z_m", "fx_n", "fy_n", "fz_n", "coverage"]);
    assert_eq!(rows[1][3..], ["0.0", "0.0", "0.0", "cell"]);
    assert_eq!(rows[3][6], "extrapolated");
    assert!(rows[3][3].parse::<f64>().expect("a number").is_finite());
    // The query must return the solved force at a grid point.
    let dumped = std::fs::read_to_string(&dump).expect("the dump");
    let solved = dumped.lines().find(|l| l.starts_with("A,1,0,0,")).expect("the point is in the dump");
    let exact: f64 = solved.split(',').nth(14).expect("fx_n").parse().expect("a number");
    let found: f64 = rows[2][3].parse().expect("a number");
    assert!((exact - found).abs() < 1e-6 * exact.abs(), "{exact} N solved, {found} N in the blob");
    ok(&[
        "query",
        text(&blob),
        "--method",
        "trilinear",
        "--points",
        text(&points),
        "--csv",
        text(&forces),
        "--stiffness",
    ]);
    let answers = std::fs::read_to_string(&forces).expect("the answers");
    let head = answers.lines().next().expect("a header");
    assert!(head.ends_with(",szx_n_m,szy_n_m,szz_n_m,energy_j"), "{head}");
    assert!(answers.lines().all(|line| line.split(',').count() == 17), "{answers}");
    ok(&["pack", text(&space), "--method", "trilinear", "--no-certificate", "--out", text(&blob)]);
    refused(
        &["run", text(&blob), "--headless", "--seconds", "1"],
        &["a.blob", "no certificate", "--uncertified"],
    );
    refused(
        &["query", text(&blob), "--method", "rbf-linear", "--points", text(&points), "--csv", text(&forces)],
        &["a.blob", "rbf-linear", "palpate pack"],
    );
    std::fs::write(&points, "x_m,y_m,z_m\n0,0,0\nnan,0,0\n").expect("the folder can be written");
    refused(
        &["query", text(&blob), "--method", "trilinear", "--points", text(&points), "--csv", text(&forces)],
        &["in.csv:3", "`nan` is not a finite number"],
    );
}

/// A real organ with every method.
const BLOB: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../firmware-like-core/golden/organ-514.blob");

/// Runs `palpate query` with these points on standard input.
fn query(more: &[&str], points: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
    let piped = command.args(["query", BLOB]).args(more).stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = piped.stderr(Stdio::piped()).spawn().expect("the binary runs");
    let mut input = child.stdin.take().expect("a pipe");
    // A command that refuses its arguments reads nothing.
    let _ = input.write_all(points.as_bytes());
    drop(input);
    child.wait_with_output().expect("it ends")
}

#[test]
fn a_query_is_a_filter() {
    let folder = tempfile::tempdir().expect("a folder");
    let [points, forces] = ["in.csv", "out.csv"].map(|name| folder.path().join(name));
    let text_of_points = "x_m,y_m,z_m\n0.001,-0.00002,0\n0,0,-0.004\n";
    std::fs::write(&points, text_of_points).expect("written");
    let by_file = palpate(&["query", BLOB, "--points", text(&points), "--csv", text(&forces)]);
    assert!(by_file.status.success(), "{}", String::from_utf8_lossy(&by_file.stderr));
    assert!(String::from_utf8_lossy(&by_file.stdout).contains("out.csv: 2 points by energy"));
    let expected = std::fs::read(&forces).expect("the answers");
    for more in [&[][..], &["--points", "-"], &["--points", "-", "--csv", "-"], &["--method", "energy"]] {
        let piped = query(more, text_of_points);
        assert!(piped.status.success(), "{}", String::from_utf8_lossy(&piped.stderr));
        assert_eq!(piped.stdout, expected, "{more:?}");
    }
    let wrong = query(&[], "x_m,y_m,z_m\n1,2\n");
    let said = String::from_utf8_lossy(&wrong.stderr);
    assert_eq!(wrong.status.code(), Some(2), "{said}");
    assert!(said.contains("standard input:2: 2 values for 3 columns"), "{said}");
}

/// The columns and values of a query of the golden blob; the values are those that `f32` and `f64` print.
#[test]
fn the_table_of_a_query_is_as_ever() {
    let answer = query(&["--method", "trilinear", "--stiffness"], "x_m,y_m,z_m\n0,0,0\n1.5e-5,0,-0\n");
    let table = String::from_utf8(answer.stdout).expect("text");
    let lines: Vec<&str> = table.lines().collect();
    assert_eq!(
        lines[0],
        "x_m,y_m,z_m,fx_n,fy_n,fz_n,coverage,sxx_n_m,sxy_n_m,sxz_n_m,syx_n_m,syy_n_m,syz_n_m,szx_n_m,szy_n_m,szz_n_m,energy_j"
    );
    assert!(lines[1].starts_with("0.0,0.0,0.0,0.0,0.0,0.0,cell,"), "{}", lines[1]);
    let cells: Vec<&str> = lines[2].split(',').collect();
    assert_eq!((cells.len(), cells[16]), (17, ""), "trilinear has no energy: {}", lines[2]);
    let read: Vec<f64> = cells[..3].iter().map(|cell| cell.parse().expect("a number")).collect();
    assert_eq!(read, [1.5e-5, 0.0, -0.0]);
}

/// As with other filters, a reader that has seen enough is no error.
#[test]
fn a_closed_pipe_ends_a_command_in_silence() {
    let many = "0,0,-0.001\n".repeat(20_000);
    let script = "\"$1\" query \"$2\" | head -n 2; echo ${PIPESTATUS[0]}; \"$1\" run --help-all | head -n 1";
    let mut command = Command::new("bash");
    command.args(["-c", script, "sh", env!("CARGO_BIN_EXE_palpate"), BLOB]).stdin(Stdio::piped());
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("bash runs");
    child.stdin.take().expect("a pipe").write_all(format!("x_m,y_m,z_m\n{many}").as_bytes()).expect("read");
    let output = child.wait_with_output().expect("it ends");
    let (out, said) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(said.is_empty(), "{said}");
    let lines: Vec<&str> = out.lines().collect();
    assert!(lines[0].starts_with("x_m,y_m") && lines[2] == "0" && lines[3].starts_with("Palpate"), "{out}");
}

/// Plausible mistakes: each one line with the fix.
#[test]
fn mistakes_are_refused_in_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write_beam_scene(folder.path(), MR, GRID, 100.0);
    let (dir, scene) = (text(folder.path()), text(&scene));
    let out = folder.path().join("a.out");
    let out = text(&out);
    let points = folder.path().join("in.csv");
    std::fs::write(&points, "x_m,y_m,z_m\n").expect("written");
    let points = text(&points);
    let mistakes: [(&[&str], &[&str]); 23] = [
        (&["dmeo"], &["demo", "palpate --help"]),
        (&["compare", scene], &["compare", "palpate --help"]),
        (&["run"], &["<BLOB>", "palpate run --help"]),
        (&["run", BLOB, "--sceonds", "1"], &["--seconds", "palpate run --help"]),
        (&["run", BLOB, "--uncertified", "--headless", "--seconds", "-1"], &["--seconds -1", "not negative"]),
        (&["live", scene, "--friction", "-0.1"], &["-0.1", "--friction", "not within 0 and 1"]),
        (&["run", BLOB, "--guard-ms", "-1"], &["-1", "--guard-ms", "3..=20"]),
        (&["run", BLOB, "--frame-rate", "-1"], &["-1", "not within 0 and 1000"]),
        (&["run", BLOB, "--uncertified", "--device", "flacon"], &["no device `flacon`", "falcon"]),
        (&["run", BLOB, "--uncertified", "--profile", "delta"], &["delta.3"]),
        (&["run", dir], &["is a folder"]),
        (&["run", scene], &["beam.toml", "blob"]),
        (&["query", BLOB, "--method", "magic"], &["magic", "trilinear", "palpate query --help"]),
        (&["query", BLOB, "--points", dir], &["is a folder"]),
        (&["query", BLOB, "--points", points, "--csv", dir], &["--csv", "is a folder"]),
        (&["query", BLOB, "--points", points, "--active", "Z"], &["no such active node", "it has"]),
        (&["pack", dir, "--out", out], &["is a folder"]),
        (&["pack", "nowhere.space", "--out", out], &["nowhere.space", "No such file", "check the name"]),
        (&["pack", scene, "--out", out], &["beam.toml", "not a .space file"]),
        (&["precompute", scene], &["beam.toml", "give --out FILE.space"]),
        (&["path", scene, "--steps", "1", "--direction", "0,0"], &["0,0", "three numbers"]),
        (&["plan", "nowhere.toml"], &["nowhere.toml", "check the path"]),
        (&["demo", "--out", scene], &["is a file; give a folder"]),
    ];
    for (arguments, words) in mistakes {
        refused(arguments, words);
    }
}

#[test]
fn damaged_and_newer_blobs_are_refused_in_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write_beam_scene(folder.path(), MR, GRID, 100.0);
    let (space, blob) = (folder.path().join("a.space"), folder.path().join("a.blob"));
    assert!(palpate(&["precompute", text(&scene), "--out", text(&space)]).status.success());
    assert!(palpate(&["pack", text(&space), "--no-certificate", "--out", text(&blob)]).status.success());
    let good = std::fs::read(&blob).expect("the blob");
    let mut flipped = good.clone();
    flipped[good.len() / 2] ^= 0x10;
    std::fs::write(&blob, &flipped).expect("the folder can be written");
    refused(&["inspect", text(&blob)], &["a.blob", "checksum", "palpate pack"]);
    std::fs::write(&blob, &good[..good.len() - 100]).expect("the folder can be written");
    refused(&["inspect", text(&blob)], &["a.blob", "cut short"]);
    // A newer version with a valid checksum.
    let mut newer = good;
    newer[8] = palpate_core::format::VERSION as u8 + 1;
    let end = newer.len() - 4;
    let sum = palpate_core::format::CHECKSUM.checksum(&newer[..end]);
    newer[end..].copy_from_slice(&sum.to_le_bytes());
    std::fs::write(&blob, &newer).expect("the folder can be written");
    refused(
        &["run", text(&blob), "--headless", "--seconds", "1"],
        &["a.blob", &format!("version {}", palpate_core::format::VERSION + 1)],
    );
    std::fs::remove_file(&blob).expect("the blob is there");
    refused(&["inspect", text(&blob)], &["a.blob"]);
}

#[test]
fn bad_scenes_are_refused_in_one_line_and_leave_nothing_behind() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write_beam_scene(folder.path(), MR, GRID, 100.0);
    let out = folder.path().join("a.space");
    let good = std::fs::read_to_string(&scene).expect("the scene");
    let mesh = folder.path().join("beam.msh");
    let good_mesh = std::fs::read_to_string(&mesh).expect("the mesh");
    let refuse = |text_now: String, words: &[&str]| {
        std::fs::write(&scene, text_now).expect("the folder can be written");
        refused(&["precompute", text(&scene), "--out", text(&out)], words);
        assert!(!out.exists(), "nothing half-written");
    };
    refuse(good.replace("beam.msh", "missing.msh"), &["missing.msh"]);
    refuse(good.replace("max_force_n", "max_forse_n"), &["beam.toml:", "max_forse_n", "max_force_n"]);
    let active_line = good.lines().find(|l| l.starts_with("node = ")).expect("an active node").to_string();
    refuse(good.replace(&active_line, "node = 99999"), &["beam.toml:", "99999"]);
    refuse(good.replace(&active_line, "node = 0"), &["beam.toml:", "fixed"]);
    let fixed_line = good.lines().find(|l| l.starts_with("nodes = ")).expect("fixed nodes").to_string();
    refuse(good.replace(&fixed_line, "nodes = []"), &["beam.toml:", "fixed"]);
    refuse(good.replace(&fixed_line, "nodes = [0]"), &["beam.toml:", "line"]);
    // All nodes are fixed except the active node and its neighbour inside: the pressures are undetermined.
    let (beam, _, active, _) = soft_beam(mooney_rivlin());
    let inside = nearest_node(&beam, [0.06, 0.02, 0.02]);
    let all: Vec<u32> = (0..beam.nodes_m.len() as u32).filter(|n| ![active, inside].contains(n)).collect();
    let held = good.replace(&fixed_line, &format!("nodes = {all:?}"));
    refuse(held.clone(), &["beam.toml:", "\"A\"", "undetermined", "`bulk_pa`"]);
    std::fs::write(&scene, held.replace("c01_pa = 1280.0", "c01_pa = 1280.0\nbulk_pa = 1e5"))
        .expect("written");
    let output = palpate(&["path", text(&scene), "--direction=0,0,-1", "--step-mm", "1", "--steps", "1"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // A truncated mesh, and one with an inverted tetrahedron.
    std::fs::write(&mesh, &good_mesh[..good_mesh.len() / 2]).expect("the folder can be written");
    refuse(good.clone(), &["beam.msh:"]);
    let tet = good_mesh.lines().find(|l| l.contains(" 4 2 1 1 ")).expect("a tetrahedron");
    let mut words: Vec<&str> = tet.split(' ').collect();
    words.swap(5, 6);
    std::fs::write(&mesh, good_mesh.replace(tet, &words.join(" "))).expect("the folder can be written");
    refuse(good.clone(), &["beam.msh:", "element 1", "vertices"]);
}
