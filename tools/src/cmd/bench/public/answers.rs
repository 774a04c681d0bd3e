//! Answers of a system: its forces at the questions.

use std::path::Path;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::questions::{HANDS, LOOPS, POSITIONS, Questions, Vec3, Way, rows};
use crate::failure::Failure;
use crate::files::Folder;
use crate::output;

/// Forces on the body at the questions of one organ, N; `None` where the system did not answer.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Forces {
    /// At the positions.
    pub(super) positions: Vec<Option<Vec3>>,
    /// At the ticks of each loop.
    pub(super) loops: Vec<Vec<Option<Vec3>>>,
    /// At the ticks of each hand.
    pub(super) hands: Vec<Vec<Option<Vec3>>>,
}

#[derive(Debug, Serialize, Deserialize)]
struct PositionRow {
    position: usize,
    fx_n: Option<f64>,
    fy_n: Option<f64>,
    fz_n: Option<f64>,
}

#[derive(Debug, Serialize, Deserialize)]
struct WayRow {
    way: String,
    tick: usize,
    fx_n: Option<f64>,
    fy_n: Option<f64>,
    fz_n: Option<f64>,
}

/// The force in a row of a file. A system that diverges has none: `nan` would leave its largest errors out unseen.
fn force(path: &Path, components: [Option<f64>; 3]) -> Result<Option<Vec3>, Failure> {
    let [Some(x), Some(y), Some(z)] = components else { return Ok(None) };
    if [x, y, z].iter().all(|x| x.is_finite()) {
        return Ok(Some([x, y, z]));
    }
    let what = "a force is not finite; leave its cells empty, then the share of the answers states it";
    Err(Failure::input(format!("{}: {what}", path.display())))
}

/// The number of rows with a force.
fn forces(path: &Path, mut rows: impl Iterator<Item = [Option<f64>; 3]>) -> Result<usize, Failure> {
    rows.try_fold(0, |count, row| Ok(count + usize::from(force(path, row)?.is_some())))
}

/// The rows of a file of answers. A file without a column of forces, as that of the questions, is refused.
fn answers<T: DeserializeOwned>(path: &Path) -> Result<Vec<T>, Failure> {
    let mut reader = csv::Reader::from_path(path)
        .map_err(|error| Failure::input(format!("{}: {error}", path.display())))?;
    let head = reader.headers().cloned().unwrap_or_default();
    if let Some(missing) = ["fx_n", "fy_n", "fz_n"].iter().find(|name| !head.iter().any(|one| one == **name))
    {
        let cause = match head.get(0) {
            Some(first) if first.contains(';') => "columns are separated by `;`; write commas".to_owned(),
            _ => format!("has no column {missing}; the columns are in docs/formats.md"),
        };
        return Err(Failure::input(format!("{}: {cause}", path.display())));
    }
    rows(path)
}

/// The number of forces in the files of the folder of an organ, whatever the questions are.
pub(super) fn count(folder: &Path) -> Result<usize, Failure> {
    let mut count = 0;
    let path = folder.join(POSITIONS);
    if path.exists() {
        let rows = answers::<PositionRow>(&path)?;
        count += forces(&path, rows.iter().map(|row| [row.fx_n, row.fy_n, row.fz_n]))?;
    }
    for path in [LOOPS, HANDS].map(|name| folder.join(name)) {
        if path.exists() {
            let rows = answers::<WayRow>(&path)?;
            count += forces(&path, rows.iter().map(|row| [row.fx_n, row.fy_n, row.fz_n]))?;
        }
    }
    Ok(count)
}

impl Forces {
    /// No answer to any of these questions.
    pub(super) fn none(questions: &Questions) -> Self {
        let ways = |ways: &[Way]| ways.iter().map(|way| vec![None; way.displacement_m.len()]).collect();
        Self {
            positions: vec![None; questions.positions.len()],
            loops: ways(&questions.loops),
            hands: ways(&questions.hands),
        }
    }

    /// The answers of a force field to all questions.
    pub(super) fn of_field(questions: &Questions, field: impl Fn(Vec3) -> Option<Vec3>) -> Self {
        let ways = |ways: &[Way]| -> Vec<Vec<Option<Vec3>>> {
            ways.iter().map(|way| way.displacement_m.iter().map(|d| field(*d)).collect()).collect()
        };
        Self {
            positions: questions.positions.iter().map(|at| field(at.displacement_m)).collect(),
            loops: ways(&questions.loops),
            hands: ways(&questions.hands),
        }
    }

