//! Held-out solutions of a .space as a table.

use std::fmt::Write as _;

use palpate_precompute::held_out::is_on_training_lattice;
use palpate_precompute::space::Store;
use palpate_precompute::spec::Sampling;

use crate::failure::Failure;
use crate::files::Output;

const CSV_HEADER: &str = "active,kind,number,step,x_m,y_m,z_m,training,tag,failure,energy_j,fx_n,fy_n,fz_n,sxx_n_m,syy_n_m,szz_n_m,\
                          sxy_n_m,sxz_n_m,syz_n_m,residual_n,min_jacobian,inverted,unstable_modes,switched,iterations,\
                          factorisations,seconds";

/// Writes one row per position. `training` is 1 if a fit may have used it: a grid point or an increment on
/// the path to one.
pub(super) fn write(store: &Store, sampling: &Sampling, file: &Output) -> Result<(), Failure> {
    let mut table = format!("{CSV_HEADER}\n");
    for (active, (name, _)) in store.active()?.into_iter().enumerate() {
        store.each_truth(active, |walk, step, t| {
            let number = |x: f64| if x.is_nan() { String::new() } else { format!("{x:?}") };
            let solved = |n: u32| if t.tag.is_solved() { n.to_string() } else { String::new() };
            let s = &t.stiffness_n_m;
            let training = u32::from(
                sampling
                    .lattice()
                    .is_some_and(|l| is_on_training_lattice(&l.grid, l.increments, t.displacement_m)),
            );
            let mut cells =
                vec![name.clone(), walk.kind.name().into(), walk.number.to_string(), step.to_string()];
            cells.extend(t.displacement_m.map(number));
            cells.extend([training.to_string(), t.tag.name().into(), t.failure.clone().unwrap_or_default()]);
            cells.push(number(t.energy_j));
            cells.extend(t.force_n.map(number));
            cells.extend([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)].map(|at| number(s[at])));
            cells.extend([number(t.residual_n), number(t.min_jacobian), solved(t.inverted)]);
            cells.push(t.unstable_modes.map_or(String::new(), |n| n.to_string()));
            cells.extend([
                solved(u32::from(t.switched)),
                t.iterations.to_string(),
                t.factorisations.to_string(),
            ]);
            cells.push(number(t.seconds));
            // Writing to a `String` cannot fail.
            let _ = writeln!(table, "{}", cells.join(","));
        })?;
    }
    file.put(table.as_bytes())
}
