//! The controller on jets.

use palpate_core::vec3::{self, Vec3};
use palpate_core::{
    AlignedBytes, Command, Config, Controller, Coverage, Fault, Field, ForceSample, Jet, JetFlags, JetMemory,
    Organ, Phase, Sample, Solver, State, Touch, TouchSurface,
};

use crate::common::ball::{RADIUS_M, uneven};
use crate::common::jets::jet;
use crate::common::{Recipe, potential, sphere};

/// The organ of a live session: spaces without tables.
fn bare(nodes: Vec<Vec3>) -> Recipe {
    Recipe {
        nodes,
        lattice_table: false,
        rbf: false,
        hermite: false,
        displacement: false,
        ..Recipe::default()
    }
}

fn config() -> Config {
    let mut config = Config::live();
    config.limits.ramp_s = 0.0;
    config
}

struct Bench<'o, 'a> {
    controller: Controller<'o, 'a, 2>,
    state: State,
    memory: JetMemory<2, 16>,
    now_us: u64,
}

impl<'o, 'a> Bench<'o, 'a> {
    fn new(organ: &'o Organ<'a, 2>) -> Self {
        let controller = Controller::new(organ, config()).expect("no table is needed");
        assert_eq!((controller.hand_scale(), controller.stiffest_n_m()), (1.0, 0.0));
        let mut bench = Self { controller, state: State::new(), memory: JetMemory::new(), now_us: 1_000_000 };
        for n in 0..4 {
            assert!(bench.memory.insert(&jet(potential, 0, [0.0, 0.0, -4e-3 * n as f32], 4e-3)));
        }
        assert!(bench.state.arm());
        bench
    }

    fn at(&mut self, position_m: Vec3) -> Command {
        self.now_us += 1000;
        let sample = Sample { t_us: self.now_us, position_m, ..Sample::default() };
        self.controller.tick_on(&mut self.state, self.now_us, Some(&sample), &mut self.memory)
    }

    fn press(&mut self) -> Command {
        for step in 0..200 {
            self.at([0.0, 0.0, 1e-3 - 0.2e-3 * (step as f32).min(30.0)]);
        }
        self.at([0.0, 0.0, -5e-3])
    }
}

fn organ_blob() -> AlignedBytes {
    bare(vec![[0.0; 3], [0.05, 0.0, 0.0]]).blob()
}

#[test]
fn a_press_has_the_force_of_the_jets() {
    let blob = organ_blob();
    let organ = Organ::<2>::read(&blob).expect("good");
    let mut bench = Bench::new(&organ);
    let pressed = bench.press();
    let exact_n = potential([0.0, 0.0, -5e-3], [0, 0, 1]) as f32;
    assert!((pressed.reaction_n[2] - exact_n).abs() < 1e-3, "{pressed:?}");
    assert!((pressed.hand_force_n[2] + pressed.reaction_n[2]).abs() < 1e-5);
    assert_eq!((pressed.engaged, pressed.coverage), (Some(0), Some(Coverage::Scattered)));
    // Without tables and without a method the other ways to tick are a fault, not a wrong force.
    let mut state = State::new();
    state.arm();
    let mut last = Command::default();
    for (t_us, z) in [(0, 1e-3), (1_000, -1e-4)] {
        let sample = Sample { t_us, position_m: [0.0, 0.0, z], ..Sample::default() };
        last = bench.controller.tick(&mut state, t_us, Some(&sample));
    }
    assert_eq!(last.phase, Phase::SafeZero(Fault::Internal));
}

