use palpate_core::{DisplacementPlanes, DisplacementTable, flags};

use super::*;

const NODES: usize = 40;

/// A surface that follows the node at (1, 0, 0) with an influence that decreases with the distance; `bend`
/// scales its curvature.
fn moved(d: [f64; 3], bend: f64) -> SurfaceMotionSample {
    let node = |n: usize| [0.4, 1.3, 2.6].map(|turn| (turn * (n + 1) as f64).sin());
    let displacement = |d: [f64; 3]| -> Vec<f64> {
        (0..NODES)
            .flat_map(|n| {
                let [x, y, z] = node(n);
                let share = 1.0 / (1.0 + (x - 1.0).powi(2) + y * y + z * z);
                let wave = bend * (40.0 * (d[0] * x + d[1] * y + d[2] * z) + n as f64).sin()
                    - bend * (n as f64).sin();
                d.map(|d| share * (d + 0.01 * wave))
            })
            .collect()
    };
    let slope = |axis: usize| {
        let [low, high] = [-1e-5, 1e-5].map(|step| {
            let mut at = d;
            at[axis] += step;
            displacement(at)
        });
        low.iter().zip(high).map(|(low, high)| ((high - low) / 2e-5) as f32).collect()
    };
    SurfaceMotionSample {
        displacement_m: displacement(d).into_iter().map(|x| x as f32).collect(),
        slopes: [slope(0), slope(1), slope(2)],
    }
}

/// The view that the core reads.
fn planes(fit: &DisplacementFit) -> DisplacementPlanes<'_> {
    DisplacementPlanes {
        slopes: fit.slopes,
        row: &fit.row,
        modes: &fit.modes,
        scale: &fit.scale,
        coefficients: &fit.coefficients,
        outlier_row: &fit.outlier_row,
        outlier_scale: &fit.outlier_scale,
        outliers: &fit.outliers,
    }
}

struct Case {
    grid: SpaceGrid,
    solved: Vec<GridIndex>,
    bend: f64,
    odd: Option<GridIndex>,
}

impl Case {
    fn new(spacing_m: f64, bend: f64) -> Self {
        let grid = SpaceGrid::new(spacing_m, 0.03).expect("a grid");
        let mut solved: Vec<GridIndex> = Domain::new(&grid, true).points().collect();
        solved.sort_unstable();
        Self { grid, solved, bend, odd: None }
    }

    fn read(&self, index: GridIndex) -> SurfaceMotionSample {
        let mut moved = moved(self.grid.displacement_m(index), self.bend);
        if Some(index) == self.odd {
            for (n, x) in moved.displacement_m.iter_mut().enumerate() {
                *x += 0.004 * (n as f32 * 1.7).sin();
            }
        }
        moved
    }

    fn fit(&self, bound: DisplacementBound) -> DisplacementFit {
        let read = |at: usize| Ok::<_, ()>(self.read(self.solved[at]));
        fit_displacement(&self.grid, &self.solved, &[], bound, read).expect("a fit")
    }

    /// Largest misfits over all configurations, by the core's own sums.
    fn misfit(&self, fit: &DisplacementFit) -> Misfit {
        let table = DisplacementTable::new(&self.grid.lattice, planes(fit), NODES).expect("whole");
        let mut found = vec![[0.0; 3]; NODES];
        let of = |&index: &GridIndex| {
            table.configuration_into(self.grid.lattice.slot(index).expect("in the box"), &mut found);
            let exact = self.read(index).displacement_m;
            let apart: Vec<f32> = exact.iter().zip(found.as_flattened()).map(|(a, b)| a - b).collect();
            Misfit::of(&apart)
        };
        let largest =
            |a: Misfit, b: Misfit| Misfit { rms_m: a.rms_m.max(b.rms_m), max_m: a.max_m.max(b.max_m) };
        self.solved.iter().map(of).fold(Misfit::default(), largest)
    }
}

