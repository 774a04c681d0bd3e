//! The same interpolants by two public crates, used as their documentation recommends: built once, one query
//! at a time.

use std::rc::Rc;

use interpn::{MulticubicRegular, MultilinearRegular};
use nalgebra_of_rbf_interp::DVector;
use palpate_core::{Method, Space, Vec3, flags};
use rbf_interp::{Basis, Scatter};

use super::PEER;
use super::timing::Run;

/// rbf-interp computes a pseudo-inverse by singular values: a thousand centres take a minute.
const MAX_CENTRES: usize = 1_000;

/// The data of the peers, in their own types.
pub(super) struct Peers {
    /// Planes x, y, z of the force on the box.
    planes: Option<[Vec<f32>; 3]>,
    side: usize,
    spacing_m: f32,
    low_m: f32,
    /// The interpolants for phi = r and phi = r^3.
    scattered: Vec<(Method, Scatter, usize)>,
}

impl Peers {
    pub(super) fn of(space: &Space<'_>, grid: usize) -> Self {
        let lattice = space.lattice();
        let force_n = space.planes().force_n;
        let mut scattered = Vec::new();
        if let (Some(force_n), true) = (force_n, grid <= MAX_CENTRES) {
            eprintln!("palpate: rbf-interp fits");
            for (method, exponent) in [(Method::RbfLinear, 1), (Method::RbfCubic, 3)] {
                let solved =
                    || (0..lattice.slots()).filter(|&slot| space.planes().flags[slot] & flags::SOLVED != 0);
                let vector = |values: [f64; 3]| DVector::from_column_slice(&values);
                // In units of cells, as in the core: in metres r^3 would be small relative to its tolerance.
                let centres: Vec<_> = solved().map(|slot| vector(lattice.ijk(slot).map(f64::from))).collect();
                let values = solved().map(|slot| vector(force_n[slot].map(f64::from))).collect();
                let bytes = centres.len() * 6 * size_of::<f64>();
                scattered.push((
                    method,
                    Scatter::create(centres, values, Basis::PolyHarmonic(exponent), 0),
                    bytes,
                ));
            }
        }
        let plane = |force_n: &[Vec3], axis: usize| force_n.iter().map(|force| force[axis]).collect();
        Self {
            planes: force_n.map(|force_n| [0, 1, 2].map(|axis| plane(force_n, axis))),
            side: (2 * lattice.reach() + 3) as usize,
            spacing_m: lattice.spacing_m(),
            low_m: -((lattice.reach() + 1) as f32) * lattice.spacing_m(),
            scattered,
        }
    }

    pub(super) fn add_to<'r>(&'r self, runs: &mut Vec<Run<'r>>) {
        if let Some(planes) = &self.planes {
            let (dims, low, step) = ([self.side; 3], [self.low_m; 3], [self.spacing_m; 3]);
            let bytes = 3 * size_of_val(planes[0].as_slice());
            let [x, y, z] = planes.each_ref().map(|plane| {
                MultilinearRegular::<f32, 3>::new(dims, low, step, plane)
                    .expect("a grid has more than one point")
            });
            let linear = Rc::new([x, y, z]);
            let ask =
                move |query: &Vec3| linear.each_ref().map(|one| one.interp_one(*query).unwrap_or(f32::NAN));
            runs.push(Run::new("interpn trilinear".into(), PEER, Method::Trilinear, bytes, ask));
            let [x, y, z] = planes.each_ref().map(|plane| {
                MulticubicRegular::<f32, 3>::new(dims, low, step, plane, false)
                    .expect("at least four points per axis")
            });
            let cubic = Rc::new([x, y, z]);
            let ask =
                move |query: &Vec3| cubic.each_ref().map(|one| one.interp_one(*query).unwrap_or(f32::NAN));
            runs.push(Run::new("interpn tricubic".into(), PEER, Method::Tricubic, bytes, ask));
        }
        for (method, scatter, bytes) in &self.scattered {
            let cells_per_m = 1.0 / self.spacing_m;
            let ask = move |query: &Vec3| -> Vec3 {
                let position = DVector::from_iterator(3, query.iter().map(|x| f64::from(x * cells_per_m)));
                let force = scatter.eval(position);
                [force[0] as f32, force[1] as f32, force[2] as f32]
            };
            runs.push(Run::new(format!("rbf-interp {}", method.name()), PEER, *method, *bytes, ask));
        }
    }
}
