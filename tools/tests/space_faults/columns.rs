//! The names of the columns, which other programs read, say what the columns hold.

use palpate_precompute::space::{Equilibrium, Store};

use super::{palpate, precompute, scene, succeeds};

const S: [(&str, (usize, usize)); 6] = [
    ("sxx_n_m", (0, 0)),
    ("sxy_n_m", (0, 1)),
    ("sxz_n_m", (0, 2)),
    ("syy_n_m", (1, 1)),
    ("syz_n_m", (1, 2)),
    ("szz_n_m", (2, 2)),
];

fn named(row: &rusqlite::Row<'_>, at: &Equilibrium) {
    let number = |name: &str| row.get::<_, f64>(name).expect(name);
    assert_eq!(number("energy_j"), at.energy_j);
    assert_eq!(["fx_n", "fy_n", "fz_n"].map(number), at.force_n);
    for (name, place) in S {
        assert_eq!(number(name), at.stiffness_n_m[place], "{name}");
    }
}

#[test]
fn columns_hold_what_their_names_say() {
    let folder = tempfile::tempdir().expect("a folder");
    let (scene, space) = (scene(folder.path(), super::SMALL), folder.path().join("a.space"));
    succeeds(precompute(&scene, &space, 2));
    let mut held_out = palpate();
    held_out.args(["paper", "held-out"]).arg(&scene).arg("--out").arg(&space);
    held_out.args(["--regular-mm", "0", "--random", "0", "--uniform", "9"]);
    succeeds(held_out);
    let store = Store::open(&space).expect("a space");
    let database = rusqlite::Connection::open(&space).expect("a database");

    let solved = "SELECT * FROM configuration WHERE active = 0 AND (i, j, k, attempt) = (?1, ?2, ?3, ?4)";
    let mut rows = 0;
    for record in store.records(0).expect("records") {
        let Some(at) = record.equilibrium() else { continue };
        let [i, j, k] = record.index;
        let row = database.query_row(solved, (i, j, k, record.attempt), |row| {
            named(row, at);
            let third: Vec<u8> = row.get("third_n_m2")?;
            let first = f64::from_le_bytes(third[..8].try_into().expect("eight bytes"));
            assert_eq!(first, record.result.as_ref().expect("solved").third_n_m2[0]);
            Ok(())
        });
        row.expect("the row");
        rows += 1;
    }
    let truth = "SELECT * FROM held_out WHERE active = 0 AND (x_m, y_m, z_m) = (?1, ?2, ?3)";
    let see = |_: &_, _, found: &palpate_precompute::space::Truth| {
        let (Some(at), [x, y, z]) = (found.equilibrium(), found.displacement_m) else { return };
        let row = database.query_row(truth, (x, y, z), |row| {
            named(row, at);
            Ok(())
        });
        row.expect("the row");
        rows += 1;
    };
    store.each_truth(0, see).expect("held-out positions");
    assert!(rows > 100, "only {rows} rows");
}
