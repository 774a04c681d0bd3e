//! Held-out solutions of a .space as a table.

use std::fmt::Write as _;

use palpate_precompute::held_out::is_on_training_lattice;
use palpate_precompute::space::{Equilibrium, Store};
use palpate_precompute::spec::Sampling;

use super::columns::{field, number, numbers};
use crate::failure::Failure;
use crate::files::Output;

pub(super) const CSV_HEADER: &str = "active,kind,number,step,x_m,y_m,z_m,training,tag,failure,energy_j,fx_n,fy_n,fz_n,sxx_n_m,sxy_n_m,sxz_n_m,\
                          syy_n_m,syz_n_m,szz_n_m,residual_n,min_jacobian,inverted,unstable_modes,switched,iterations,\
                          factorisations,seconds";

/// Writes one row per position. `training` is 1 if a fit may have used it: a grid point or an increment on
/// the path to one.
pub(super) fn write(store: &Store, sampling: &Sampling, file: &Output) -> Result<(), Failure> {
    let mut table = format!("{CSV_HEADER}\n");
    for (active, (name, _)) in store.active()?.into_iter().enumerate() {
        store.each_truth(active, |walk, step, t| {
            let at = t.equilibrium();
            let training = u32::from(
                sampling
                    .lattice()
                    .is_some_and(|l| is_on_training_lattice(&l.grid, l.increments, t.displacement_m)),
            );
            let mut cells =
                vec![name.clone(), walk.kind.name().into(), walk.number.to_string(), step.to_string()];
            cells.extend(t.displacement_m.map(number));
            cells.extend([training.to_string(), t.tag().name().into(), field(t.result.as_ref().err())]);
            cells.extend(numbers(at.map(Equilibrium::numbers)));
            cells.extend([field(t.residual_n.map(number)), field(at.map(|at| number(at.min_jacobian)))]);
            cells.extend([field(at.map(|at| at.inverted)), field(at.and_then(|at| at.unstable_modes))]);
            cells.push(field(at.map(|at| u32::from(at.switched))));
            cells.extend([t.iterations.to_string(), t.factorisations.to_string(), number(t.seconds)]);
            // Writing to a `String` cannot fail.
            let _ = writeln!(table, "{}", cells.join(","));
        })?;
    }
    file.put(table.as_bytes())
}
