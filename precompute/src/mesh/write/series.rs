//! PVD: a list of VTU files with their times, which ParaView shows as an animation.

use std::path::{Path, PathBuf};

use super::{Grid, escaped};
use crate::files::write_atomically;

/// A growing series: `NAME.pvd`, and `NAME/step_0000.vtu`, `NAME/step_0001.vtu`, ...
///
/// The list is rewritten after each step, so that an interrupted run leaves a valid series. Files of an
/// earlier, longer run of the same name remain in the folder but are not in the list.
#[derive(Debug)]
pub struct Series {
    path: PathBuf,
    entries: String,
    steps: usize,
}

impl Series {
    /// Starts a series and replaces an existing list by an empty one.
    ///
    /// `path` is the path of the list. It must have an extension, because the folder's name is `path` without
    /// it.
    pub fn create(path: &Path) -> std::io::Result<Self> {
        if path.extension().is_none() {
            let what = "the name of a series needs its extension .pvd";
            return Err(std::io::Error::new(std::io::ErrorKind::InvalidInput, what));
        }
        let series = Self { path: path.to_path_buf(), entries: String::new(), steps: 0 };
        std::fs::create_dir_all(series.folder())?;
        series.write_list()?;
        Ok(series)
    }

    /// Folder of the steps.
    fn folder(&self) -> PathBuf {
        self.path.with_extension("")
    }

    /// Writes the next step, then the list that includes it.
    pub fn add(&mut self, time: f64, grid: &Grid<'_>) -> std::io::Result<()> {
        let file = format!("step_{:04}.vtu", self.steps);
        let folder = self.folder();
        grid.write(&folder.join(&file))?;
        // Relative to the list, so that list and folder can be moved together.
        let folder = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        self.entries.push_str(&format!(
            "<DataSet timestep=\"{time:?}\" part=\"0\" file=\"{}/{file}\"/>\n",
            escaped(&folder)
        ));
        self.steps += 1;
        self.write_list()
    }

    fn write_list(&self) -> std::io::Result<()> {
        let text = format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\" byte_order=\"LittleEndian\">\n\
             <Collection>\n{}</Collection>\n</VTKFile>\n",
            self.entries
        );
        write_atomically(&self.path, text.as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use roxmltree::Document;

    use super::*;
    use crate::mesh::LengthUnit;
    use crate::mesh::testing::cube;
    use crate::mesh::write::{Cell, Field};

    /// Times and files of the list, each file read as a mesh.
    fn list(path: &Path) -> Vec<(f64, String)> {
        let text = std::fs::read_to_string(path).expect("the list is there");
        let document = Document::parse(&text).expect("well-formed XML");
        assert_eq!(document.root_element().attribute("type"), Some("Collection"));
        let sets = document.descendants().filter(|node| node.has_tag_name("DataSet"));
        sets.map(|set| {
            let file = set.attribute("file").expect("a file").to_owned();
            let whole = path.parent().expect("a folder").join(&file);
            crate::mesh::read(&whole, LengthUnit::Metre).unwrap_or_else(|error| panic!("{error}"));
            (set.attribute("timestep").expect("a time").parse().expect("a number"), file)
        })
        .collect()
    }

    #[test]
    fn after_each_step_the_list_is_whole() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a & b.pvd");
        let mesh = cube(1, 0.1);
        let mut series = Series::create(&path).expect("created");
        assert_eq!(list(&path), [], "from the start");
        let mut expected = Vec::new();
        for step in 0..3 {
            let u = vec![f64::from(step); 24];
            let point_data = [Field { name: "displacement_m", components: 3, values: &u }];
            let grid = Grid {
                nodes_m: &mesh.nodes_m,
                cell: Cell::Tet4,
                connectivity: mesh.tets.as_flattened(),
                point_data: &point_data,
                cell_data: &[],
                field_data: &[],
            };
            let time = 0.1 * f64::from(step);
            series.add(time, &grid).expect("added");
            expected.push((time, format!("a & b/step_000{step}.vtu")));
            assert_eq!(list(&path), expected);
            // A step that cannot be written is not listed.
            let broken = [Field { name: "u", components: 3, values: &[0.0] }];
            assert!(series.add(9.0, &Grid { point_data: &broken, ..grid }).is_err());
            assert_eq!(list(&path), expected);
        }
        let again = Series::create(&path).expect("a second run");
        assert_eq!(list(&path), []);
        assert!(again.folder().join("step_0002.vtu").exists());
    }

    #[test]
    fn a_series_without_extension_or_with_a_file_in_its_way_is_refused() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        assert!(Series::create(&folder.path().join("bare")).is_err());
        std::fs::write(folder.path().join("taken"), "a file").expect("written");
        assert!(Series::create(&folder.path().join("taken.pvd")).is_err());
        assert!(!folder.path().join("taken.pvd").exists());
    }
}
