//! The commands of `palpate paper`: comparison of laws, held-out truth, protocol; and several active nodes.

use std::path::Path;

use palpate_tests::{mooney_rivlin, nearest_node, soft_beam, write_beam_scene};

use crate::{GRID, MR, palpate, refused, text};

/// Rows of `palpate compare --csv` by law.
fn compared(csv: &Path) -> std::collections::BTreeMap<String, Vec<String>> {
    let table = std::fs::read_to_string(csv).expect("the table is written");
    let mut lines = table.lines();
    assert_eq!(
        lines.next(),
        Some(
            "law,status,length_m,asked_m,fx_n,fy_n,fz_n,force_n,volume_change,min_jacobian,inverted,newton_iterations"
        )
    );
    lines
        .map(|line| line.split(',').map(String::from).collect::<Vec<_>>())
        .map(|mut row| (row.remove(0), row))
        .collect()
}

#[test]
fn a_comparison_is_a_table_of_the_laws() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write_beam_scene(folder.path(), MR, GRID, 100.0);
    let csv = folder.path().join("laws.csv");
    let arguments = [
        "paper",
        "compare",
        text(&scene),
        "--active",
        "A",
        "--direction=0,0,-1",
        "--length-mm",
        "12",
        "--csv",
        text(&csv),
        "--json",
    ];
    let output = palpate(&arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));

    let rows = compared(&csv);
    assert_eq!(rows.len(), 3);
    let number = |law: &str, column: usize| rows[law][column].parse::<f64>().expect("a number");
    for law in ["linear", "st-venant-kirchhoff", "mooney-rivlin"] {
        assert_eq!(rows[law][0], "ok");
        assert!((number(law, 1) - 0.012).abs() < 1e-12 && number(law, 2) == 0.012);
        assert!(number(law, 5) < 0.0, "{law}: pressing down takes a downward force");
        let norm = (3..6).map(|axis| number(law, axis).powi(2)).sum::<f64>().sqrt();
        assert!((number(law, 6) / norm - 1.0).abs() < 1e-12);
        assert_eq!(rows[law][9], "0", "{law}: nothing is inside out");
    }
    assert!(number("mooney-rivlin", 7).abs() < 1e-9, "{}", number("mooney-rivlin", 7));
    assert!(number("linear", 7) > 1e-3, "a turned body grows by the linear law: {}", number("linear", 7));

    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(json[2]["law"], "mooney-rivlin");
    assert_eq!(json[0]["volume_change"].as_f64(), Some(number("linear", 7)));

    // The same pull by `path` ends with the same force.
    let path = folder.path().join("path.csv");
    let arguments = ["path", text(&scene), "--direction=0,0,-1", "--steps", "12", "--csv", text(&path)];
    assert!(palpate(&arguments).status.success());
    let table = std::fs::read_to_string(&path).expect("the table is written");
    let last: f64 =
        table.lines().last().and_then(|l| l.split(',').nth(6)).expect("fz").parse().expect("a number");
    assert!((last / number("mooney-rivlin", 5) - 1.0).abs() < 1e-9);
}

#[test]
fn a_law_that_fails_is_shown_as_far_as_it_came() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write_beam_scene(folder.path(), MR, GRID, 100.0);
    let csv = folder.path().join("laws.csv");
    // St. Venant-Kirchhoff has no barrier at J = 0: under sufficient compression it collapses.
    let arguments = [
        "paper",
        "compare",
        text(&scene),
        "--direction=-1,0,0",
        "--length-mm",
        "60",
        "--laws",
        "st-venant-kirchhoff,linear",
        "--csv",
        text(&csv),
    ];
    let output = palpate(&arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    let rows = compared(&csv);
    let reached: f64 = rows["st-venant-kirchhoff"][1].parse().expect("a number");
    assert_eq!(rows["st-venant-kirchhoff"][0], "failed");
    assert!(reached > 0.0 && reached < 0.06, "{reached}");
    assert!(
        said.contains("st-venant-kirchhoff") && said.contains("its row is that of the last converged step"),
        "{said}"
    );
    assert_eq!(rows["linear"][0], "ok");
}

