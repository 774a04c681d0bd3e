//! Tetrahedral meshes: readers, quality, surface and output.
//!
//! A reader for each file format fills a `RawMesh` with the tag and the line of every node and element, so
//! that the shared checks can report them. The result is a [`TetMesh`]: metres, 0-based file order, positive
//! volumes.
//!
//! Files of straight-sided ten-node tets are accepted. The mid-edge nodes are checked and dropped: a
//! [`TetMesh`] has vertices only, and node indices (also in scenes) count the vertices in file order.

pub(crate) mod quality;
pub(crate) mod refine;
pub(crate) mod surface;
pub(crate) mod tetrahedral;
pub mod write;

mod bisect;
mod cell_data;
mod gmsh;
mod lines;
mod mid_edge;
mod offset;
mod raw;
mod skin_point;
mod tetgen;
mod vtk;
mod vtu;

use std::path::Path;

use crate::error::InputError;
pub(crate) use bisect::{BISECTIONS_A_LEVEL, Near, mean_edge_m};
pub(crate) use cell_data::{CellData, RegionFault};
pub(crate) use offset::Offset;
pub use quality::{MeshReport, doubtful_for_pressure};
use raw::RawMesh;
pub(crate) use refine::Refined;
pub use skin_point::SkinPoint;
pub(crate) use skin_point::{nearest_of_segment, nearest_on_triangle};
pub use surface::Surface;
pub(crate) use tetrahedral::Edges;
pub use tetrahedral::{MeshFault, TetMesh};

/// Unit of length of a mesh file. Internally all lengths are in metres.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LengthUnit {
    /// Metres.
    #[default]
    Metre,
    /// Centimetres.
    Centimetre,
    /// Millimetres.
    Millimetre,
}

impl std::str::FromStr for LengthUnit {
    type Err = &'static str;

    /// The unit with the symbol `m`, `cm` or `mm`.
    fn from_str(symbol: &str) -> Result<Self, Self::Err> {
        match symbol {
            "m" => Ok(Self::Metre),
            "cm" => Ok(Self::Centimetre),
            "mm" => Ok(Self::Millimetre),
            _ => Err("use m, cm or mm"),
        }
    }
}

impl LengthUnit {
    /// Number of units in a metre.
    ///
    /// A reader divides lengths by this integer. A multiplication by its inverse would round twice, because
    /// 1e-3 is not exact.
    pub(crate) fn per_metre(self) -> f64 {
        match self {
            Self::Metre => 1.0,
            Self::Centimetre => 100.0,
            Self::Millimetre => 1000.0,
        }
    }
}

/// Reads a mesh file: Gmsh 2.2 or 4.1, VTK legacy, VTU, or TetGen .node/.ele (`path` can be either file).
///
/// Tets have four nodes, or ten with straight edges, of which the vertices are kept. The content determines
/// the format if it is distinctive, otherwise the extension. An error names the file, the line or the element
/// with the file's own tag, and the fix.
pub fn read(path: &Path, unit: LengthUnit) -> Result<TetMesh, InputError> {
    read_raw(path, false)?.finish(unit)
}

/// Reads a mesh file with the numbers of its cells; `None` if the format has none.
pub(crate) fn read_with_cell_data(
    path: &Path,
    unit: LengthUnit,
) -> Result<(TetMesh, Option<CellData>), InputError> {
    let mut raw = read_raw(path, true)?;
    let data = raw.cell_data.take();
    Ok((raw.finish(unit)?, data))
}

fn read_raw(path: &Path, with_cell_data: bool) -> Result<RawMesh, InputError> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    if matches!(extension.as_str(), "node" | "ele") {
        let [node, ele] = tetgen::load(path)?;
        return MeshBytes::TetGen { node: &node, ele: &ele }.read_raw(path, with_cell_data);
    }
    let bytes = std::fs::read(path).map_err(|e| InputError::unreadable(path, &e))?;
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(256)]).trim_start().to_lowercase();
    let content = if head.starts_with("$meshformat") || extension == "msh" {
        MeshBytes::Gmsh(&bytes)
    } else if head.starts_with("# vtk") || extension == "vtk" {
        MeshBytes::Vtk(&bytes)
    } else if head.starts_with("<?xml") || head.starts_with("<vtkfile") || extension == "vtu" {
        MeshBytes::Vtu(&bytes)
    } else {
        return Err(InputError::new(
            path,
            "the mesh format is not known from content or extension",
            "save it as Gmsh .msh (2.2 or 4.1), VTK .vtk, VTU .vtu or TetGen .node/.ele",
        ));
    };
    content.read_raw(path, with_cell_data)
}

