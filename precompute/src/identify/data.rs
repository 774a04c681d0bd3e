//! Measured places and forces, from a table.
//!
//! Columns, each with its unit at the end of its name:
//!
//! | place | `dx_m,dy_m,dz_m` displacement of the tool; `x_m,y_m,z_m` its position; or `depth_m` along a direction |
//! | force on the body | `fx_n,fy_n,fz_n`; or `force_n` along the direction |
//! | optional | `test`: name of the test; `active`: where the tool is |
//!
//! Lengths may be in `_mm`, forces in `_mn`. Other columns are ignored.

use std::path::{Path, PathBuf};

use csv::StringRecord;

use crate::error::InputError;
use crate::num::vector::{dot, norm};

/// A measured force on the body, N.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Force {
    /// All three components.
    Vector([f64; 3]),
    /// The component along the direction of the measurement.
    Along(f64),
}

/// What the places of a table are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Places {
    /// Displacements from the place of the active node at rest.
    Displacements,
    /// Positions in the frame of the body.
    Positions,
    /// Displacements along the direction.
    Depths,
}

/// One row.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// 1-based line in the table.
    pub line: usize,
    /// Name of the test; empty if the table has no such column.
    pub test: String,
    /// Where the tool is; `None` if the table has no such column.
    pub active: Option<String>,
    /// Displacement or position of the tool, m.
    pub place_m: [f64; 3],
    /// The measured force.
    pub force_n: Force,
}

/// A table of measurements.
#[derive(Debug, Clone, PartialEq)]
pub struct Data {
    /// Name of the table in messages.
    pub path: PathBuf,
    /// What the places are.
    pub places: Places,
    /// Unit direction of depths and of single force components.
    pub direction: Option<[f64; 3]>,
    /// The rows, those of a test in the order of the test.
    pub rows: Vec<Measurement>,
}

/// A column or three, with the factor to metres or newtons.
#[derive(Debug, Clone, Copy)]
enum Columns {
    One(usize, f64),
    Three([usize; 3], f64),
}

impl Columns {
    fn read(self, number: impl Fn(usize) -> Result<f64, InputError>) -> Result<[f64; 3], InputError> {
        Ok(match self {
            Self::One(column, factor) => [number(column)? * factor, 0.0, 0.0],
            Self::Three([x, y, z], factor) => [number(x)?, number(y)?, number(z)?].map(|v| v * factor),
        })
    }
}

const LENGTHS: [(&str, f64); 2] = [("_m", 1.0), ("_mm", 1e-3)];
const FORCES: [(&str, f64); 2] = [("_n", 1.0), ("_mn", 1e-3)];
const HEADERS: &str = "the columns are dx_m,dy_m,dz_m,fx_n,fy_n,fz_n, or depth_m,force_n with a direction";

/// The columns of these names in one of the units. Names without a unit are an error.
fn find<const N: usize>(
    path: &Path,
    header: &StringRecord,
    names: [&str; N],
    units: [(&str, f64); 2],
) -> Result<Option<([usize; N], f64)>, InputError> {
    for (unit, factor) in units {
        let place = |name: &str| header.iter().position(|h| h == format!("{name}{unit}"));
        let found: Vec<usize> = names.iter().filter_map(|name| place(name)).collect();
        if let Ok(found) = <[usize; N]>::try_from(found.as_slice()) {
            return Ok(Some((found, factor)));
        }
        if let (false, Some(lost)) = (found.is_empty(), names.iter().find(|name| place(name).is_none())) {
            let what = format!("the column {lost}{unit} is missing beside the others");
            return Err(InputError::at(path, 1, what, format!("add {lost}{unit}")));
        }
    }
    match names.iter().find(|name| header.iter().any(|h| h == **name)) {
        Some(bare) => {
            let [(a, _), (b, _)] = units;
            let what = format!("the column {bare} states no unit");
            Err(InputError::at(path, 1, what, format!("name it {bare}{a} or {bare}{b}")))
        }
        None => Ok(None),
    }
}

/// The first kind of columns that is whole. Without one the error is that of the first that is not, or `none`.
fn first<K, const N: usize>(
    kinds: [(K, Result<Option<Columns>, InputError>); N],
    none: impl Fn() -> InputError,
) -> Result<(K, Columns), InputError> {
    let mut fault = None;
    for (kind, found) in kinds {
        match found {
            Ok(Some(columns)) => return Ok((kind, columns)),
            Ok(None) => {}
            Err(error) => fault = fault.or(Some(error)),
        }
    }
    Err(fault.unwrap_or_else(none))
}

impl Data {
    /// Reads a CSV file. `direction` is a unit vector for depths and single components.
    ///
    /// # Errors
    ///
    /// [`InputError`] with the line of the table.
    pub fn read(path: &Path, direction: Option<[f64; 3]>) -> Result<Self, InputError> {
        let bytes = std::fs::read(path).map_err(|error| InputError::unreadable(path, &error))?;
        Self::parse(path, &bytes, direction)
    }