#[test]
fn a_lost_solver_ends_in_a_soft_fade_and_a_latched_fault() {
    let blob = organ_blob();
    let organ = Organ::<2>::read(&blob).expect("good");
    let mut bench = Bench::new(&organ);
    let pressed = bench.press();
    bench.memory.solver(Solver::Gone);
    let mut before_n = pressed.hand_force_n;
    let (mut largest_n, mut ticks) = (0.0_f32, 0);
    let latched = loop {
        let command = bench.at([0.0, 0.0, -5e-3]);
        largest_n = largest_n.max(vec3::distance(command.hand_force_n, before_n));
        before_n = command.hand_force_n;
        ticks += 1;
        match command.phase {
            Phase::Active => assert!(ticks < 1_000, "{command:?}"),
            _ => break command,
        }
        if ticks <= 500 {
            assert_eq!(command.hand_force_n, pressed.hand_force_n, "{ticks} ms");
        }
    };
    assert_eq!((latched.phase, latched.hand_force_n), (Phase::SafeZero(Fault::Solver), vec3::ZERO));
    assert!((800..=803).contains(&ticks), "{ticks} ms");
    assert!(largest_n <= 1.05 * vec3::norm(pressed.hand_force_n) / 300.0, "{largest_n} N in one tick");
    // Latched, whatever happens to the solver; arming alone does not help.
    bench.memory.solver(Solver::Alive);
    assert_eq!(bench.at([0.0, 0.0, 1e-3]).phase, Phase::SafeZero(Fault::Solver));
    assert!(!bench.state.arm());
    bench.state.reset();
    assert!(bench.state.arm());
    let again = bench.press();
    assert!((again.reaction_n[2] - pressed.reaction_n[2]).abs() < 1e-3, "{again:?}");
}

#[test]
fn a_lost_solver_is_a_fault_of_a_free_tool_too() {
    let blob = organ_blob();
    let organ = Organ::<2>::read(&blob).expect("good");
    let mut bench = Bench::new(&organ);
    bench.memory.solver(Solver::Gone);
    let ticks = (1..2_000).find(|_| bench.at([0.0, 0.0, 0.01]).phase != Phase::Active);
    assert!(ticks.is_some_and(|ticks| (800..=803).contains(&ticks)), "{ticks:?}");
    assert_eq!(bench.state.phase(), Phase::SafeZero(Fault::Solver));
    // It is still gone: armed again, the fault returns at once, and no touch begins.
    bench.state.reset();
    assert!(bench.state.arm());
    assert_eq!(bench.at([0.0, 0.0, 0.01]).phase, Phase::SafeZero(Fault::Solver));
    // A solver that is late is none.
    bench.state.reset();
    bench.state.arm();
    bench.memory.solver(Solver::Silent);
    for _ in 0..3_000 {
        assert_eq!(bench.at([0.0, 0.0, 0.01]).phase, Phase::Active);
    }
}

/// A device that renders 200 N/m feels a body of 500 N/m with two fifths of its force; a stiffer jet lowers the force
/// further, in time.
#[test]
fn the_stiffness_of_the_jets_limits_the_force() {
    let blob = organ_blob();
    let organ = Organ::<2>::read(&blob).expect("good");
    let stiff = |k: f32, control_m: [f32; 3]| Jet {
        control_m,
        force_n: vec3::scale(control_m, k),
        // |S| = k.
        stiffness_n_m: [0.0, 0.0, 0.0, 0.0, 0.0, k],
        trust_m: 0.025,
        ..Jet::default()
    };
    let mut limited = config();
    limited.limits.max_stiffness_n_m = 200.0;
    let controller = Controller::new(&organ, limited).expect("good");
    let (mut memory, mut state) = (Box::new(JetMemory::<3, 8>::new()), State::new());
    state.arm();
    memory.insert(&stiff(500.0, [0.0; 3]));
    let mut now_us = 0;
    let mut at = |memory: &mut JetMemory<3, 8>, height_m: f32| {
        now_us += 1_000;
        let node = &organ.spaces[0].active;
        let position_m = vec3::add(node.rest_position_m, [0.0, 0.0, height_m]);
        controller.tick_on(
            &mut state,
            now_us,
            Some(&Sample { t_us: now_us, position_m, ..Sample::default() }),
            memory,
        )
    };
    for tick in 0..200 {
        at(&mut memory, 2e-3 - 5e-5 * tick as f32);
    }
    let pressed = at(&mut memory, -8e-3);
    assert!(pressed.engaged.is_some(), "{pressed:?}");
    let share = |command: Command| vec3::norm(command.hand_force_n) / vec3::norm(command.reaction_n);
    assert!((share(pressed) - 0.4).abs() < 1e-3, "{}", share(pressed));
    // What the hand does not reach with the largest force, and the fixed part where it does not touch, do not count.
    let far = Jet { contact: 1, force_n: [0.0, 0.0, -300.0], ..stiff(5_000.0, [0.0; 3]) };
    let fixed = Jet {
        contact: 1,
        flags: JetFlags { fixed: true, ..JetFlags::default() },
        ..stiff(4_000.0, [0.0; 3])
    };
    for jet in [far, fixed] {
        memory.insert(&jet);
        let after = (0..300).map(|_| share(at(&mut memory, -8e-3))).fold(f32::INFINITY, f32::min);
        assert!((after - 0.4).abs() < 1e-3, "{after} {jet:?}");
    }
    memory.insert(&stiff(1_000.0, [0.0, 0.0, -8e-3]));
    let shares: Vec<f32> = (0..300).map(|_| share(at(&mut memory, -8e-3))).collect();
    assert!(shares.windows(2).all(|pair| pair[1] <= pair[0] + 1e-4), "it only falls");
    assert!(shares[0] > 0.35 && (shares[299] - 0.2).abs() < 1e-3, "{} {}", shares[0], shares[299]);
}