#[test]
fn a_comparison_of_nonsense_is_refused_in_one_line_and_leaves_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write_beam_scene(folder.path(), MR, GRID, 100.0);
    let before = std::fs::read_dir(folder.path()).expect("the folder").count();
    let refuse = |more: &[&str], words: &[&str]| {
        let mut arguments = vec!["paper", "compare", text(&scene), "--direction=0,0,1"];
        arguments.extend_from_slice(more);
        if !more.contains(&"--length-mm") {
            arguments.extend_from_slice(&["--length-mm", "5"]);
        }
        refused(&arguments, words);
        assert_eq!(std::fs::read_dir(folder.path()).expect("the folder").count(), before, "{more:?}");
    };
    refuse(&["--laws", "linear,hooke"], &["hooke", "mooney-rivlin"]);
    refuse(&["--laws", "linear,linear"], &["twice"]);
    refuse(&["--laws", "linear"], &["two or more"]);
    refuse(&["--laws", "linear,holzapfel-gasser-ogden"], &["fibres"]);
    refuse(&["--active", "B"], &["no active node `B`", "A"]);
    refuse(&["--length-mm", "0"], &["--length-mm", "positive"]);
    refuse(&["--length-mm", "NaN"], &["--length-mm", "positive"]);
    refuse(&["--csv", "/nowhere/laws.csv"], &["/nowhere/laws.csv"]);
    refuse(&["--csv", text(folder.path())], &["folder"]);
    for (direction, word) in [("0,0,0", "not zero"), ("1,2", "three numbers"), ("inf,0,0", "finite")] {
        refused(
            &["paper", "compare", text(&scene), "--direction", direction, "--length-mm", "5"],
            &["--direction", direction, word],
        );
    }
}

#[test]
fn held_out_truth_is_solved_shown_and_tabled() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write_beam_scene(folder.path(), MR, GRID, 1.0);
    let (space, csv) = (folder.path().join("a.space"), folder.path().join("truth.csv"));
    let ask = |more: &[&str]| {
        let fixed = [
            "paper",
            "held-out",
            text(&scene),
            "--out",
            text(&space),
            "--uniform",
            "7",
            "--random",
            "2",
            "--json",
        ];
        palpate(&[&fixed, more].concat())
    };
    refused(
        &["paper", "held-out", text(&scene), "--out", text(&space)],
        &["a.space", "palpate precompute", "--uniform 0"],
    );
    assert!(palpate(&["precompute", text(&scene), "--out", text(&space)]).status.success());
    let done = ask(&[]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let figures: serde_json::Value = serde_json::from_slice(&done.stdout).expect("JSON");
    let kinds = &figures["actives"][0]["kinds"];
    assert_eq!((kinds["regular"]["walks"].as_u64(), kinds["random"]["walks"].as_u64()), (Some(26), Some(2)));
    assert_eq!(kinds["uniform"]["whole"].as_u64(), Some(7));
    let again: serde_json::Value = serde_json::from_slice(&ask(&[]).stdout).expect("JSON");
    assert_eq!(again["positions_now"].as_u64(), Some(0), "what is there is not solved again");
    for other in [["--seed", "9"], ["--step-mm", "0.9"], ["--regular-mm", "5"]] {
        let other = ask(&other);
        assert_eq!(other.status.code(), Some(2));
        let said = String::from_utf8_lossy(&other.stderr);
        assert!(said.contains("of a different draw") && said.contains("--again"), "{said}");
    }
    assert!(ask(&["--seed", "9", "--again"]).status.success());

    let shown = palpate(&["inspect", text(&space), "--verbose", "--held-out", text(&csv)]);
    assert!(String::from_utf8_lossy(&shown.stdout).contains("held-out solutions"));
    let table = std::fs::read_to_string(&csv).expect("the table is written");
    let header: Vec<&str> = table.lines().next().expect("a header").split(',').collect();
    assert!(table.lines().skip(1).all(|line| line.split(',').count() == header.len()));
    let training = header.iter().position(|name| *name == "training").expect("a column");
    let seen = table.lines().filter(|line| line.split(',').nth(training) == Some("1"));
    let on_axes = seen.filter(|line| line.starts_with("A,regular,")).count();
    assert!(on_axes >= 6, "the axes go through grid points: {on_axes}");
}

