//! A touch that goes on over more places than the loop has room for.

use std::path::Path;

use palpate_core::JetMemory;
use palpate_precompute::live::{Hand, LiveSolver, Step, Touch};
use palpate_precompute::scene::Scene;

/// As many contacts as the loop of a session has room for.
type Loop = JetMemory<64, 256>;

fn hand(contact: u16, normal: [f64; 3], depth_m: f64) -> Hand {
    let control_m = normal.map(|n| -depth_m * n);
    let contacts = [(contact, 1.0), (0, 0.0), (0, 0.0)];
    Hand { touch: Some(Touch { contacts, control_m }), ..Hand::default() }
}

/// Steps until nothing is left to solve; the jets go to the loop.
fn press(solver: &mut LiveSolver, memory: &mut Loop, contact: u16, depth_m: f64) {
    let normal = solver.skin().contacts[usize::from(contact)].normal;
    while solver.step(&hand(contact, normal, depth_m)) != Step::Idle {
        while let Some(published) = solver.published() {
            assert!(memory.insert(&published.jet(0)), "refused");
        }
    }
    while let Some(published) = solver.published() {
        assert!(memory.insert(&published.jet(0)), "refused");
    }
}

#[test]
fn a_place_that_is_touched_again_after_many_others_has_its_jets_again() {
    // The memory of the loop is as large as the stack of a test.
    let run = std::thread::Builder::new().stack_size(32 << 20).spawn(touch_many_places);
    run.expect("a thread").join().expect("it passes");
}

fn touch_many_places() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/liver-small.toml");
    let scene = Scene::load(&path).and_then(|scene| scene.resolve()).expect("a bundled scene");
    let mut solver = LiveSolver::new(&scene).expect("it can be touched");
    let mut memory: Box<Loop> = Box::default();
    let places = solver.skin().contacts.len() as u16;
    let (first, depth_m) = (7, 4e-3);
    press(&mut solver, &mut memory, first, depth_m);
    let known = memory.jets(first);
    assert!(known > 1, "{known}");
    for others in [80, 200] {
        for other in (first + 1..places).take(others) {
            press(&mut solver, &mut memory, other, 2e-3);
        }
        assert_eq!(memory.jets(first), 0, "the loop has given up the first place");
        press(&mut solver, &mut memory, first, depth_m);
        assert!(memory.jets(first) >= known.min(2), "after {others} others: {}", memory.jets(first));
    }
}
