//! The tables of a space, made from the surrogate by the packer's fits: their error, time and bytes.

use crate::certificate::nanoseconds;
use crate::fit::{
    Centre, HermiteNodes, Kernel, LatticeValues, RbfFit, Sample, fit_rbf, hermite_nodes, lattice_values,
};
use crate::num::norm;
use crate::spec::{SpaceGrid, Tolerance};
use palpate_core::format::ALIGNMENT;
use palpate_core::{
    ActiveNode, BallLattice, HermiteNode, HermitePlanes, Method, RBF_LANES, RbfPlanes, Space, SpacePlanes,
};

/// With more centres than this a dense fit of weights would take too long for a plan.
const MAX_CENTRES: usize = 1100;

/// Every table of one space.
#[derive(Debug)]
pub(super) struct Tables {
    lattice: BallLattice,
    values: LatticeValues,
    hermite: HermiteNodes,
    rbf: Option<RbfFit>,
}

/// A reachable position with the surrogate's force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// Displacement, m.
    pub at: [f64; 3],
    /// h, N.
    pub exact: [f64; 3],
}

/// Error of a method.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Error {
    /// 99th percentile of |error|, N.
    pub p99_n: f64,
    /// Share of the positions with an error within the tolerance.
    pub within: f64,
}

impl Tables {
    /// Tables of these samples; without radial basis functions if they are of a fit or too many.
    pub(super) fn of(grid: &SpaceGrid, samples: &[Sample]) -> Self {
        let hermite = hermite_nodes(grid, samples, &[]);
        let is_of_fit = samples.iter().any(|sample| sample.derivatives.is_some());
        let centres: Vec<Centre> = samples.iter().map(Centre::from).collect();
        let few = !is_of_fit && centres.len() <= MAX_CENTRES;
        let rbf = few.then(|| fit_rbf(Kernel::Cubic, &centres, 1).ok()).flatten();
        Self { lattice: grid.lattice, values: lattice_values(grid, samples, &[]), hermite, rbf }
    }

    /// The view that the loop uses; `None` if a table is not finite.
    fn space(&self) -> Option<Space<'_>> {
        let HermiteNodes { row, nodes } = &self.hermite;
        let rbf = self.rbf.as_ref().map(|fit| {
            let [centres, weights] =
                [&fit.centres, &fit.weights].map(|planes| planes.each_ref().map(|x| &x[..]));
            RbfPlanes { centres, weights }
        });
        let planes = SpacePlanes {
            flags: &self.values.flags,
            force_n: Some(&self.values.force_n),
            rbf_cubic: rbf,
            hermite: (!row.is_empty()).then_some(HermitePlanes { row, nodes }),
            ..SpacePlanes::default()
        };
        Space::new(ActiveNode::default(), self.lattice, planes, 0).ok()
    }

    /// Error relative to the surrogate at `places`; `None` if the method has no table.
    pub(super) fn error(&self, method: Method, places: &[Place], tolerance: &Tolerance) -> Option<Error> {
        let space = self.space()?;
        if !space.has(method) {
            return None;
        }
        let mut errors = Vec::new();
        let mut within = 0;
        for &Place { at, exact } in places {
            let found = space.force(method, at.map(|x| x as f32))?.force_n;
            let error_n = norm(std::array::from_fn(|i| f64::from(found[i]) - exact[i]));
            within += usize::from(error_n <= tolerance.at(exact));
            errors.push(error_n);
        }
        Some(Error { p99_n: percentile_99(&mut errors), within: within as f64 / errors.len().max(1) as f64 })
    }

    /// Median nanoseconds of a query on this machine, slightly inside `places`: rounding moves some positions
    /// at the rim beyond it, where the slower extrapolation answers.
    pub(super) fn nanoseconds(&self, method: Method, places: &[Place]) -> f64 {
        let places: Vec<[f32; 3]> = places.iter().map(|place| place.at.map(|x| 0.99 * x as f32)).collect();
        self.space().map_or(f64::NAN, |space| nanoseconds(&space, method, &places))
    }
}

/// The smallest value that 99 % of the values do not exceed. Sorts them.
pub(super) fn percentile_99(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let place = (0.99 * values.len() as f64).ceil() as usize;
    values.get(place.max(1) - 1).copied().unwrap_or(0.0)
}

/// Content of the displacement planes for display.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub struct VisualModel {
    /// Surface vertices.
    pub vertices: usize,
    /// Modes.
    pub modes: usize,
    /// Modes with slopes.
    pub slopes: usize,
    /// Share of the configurations with a surface of their own.
    pub outliers: f64,
}