#[test]
fn the_protocol_counts_the_paths_of_every_fixed_set() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/liver-small.toml");
    let out = folder.path().join("out");
    let run = [
        "paper",
        "protocol",
        text(&scene),
        "--out",
        text(&out),
        "--active-nodes",
        "2",
        "--length-mm",
        "2",
        "--json",
    ];
    let done = palpate(&run);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let figures: serde_json::Value = serde_json::from_slice(&done.stdout).expect("JSON");
    assert_eq!(figures["total"]["walks"].as_u64(), Some(2 * 2 * 26));
    assert_eq!(figures["total"]["positions"].as_u64(), Some(2 * 2 * 26 * 2));
    let nodes: std::collections::BTreeSet<u64> =
        figures["rows"].as_array().expect("rows").iter().filter_map(|row| row["node"].as_u64()).collect();
    assert_eq!(nodes.len(), 2);
    assert!(out.join("liver-small-F1.space").exists() && out.join("liver-small-F2.space").exists());
    refused(&["paper", "protocol", text(&scene), "--out", text(&out), "--fixed", "F9"], &["F9", "F1", "F2"]);
    let twice = ["paper", "protocol", text(&scene), "--out", text(&out), "--fixed", "F1,F2,F1"];
    refused(&twice, &["--fixed", "F1", "twice"]);
}

