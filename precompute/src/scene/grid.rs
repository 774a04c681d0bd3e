//! The `[grid]` of a scene: lattice, or tolerance of adaptive sampling.

use toml::Spanned;

use super::GRID_POINTS;
use super::file::{ActiveTable, GridTable};
use super::lookup::Lookup;
use super::place::{Located, positive};
use crate::error::InputError;
use crate::num::vector::norm;
use crate::spec::{
    Lattice, MAX_RADIUS_M, MIN_RADIUS_M, Sampling, Scattered, SpaceGrid, Tolerance, Workspace,
};

/// Maximum number of cells along the radius: the limit of the core's tables, 8 million points.
const MAX_CELLS: f64 = palpate_core::MAX_CELLS as f64;

impl Lookup<'_> {
    pub(super) fn grid(
        &mut self,
        grid: &Spanned<GridTable>,
        only_push: bool,
        max_force_n: f64,
        workspace_m: Option<Workspace>,
    ) -> Result<Sampling, InputError> {
        let table = grid.get_ref();
        let radius_m = positive(self.place, "radius_m", &table.radius_m)?;
        let (smallest, largest) = (MIN_RADIUS_M, MAX_RADIUS_M);
        if !(smallest..=largest).contains(&radius_m) {
            let what = format!("`radius_m` = {radius_m} is not from {smallest} to {largest}");
            return Err(self.place.error(
                table.radius_m.span(),
                what,
                "give in metres how far the tool moves the node",
            ));
        }
        let size = self.mesh.diagonal_m();
        if radius_m > size {
            self.warnings
                .push(format!("the grid's radius {radius_m} m is larger than the body, {size:.3} m across"));
        }
        if let Some(tolerance) = self.tolerance(table)? {
            self.check_force_limit(grid, max_force_n, tolerance)?;
            return Ok(Sampling::Scattered(Scattered { radius_m, tolerance, only_push, workspace_m }));
        }
        if let Some(corner) = &table.workspace_min_m {
            let what = "a lattice has no workspace";
            let fix = "give `cannot_be_felt` or a tolerance instead of the spacing, or a smaller `radius_m`";
            return Err(self.place.error(corner.span(), what, fix));
        }
        if only_push {
            let what = "contact = \"push\" does not restrict a lattice, only adaptive sampling";
            self.warnings.push(what.into());
        }
        let spacing_m = self.spacing_m(grid, radius_m)?;
        let increments = self.increments(table)?;
        let complete_cells = table.complete_cells.unwrap_or(true);
        let space_grid = SpaceGrid::new(spacing_m, radius_m).map_err(|error| {
            self.place.error(
                grid.span(),
                format!("[grid] is not a valid lattice: {error}"),
                "correct its numbers (metres)",
            )
        })?;
        Ok(Sampling::Lattice(Lattice { grid: space_grid, complete_cells, increments }))
    }

    /// Displacements to solve first are for adaptive sampling, and lie within its radius.
    pub(super) fn check_visited(
        &self,
        active: Vec<Located<'_, ActiveTable>>,
        grid: Option<&Sampling>,
    ) -> Result<(), InputError> {
        for table in active {
            let Some(visited) = &table.table.visited_m else { continue };
            let error = |what: String, fix: &str| Err(self.place.error(visited.span(), what, fix));
            let Some(Sampling::Scattered(scattered)) = grid else {
                let what = "`visited_m` is for adaptive sampling";
                return error(
                    what.into(),
                    "give [grid] `cannot_be_felt = true` or a tolerance, or remove it",
                );
            };
            let far = visited.get_ref().iter().find(|at_m| norm(at_m.0) > scattered.radius_m);
            if let Some(far) = far {
                let what = format!("`visited_m` {:?} lies beyond `radius_m` = {}", far.0, scattered.radius_m);
                return error(what, "give a larger `radius_m`, or remove it");
            }
        }
        Ok(())
    }

    /// Adaptive sampling needs a force limit above its tolerance.
    fn check_force_limit(
        &self,
        grid: &Spanned<GridTable>,
        max_force_n: f64,
        tolerance: Tolerance,
    ) -> Result<(), InputError> {
        if !max_force_n.is_finite() {
            let what = "adaptive sampling needs the force limit of the device";
            return Err(self.place.error(grid.span(), what, "add [device] with `max_force_n` or `profile`"));
        }
        if max_force_n <= tolerance.absolute_n {
            let what = format!(
                "the largest force {max_force_n} N is within the tolerance {} N: no force would be perceptible",
                tolerance.absolute_n
            );
            let span = grid.get_ref().adaptive_key().map_or(grid.span(), |(span, _)| span);
            return Err(self.place.error(
                span,
                what,
                "give [device] a larger `max_force_n` in newtons, or a smaller `tolerance_n`",
            ));
        }
        Ok(())
    }

    /// Spacing of a lattice, from `spacing_m` or from the number of points.
    fn spacing_m(&self, grid: &Spanned<GridTable>, radius_m: f64) -> Result<f64, InputError> {
        let table = grid.get_ref();
        match (&table.spacing_m, &table.points) {
            (Some(spacing), None) => {
                let spacing_m = positive(self.place, "spacing_m", spacing)?;
                if spacing_m > radius_m {
                    let what = format!(
                        "`spacing_m` = {spacing_m} is larger than `radius_m` = {radius_m}: no grid point"
                    );
                    return Err(self.place.error(spacing.span(), what, "give about a fifth of the radius"));
                }
                if radius_m / spacing_m > MAX_CELLS {
                    let what = format!(
                        "`spacing_m` = {spacing_m} gives more than {MAX_CELLS} cells along the radius"
                    );
                    return Err(self.place.error(spacing.span(), what, "give a coarser spacing, in metres"));
                }
                Ok(spacing_m)
            }
            (None, Some(points)) => {
                let known = GRID_POINTS.iter().find(|(n, _)| i64::from(*n) == *points.get_ref());
                let Some((_, cells)) = known else {
                    let what = format!("`points` = {} is not a grid of the paper", points.get_ref());
                    return Err(self.place.error(
                        points.span(),
                        what,
                        "use 514, 1418, 4168 or 14146, or `spacing_m`",
                    ));
                };
                Ok(radius_m / f64::from(*cells))
            }
            (Some(_), Some(points)) => {
                let what = "[grid] has both `spacing_m` and `points`";
                Err(self.place.error(points.span(), what, "keep one of the two"))
            }
            (None, None) => {
                let what = "[grid] has no resolution";
                Err(self.place.error(grid.span(), what, "give `spacing_m` or `points`"))
            }
        }
    }

    /// Load increments whose states are stored.
    fn increments(&self, table: &GridTable) -> Result<Option<u32>, InputError> {
        match &table.increments {
            None => Ok(None),
            Some(n) if (2..=100).contains(n.get_ref()) => Ok(Some(*n.get_ref() as u32)),
            Some(n) => {
                let what = format!("`increments` = {} is not from 2 to 100", n.get_ref());
                Err(self.place.error(n.span(), what, "the paper uses 5; omit the key to store no states"))
            }
        }
    }

    /// The tolerance of adaptive sampling; `None` for a lattice.
    fn tolerance(&self, table: &GridTable) -> Result<Option<Tolerance>, InputError> {
        let GridTable { tolerance_n, tolerance_relative, cannot_be_felt, .. } = table;
        let Some((span, key)) = table.adaptive_key() else { return Ok(None) };
        if let Some((span, other)) = table.lattice_key() {
            let what = format!("[grid] has both `{other}` and `{key}`");
            let fix = format!("keep `{other}` for a lattice, or `{key}` for adaptive sampling");
            return Err(self.place.error(span, what, fix));
        }
        let is_given = tolerance_n.is_some() || tolerance_relative.is_some();
        match cannot_be_felt {
            Some(felt) if *felt.get_ref() && is_given => {
                let what = "`cannot_be_felt` excludes other tolerances";
                Err(self.place.error(felt.span(), what, "keep it, or `tolerance_n` and `tolerance_relative`"))
            }
            Some(felt) if *felt.get_ref() => Ok(Some(Tolerance::IMPERCEPTIBLE)),
            _ if is_given => {
                let given = |key, value: &Option<Spanned<f64>>| {
                    value.as_ref().map_or(Ok(0.0), |value| positive(self.place, key, value))
                };
                let relative = given("tolerance_relative", tolerance_relative)?;
                Ok(Some(Tolerance { relative, absolute_n: given("tolerance_n", tolerance_n)? }))
            }
            _ => {
                let what = format!("`{key}` = false has no effect");
                let fix = "set it to true, or give `spacing_m`, `points` or a tolerance";
                Err(self.place.error(span, what, fix))
            }
        }
    }
}
