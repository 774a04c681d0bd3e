//! The result in words and as a table.

use std::path::Path;

use palpate_precompute::identify::{Identified, Parameter};

use crate::failure::Failure;
use crate::output::{self, Csv, Table};
use crate::words::count;

/// Significant digits of a constant.
const DIGITS: usize = 5;

/// A number with a few significant digits, without an exponent where a person would write none.
fn number(value: f64) -> String {
    let size = value.abs();
    if value != 0.0 && !(1e-3..1e7).contains(&size) {
        return format!("{value:.*e}", DIGITS - 1);
    }
    let before = if size >= 1.0 { size.log10().floor() as usize + 1 } else { 1 };
    format!("{value:.*}", DIGITS.saturating_sub(before))
}

fn interval(parameter: &Parameter) -> [String; 2] {
    if parameter.is_at_bound {
        return ["at its bound".into(), String::new()];
    }
    let Parameter { low, high, standard_error, value, .. } = parameter;
    let share = 100.0 * standard_error / value.abs();
    [format!("{} .. {}", number(*low), number(*high)), format!("{share:.2}")]
}

/// Prints the result; warnings go to standard error.
pub(super) fn print<'p>(
    found: &Identified,
    seconds: f64,
    written: impl Iterator<Item = &'p Path>,
) -> Result<(), Failure> {
    let heading = format!("{:.0} % interval", 100.0 * found.confidence);
    let mut table = Table::new(1, ["constant", "value", &heading, "standard error, %", "began at"]);
    for parameter in &found.parameters {
        let [interval, error] = interval(parameter);
        let Parameter { name, value, initial, .. } = parameter;
        table.row([name.clone(), number(*value), interval, error, number(*initial)]);
    }
    output::line(&table)?;
    for (i, one) in found.parameters.iter().enumerate() {
        for (k, other) in found.parameters.iter().enumerate().skip(i + 1) {
            output::line(format!(
                "correlation of {} and {}: {:.3}",
                one.name, other.name, found.correlation[i][k]
            ))?;
        }
    }
    output::line(format!(
        "RMS residual {:.2} mN, {:.2} % of the forces; from row to row correlated by {:.2}",
        1e3 * found.rms_residual_n,
        100.0 * found.rms_share,
        found.succession
    ))?;
    let rows = count(found.rows.len());
    output::line(format!(
        "{rows} rows, {} evaluations, {} solves, {seconds:.1} s",
        found.evaluations,
        count(found.solves)
    ))?;
    for path in written {
        output::line(format!("wrote {}", path.display()))?;
    }
    for warning in &found.warnings {
        eprintln!("palpate: warning: {warning}");
    }
    Ok(())
}

/// The rows with measured and computed forces. A single component along the direction is `force_n`.
pub(super) fn table(found: &Identified) -> Result<Vec<u8>, Failure> {
    let is_single = found.rows.first().is_some_and(|row| row.measured_n.len() == 1);
    let forces = if is_single { "force_n,model_n" } else { "fx_n,fy_n,fz_n,model_x_n,model_y_n,model_z_n" };
    let header = format!("line,test,dx_m,dy_m,dz_m,{forces}");
    let mut table = Csv::new(header.split(','))?;
    for row in &found.rows {
        table.row((row.line, &row.test, row.displacement_m, &row.measured_n, &row.model_n))?;
    }
    table.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_has_five_digits() {
        let all = [1300.0, 254_536.9, 0.45, 12.34567, 1.5e9, 2e-5, -3.25];
        assert_eq!(
            all.map(number),
            ["1300.0", "254537", "0.4500", "12.346", "1.5000e9", "2.0000e-5", "-3.2500"]
        );
    }
}