    /// The same from the content of a file; `path` is its name in messages.
    ///
    /// # Errors
    ///
    /// [`InputError`] with the line of the table.
    pub fn parse(path: &Path, bytes: &[u8], direction: Option<[f64; 3]>) -> Result<Self, InputError> {
        let at = |line: usize, what: String, fix: &str| InputError::at(path, line, what, fix);
        let invalid =
            |line: usize, error: csv::Error| at(line, error.to_string(), "save the table as CSV in UTF-8");
        let mut reader =
            csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(bytes);
        let header = reader.headers().map_err(|error| invalid(1, error))?;
        if let Some(separator) = [";", "\t"].into_iter().find(|s| header.len() == 1 && header[0].contains(s))
        {
            let what = format!("the columns are separated by {separator:?}");
            return Err(at(1, what, "save the table with commas, and points in the numbers"));
        }
        // A laboratory may write Fx_N.
        let header: StringRecord = header.iter().map(str::to_ascii_lowercase).collect();
        let three = |names, units| {
            Ok::<_, InputError>(
                find(path, &header, names, units)?.map(|(at, factor)| Columns::Three(at, factor)),
            )
        };
        let one = |name, units| {
            Ok::<_, InputError>(
                find(path, &header, [name], units)?.map(|([at], factor)| Columns::One(at, factor)),
            )
        };
        let kinds = [
            (Places::Displacements, three(["dx", "dy", "dz"], LENGTHS)),
            (Places::Positions, three(["x", "y", "z"], LENGTHS)),
            (Places::Depths, one("depth", LENGTHS)),
        ];
        let (places, place) = first(kinds, || at(1, "no column of a displacement".into(), HEADERS))?;
        let forces = [((), three(["fx", "fy", "fz"], FORCES)), ((), one("force", FORCES))];
        let ((), force) = first(forces, || at(1, "no column of a force".into(), HEADERS))?;
        let is_along = matches!(force, Columns::One(..)) || places == Places::Depths;
        if is_along && direction.is_none() {
            let what = "a depth or a single force needs its direction";
            return Err(at(
                1,
                what.into(),
                "give the direction of the indentation, from the tool into the body",
            ));
        }
        let [test, active] = ["test", "active"].map(|name| header.iter().position(|h| h == name));
        let mut rows = Vec::new();
        for record in reader.records() {
            let record = record.map_err(|error| {
                let line = error.position().map_or(1, |position| position.line() as usize);
                invalid(line, error)
            })?;
            let line = record.position().map_or(1, |position| position.line() as usize);
            let number = |column: usize| {
                let text = record.get(column).unwrap_or("");
                let finite = text.parse().ok().filter(|number: &f64| number.is_finite());
                let name = &header[column];
                finite.ok_or_else(|| {
                    at(line, format!("{name} = `{text}` is not a finite number"), "correct the row")
                })
            };
            let (place, along) = (place.read(number)?, direction.unwrap_or_default());
            let values = force.read(number)?;
            let word =
                |column: Option<usize>| column.and_then(|column| record.get(column)).map(str::to_owned);
            rows.push(Measurement {
                line,
                test: word(test).unwrap_or_default(),
                active: word(active),
                place_m: if places == Places::Depths { along.map(|x| x * place[0]) } else { place },
                force_n: match force {
                    Columns::Three(..) => Force::Vector(values),
                    Columns::One(..) => Force::Along(values[0]),
                },
            });
        }
        Ok(Self { path: path.to_path_buf(), places, direction, rows })
    }

    /// Number of measured force components.
    pub(super) fn components(&self) -> usize {
        let of = |row: &Measurement| match row.force_n {
            Force::Vector(_) => 3,
            Force::Along(_) => 1,
        };
        self.rows.iter().map(of).sum()
    }

    /// Forces that are all zero have no constants.
    pub(super) fn check_size(&self) -> Result<(), InputError> {
        let size = |row: &Measurement| match row.force_n {
            Force::Vector(force) => norm(force),
            Force::Along(force) => force.abs(),
        };
        if self.rows.iter().map(size).fold(0.0, f64::max) > 0.0 {
            return Ok(());
        }
        Err(InputError::new(
            &self.path,
            "all forces are zero",
            "check the columns of the force and their units",
        ))
    }

