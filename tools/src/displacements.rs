//! Writes the displacements of a path's steps: a CSV table, or a PVD series for ParaView.

use std::path::Path;

use palpate_precompute::fem::{Body, Configuration, Order, volume_ratios};
use palpate_precompute::mesh::write::{Cell, Field, Grid, Series};

use crate::failure::Failure;
use crate::files::{FileKind, Files, Output};
use crate::output::Csv;

/// The option that names the file.
const OPTION: &str = "--displacements";

/// Whether this file name in the folder of a series is that of a step.
fn is_step(name: &str) -> bool {
    name.starts_with("step_") && name.ends_with(".vtu")
}

/// Destination of the displacements, chosen by the file extension.
#[derive(Debug)]
pub(crate) enum Displacements {
    /// None.
    Unwanted,
    /// A row per node and step, written at the end.
    Csv { file: Output, table: Box<Csv> },
    /// A VTU file per step, including rest, listed in a PVD file that is complete after each step.
    Pvd { file: Output, series: Option<Series> },
}

impl Displacements {
    /// Checks the destination. No file is written before the first step.
    pub(crate) fn new(path: Option<&Path>, files: &mut Files) -> Result<Self, Failure> {
        let Some(path) = path else { return Ok(Self::Unwanted) };
        match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
            Some("csv") => {
                let table = Box::new(Csv::new(["step", "node", "ux_m", "uy_m", "uz_m"])?);
                Ok(Self::Csv { file: files.write(OPTION, path, FileKind::Table)?, table })
            }
            Some("pvd") => {
                let file = files.write(OPTION, path, FileKind::Pvd)?;
                files.folder(OPTION, &path.with_extension(""), |name| {
                    is_step(name).then_some(FileKind::Vtu)
                })?;
                Ok(Self::Pvd { file, series: None })
            }
            _ => Err(Failure::input(format!(
                "{OPTION} {}: unknown extension; end the name with .csv or .pvd",
                path.display()
            ))),
        }
    }

    /// Adds a converged step. Step 0 is rest, which the CSV table omits. The time of the series is
    /// `length_mm`, the length of the active node's displacement.
    pub(crate) fn add(
        &mut self,
        step: u32,
        length_mm: f64,
        body: &Body,
        c: &Configuration,
    ) -> Result<(), Failure> {
        let u = &c.seed.state[..body.displacement_len()];
        match self {
            Self::Unwanted => {}
            Self::Csv { table, .. } if step > 0 => {
                for (node, moved_m) in u.as_chunks::<3>().0.iter().enumerate() {
                    table.row((step, node, moved_m))?;
                }
            }
            Self::Csv { .. } => {}
            Self::Pvd { file, series } => {
                if series.is_none() {
                    *series = Some(Series::create(file.path()).map_err(|error| file.failure(&error))?);
                }
                let series = series.as_mut().expect("just made");
                let ratios = volume_ratios(body, &c.seed.state);
                let grid = Grid {
                    nodes_m: &body.nodes_m,
                    cell: match body.order {
                        Order::Linear => Cell::Tet4,
                        Order::Quadratic => Cell::Tet10,
                    },
                    connectivity: &body.connectivity,
                    point_data: &[Field { name: "displacement_m", components: 3, values: u }],
                    cell_data: &[Field { name: "volume_ratio", components: 1, values: &ratios }],
                    field_data: &[
                        Field { name: "reaction_force_n", components: 3, values: &c.jet().force_n },
                        Field {
                            name: "active_displacement_m",
                            components: 3,
                            values: &c.seed.pose.displacement_m,
                        },
                        Field { name: "energy_j", components: 1, values: &[c.jet().energy_j] },
                    ],
                };
                series.add(length_mm, &grid).map_err(|error| file.failure(&error))?;
            }
        }
        Ok(())
    }

    /// Writes the remaining data.
    pub(crate) fn finish(self) -> Result<(), Failure> {
        match self {
            Self::Csv { file, table } => file.put(&table.finish()?),
            Self::Unwanted | Self::Pvd { .. } => Ok(()),
        }
    }
}
