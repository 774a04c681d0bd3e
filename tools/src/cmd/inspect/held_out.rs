//! Held-out solutions of a .space as a table.

use palpate_precompute::held_out::is_on_training_lattice;
use palpate_precompute::space::{Equilibrium, Store};
use palpate_precompute::spec::Sampling;

use super::columns::cells;
use crate::failure::Failure;
use crate::files::Output;
use crate::output::Csv;

pub(super) const CSV_HEADER: &str = "active,kind,number,step,x_m,y_m,z_m,training,tag,failure,energy_j,fx_n,fy_n,fz_n,sxx_n_m,sxy_n_m,sxz_n_m,\
                          syy_n_m,syz_n_m,szz_n_m,residual_n,min_jacobian,inverted,unstable_modes,switched,iterations,\
                          factorisations,seconds";

/// Writes one row per position. `training` is 1 if a fit may have used it: a grid point or an increment on
/// the path to one.
pub(super) fn write(store: &Store, sampling: &Sampling, file: &Output) -> Result<(), Failure> {
    let (mut table, mut ended) = (Csv::new(CSV_HEADER.split(','))?, Ok(()));
    for (active, (name, _)) in store.active()?.into_iter().enumerate() {
        store.each_truth(active, |walk, step, t| {
            let at = t.equilibrium();
            let training = u32::from(
                sampling
                    .lattice()
                    .is_some_and(|l| is_on_training_lattice(&l.grid, l.increments, t.displacement_m)),
            );
            let position = (&name, walk.kind.name(), walk.number, step, t.displacement_m, training);
            let outcome = (t.tag().name(), t.result.as_ref().err(), cells(at.map(Equilibrium::numbers)));
            let quality = (t.residual_n, at.map(|at| at.min_jacobian), at.map(|at| at.inverted));
            let branch = (at.and_then(|at| at.unstable_modes), at.map(|at| u32::from(at.switched)));
            let cost = (t.iterations, t.factorisations, t.seconds);
            let written = table.row((position, outcome, quality, branch, cost));
            if ended.is_ok() {
                ended = written;
            }
        })?;
    }
    ended?;
    file.put(&table.finish()?)
}