/// Disarming ends a touch for the jets too: its point makes room for others.
#[test]
fn a_disarmed_controller_touches_nothing() {
    let blob = organ_blob();
    let organ = Organ::<2>::read(&blob).expect("good");
    let mut bench = Bench::new(&organ);
    bench.press();
    for contact in [5, 6] {
        assert!(bench.memory.insert(&jet(potential, contact, [0.0; 3], 4e-3)));
    }
    assert_eq!([0, 5, 6].map(|contact| bench.memory.jets(contact)), [4, 0, 1], "the touched point is kept");
    bench.state.disarm();
    assert_eq!(bench.at([0.0, 0.0, -5e-3]).phase, Phase::Disarmed);
    assert!(bench.memory.insert(&jet(potential, 7, [0.0; 3], 4e-3)));
    assert!(bench.memory.insert(&jet(potential, 8, [0.0; 3], 4e-3)));
    assert_eq!([0, 7, 8].map(|contact| bench.memory.jets(contact)), [0, 1, 1]);
}

/// A jet of the ball's vertex: isotropic, with the uneven stiffness of its neighbours.
fn of_vertex(contact: u16) -> Jet {
    let k = (400.0 * uneven(contact.into())) as f32;
    Jet { contact, stiffness_n_m: [k, 0.0, 0.0, k, 0.0, k], trust_m: 0.025, ..Jet::default() }
}

/// Jets with or without their energy.
struct Jets {
    memory: Box<JetMemory<168, 8>>,
    has_energy: bool,
}

impl Field for Jets {
    fn force(&mut self, touch: &Touch) -> Option<ForceSample> {
        self.memory.force(touch)
    }

    fn energy_j(&self, space: u16, displacement_m: Vec3) -> Option<f32> {
        self.memory.energy_j(space, displacement_m).filter(|_| self.has_energy)
    }

    fn slips(&self) -> bool {
        self.memory.slips()
    }

    fn released(&mut self, now_us: u64) {
        self.memory.released(now_us);
    }
}

/// Work on the body of a press, a slide at a depth along a part of a circle, and a lift, J, and the ticks in
/// contact. The way back is free, so the path is closed.
fn stroke(controller: &Controller<'_, '_>, jets: &mut Jets, (tilt, from): (f32, u32)) -> (f64, u32) {
    let mut state = State::new();
    state.arm();
    let at = |index: u32, height_m: f32| -> Vec3 {
        let angle = core::f32::consts::TAU * index as f32 / 3_000.0;
        let (sine, cosine) = (libm::sinf(angle), libm::cosf(angle));
        vec3::scale([cosine, sine * libm::cosf(tilt), sine * libm::sinf(tilt)], RADIUS_M + height_m)
    };
    let down = (0..=60).map(|i| at(from, 1e-3 - 1e-4 * i as f32));
    let along = (0..=220).map(|i| at(from + i, -5e-3));
    let up = (0..=100).map(|i| at(from + 220, -5e-3 + 1e-4 * i as f32));
    let (mut work_j, mut engaged, mut before) = (0.0_f64, 0, None);
    for (t, position_m) in (0..).zip(down.chain(along).chain(up)) {
        let sample = Sample { t_us: 1_000 * t, position_m, ..Sample::default() };
        let command = controller.tick_on(&mut state, sample.t_us, Some(&sample), jets);
        assert_eq!(command.phase, Phase::Active, "{command:?}");
        engaged += u32::from(command.engaged.is_some());
        if let Some((from_m, from_n)) = before {
            let mean_n = vec3::scale(vec3::add(from_n, command.reaction_n), 0.5);
            work_j += f64::from(vec3::dot(mean_n, vec3::sub(position_m, from_m)));
        }
        before = Some((position_m, command.reaction_n));
    }
    (work_j, engaged)
}