/// Bytes of a space's planes (docs/formats.md, section 4): flags, the tables of `methods`, and the
/// displacement planes.
pub(super) fn space_bytes(
    grid: &SpaceGrid,
    solved: usize,
    methods: &[Method],
    eye: Option<&VisualModel>,
) -> usize {
    let slots = grid.lattice.slots();
    let rows = grid.points(true).into_iter().filter(|&p| grid.lattice.slot(p).is_some()).count();
    let has = |any: &[Method]| any.iter().any(|method| methods.contains(method));
    let centres = solved.next_multiple_of(RBF_LANES);
    let mut planes = vec![slots];
    if has(&[Method::Trilinear, Method::Tricubic, Method::Hybrid]) {
        planes.push(size_of::<[f32; 3]>() * slots);
    }
    if has(&[Method::RbfLinear]) {
        planes.extend([size_of::<f32>() * centres; 6]);
    }
    if has(&[Method::RbfCubic]) {
        planes.extend([size_of::<f64>() * centres; 6]);
    }
    let energy = has(&[Method::Hermite, Method::Energy]);
    if energy {
        planes.extend([size_of::<u32>() * slots, size_of::<HermiteNode>() * rows]);
    }
    if let Some(&VisualModel { vertices, modes, slopes, outliers }) = eye {
        let beyond = (outliers * solved as f64).round() as usize;
        if !energy {
            planes.push(size_of::<u32>() * slots);
        }
        let surface = 3 * size_of::<i16>() * vertices;
        let coefficients = size_of::<i16>() * rows * (modes + 3 * slopes);
        planes.extend([surface * modes, 4 * modes, coefficients, 8 * beyond, surface * beyond]);
    }
    planes.iter().map(|bytes| bytes.next_multiple_of(ALIGNMENT)).sum()
}

/// Bytes of a blob outside its spaces: the skin (vertices, triangles), the header, and the certificate of
/// this number of methods, if there is one, in this number of spaces.
pub(super) fn other_bytes([vertices, triangles]: [usize; 2], spaces: usize, methods: Option<usize>) -> usize {
    const HEADER: usize = 512;
    const SPACE_HEADER: usize = 192;
    /// Measured on certificates of the bundled organ: origin, a space, a method of a space.
    const CERTIFICATE: [usize; 3] = [400, 900, 2100];
    let skin = (4 + 12 + 1) * vertices + 12 * triangles + 6 * ALIGNMENT;
    let certificate =
        methods.map_or(0, |methods| CERTIFICATE[0] + spaces * (CERTIFICATE[1] + methods * CERTIFICATE[2]));
    skin + HEADER + SPACE_HEADER * spaces + certificate
}

#[cfg(test)]
mod tests {
    use super::super::surrogate::Surrogate;
    use super::super::surrogate::tests::probed;
    use super::*;
    use crate::spec::Lattice;

    const ALL: [Method; 4] = [Method::Trilinear, Method::Hybrid, Method::RbfCubic, Method::Energy];

    #[test]
    fn finer_is_closer_and_the_energy_is_closest() {
        let truth = Surrogate::of(&probed(2, 8.0)).unwrap();
        let places: Vec<Place> = truth.places(&truth.scattered().fit, 600);
        let p99 = |cells: f64| {
            let grid = SpaceGrid::new(0.05 / cells, 0.05).unwrap();
            let expanded = truth.lattice(&Lattice { grid, complete_cells: true, increments: None });
            let tables = Tables::of(&grid, &expanded.samples);
            ALL.map(|m| tables.error(m, &places, &Tolerance::IMPERCEPTIBLE).map(|e| e.p99_n))
        };
        let (coarse, fine) = (p99(3.0), p99(5.0));
        for (coarse, fine) in coarse.iter().zip(&fine) {
            assert!(fine.unwrap() < coarse.unwrap(), "{coarse:?} {fine:?}");
        }
        assert!(fine[3].unwrap() < 0.2 * fine[0].unwrap(), "{fine:?}");
    }

    #[test]
    fn bytes_grow_with_what_is_packed() {
        let grid = SpaceGrid::new(0.01, 0.05).unwrap();
        let slots = grid.lattice.slots();
        let bare = space_bytes(&grid, 1015, &[], None);
        assert_eq!(bare, slots.next_multiple_of(ALIGNMENT));
        let lattice = space_bytes(&grid, 1015, &[Method::Trilinear, Method::Hybrid], None);
        assert_eq!(
            lattice - bare,
            (12 * slots).next_multiple_of(ALIGNMENT),
            "methods of one table come together"
        );
        let eye = VisualModel { vertices: 300, modes: 30, slopes: 10, outliers: 0.0 };
        let [energy, seen] = [None, Some(&eye)].map(|eye| space_bytes(&grid, 1015, &[Method::Energy], eye));
        assert!(energy > bare + 144 * 1015 && seen > energy + 6 * 300 * 30);
    }

    #[test]
    fn the_99th_percentile() {
        let mut values: Vec<f64> = (1..=200).rev().map(f64::from).collect();
        assert_eq!(percentile_99(&mut values), 198.0);
        assert_eq!(percentile_99(&mut []), 0.0);
    }
}
