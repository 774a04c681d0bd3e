//! Jets of analytic potentials, and a tool that touches them.

use palpate_core::vec3::Vec3;
use palpate_core::{Field, ForceSample, Jet, JetFlags, JetMemory, NodeWeight, Touch};

/// Orders of the ten third derivatives in a jet.
const THIRD: [[usize; 3]; 10] = [
    [3, 0, 0],
    [2, 1, 0],
    [2, 0, 1],
    [1, 2, 0],
    [1, 1, 1],
    [1, 0, 2],
    [0, 3, 0],
    [0, 2, 1],
    [0, 1, 2],
    [0, 0, 3],
];

/// Orders of the six second derivatives in a jet.
const SECOND: [[usize; 3]; 6] = [[2, 0, 0], [1, 1, 0], [1, 0, 1], [0, 2, 0], [0, 1, 1], [0, 0, 2]];

/// The jet of a potential, which is given by its derivatives.
pub fn jet(of: impl Fn(Vec3, [usize; 3]) -> f64, contact: u16, control_m: Vec3, trust_m: f32) -> Jet {
    let at = |orders| of(control_m, orders) as f32;
    Jet {
        contact,
        sequence: 0,
        flags: JetFlags::default(),
        control_m,
        energy_j: at([0, 0, 0]),
        force_n: [at([1, 0, 0]), at([0, 1, 0]), at([0, 0, 1])],
        stiffness_n_m: SECOND.map(at),
        third_n_m2: THIRD.map(at),
        trust_m,
        coupling: None,
        model: 0,
    }
}

/// A jet whose force is the same everywhere.
pub fn flat(contact: u16, control_m: Vec3, force_n: Vec3) -> Jet {
    Jet { contact, control_m, force_n, trust_m: 0.02, ..Jet::default() }
}

/// A tool that holds contact points with fixed weights, once per millisecond.
pub struct Tool<const CONTACTS: usize, const JETS: usize> {
    pub memory: Box<JetMemory<CONTACTS, JETS>>,
    pub weights: [NodeWeight; 3],
    pub now_us: u64,
}

impl<const CONTACTS: usize, const JETS: usize> Tool<CONTACTS, JETS> {
    pub fn new(held: &[(u16, f32)]) -> Self {
        let mut tool = Self {
            memory: Box::new(JetMemory::new()),
            weights: [NodeWeight::default(); 3],
            now_us: 5_000_000,
        };
        tool.hold(held);
        tool
    }

    pub fn hold(&mut self, held: &[(u16, f32)]) {
        self.weights = [NodeWeight::default(); 3];
        for (node, &(space, weight)) in self.weights.iter_mut().zip(held) {
            *node = NodeWeight { space, weight };
        }
    }

    pub fn learn(&mut self, jets: impl IntoIterator<Item = Jet>) {
        jets.into_iter().for_each(|jet| assert!(self.memory.insert(&jet), "{jet:?}"));
    }

    pub fn at(&mut self, displacement_m: Vec3) -> ForceSample {
        self.after_us(1_000, displacement_m)
    }

    pub fn after_us(&mut self, elapsed_us: u64, displacement_m: Vec3) -> ForceSample {
        self.now_us += elapsed_us;
        let touch = Touch {
            now_us: self.now_us,
            weights: self.weights,
            displacement_m,
            hip_m: displacement_m,
            half_axis_m: None,
        };
        self.memory.force(&touch).expect("jets always have an answer")
    }

    pub fn release(&mut self) {
        self.now_us += 1_000;
        self.memory.released(self.now_us);
    }
}
