//! The mesh of a scene, and the regions of its materials.

use toml::Spanned;

use super::file::{MeshTable, tables};
use super::lookup::Lookup;
use super::place::Place;
use super::{MaterialRegion, Scene, material};
use crate::error::{InputError, count, nearest_word};
use crate::mesh::{self, CellData, LengthUnit, RegionFault, TetMesh};

/// Regions without a material that an error names.
const MAX_NAMED: usize = 4;

/// Reads the mesh of a scene; the cell array `regions` becomes groups of volumes.
pub(super) fn load_mesh(scene: &Scene) -> Result<TetMesh, InputError> {
    let place = &scene.place;
    let table = scene.file.mesh.get_ref();
    let unit = unit(place, table)?;
    let path = scene.mesh_path();
    // A missing file is an error in the scene; an invalid file is an error in the mesh.
    if let Err(error) = std::fs::File::open(&path) {
        let what = format!("cannot open the mesh {} ({error})", path.display());
        return Err(place.error(
            table.file.span(),
            what,
            "correct `file` (it is relative to the scene file)",
        ));
    }
    let Some(regions) = &table.regions else { return mesh::read(&path, unit) };
    let (mut mesh, data) = mesh::read_with_cell_data(&path, unit)?;
    let Some(data) = data else {
        let what = format!("`regions` names cell data, and the format of {} has none", path.display());
        return Err(place.error(
            regions.span(),
            what,
            "remove it, and name the groups of the file in [[material]]",
        ));
    };
    let of_array = data.regions(regions.get_ref()).map_err(|fault| explain(place, regions, &data, fault))?;
    mesh.add_regions(of_array);
    Ok(mesh)
}

fn unit(place: &Place, table: &MeshTable) -> Result<LengthUnit, InputError> {
    let Some(word) = &table.unit else { return Ok(LengthUnit::Metre) };
    word.get_ref().parse().map_err(|_| {
        let what = format!("unknown unit \"{}\"", word.get_ref());
        place.error(word.span(), what, "use \"m\", \"cm\" or \"mm\"")
    })
}

fn explain(place: &Place, regions: &Spanned<String>, data: &CellData, fault: RegionFault) -> InputError {
    let name = regions.get_ref();
    let names = data.names();
    let others = names.join(", ");
    let numbers = || format!("name an array with one whole number per cell (the file has: {others})");
    let (what, fix) = match fault {
        RegionFault::Missing => {
            let fix = match nearest_word(name, names.iter().copied()) {
                _ if names.is_empty() => "the file has none: export the region numbers as cell data".into(),
                Some(guess) => format!("did you mean \"{guess}\"? (the file has: {others})"),
                None => format!("use one of: {others}"),
            };
            (format!("the mesh has no cell array of numbers named \"{name}\""), fix)
        }
        RegionFault::Components(n) => {
            (format!("the cell array \"{name}\" has {n} numbers per cell"), numbers())
        }
        RegionFault::Fraction { cell, number } => {
            (format!("cell {cell} has {number} in the array \"{name}\", which is no whole number"), numbers())
        }
    };
    place.error(regions.span(), what, fix)
}

