//! Configuration spaces: the same bits for any number of threads, and a blob that reproduces the solved forces.
//! `tools/tests/space_faults` interrupts, kills and damages them.

use palpate_core::{AlignedBytes, BallLattice, ConfigTag, Coverage, Method, Organ};
use palpate_host::BlobFile;
use palpate_precompute::fem::Solver;
use palpate_precompute::num::{EnergyJet, norm};
use palpate_precompute::pack::{PackOptions, pack};
use palpate_precompute::space::{Record, Store};
use palpate_precompute::spec::DisplacementBound;
use palpate_tests::space_bench::SpaceBench;

/// Largest |h| of the solved records, N.
fn largest_n(records: &[Record]) -> f64 {
    records.iter().filter_map(Record::equilibrium).map(|at| norm(at.force_n)).fold(0.0, f64::max)
}

/// All data of the records except the seconds, bit for bit.
fn bits(records: &[Record]) -> Vec<String> {
    // `Debug` prints the shortest decimal number that has the same bits.
    records.iter().map(|r| format!("{:?}", Record { seconds: 0.0, ..r.clone() })).collect()
}

#[test]
fn the_papers_four_grids_have_its_numbers_of_points() {
    for (cells, points) in [(5, 514), (7, 1418), (10, 4168), (15, 14146)] {
        let lattice = BallLattice::new(0.1 / cells as f32, 0.1).expect("the grid is valid");
        assert_eq!(lattice.points().count(), points, "r_G / {cells}");
    }
}

#[test]
fn one_thread_and_two_threads_give_the_same_bits() {
    let bench = SpaceBench::new(1.0);
    let folder = tempfile::tempdir().expect("a folder for the stores");
    let (one, counts) = bench.solve(&folder.path().join("one.space"), 1);
    let (two, again) = bench.solve(&folder.path().join("two.space"), 2);
    assert_eq!(counts, again);
    let expected = bits(&one.attempts(0).expect("records"));
    assert!(counts.solved() > 20, "{counts:?}");
    assert_eq!(expected, bits(&two.attempts(0).expect("records")));
    // A store without configurations is not complete either.
    let empty = bench.store(&folder.path().join("empty.space")).expect("a store");
    assert!(bench.still_to_solve(&empty) > 0);
}

#[test]
fn points_beyond_the_force_limit_end_the_expansion() {
    let folder = tempfile::tempdir().expect("a folder for the stores");
    let (free, all) = SpaceBench::new(f64::INFINITY).solve(&folder.path().join("free.space"), 2);
    // The ball of two cells has 32 points. With the corners that complete its cells it is the cube of 5^3
    // points.
    assert_eq!((all.expandable, all.terminating, all.failed, all.unknown), (124, 0, 0, 0));
    let largest = largest_n(&free.records(0).expect("records"));
    let bench = SpaceBench::new(0.5 * largest);
    let (limited, counts) = bench.solve(&folder.path().join("limited.space"), 2);
    assert!(counts.terminating > 0 && counts.expandable > 0, "{counts:?}");
    // Points whose neighbours all terminate are not pending.
    assert_eq!(bench.still_to_solve(&limited), 0);
    for record in limited.records(0).expect("records") {
        let beyond = norm(record.equilibrium().expect("solved").force_n) >= 0.5 * largest;
        assert_eq!(record.tag() == ConfigTag::Terminating, beyond, "{:?}", record.index);
        if let Some((parent, _)) = record.parent {
            let parent = limited.records(0).expect("records").into_iter().find(|r| r.index == parent);
            assert_eq!(parent.expect("a parent is stored").tag(), ConfigTag::Expandable);
        }
    }
}

#[test]
fn every_method_reproduces_the_solved_forces() {
    let bench = SpaceBench::new(f64::INFINITY);
    let folder = tempfile::tempdir().expect("a folder for the stores");
    let (store, _) = bench.solve(&folder.path().join("a.space"), 2);
    let options = PackOptions { methods: &Method::OF_LATTICE, use_intermediate_states: false, threads: 2 };
    let bytes = pack(&store, &options).and_then(|packed| packed.bytes()).expect("the space packs");
    let blob = AlignedBytes::from(&bytes);
    let organ: Organ<'_> = Organ::read(&blob).expect("the blob is valid");
    let space = &organ.spaces[0];
    let records = store.records(0).expect("records");
    let largest = largest_n(&records);
    assert_eq!(records.len(), bench.grid.points(true).len(), "every point is solved");
    // Corners outside the ball serve interpolation only and are not queried.
    for record in records.iter().filter(|r| bench.grid.lattice.contains(r.index)) {
        let at = bench.grid.displacement_m(record.index).map(|x| x as f32);
        for method in Method::OF_LATTICE {
            let found = space.force(method, at).expect("every method was packed");
            for (exact, force) in record.equilibrium().expect("solved").force_n.iter().zip(found.force_n) {
                let error = (exact - f64::from(force)).abs();
                assert!(error < 2e-5 * largest, "{} at {:?}: error {error} N", method.name(), record.index);
            }
        }
    }
    // Between the points: compared with a new solve.
    let mut solver = Solver::new(bench.problem.clone());
    let rest = solver.rest().expect("the beam is fixed");
    let d = [0.0021, -0.0017, 0.0034];
    let truth = solver.advance(&rest.seed, d).expect("a step of 4 mm converges");
    for method in Method::OF_LATTICE {
        let found = space.force(method, d.map(|x| x as f32)).expect("every method was packed");
        let squared: f64 =
            truth.jet().force_n.iter().zip(found.force_n).map(|(a, b)| (a - f64::from(b)).powi(2)).sum();
        let size: f64 = truth.jet().force_n.iter().map(|f| f * f).sum();
        // Cells of 5 mm on a stiffening body; the kernel r has a kink at each of its 33 centres.
        let bound = if method == Method::RbfLinear { 0.10 } else { 0.05 };
        let relative = (squared / size).sqrt();
        assert!(relative < bound, "{}: error {:.1} %", method.name(), 100.0 * relative);
        // With the completing corners, two cells along the radius contain the super-cell of the innermost
        // cells.
        assert!(found.coverage != Coverage::Extrapolated, "{}", method.name());
        if method == Method::Trilinear {
            assert!(relative > 1e-4, "a coarse table cannot be exact; the truth may be its own input");
        }
    }
    // Displacements for the viewer: the active node moves with the tool, within the packing error.
    let mut moved = vec![[0.0f32; 3]; organ.surface.node.len()];
    assert!(space.displacement_into(d.map(|x| x as f32), &mut moved));
    let vertex = organ
        .surface
        .node
        .iter()
        .position(|&n| n == bench.active)
        .expect("the active node is on the surface");
    for (u, d) in moved[vertex].iter().zip(d) {
        let bound_m = DisplacementBound::default().max_m;
        assert!((f64::from(*u) - d).abs() < 0.1 * bound_m, "{u} m, the tool is at {d} m");
    }
}

