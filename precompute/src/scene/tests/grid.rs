//! Grids, tolerances and workspaces in scene files.

use super::*;

#[test]
fn sampling_driven_by_the_error_is_read() {
    let bench = Bench::new();
    let sampled = |keys: &str| match bench.with("spacing_m = 0.01", keys).expect("sound").grid {
        Some(Sampling::Scattered(Scattered { radius_m, tolerance, only_push, .. })) => {
            assert_eq!((radius_m, only_push), (0.05, false));
            tolerance
        }
        other => panic!("{other:?}"),
    };
    assert_eq!(sampled("cannot_be_felt = true"), Tolerance::IMPERCEPTIBLE);
    assert_eq!(sampled("tolerance_n = 0.1"), Tolerance { relative: 0.0, absolute_n: 0.1 });
    let both = sampled("tolerance_relative = 0.05\ntolerance_n = 0.1");
    assert_eq!(both, Tolerance { relative: 0.05, absolute_n: 0.1 });
    let push = SCENE.replacen("spacing_m = 0.01", "cannot_be_felt = true", 1);
    let push = bench.resolve(&push.replacen("[needs]", "[needs]\ncontact = \"push\"", 1)).expect("sound");
    assert!(
        matches!(push.grid, Some(Sampling::Scattered(Scattered { only_push: true, .. }))),
        "{:?}",
        push.grid
    );

    let refuses = |keys: &str, line: usize, what: &str, fix: &str| {
        bench.refuses("spacing_m = 0.01", keys, &format!("block.toml:{line}"), what, fix);
    };
    refuses("spacing_m = 0.01\ntolerance_n = 0.1", 21, "both `spacing_m` and `tolerance_n`", "for a lattice");
    refuses("cannot_be_felt = true\ntolerance_n = 0.1", 21, "excludes other tolerances", "keep it, or");
    refuses("cannot_be_felt = false", 21, "has no effect", "set it to true");
    refuses("tolerance_n = 0.0", 21, "`tolerance_n` = 0", "");
    bench.refuses(
        "[needs]",
        "[needs]\ncontact = \"stroke\"",
        "block.toml:25",
        "unknown word \"stroke\"",
        "use \"any\" or \"push\"",
    );
}

#[test]
fn a_workspace_leaves_nodes_out_and_is_refused_where_it_means_nothing() {
    let bench = Bench::new();
    let felt = SCENE.replacen("spacing_m = 0.01", "cannot_be_felt = true", 1);
    let of = |min: &str, max: &str| format!("workspace_min_m = {min}\nworkspace_max_m = {max}\n[device]");
    let group = felt.replacen("name = \"A1\"\nnode = 63", "name = \"A1\"\ngroup = \"right\"", 1);
    let whole = bench.resolve(&group).expect("sound");
    assert!(!whole.unreachable.any());
    // The right side is x = 0.3 with 16 nodes, eight of them below z = 0.15. A2 is one of these; a node that
    // is named by itself may also belong to the group.
    let half = group.replacen("[device]", &of("[0.0, -0.1, -0.1]", "[0.35, 0.4, 0.15]"), 1);
    let half = bench.resolve(&half).expect("sound");
    assert_eq!(half.unreachable, Unreachable { outside: 8, hidden: 0 });
    assert_eq!(half.active.len() + 8, whole.active.len());
    assert!(half.active.iter().all(|active| half.mesh.nodes_m[active.node as usize][2] < 0.15));
    assert_ne!(half.content_hash(), whole.content_hash());
    assert!(
        matches!(half.grid, Some(Sampling::Scattered(s)) if s.workspace_m == Some([[0.0, -0.1, -0.1], [0.35, 0.4, 0.15]]))
    );

    let refuses = |text: String, what: &str, fix: &str| {
        let error = bench.resolve(&text).expect_err("planted fault").to_string();
        assert!(error.contains(what) && error.contains(fix), "{error}");
    };
    let with = |min, max| felt.replacen("[device]", &of(min, max), 1);
    refuses(with("[0.0, 0.0, 0.0]", "[0.1, 0.1, 0.1]"), "is outside the workspace", "enlarge it");
    refuses(with("[0.0, 0.0, 0.2]", "[0.1, 0.1, 0.1]"), "workspace is empty", "swap the corners");
    refuses(with("[0.0, 0.0, nan]", "[0.1, 0.1, 0.1]"), "not finite", "");
    refuses(
        felt.replacen("[device]", "workspace_min_m = [0.0, 0.0, 0.0]\n[device]", 1),
        "belong together",
        "",
    );
    let everywhere = of("[-1.0, -1.0, -1.0]", "[1.0, 1.0, 1.0]");
    refuses(SCENE.replacen("[device]", &everywhere, 1), "a lattice has no workspace", "cannot_be_felt");
    let heavy =
        felt.replacen("[device]", &everywhere, 1) + "[body_force]\nforce_n_per_m3 = [0.0, 0.0, -9.81]\n";
    refuses(heavy, "undeformed mesh", "remove one");
    let nowhere = group.replacen("[device]", &of("[0.0, 0.0, 1.0]", "[1.0, 1.0, 2.0]"), 1);
    refuses(nowhere, "the tool cannot reach any node", "enlarge the workspace");
}

#[test]
fn grids_in_every_way() {
    let bench = Bench::new();
    for (points, cells) in GRID_POINTS {
        let grid = bench.with("spacing_m = 0.01", &format!("points = {points}")).expect("sound").grid;
        assert_eq!(
            grid,
            Some(Sampling::Lattice(Lattice {
                grid: SpaceGrid::new(0.05 / f64::from(cells), 0.05).expect("a lattice"),
                complete_cells: true,
                increments: None
            }))
        );
    }
    let refuses = |from, to, place, what, fix| bench.refuses(from, to, place, what, fix);
    refuses(
        "spacing_m = 0.01",
        "points = 515",
        "block.toml:21",
        "`points` = 515",
        "514, 1418, 4168 or 14146",
    );
    refuses("spacing_m = 0.01", "", "block.toml:19", "has no resolution", "`spacing_m` or `points`");
    refuses("spacing_m = 0.01", "spacing_m = 0.01\npoints = 514", "block.toml:22", "both", "keep one");
    refuses("spacing_m = 0.01", "spacing_m = 0.06", "block.toml:21", "larger than `radius_m`", "a fifth");
    refuses(
        "spacing_m = 0.01",
        "spacing_m = 0.0",
        "block.toml:21",
        "`spacing_m` = 0 is not a positive",
        "correct",
    );
    refuses("spacing_m = 0.01", "spacing_m = 0.0001", "block.toml:21", "more than 126 cells", "coarser");
    refuses(
        "radius_m = 0.05",
        "radius_m = -1",
        "block.toml:20",
        "`radius_m` = -1 is not a positive",
        "correct",
    );
    refuses(
        "radius_m = 0.05",
        "radius_m = inf",
        "block.toml:20",
        "`radius_m` = inf is not a positive",
        "correct",
    );
    refuses(
        "max_force_n = 8",
        "max_force_n = nan",
        "block.toml:23",
        "`max_force_n` = NaN",
        "correct the value",
    );
    refuses("max_force_n = 8", "", "block.toml:22", "`max_force_n` is missing", "add `max_force_n`");
}