impl Lookup<'_> {
    /// The materials; their groups share no tet and cover the body.
    pub(super) fn materials(&mut self, scene: &Scene) -> Result<Vec<MaterialRegion>, InputError> {
        let tables = tables(&scene.file.material);
        let mut owner: Vec<Option<usize>> = vec![None; self.mesh.tets.len()];
        let mut regions = Vec::new();
        for (index, table) in tables.iter().enumerate() {
            let (law, bulk_modulus_pa) = material::law(self.place, table, &mut self.warnings)?;
            let tets = match &table.table.group {
                Some(group) => {
                    let members = self.group(&self.mesh.tet_groups, "volumes", group);
                    Some(members.map_err(|error| self.in_cell_data(scene, group, error))?.to_vec())
                }
                None if tables.len() > 1 => {
                    let what = "one of several [[material]] tables has no `group`";
                    return Err(self.place.error(table.span.clone(), what, "name the group of each region"));
                }
                None => None,
            };
            for &tet in tets.iter().flatten() {
                if owner[tet as usize].replace(index).is_some() {
                    let what =
                        format!("tet {tet} (0-based) already has a material from another [[material]]");
                    return Err(self.place.error(
                        table.span.clone(),
                        what,
                        "let the groups share no element",
                    ));
                }
            }
            regions.push(MaterialRegion { material: law, bulk_modulus_pa, tets });
        }
        let Some(last) = tables.last() else {
            return Err(self.place.error(
                scene.file.material.span(),
                "[[material]] is empty",
                "add a [material]",
            ));
        };
        let bare: Vec<bool> = owner.iter().map(Option::is_none).collect();
        if regions.iter().all(|region| region.tets.is_some()) && bare.contains(&true) {
            let array = scene.file.mesh.get_ref().regions.as_ref();
            let (what, fix) = self.without_material(&bare, array);
            return Err(self.place.error(last.span.clone(), what, fix));
        }
        Ok(regions)
    }

    /// What is wrong with tets without a material, and the fix. Groups that contain only such tets are named.
    fn without_material(&self, bare: &[bool], array: Option<&Spanned<String>>) -> (String, String) {
        let groups = self.mesh.tet_groups.iter();
        let mut named: Vec<(&str, usize)> = groups
            .filter(|(_, tets)| tets.iter().all(|&tet| bare[tet as usize]))
            .map(|(name, tets)| (name.as_str(), tets.len()))
            .collect();
        // Numbers in their order, not in that of their digits.
        named.sort_by_key(|(name, _)| name.parse::<i64>().unwrap_or_default());
        let Some(&(first, _)) = named.first() else {
            let n = bare.iter().filter(|bare| **bare).count();
            let what = format!("{} of the mesh without a material", count(n, "tet"));
            return (what, "add a [[material]] for the rest".into());
        };
        let (noun, of) = match array {
            Some(array) => ("value", format!(" of \"{}\"", array.get_ref())),
            None => ("group", String::new()),
        };
        let quote = |name: &str| if array.is_some() { name.to_owned() } else { format!("\"{name}\"") };
        let listed =
            named.iter().take(MAX_NAMED).map(|(name, n)| format!("{} ({})", quote(name), count(*n, "tet")));
        let mut list = listed.collect::<Vec<_>>().join(", ");
        if named.len() > MAX_NAMED {
            list.push_str(&format!(" and {} more", named.len() - MAX_NAMED));
        }
        let (plural, has) = if named.len() == 1 { ("", "has") } else { ("s", "have") };
        let fix = match named.len() {
            1 => format!("add a [[material]] with group = \"{first}\""),
            _ => format!("add a [[material]] for each, the first with group = \"{first}\""),
        };
        (format!("{noun}{plural} {list}{of} {has} no [[material]]"), fix)
    }

    /// The error of a group that is missing; its fix names the cell array that numbers such a region, if there
    /// is one.
    fn in_cell_data(&self, scene: &Scene, group: &Spanned<String>, error: InputError) -> InputError {
        let table = scene.file.mesh.get_ref();
        if !self.has_file || table.regions.is_some() {
            return error;
        }
        // The unit does not matter here, and the mesh was read before.
        let data = mesh::read_with_cell_data(&scene.mesh_path(), LengthUnit::Metre);
        let data = data.ok().and_then(|(_, data)| data).unwrap_or_default();
        match data.with_region(group.get_ref())[..] {
            [] => error,
            [array] => {
                let fix = format!(
                    "the cell array \"{array}\" has this value: add `regions = \"{array}\"` to [mesh]"
                );
                InputError { fix, ..error }
            }
            ref arrays => {
                let arrays = arrays.join("\" or \"");
                let fix = format!(
                    "add the cell array that numbers the regions to [mesh]: `regions` = \"{arrays}\""
                );
                InputError { fix, ..error }
            }
        }
    }
}
