//! A complete space is never replayed: its fit is read from the store. The count is that of the process, so
//! the test runs in a process of its own.

use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

use palpate_core::{Method, Organ};
use palpate_host::BlobFile;
use palpate_precompute::certificate::certify;
use palpate_precompute::held_out::{Draw, HeldOut};
use palpate_precompute::pack::{PackOptions, pack};
use palpate_precompute::pipeline::{Analysis, Run, add_ledgers, certified, certified_blob};
use palpate_precompute::space::{Store, replays, state, with_threads};
use palpate_precompute::spec::{Sampling, Scattered, Tolerance};
use palpate_tests::space_bench::SpaceBench;

#[test]
fn a_finished_space_is_solved_packed_and_certified_without_a_replay() {
    let this = std::env::current_exe().expect("a test has a file");
    let alone = ["--ignored", "--exact", "stored_fit::replays_of_this_process", "--nocapture"];
    let output = Command::new(this).args(alone).output().expect("it starts");
    let text = [output.stdout, output.stderr].concat();
    let text = String::from_utf8_lossy(&text);
    assert!(output.status.success() && text.contains("1 passed"), "{text}");
}

#[test]
#[ignore = "other tests of the process would be counted; the test above starts it alone"]
fn replays_of_this_process() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut bench = SpaceBench::new(1.0);
    let tolerance = Tolerance { relative: 0.035, absolute_n: 0.005 };
    bench.identity.sampling =
        Sampling::Scattered(Scattered { radius_m: 0.01, tolerance, only_push: false, workspace_m: None });
    let path = folder.path().join("one.space");

    // Interrupted, and then inspected: the count includes a replay.
    let (store, stop) = (bench.store(&path).expect("the store opens"), AtomicBool::new(false));
    let ended = bench.expand(&store, 2, &stop, |p| stop.store(p.solved_now >= 4, Ordering::Relaxed));
    assert!(ended.is_err() && replays() == 0, "{ended:?}, {} replays", replays());
    assert!(state(&store, 0).expect("readable").open > 0);
    assert_eq!(replays(), 1);

    bench.expand(&store, 2, &AtomicBool::new(false), |_| ()).expect("the run completes");
    // A second run, with nothing left to solve.
    let counts = bench.expand(&store, 2, &AtomicBool::new(false), |_| ()).expect("nothing is to be done");
    assert_eq!(state(&store, 0).expect("readable").counts, counts);
    let held_out = HeldOut {
        actives: vec![(0, "A".into())],
        sampling: bench.identity.sampling,
        draw: Draw { uniform: 10, random: 0, regular_m: None, ..Draw::PAPER },
        places: None,
        keep_displacements: true,
    };
    let solved = with_threads(&bench.context(), 2, |executor| {
        held_out.run(&store, executor, &AtomicBool::new(false), |_| ())
    });
    solved.expect("the held-out truth is solved");
    let options =
        PackOptions { methods: &[Method::Energy, Method::Kernel], use_intermediate_states: true, threads: 2 };
    let file = BlobFile::of(&pack(&store, &options).expect("the space packs").bytes().expect("bytes"));
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("a blob");
    let certificate = certify(&store, &organ).expect("measured");
    assert_eq!(certificate.spaces[0].methods[0].uniform.count, 10);
    assert_eq!(replays(), 1, "a finished space was replayed");

    // The way of `palpate pack`, from a scene.
    let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/scenes/light-touch.toml");
    let space = folder.path().join("two.space");
    let analysis = Analysis::load(scene.as_ref()).expect("a scene");
    analysis.solve_all(&space, Run::run_to_end()).expect("solved");
    certified_blob(&space, &[Method::Energy], Some(10), Run::run_to_end()).expect("certified");
    let store = Store::open(&space).expect("the space");
    let options = PackOptions { methods: &[Method::Energy], use_intermediate_states: true, threads: 2 };
    let (mut packed, mut measured) = certified(&store, &options).expect("certified");
    add_ledgers(&store, (&mut packed, &mut measured), 0, Run::run_to_end(), |_| ()).expect("a ledger");
    assert_eq!(replays(), 1, "`pack` replayed a finished space");
}
