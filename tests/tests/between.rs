//! Held-out positions between contact points, and the error of the discretisation, solved again by themselves.

use std::sync::Arc;

use palpate_core::{AlignedBytes, Method, Organ};
use palpate_precompute::certificate::{Certificate, Discretisation, answers};
use palpate_precompute::fem::Solver;
use palpate_precompute::held_out::{Draw, Places};
use palpate_precompute::mesh::Surface;
use palpate_precompute::num::{distance, norm};
use palpate_precompute::pipeline::{Analysis, Run, certified_blob, solve_discretisation};
use palpate_precompute::scene::{ElementOrder, ResolvedScene, Scene};
use palpate_precompute::space::{Kind, Store};
use palpate_tests::write_beam_scene;

/// The skin of a beam under a pad as large as an element.
fn scene(folder: &std::path::Path) -> std::path::PathBuf {
    let law = "law = \"mooney-rivlin\"\nc10_pa = 1300.0\nc01_pa = 1280.0";
    let path = write_beam_scene(folder, law, "radius_m = 0.01\ncannot_be_felt = true", 4.0);
    let text = std::fs::read_to_string(&path).expect("written");
    let (head, rest) = text.split_once("[[active]]").expect("an active node");
    let (_, tail) = rest.split_once("\n[").expect("a table after it");
    let tool = "[tool]\nshape = \"fingertip\"\nradius_m = 0.02\nstiffness_pa_m = 1e6\n";
    let active = "[[active]]\nname = \"skin\"\ngroup = \"surface\"\n";
    std::fs::write(&path, format!("{head}{active}\n[{tail}\n{tool}")).expect("written");
    path
}

#[test]
fn held_out_positions_lie_between_contact_points_and_are_blended() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, space) = (scene(folder.path()), folder.path().join("a.space"));
    let analysis = Analysis::load(&path).expect("a scene");
    let run = Run::run_to_end();
    analysis.solve_all(&space, run).expect("solved");
    let bytes = certified_blob(&space, &[Method::Energy], Some(2), run).expect("a blob");
    let bytes = AlignedBytes::from(&bytes[..]);
    let organ = Organ::read_boxed(&bytes).expect("read");
    let store = Store::open(&space).expect("a space");
    let places = Places::of(analysis.scene.contacts(), &analysis.scene.mesh).expect("triangles");
    let draw = Draw { uniform: 2, ..Draw::PAPER };
    let problems = analysis.scene.problems(&analysis.body);
    let (mut checked, mut between) = (0, 0);
    for active in (0..analysis.scene.active.len()).step_by(7) {
        let name = &analysis.scene.active[active].name;
        for answer in answers(&store, active, &organ, Method::Energy).expect("answers") {
            assert_eq!(answer.walk.kind, Kind::Uniform);
            let place = places.drawn(&draw, active, name, answer.walk.number).expect("a corner");
            // Its truth is a solution at that place, found here from rest.
            let mut solver = Solver::new(problems.at(places.on_skin(&place).expect("skin")));
            let rest = solver.rest().expect("rest");
            let mut at = None;
            store
                .each_truth(active, |walk, _, truth| {
                    if walk.number == answer.walk.number {
                        at = Some(truth.displacement_m);
                    }
                })
                .expect("intact");
            let solved = solver.advance(&rest.seed, at.expect("stored")).expect("solved");
            let apart = distance(solved.jet().force_n, answer.compared.truth_n);
            assert!(apart < 1e-7 * norm(answer.compared.truth_n).max(0.1), "{name}: {apart}");
            // The compared force is the sum of those of the corners.
            let mut blended = [0.0f64; 3];
            for (corner, weight) in place.corners.into_iter().zip(place.weights) {
                let corner = &analysis.scene.active[corner as usize].name;
                let space = organ.spaces.iter().find(|space| *space.active.name == **corner).expect("packed");
                let force = space.force(Method::Energy, answer.displacement_m).expect("energy").force_n;
                blended = std::array::from_fn(|axis| blended[axis] + weight * f64::from(force[axis]));
            }
            assert!(distance(blended, answer.compared.found_n) < 1e-5 * norm(blended).max(0.1), "{name}");
            between += usize::from(place.weights.iter().all(|weight| *weight < 0.9));
            checked += 1;
        }
    }
    assert!(checked >= 8 && 3 * between > checked, "{checked} {between}");
    discretisation(&analysis, &organ);
    drop(store);
    replacement(&space);
}

