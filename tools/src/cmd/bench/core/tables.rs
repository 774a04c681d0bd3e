//! Tables of a synthetic smooth energy, made by the fits for real tables.

use palpate_core::{ActiveNode, HermitePlanes, RBF_LANES, RbfPlanes, Space, SpacePlanes};
use palpate_precompute::fit::{
    Centre, HermiteNodes, Kernel, LatticeValues, RbfFit, Sample, fit_rbf, hermite_nodes, lattice_values,
};
use palpate_precompute::num::{EnergyJet, SECOND_INDICES, THIRD_INDICES};
use palpate_precompute::spec::{GridIndex, SpaceGrid};

use crate::failure::Failure;

/// r_G, m.
const RADIUS_M: f64 = 0.05;
/// With more centres than this a dense fit takes minutes and gigabytes.
const MAX_FITTED: usize = 5_000;

/// The data that a space refers to.
pub(super) struct Tables {
    grid: SpaceGrid,
    values: LatticeValues,
    linear: [Vec<Vec<f32>>; 2],
    cubic: [Vec<Vec<f64>>; 2],
    hermite: HermiteNodes,
    /// Whether the RBF weights interpolate the field, so that they cancel as real weights do.
    pub(super) fitted: bool,
}

impl Tables {
    /// Tables of one of the paper's grids.
    pub(super) fn made_up(points: usize) -> Result<Self, Failure> {
        let cells = match points {
            514 => 5.0,
            1418 => 7.0,
            4168 => 10.0,
            14146 => 15.0,
            _ => {
                return Err(Failure::input(format!(
                    "no grid has {points} points; choose from 514, 1418, 4168 and 14146"
                )));
            }
        };
        let grid = SpaceGrid::new(RADIUS_M / cells, RADIUS_M).map_err(Failure::work)?;
        let mut samples: Vec<Sample> =
            grid.lattice.points().chain([[0; 3]]).map(|index| sample(&grid, index)).collect();
        samples.sort_unstable_by_key(|sample| sample.index);
        let centres: Vec<Centre> = samples.iter().map(Centre::from).collect();
        let fitted = samples.len() <= MAX_FITTED;
        let fit = |kernel| {
            if fitted { fit_rbf(kernel, &centres, 1).map_err(Failure::work) } else { Ok(unfitted(&samples)) }
        };
        let (linear, cubic) = (fit(Kernel::Linear)?, fit(Kernel::Cubic)?);
        Ok(Self {
            values: lattice_values(&grid, &samples, &[]),
            linear: [linear.centres, linear.weights].map(|planes| padded(&planes, |x| x as f32)),
            cubic: [cubic.centres, cubic.weights].map(|planes| padded(&planes, |x| x)),
            hermite: hermite_nodes(&grid, &samples, &[]),
            grid,
            fitted,
        })
    }

    /// The view of the tables that the loop uses.
    pub(super) fn space(&self) -> Space<'_> {
        let planes = SpacePlanes {
            flags: &self.values.flags,
            force_n: Some(&self.values.force_n),
            rbf_linear: Some(RbfPlanes { centres: three(&self.linear[0]), weights: three(&self.linear[1]) }),
            rbf_cubic: Some(RbfPlanes { centres: three(&self.cubic[0]), weights: three(&self.cubic[1]) }),
            hermite: Some(HermitePlanes { row: &self.hermite.row, nodes: &self.hermite.nodes }),
            ..SpacePlanes::default()
        };
        Space::new(ActiveNode::default(), self.grid.lattice, planes, 0)
            .expect("a smooth field has finite tables")
    }
}

/// W = a |d|^2 / 2 + sum of c_n (1 - cos k_n . d): some newtons at the rim, zero force at rest, all
/// derivatives known.
const STIFFNESS_N_M: f64 = 150.0;
const WAVES: [([f64; 3], f64); 3] =
    [([40.0, 10.0, -15.0], 0.03), ([-5.0, 35.0, 20.0], 0.04), ([15.0, -20.0, 45.0], 0.025)];

fn derivative(d: [f64; 3], axes: &[usize]) -> f64 {
    let wave = |(k, c): &([f64; 3], f64)| {
        let phase: f64 = k.iter().zip(d).map(|(k, d)| k * d).sum();
        let minus_cosine = match axes.len() % 4 {
            0 => -phase.cos(),
            1 => phase.sin(),
            2 => phase.cos(),
            _ => -phase.sin(),
        };
        let constant = if axes.is_empty() { 1.0 } else { 0.0 };
        c * (constant + axes.iter().map(|&axis| k[axis]).product::<f64>() * minus_cosine)
    };
    let spring = match axes {
        [] => 0.5 * STIFFNESS_N_M * d.iter().map(|d| d * d).sum::<f64>(),
        [i] => STIFFNESS_N_M * d[*i],
        [i, j] if i == j => STIFFNESS_N_M,
        _ => 0.0,
    };
    spring + WAVES.iter().map(wave).sum::<f64>()
}

fn sample(grid: &SpaceGrid, index: GridIndex) -> Sample {
    let d = grid.displacement_m(index);
    let axes = [&[][..], &[0], &[1], &[2]].into_iter();
    let axes = axes.chain(SECOND_INDICES.iter().map(|pair| &pair[..]));
    let axes = axes.chain(THIRD_INDICES.iter().map(|triple| &triple[..]));
    let mut numbers = [0.0; 20];
    for (number, axes) in numbers.iter_mut().zip(axes) {
        *number = derivative(d, axes);
    }
    let jet = EnergyJet::from_numbers(d, &numbers);
    Sample { index, attempt: 0, jet, derivatives: None, terminating: false, inverted: false }
}

/// The real centres with arbitrary weights.
fn unfitted(samples: &[Sample]) -> RbfFit {
    let plane = |of: &dyn Fn(&Sample) -> f64| samples.iter().map(of).collect::<Vec<f64>>();
    RbfFit {
        centres: [0, 1, 2].map(|axis| plane(&|sample| f64::from(sample.index[axis]))),
        weights: [0, 1, 2].map(|axis| plane(&|sample| 1e-3 * sample.jet.force_n[axis])),
        misfit_n: f64::NAN,
    }
}

fn padded<T: Copy + Default>(planes: &[Vec<f64>; 3], convert: impl Fn(f64) -> T) -> Vec<Vec<T>> {
    let pad = |plane: &Vec<f64>| {
        let mut padded: Vec<T> = plane.iter().map(|&x| convert(x)).collect();
        padded.resize(plane.len().next_multiple_of(RBF_LANES), T::default());
        padded
    };
    planes.iter().map(pad).collect()
}

fn three<T>(planes: &[Vec<T>]) -> [&[T]; 3] {
    [&planes[0], &planes[1], &planes[2]]
}