#[test]
fn only_one_process_writes_a_store_and_others_may_read_it() {
    let bench = SpaceBench::new(f64::INFINITY);
    let folder = tempfile::tempdir().expect("a folder for the stores");
    let path = folder.path().join("a.space");
    let (writer, _) = bench.solve(&path, 2);
    // The lock also excludes a second writer in the same process.
    let refused = bench.store(&path).expect_err("one writer");
    assert!(refused.to_string().contains("another process is writing it"), "{refused}");
    let reader = Store::open(&path).expect("readers are allowed");
    assert_eq!(bits(&reader.attempts(0).expect("read")), bits(&writer.attempts(0).expect("read")));
    drop(writer);
    bench.store(&path).expect("the lock is released");
}

#[test]
fn intermediate_states_are_kept_on_request() {
    let mut bench = SpaceBench::new(f64::INFINITY);
    bench.in_parts(3);
    let folder = tempfile::tempdir().expect("a folder for the stores");
    let (store, counts) = bench.solve(&folder.path().join("a.space"), 2);
    let states = store.intermediate(0).expect("intact");
    assert_eq!((counts.solved(), states.len()), (32, 2 * 32));
    // Each is at a third or two thirds of the way between two grid points, and in equilibrium.
    let mut solver = Solver::new(bench.problem.clone());
    let rest = solver.rest().expect("the beam is fixed");
    for (_, _, state) in states.iter().step_by(9) {
        let cells = state.control_m.map(|x| 3.0 * x / bench.grid.spacing_m);
        assert!(cells.iter().all(|x| (x - x.round()).abs() < 1e-9), "{cells:?}");
        let fresh = solver.advance(&rest.seed, state.control_m).expect("converges");
        let error = (0..3).map(|i| (fresh.jet().force_n[i] - state.force_n[i]).abs()).fold(0.0, f64::max);
        assert!(error < 1e-9, "{error} N at {:?}", state.control_m);
        assert!((fresh.jet().energy_j - state.energy_j).abs() < 1e-10);
    }
    // Radial basis functions interpolate them if they are centres, and otherwise have an error there.
    let worst = |intermediate: bool| -> f64 {
        let options =
            PackOptions { methods: &[Method::RbfCubic], use_intermediate_states: intermediate, threads: 2 };
        let bytes = pack(&store, &options).and_then(|packed| packed.bytes()).expect("the space packs");
        let file = BlobFile::of(&bytes);
        let organ: Organ<'_> = Organ::read(file.bytes()).expect("a valid blob");
        let error = |state: &EnergyJet| {
            let at = state.control_m.map(|x| x as f32);
            let found = organ.spaces[0].force(Method::RbfCubic, at).expect("packed").force_n;
            (0..3).map(|i| (f64::from(found[i]) - state.force_n[i]).abs()).fold(0.0, f64::max)
        };
        states.iter().map(|(_, _, state)| error(state)).fold(0.0, f64::max)
    };
    let (with, without) = (worst(true), worst(false));
    assert!(with < 1e-5 && without > 1e-3, "{with} N with them as centres, {without} N without");
}

/// Terminating configurations are solved like any other, so their intermediate states are valid centres.
#[test]
fn intermediate_states_of_terminating_points_are_kept() {
    let folder = tempfile::tempdir().expect("a folder for the stores");
    let bench = |max_force_n| {
        let mut bench = SpaceBench::new(max_force_n);
        bench.in_parts(3);
        bench
    };
    let (free, _) = bench(f64::INFINITY).solve(&folder.path().join("free.space"), 2);
    let limit_n = 0.5 * largest_n(&free.records(0).expect("records"));
    let (limited, counts) = bench(limit_n).solve(&folder.path().join("limited.space"), 2);
    assert!(counts.terminating >= 5 && counts.expandable > 5, "{counts:?}");
    let solved = limited.attempts(0).expect("records").iter().filter(|r| r.tag().is_solved()).count();
    // All but the rest point have a parent.
    assert_eq!(limited.intermediate(0).expect("intact").len(), 2 * (solved - 1));
}
