//! The questions: positions, closed loops and hands with the forces of finite elements, as CSV that any program
//! can read.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::failure::Failure;
use crate::files::Folder;
use crate::output;

/// Version of the set; another one has other positions or another meaning.
pub(super) const VERSION: u32 = 1;
/// Time between two samples of a way, s.
pub(super) const TICK_S: f64 = 1e-3;
/// Files of the questions of an organ, and of their answers.
pub(super) const POSITIONS: &str = "positions.csv";
pub(super) const LOOPS: &str = "loops.csv";
pub(super) const HANDS: &str = "hands.csv";

/// A displacement or a force.
pub(super) type Vec3 = [f64; 3];

/// What is asked about one organ.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Questions {
    /// Its name, and that of its folder.
    pub(super) organ: String,
    /// Independent positions of the touched place.
    pub(super) positions: Vec<Position>,
    /// Closed loops, without a reference force.
    pub(super) loops: Vec<Way>,
    /// Hands, with a reference force at some samples.
    pub(super) hands: Vec<Way>,
}

/// A displacement of the touched place with the force of finite elements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Position {
    /// d, m.
    pub(super) displacement_m: Vec3,
    /// h, N.
    pub(super) truth_n: Vec3,
    /// Residual of that solution, N.
    pub(super) residual_n: f64,
}

/// A sequence of displacements, one each millisecond.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Way {
    /// Its name.
    pub(super) name: String,
    /// The first tick that counts; before it the tool comes from rest.
    pub(super) counted_from: usize,
    /// d, m.
    pub(super) displacement_m: Vec<Vec3>,
    /// h by finite elements where it was solved, N.
    pub(super) truth_n: Vec<Option<Vec3>>,
}

#[derive(Debug, Serialize, Deserialize)]
struct PositionRow {
    position: usize,
    dx_m: f64,
    dy_m: f64,
    dz_m: f64,
    hx_n: f64,
    hy_n: f64,
    hz_n: f64,
    residual_n: f64,
}

#[derive(Debug, Serialize, Deserialize)]
struct WayRow {
    way: String,
    tick: usize,
    t_s: f64,
    counted: u8,
    dx_m: f64,
    dy_m: f64,
    dz_m: f64,
    hx_n: Option<f64>,
    hy_n: Option<f64>,
    hz_n: Option<f64>,
}

/// The rows of a CSV file.
pub(super) fn rows<T: serde::de::DeserializeOwned>(path: &Path) -> Result<Vec<T>, Failure> {
    let bytes = std::fs::read(path).map_err(|error| Failure::file(path, &error))?;
    let mut reader = csv::Reader::from_reader(&bytes[..]);
    let head = reader.headers().cloned().unwrap_or_default();
    let rows = reader.into_deserialize().collect::<Result<Vec<T>, _>>();
    rows.map_err(|error| Failure::input(format!("{}: {}", path.display(), cause(&error, &head, &bytes))))
}

/// What is wrong with a CSV file: line, column and value where they are known.
fn cause(error: &csv::Error, head: &csv::StringRecord, bytes: &[u8]) -> String {
    let csv::ErrorKind::Deserialize { pos: Some(at), err } = error.kind() else {
        return format!("{error}; the columns are in docs/formats.md");
    };
    let line = at.line();
    let Some(field) = err.field().and_then(|field| usize::try_from(field).ok()) else {
        return format!("line {line}: {err}; the columns are in docs/formats.md");
    };
    let mut record =
        csv::ReaderBuilder::new().has_headers(false).from_reader(&bytes[at.byte() as usize..]).into_records();
    let record = record.next().and_then(Result::ok).unwrap_or_default();
    let (column, value) = (head.get(field).unwrap_or("?"), record.get(field).unwrap_or_default());
    format!("line {line}: `{value}` is no {column}")
}

impl Questions {
    /// Writes the three files into a folder.
    pub(super) fn write(&self, folder: &Folder) -> Result<(), Failure> {
        let position = |(position, at): (usize, &Position)| {
            let ([dx_m, dy_m, dz_m], [hx_n, hy_n, hz_n]) = (at.displacement_m, at.truth_n);
            PositionRow { position, dx_m, dy_m, dz_m, hx_n, hy_n, hz_n, residual_n: at.residual_n }
        };
        let positions: Vec<PositionRow> = self.positions.iter().enumerate().map(position).collect();
        folder.file(POSITIONS).put(&output::csv(&positions)?)?;
        folder.file(LOOPS).put(&output::csv(&way_rows(&self.loops))?)?;
        folder.file(HANDS).put(&output::csv(&way_rows(&self.hands))?)
    }

    /// Reads the three files of the folder of an organ.
    pub(super) fn read(organ: &str, folder: &Path) -> Result<Self, Failure> {
        let position = |row: PositionRow| Position {
            displacement_m: [row.dx_m, row.dy_m, row.dz_m],
            truth_n: [row.hx_n, row.hy_n, row.hz_n],
            residual_n: row.residual_n,
        };
        Ok(Self {
            organ: organ.into(),
            positions: rows(&folder.join(POSITIONS))?.into_iter().map(position).collect(),
            loops: ways(rows(&folder.join(LOOPS))?),
            hands: ways(rows(&folder.join(HANDS))?),
        })
    }
}

fn way_rows(ways: &[Way]) -> Vec<WayRow> {
    let mut rows = Vec::new();
    for way in ways {
        rows.extend(way.displacement_m.iter().zip(&way.truth_n).enumerate().map(|(tick, (d, truth))| {
            WayRow {
                way: way.name.clone(),
                tick,
                t_s: tick as f64 * TICK_S,
                counted: u8::from(tick >= way.counted_from),
                dx_m: d[0],
                dy_m: d[1],
                dz_m: d[2],
                hx_n: truth.map(|h| h[0]),
                hy_n: truth.map(|h| h[1]),
                hz_n: truth.map(|h| h[2]),
            }
        }));
    }
    rows
}

/// The ways of rows that are ordered by way and tick.
fn ways(rows: Vec<WayRow>) -> Vec<Way> {
    let mut ways: Vec<Way> = Vec::new();
    for row in rows {
        if ways.last().is_none_or(|way| way.name != row.way) {
            ways.push(Way { name: row.way.clone(), ..Way::default() });
        }
        let Some(way) = ways.last_mut() else { continue };
        way.counted_from += usize::from(row.counted == 0);
        way.displacement_m.push([row.dx_m, row.dy_m, row.dz_m]);
        let truth = row.hx_n.zip(row.hy_n).zip(row.hz_n);
        way.truth_n.push(truth.map(|((x, y), z)| [x, y, z]));
    }
    ways
}