    /// Reads the files in the folder of an organ; a missing file is no answer.
    pub(super) fn read(questions: &Questions, folder: &Path) -> Result<Self, Failure> {
        let mut forces = Self::none(questions);
        let path = folder.join(POSITIONS);
        if path.exists() {
            for row in answers::<PositionRow>(&path)? {
                let slot = forces.positions.get_mut(row.position).ok_or_else(|| {
                    Failure::input(format!(
                        "{}: there is no position {}; answer those of {}/{POSITIONS} of the same version",
                        path.display(),
                        row.position,
                        questions.organ
                    ))
                })?;
                let again = || format!("{}: position {} is answered twice", path.display(), row.position);
                fill(slot, force(&path, [row.fx_n, row.fy_n, row.fz_n])?, again)?;
            }
        }
        read_ways(&folder.join(LOOPS), &questions.loops, &mut forces.loops)?;
        read_ways(&folder.join(HANDS), &questions.hands, &mut forces.hands)?;
        Ok(forces)
    }

    /// Writes the files that have an answer into a folder.
    pub(super) fn write(&self, questions: &Questions, folder: &Folder) -> Result<(), Failure> {
        if self.positions.iter().any(Option::is_some) {
            let row = |(position, f): (usize, &Option<Vec3>)| {
                let [fx_n, fy_n, fz_n] = f.map_or([None; 3], |f| f.map(Some));
                PositionRow { position, fx_n, fy_n, fz_n }
            };
            let rows: Vec<PositionRow> = self.positions.iter().enumerate().map(row).collect();
            folder.file(POSITIONS).put(&output::csv(&rows)?)?;
        }
        for (name, ways, forces) in
            [(LOOPS, &questions.loops, &self.loops), (HANDS, &questions.hands, &self.hands)]
        {
            if forces.iter().flatten().any(Option::is_some) {
                folder.file(name).put(&output::csv(&way_rows(ways, forces))?)?;
            }
        }
        Ok(())
    }
}

fn read_ways(path: &Path, ways: &[Way], forces: &mut [Vec<Option<Vec3>>]) -> Result<(), Failure> {
    if !path.exists() {
        return Ok(());
    }
    for row in answers::<WayRow>(path)? {
        let way = ways.iter().position(|way| way.name == row.way);
        let slot = way.and_then(|way| forces[way].get_mut(row.tick)).ok_or_else(|| {
            Failure::input(format!(
                "{}: there is no tick {} of `{}`; answer the questions of the same version",
                path.display(),
                row.tick,
                row.way
            ))
        })?;
        let again = || format!("{}: tick {} of `{}` is answered twice", path.display(), row.tick, row.way);
        fill(slot, force(path, [row.fx_n, row.fy_n, row.fz_n])?, again)?;
    }
    Ok(())
}

/// The answer to a question, unless it has one.
fn fill(slot: &mut Option<Vec3>, force: Option<Vec3>, again: impl Fn() -> String) -> Result<(), Failure> {
    if slot.is_some() {
        return Err(Failure::input(again()));
    }
    *slot = force;
    Ok(())
}

fn way_rows(ways: &[Way], forces: &[Vec<Option<Vec3>>]) -> Vec<WayRow> {
    let mut rows = Vec::new();
    for (way, forces) in ways.iter().zip(forces) {
        rows.extend(forces.iter().enumerate().map(|(tick, f)| {
            let [fx_n, fy_n, fz_n] = f.map_or([None; 3], |f| f.map(Some));
            WayRow { way: way.name.clone(), tick, fx_n, fy_n, fz_n }
        }));
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cmd::bench::public::questions::Position;

    /// What reading these answers to two positions says.
    fn read(positions: &str) -> Result<Vec<Option<Vec3>>, String> {
        let at = Position { displacement_m: [0.01, 0.0, 0.0], truth_n: [1.0, 0.0, 0.0], residual_n: 0.0 };
        let asked = Questions { organ: "point".into(), positions: vec![at; 2], ..Questions::default() };
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join(POSITIONS), positions).expect("a file");
        let read = Forces::read(&asked, folder.path());
        read.map(|forces| forces.positions).map_err(|failure| format!("{failure:?}"))
    }

    #[test]
    fn a_wrong_answer_is_named_by_line_column_and_value() {
        let says = |text: &str, what: &str| {
            let said = read(text).expect_err(text);
            assert!(said.contains(what), "{said}");
        };
        says("position,fx_n,fy_n,fz_n\n0,1,2,3\n1,1,soft,3\n", "line 3: `soft` is no fy_n");
        says("position;fx_n;fy_n;fz_n\n0;1;2;3\n", "write commas");
        says("position,fx_n,fy_n,fz_n\n0,1,2,3\n0,1,2,4\n", "position 0 is answered twice");
        says("position,fx_n,fy_n,fz_n\n7,1,2,3\n", "no position 7");
        says("position,fx_n,fy_n,fz_n\n0,1,nan,3\n", "is not finite");
    }

    #[test]
    fn empty_cells_are_no_answer() {
        let answered = read("position,fx_n,fy_n,fz_n\n0,1,,3\n1,1,2,3\n");
        assert_eq!(answered, Ok(vec![None, Some([1.0, 2.0, 3.0])]));
    }
}