/// A sphere that is touched anywhere.
fn sphere_blob() -> AlignedBytes {
    let body = sphere(RADIUS_M, 2);
    let recipe = Recipe { normal: vec3::normalize_or_zero, radius_m: 0.02, ..bare(body.0.clone()) };
    Recipe { body: Some(body), ..recipe }.blob()
}

fn without_friction() -> Config {
    let mut config = config();
    config.contact.friction = 0.0;
    config.contact.capture_radius_m = 1.0;
    config
}

/// As for the tables: a slip over points of uneven stiffness uses the energy of the jets.
#[test]
fn no_closed_path_over_jets_gives_energy_to_the_hand() {
    let blob = sphere_blob();
    let organ = <Organ<'_>>::read(&blob).expect("good");
    let mut words = vec![0; TouchSurface::words(&organ)];
    let surface = TouchSurface::new(&organ, &mut words);
    let controller = Controller::new(&organ, without_friction()).expect("sound").on_surface(surface);
    let mut jets = Jets { memory: Box::new(JetMemory::new()), has_energy: true };
    for contact in 0..organ.spaces.len() as u16 {
        assert!(jets.memory.insert(&of_vertex(contact)));
    }
    let mut least_j = [f64::INFINITY; 2];
    for tilt in [0.0, 0.4, 1.1, 2.3] {
        for from in (0..3_000).step_by(150) {
            for (least_j, has_energy) in least_j.iter_mut().zip([true, false]) {
                jets.has_energy = has_energy;
                let (work_j, engaged) = stroke(&controller, &mut jets, (tilt, from));
                *least_j = least_j.min(work_j);
                assert!(engaged > 250, "{engaged} ticks of touch");
            }
        }
    }
    let [with_j, without_j] = least_j;
    println!("least work into the body: {:.4} mJ, without energy {:.4} mJ", 1e3 * with_j, 1e3 * without_j);
    assert!(with_j > -2e-6, "the hand receives {with_j} J");
    assert!(without_j < -1e-4, "the paths are too easy: {without_j}");
}

/// A slide without friction over a body of which one vertex of the touch has no jet: the anchor stays until it has one.
#[test]
fn a_touch_sticks_while_a_vertex_is_unknown() {
    let blob = sphere_blob();
    let organ = <Organ<'_>>::read(&blob).expect("good");
    let mut words = vec![0; TouchSurface::words(&organ)];
    let surface = TouchSurface::new(&organ, &mut words);
    let controller = Controller::new(&organ, without_friction()).expect("sound").on_surface(surface);
    let mut jets = Jets { memory: Box::new(JetMemory::new()), has_energy: true };
    let (mut state, mut t_us) = (State::new(), 0);
    state.arm();
    let mut at = |jets: &mut Jets, angle: f32, height_m: f32| {
        t_us += 1_000;
        let way = [libm::cosf(angle), libm::sinf(angle), 0.1];
        let position_m = vec3::scale(vec3::normalize_or_zero(way), RADIUS_M + height_m);
        let sample = Sample { t_us, position_m, ..Sample::default() };
        controller.tick_on(&mut state, t_us, Some(&sample), jets)
    };
    at(&mut jets, 0.1, 1e-3);
    let begun = at(&mut jets, 0.1, -1e-3).weights;
    let [a, b, missing] = begun.map(|node| node.space);
    assert!(begun.iter().all(|node| node.weight > 0.0), "{begun:?}");
    for contact in (0..organ.spaces.len() as u16).filter(|contact| *contact != missing) {
        assert!(jets.memory.insert(&of_vertex(contact)));
    }
    for step in 1..100 {
        let command = at(&mut jets, 0.1 + 1e-3 * step as f32, -3e-3);
        assert_eq!(command.weights, begun, "step {step}, with {a} and {b} known");
    }
    assert!(jets.memory.insert(&of_vertex(missing)));
    for _ in 0..3 {
        at(&mut jets, 0.2, -3e-3);
    }
    assert_ne!(at(&mut jets, 0.2, -3e-3).weights, begun, "it slides when all are known");
}