#[test]
fn the_bound_holds_for_what_the_core_makes_of_the_packed_numbers() {
    let case = Case::new(0.01, 0.3);
    let mut before = usize::MAX;
    for (rms_m, max_m) in [(1e-5, 1e-4), (1e-5, 1e-5), (1e-4, 1e-3), (1e-3, 3e-4), (3e-4, 1.0)] {
        let bound = DisplacementBound { rms_m, max_m };
        let fit = case.fit(bound);
        let misfit = case.misfit(&fit);
        assert!(bound.holds(misfit), "{bound:?} {misfit:?}");
        // The misfit uses a good part of the bound: a looser bound gives fewer modes.
        assert!(misfit.rms_m > 0.1 * rms_m.min(max_m), "{bound:?} {misfit:?}");
        if max_m > 3.0 * rms_m {
            assert!(fit.scale.len() <= before, "{bound:?} {}", fit.scale.len());
            before = fit.scale.len();
        }
    }
    assert!(before >= 3);
}

#[test]
fn a_configuration_unlike_the_others_is_an_outlier_and_exact() {
    let odd = Some([1, -2, 0]);
    let case = Case { odd, ..Case::new(0.01, 0.0) };
    let bound = DisplacementBound::default();
    let fit = case.fit(bound);
    // Three modes represent the other configurations. An outlier costs fewer bytes than a fourth mode.
    assert_eq!((fit.scale.len(), fit.outlier_row.len()), (3, 1));
    assert_eq!(fit.row[case.grid.lattice.slot([1, -2, 0]).expect("in the box")], fit.outlier_row[0]);
    assert!(bound.holds(case.misfit(&fit)));
    assert!(fit.outlier_scale[0] > 1e-8 && fit.outlier_scale[0] < 1e-6, "{:?}", fit.outlier_scale);
}

#[test]
fn slopes_are_packed_where_the_grid_is_too_coarse_without() {
    let bound = DisplacementBound { rms_m: 1e-5, max_m: 1e-4 };
    let straight = Case::new(0.01, 0.0).fit(bound);
    assert_eq!((straight.slopes, straight.scale.len()), (0, 3));
    let (coarse, fine) = (Case::new(0.01, 0.3), Case::new(0.003, 0.3));
    let (fit, fitted_fine) = (coarse.fit(bound), fine.fit(bound));
    assert!(fit.slopes > 0 && fitted_fine.slopes == 0, "{} {}", fit.slopes, fitted_fine.slopes);
    // The slopes reduce the error between the configurations, measured against the function itself.
    let table = DisplacementTable::new(&coarse.grid.lattice, planes(&fit), NODES).expect("whole");
    let flags = vec![flags::SMOOTH; coarse.grid.lattice.slots()];
    let mut worst = [0.0f64; 2];
    for n in 0..300 {
        let d = [1.3, 2.9, 4.7].map(|turn| 0.016 * f64::sin(f64::from(n + 1) * turn));
        let exact = moved(d, 0.3).displacement_m;
        for (worst, table) in worst.iter_mut().zip([table, table.without_slopes()]) {
            let mut found = vec![[0.0; 3]; NODES];
            table.displacement_into(&coarse.grid.lattice, &flags, d.map(|x| x as f32), &mut found);
            let apart: Vec<f32> = exact.iter().zip(found.as_flattened()).map(|(a, b)| a - b).collect();
            *worst = worst.max(Misfit::of(&apart).rms_m);
        }
    }
    assert!(worst[0] < 2.0 * bound.rms_m && worst[1] > 1.5 * worst[0], "{worst:?}");
}

#[test]
fn a_ghost_goes_on_in_a_straight_line() {
    let mut case = Case::new(0.01, 0.0);
    let holes = [[1, 1, 0], [3, 0, 0]];
    case.solved.retain(|index| !holes.contains(index));
    let fit = case.fit(DisplacementBound::default());
    case.solved.extend(holes);
    let misfit = case.misfit(&fit);
    assert!(misfit.rms_m < 1e-5, "{misfit:?}");
}

#[test]
fn the_same_numbers_every_time() {
    let case = Case { odd: Some([0, 2, 1]), ..Case::new(0.01, 0.3) };
    assert_eq!(case.fit(DisplacementBound::default()), case.fit(DisplacementBound::default()));
}

#[test]
fn a_body_that_does_not_move_has_a_table_too() {
    let mut case = Case::new(0.015, 0.0);
    case.solved = vec![[0; 3]];
    let fit = case.fit(DisplacementBound::default());
    assert_eq!(case.misfit(&fit), Misfit::default());
}