    /// The forces of each test point where those of the model do, which are `model_n` row by row: constants change
    /// their size, not their sign.
    pub(super) fn check_sign(&self, model_n: &[[f64; 3]]) -> Result<(), InputError> {
        let mut tests: Vec<(&str, f64, usize)> = Vec::new();
        for (row, model) in self.rows.iter().zip(model_n) {
            let work = match row.force_n {
                Force::Vector(force) => dot(force, *model),
                Force::Along(force) => force * dot(self.direction.unwrap_or_default(), *model),
            };
            match tests.iter_mut().find(|(test, ..)| *test == row.test) {
                Some((_, sum, _)) => *sum += work,
                None => tests.push((&row.test, work, row.line)),
            }
        }
        let Some((test, _, line)) = tests.into_iter().find(|(_, sum, _)| *sum < 0.0) else { return Ok(()) };
        let of = if test.is_empty() { String::new() } else { format!(" of test \"{test}\"") };
        let what = format!("the forces{of} point against those of the model");
        let fix = "give the force of the tool on the body: change the sign of the force columns";
        Err(InputError::at(&self.path, line, what, fix))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str, direction: Option<[f64; 3]>) -> Result<Data, String> {
        Data::parse(Path::new("d.csv"), text.as_bytes(), direction).map_err(|error| error.to_string())
    }

    #[test]
    fn columns_are_found_by_name_in_their_unit() {
        let data =
            parse("t_s,fz_mn,fx_mn,fy_mn,dx_mm,dy_mm,dz_mm,test\n0,3,1,2,4,5,6,a\n", None).expect("valid");
        let [row] = &data.rows[..] else { panic!("one row") };
        assert_eq!(row.place_m, [4e-3, 5e-3, 6e-3]);
        assert_eq!((row.force_n, row.line), (Force::Vector([1e-3, 2e-3, 3e-3]), 2));
        assert_eq!((row.test.as_str(), data.places), ("a", Places::Displacements));
        let data = parse("depth_mm,force_n\n2,0.5\n", Some([0.0, 0.0, -1.0])).expect("valid");
        assert_eq!((data.rows[0].place_m, data.rows[0].force_n), ([0.0, 0.0, -2e-3], Force::Along(0.5)));
        assert_eq!(data.components(), 1);
    }

    #[test]
    fn what_a_table_lacks_is_one_line_with_the_fix() {
        let refused = |text: &str| parse(text, None).expect_err("refused");
        for (text, words) in [
            ("dx,dy,dz,fx_n,fy_n,fz_n\n", ["d.csv:1: the column dx states no unit", "name it dx_m or dx_mm"]),
            ("dx_m,dy_m,dz_m,force\n", ["the column force states no unit", "force_n or force_mn"]),
            ("dx_m,dy_m,fx_n,fy_n,fz_n\n", ["the column dz_m is missing", "add dz_m"]),
            ("dx_m,dy_m,dz_m\n", ["no column of a force", "depth_m,force_n"]),
            ("fx_n,fy_n,fz_n\n", ["no column of a displacement", "dx_m,dy_m,dz_m"]),
            ("depth_m,force_n\n1,1\n", ["needs its direction", "from the tool into the body"]),
            (
                "dx_m,dy_m,dz_m,fx_n,fy_n,fz_n\n0,0,0,0,0,0\n0,0,0,0,NaN,0\n",
                ["d.csv:3: fy_n = `NaN`", "correct the row"],
            ),
        ] {
            let error = refused(text);
            assert!(words.iter().all(|word| error.contains(word)), "{error}");
        }
    }

    #[test]
    fn a_whole_kind_of_columns_counts_and_other_columns_do_not() {
        let data = parse("z_m,x,dX_mm,dY_mm,dZ_mm,Fx_N,Fy_N,Fz_N\n9,9,1,2,3,4,5,6\n", None).expect("valid");
        assert_eq!(data.places, Places::Displacements);
        assert_eq!(data.rows[0].force_n, Force::Vector([4.0, 5.0, 6.0]));
        let error = parse("dx_m;dy_m\n", None).expect_err("refused");
        assert!(error.contains("separated by \";\"") && error.contains("commas"), "{error}");
    }

    #[test]
    fn a_test_against_the_model_and_forces_of_zero_are_refused() {
        let rows = "test,dx_m,dy_m,dz_m,fx_n,fy_n,fz_n\na,0,0,-0.01,0,0,-0.5\nb,0,0,-0.01,0,0,0.4\n";
        let data = parse(rows, None).expect("valid");
        let model = [[0.0, 0.1, -0.3]; 2];
        let error = data.check_sign(&model).expect_err("refused").to_string();
        assert!(
            error.contains("d.csv:3: the forces of test \"b\"") && error.contains("change the sign"),
            "{error}"
        );
        assert!(data.check_sign(&[model[0], [0.0, 0.0, 0.2]]).is_ok() && data.check_size().is_ok());
        let zero = parse("dx_m,dy_m,dz_m,fx_n,fy_n,fz_n\n0,0,-0.01,0,0,0\n", None).expect("valid");
        assert!(zero.check_size().expect_err("refused").to_string().contains("all forces are zero"));
    }
}