/// The content of a mesh file in memory, for callers without a file.
#[derive(Debug, Clone, Copy)]
pub enum MeshBytes<'a> {
    /// Gmsh `.msh`, version 2.2 or 4.1, text or binary.
    Gmsh(&'a [u8]),
    /// VTK legacy `.vtk`, ASCII or binary.
    Vtk(&'a [u8]),
    /// VTK's XML format `.vtu`.
    Vtu(&'a [u8]),
    /// The two files of TetGen.
    TetGen {
        /// The `.node` file.
        node: &'a [u8],
        /// The `.ele` file.
        ele: &'a [u8],
    },
}

impl MeshBytes<'_> {
    /// Reads the mesh as [`read`] does. Errors name `path`, which is not opened.
    pub fn read(self, path: &Path, unit: LengthUnit) -> Result<TetMesh, InputError> {
        self.read_raw(path, false)?.finish(unit)
    }

    /// Reads the mesh as a scene with `[mesh] regions` does: each array of whole numbers of the cells becomes
    /// groups of volumes.
    pub fn read_with_regions(self, path: &Path, unit: LengthUnit) -> Result<TetMesh, InputError> {
        let mut raw = self.read_raw(path, true)?;
        let data = raw.cell_data.take().unwrap_or_default();
        let mut mesh = raw.finish(unit)?;
        data.names()
            .into_iter()
            .filter_map(|name| data.regions(name).ok())
            .for_each(|it| mesh.add_regions(it));
        Ok(mesh)
    }

    fn read_raw(self, path: &Path, with_cell_data: bool) -> Result<RawMesh, InputError> {
        match self {
            Self::Gmsh(bytes) => gmsh::read(path, bytes),
            Self::Vtk(bytes) => vtk::read_legacy(path, bytes, with_cell_data),
            Self::Vtu(bytes) => vtu::read(path, bytes, with_cell_data),
            Self::TetGen { node, ele } => tetgen::read(path, node, ele),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_unit_is_found_by_its_symbol() {
        let per_metre = ["m", "cm", "mm"].map(|symbol| symbol.parse().map(LengthUnit::per_metre));
        assert_eq!(per_metre, [Ok(1.0), Ok(100.0), Ok(1000.0)]);
        assert!("inch".parse::<LengthUnit>().is_err());
    }

    #[test]
    fn unknown_formats_and_missing_files_say_what_would_do() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let path = dir.path().join("body.stl");
        std::fs::write(&path, "solid x").expect("written");
        let error = read(&path, LengthUnit::Metre).unwrap_err();
        assert!(error.to_string().contains("body.stl: the mesh format is not known"), "{error}");
        assert!(error.fix.contains("Gmsh .msh"), "{error}");
        let missing = read(&dir.path().join("none.msh"), LengthUnit::Metre).unwrap_err();
        assert!(missing.to_string().contains("none.msh: cannot read the file"), "{missing}");
        assert!(missing.fix.contains("check the path"), "{missing}");
    }
}

/// Small meshes for the tests of this crate.
#[cfg(test)]
pub(crate) mod testing {
    use super::TetMesh;

    /// A tet with vertices at the origin and at the three unit points.
    pub(crate) fn unit_tet() -> (Vec<[f64; 3]>, Vec<[u32; 4]>) {
        (vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], vec![[0, 1, 2, 3]])
    }

    /// A cube of side `side_m`, divided into `cells`^3 cubes of six tets each.
    pub(crate) fn cube(cells: usize, side_m: f64) -> TetMesh {
        TetMesh::cuboid([cells; 3], side_m / cells as f64)
    }

    /// A box of `cells` cubes of edge `edge_m`. Its nodes are moved off the lattice, those of a face within
    /// the face, so that no symmetry hides an error.
    pub(crate) fn box_mesh(cells: [usize; 3], edge_m: f64) -> TetMesh {
        let mut mesh = TetMesh::cuboid(cells, edge_m);
        for x in &mut mesh.nodes_m {
            let at = x.map(|x| (x / edge_m).round() as usize);
            let [i, j, k] = at;
            for axis in 0..3 {
                let wobble = ((7 * i + 11 * j + 13 * k + 4 * axis + 1) % 17) as f64 / 17.0 - 0.5;
                if at[axis] != 0 && at[axis] != cells[axis] {
                    x[axis] += 0.3 * wobble * edge_m;
                }
            }
        }
        mesh.check().expect("the box is a valid mesh");
        mesh
    }

    /// Nodes of a mesh that `keep` accepts.
    pub(crate) fn nodes_where(mesh: &TetMesh, keep: impl Fn([f64; 3]) -> bool) -> Vec<u32> {
        (0..mesh.nodes_m.len() as u32).filter(|&n| keep(mesh.nodes_m[n as usize])).collect()
    }
}