/// A result that lacks a position, as an earlier version kept it, gets the next held-out position.
fn replacement(space: &std::path::Path) {
    let kept = |space: &std::path::Path| -> (rusqlite::Connection, serde_json::Value) {
        let database = rusqlite::Connection::open(space).expect("a database");
        let sql = "SELECT value FROM meta WHERE key = 'held_out_discretisation'";
        let text: String = database.query_row(sql, [], |row| row.get(0)).expect("kept");
        (database, serde_json::from_str(&text).expect("JSON"))
    };
    let (database, mut value) = kept(space);
    let whole: Discretisation = serde_json::from_value(value.clone()).expect("a measurement");
    let fields = value.as_object_mut().expect("fields");
    fields.remove("replaced").expect("not in an earlier version");
    fields.insert("unsolved".into(), 1.into());
    fields["positions"].as_array_mut().expect("positions").remove(0);
    let sql = "UPDATE meta SET value = ?1 WHERE key = 'held_out_discretisation'";
    database.execute(sql, [value.to_string()]).expect("kept");
    drop(database);
    let solve = || solve_discretisation(space, 6, Run::run_to_end(), |_, _| {}).expect("solved");
    assert_eq!(solve(), 1, "the replacement and no other");
    let found: Discretisation = serde_json::from_value(kept(space).1).expect("a measurement");
    assert_eq!((found.positions.len(), found.unsolved, found.replaced), (6, 1, 1));
    assert_eq!(found.positions[..5], whole.positions[1..]);
    let [old, new] = [&whole.positions[0], &found.positions[5]];
    assert!(new.number > old.number || new.active != old.active, "{old:?} {new:?}");
    assert!(
        norm(new.finer_n) > 0.0 && found.in_words().contains("1 more not solved"),
        "{}",
        found.in_words()
    );
    assert_eq!(solve(), 0);
}

/// The positions of the certificate's discretisation are solved again with quadratic elements.
fn discretisation(analysis: &Analysis, organ: &Organ<'_>) {
    let certificate: Certificate =
        serde_json::from_slice(organ.certificate.expect("certified")).expect("a certificate");
    let measured = certificate.discretisation.as_ref().expect("measured");
    println!("{}", measured.in_words());
    assert_eq!((&measured.elements[..], &measured.reference[..]), ("P1/P1", "P2/P1"));
    assert_eq!((measured.positions.len(), measured.unsolved), (6, 0));
    let finer = ResolvedScene {
        order: ElementOrder::Quadratic,
        ..Scene::load(&analysis.path).expect("a scene").resolve().expect("sound")
    };
    let body = Arc::new(finer.body().expect("a body"));
    let (problems, skin) = (finer.problems(&body), Surface::of(&finer.mesh));
    let places = Places::of(analysis.scene.contacts(), &analysis.scene.mesh).expect("triangles");
    for of in &measured.positions {
        let active = analysis.scene.active.iter().position(|active| active.name == of.active);
        let place = places.drawn(&Draw::PAPER, active.expect("an active node"), &of.active, of.number);
        let on_skin = places.on_skin(&place.expect("a corner")).expect("skin");
        let at_m = on_skin.interpolate(|node| finer.mesh.nodes_m[node as usize]);
        let mut solver = Solver::new(problems.at(skin.nearest(&finer.mesh, at_m).expect("skin")));
        let rest = solver.rest().expect("rest");
        let solved = solver.advance(&rest.seed, of.displacement_m).expect("solved");
        let apart = distance(solved.jet().force_n, of.finer_n);
        assert!(apart < 1e-7 * norm(of.finer_n), "{}: {apart}", of.active);
        assert!(of.relative() > 0.01, "linear elements of this size are not those of second order");
    }
    // Every space says so.
    let reason = "use order = \"tool\" or 2, or [mesh] refine = \"tool\"";
    for space in &certificate.spaces {
        let health = space.health.as_ref().expect("judged");
        assert!(health.reasons.iter().any(|of| of.what.ends_with(reason)), "{}", space.active);
    }
}