/// The scene's force limit would end paths that the paper continues.
#[test]
fn the_protocol_leaves_the_force_limit_out_and_begins_anew_if_asked() {
    let folder = tempfile::tempdir().expect("a folder");
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets");
    let whole = std::fs::read_to_string(assets.join("liver-small.toml")).expect("the scene");
    let limited = whole.replace("max_force_n = 8.0", "max_force_n = 0.001");
    let mesh = format!("file = {:?}", assets.join("liver-small.msh"));
    let scene = folder.path().join("limited.toml");
    std::fs::write(&scene, limited.replace("file = \"liver-small.msh\"", &mesh)).expect("written");
    assert_ne!(limited, whole);
    let out = folder.path().join("out");
    let run = |more: &[&str]| -> serde_json::Value {
        let fixed =
            ["paper", "protocol", text(&scene), "--out", text(&out), "--fixed", "F1", "--active-nodes", "1"];
        let done = palpate(&[&fixed[..], &["--length-mm", "3", "--json"], more].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        serde_json::from_slice(&done.stdout).expect("JSON")
    };
    let figures = run(&[]);
    let total = &figures["total"];
    assert_eq!((total["whole"].as_u64(), total["at_force_limit"].as_u64()), (Some(26), Some(0)));
    assert_eq!(total["positions"].as_u64(), Some(26 * 3));
    assert!(total["largest_n"].as_f64().is_some_and(|n| n > 0.01), "the limit would have been felt: {total}");
    let kept = run(&[])["total"]["seconds"].as_f64();
    assert_eq!(kept, total["seconds"].as_f64(), "what is there is not solved again");
    assert_ne!(run(&["--again"])["total"]["seconds"].as_f64(), kept, "unless it is asked for");
}

/// Columns of a CSV by name, except those named in `but`.
fn rows(csv: &Path, but: &[&str]) -> Vec<std::collections::BTreeMap<String, String>> {
    let table = std::fs::read_to_string(csv).expect("the table is written");
    let header: Vec<&str> = table.lines().next().expect("a header").split(',').collect();
    let named = |line: &str| {
        let cells = header.iter().zip(line.split(',')).filter(|(name, _)| !but.contains(name));
        cells.map(|(name, cell)| (name.to_string(), cell.to_string())).collect()
    };
    table.lines().skip(1).map(named).collect()
}

/// Several active nodes share only a store, the workers and their solvers.
#[test]
fn several_active_nodes_are_solved_as_if_each_were_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write_beam_scene(folder.path(), MR, GRID, 1.0);
    let (mesh, ..) = soft_beam(mooney_rivlin());
    let others = [[0.06, 0.0, 0.0], [0.04, 0.02, 0.04]].map(|at| nearest_node(&mesh, at));
    let mut text_of_scene = std::fs::read_to_string(&scene).expect("there");
    for (name, node) in ["B", "C"].iter().zip(others) {
        text_of_scene.push_str(&format!("[[active]]\nname = \"{name}\"\nnode = {node}\n"));
    }
    std::fs::write(&scene, text_of_scene).expect("written");
    let run = |arguments: &[&str]| {
        let done = palpate(arguments);
        assert!(done.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&done.stderr));
    };
    let dump = |name: &str, runs: &[&[&str]]| {
        let [space, points, truth] =
            ["space", "csv", "truth"].map(|kind| folder.path().join(format!("{name}.{kind}")));
        for more in runs {
            run(&[&["precompute", text(&scene), "--out", text(&space)], *more].concat());
        }
        for more in runs {
            let walks = ["--regular-mm", "2", "--random", "2", "--random-steps", "6", "--uniform", "4"];
            run(&[&["paper", "held-out", text(&scene), "--out", text(&space)], &walks[..], *more].concat());
        }
        run(&["inspect", text(&space), "--all-tries", "--csv", text(&points), "--held-out", text(&truth)]);
        (rows(&points, &["seconds"]), rows(&truth, &["seconds"]))
    };
    let (points, truth) = dump("together", &[&["--threads", "2"]]);
    let alone = [
        ["--threads", "1", "--active", "C"],
        ["--threads", "1", "--active", "A"],
        ["--threads", "1", "--active", "B"],
    ];
    let (alone_points, alone_truth) = dump("alone", &alone.each_ref().map(|more| &more[..]));
    assert!(points == alone_points, "points differ");
    assert!(truth == alone_truth, "held-out truth differs");

    for name in ["A", "B", "C"] {
        let of_node = |table: &[std::collections::BTreeMap<String, String>], key: &str, value: &str| {
            let found = table.iter().find(|row| row["active"] == name && row[key] == value);
            found.unwrap_or_else(|| panic!("{name} has no row with {key} = {value}")).clone()
        };
        // The force at a grid point is that of a path that displaces this node to the point.
        let point =
            points.iter().find(|r| r["active"] == name && r["i"] == "1" && r["j"] == "0" && r["k"] == "0");
        let point = point.expect("the first neighbour along x");
        let csv = folder.path().join(format!("{name}.path"));
        let path = [
            "path",
            text(&scene),
            "--active",
            name,
            "--direction",
            "1,0,0",
            "--step-mm",
            "5",
            "--steps",
            "1",
        ];
        run(&[&path[..], &["--csv", text(&csv)]].concat());
        let fresh = &rows(&csv, &[])[0];
        for force in ["fx_n", "fy_n", "fz_n"] {
            let [a, b] = [fresh, point].map(|row| row[force].parse::<f64>().expect("a number"));
            assert!((a - b).abs() < 1e-9, "{name}: {force} is {b}, alone {a}");
        }
        // Each node has its own random positions.
        let first = of_node(&truth, "kind", "random");
        let same = truth.iter().filter(|row| row["kind"] == "random" && row["x_m"] == first["x_m"]).count();
        assert_eq!(same, 1, "{name} shares its random path");
    }
}
