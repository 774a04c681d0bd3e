//! Numbers of the cells of a mesh file, from which a scene takes its regions.

use std::collections::BTreeMap;

use super::TetMesh;

/// An array of numbers of all cells of a file, tets and others.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct CellArray {
    pub(crate) name: String,
    /// Numbers per cell.
    pub(crate) components: usize,
    /// The numbers of the first cell, then those of the next.
    pub(crate) numbers: Vec<f64>,
}

/// The arrays of a file, and the cell of each tet.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct CellData {
    pub(crate) arrays: Vec<CellArray>,
    /// Position of each tet among the cells.
    pub(crate) cell_of_tet: Vec<usize>,
}

/// Why an array numbers no regions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum RegionFault {
    /// The file has no array of this name.
    Missing,
    /// A cell has several numbers.
    Components(usize),
    /// The number of a tet is not whole.
    Fraction { cell: usize, number: f64 },
}

/// Above this every f64 is whole, and different integers of a file can be the same f64.
const MAX_REGION: f64 = 9_007_199_254_740_992.0;

impl CellData {
    /// Names of the arrays, in file order.
    pub(crate) fn names(&self) -> Vec<&str> {
        self.arrays.iter().map(|array| array.name.as_str()).collect()
    }

    /// Tets of each number of an array, ascending; the names are the numbers.
    pub(crate) fn regions(&self, name: &str) -> Result<BTreeMap<String, Vec<u32>>, RegionFault> {
        let array = self.arrays.iter().find(|array| array.name == name).ok_or(RegionFault::Missing)?;
        if array.components != 1 {
            return Err(RegionFault::Components(array.components));
        }
        let mut regions: BTreeMap<String, Vec<u32>> = BTreeMap::new();
        for (tet, &cell) in (0..).zip(&self.cell_of_tet) {
            let number = array.numbers[cell];
            if number.fract() != 0.0 || number.abs() > MAX_REGION {
                return Err(RegionFault::Fraction { cell, number });
            }
            regions.entry((number as i64).to_string()).or_default().push(tet);
        }
        Ok(regions)
    }

    /// Names of the arrays that number a region like this.
    pub(crate) fn with_region(&self, region: &str) -> Vec<&str> {
        let has = |name: &&str| self.regions(name).is_ok_and(|regions| regions.contains_key(region));
        self.names().into_iter().filter(has).collect()
    }
}

impl TetMesh {
    /// Adds groups of tets, and groups of their nodes with the same names, as a physical group has both.
    pub(crate) fn add_regions(&mut self, regions: BTreeMap<String, Vec<u32>>) {
        for (name, tets) in regions {
            let nodes = self.node_groups.entry(name.clone()).or_default();
            nodes.extend(tets.iter().flat_map(|&tet| self.tets[tet as usize]));
            nodes.sort_unstable();
            nodes.dedup();
            self.tet_groups.insert(name, tets);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three cells of which the second is no tet.
    fn data(components: usize, numbers: &[f64]) -> CellData {
        let array = |name: &str, numbers: &[f64]| CellArray {
            name: name.into(),
            components,
            numbers: numbers.to_vec(),
        };
        CellData { arrays: vec![array("part", numbers), array("other", &[7.0; 6])], cell_of_tet: vec![0, 2] }
    }

    #[test]
    fn whole_numbers_of_tets_are_regions() {
        let regions = data(1, &[-3.0, 0.5, 12.0]).regions("part").expect("the half is no tet's");
        assert_eq!(regions, BTreeMap::from([("-3".into(), vec![0]), ("12".into(), vec![1])]));
        let one = data(1, &[0.0, 1.0, -0.0]).regions("part").expect("whole");
        assert_eq!(one, BTreeMap::from([("0".into(), vec![0, 1])]));
        assert_eq!(data(1, &[7.0, 1.0, 12.0]).with_region("7"), ["part", "other"]);
        assert_eq!(data(1, &[-3.0, 1.0, 12.0]).with_region("1"), [""; 0], "of a cell that is no tet");
    }

    #[test]
    fn other_numbers_are_not() {
        let fault = |components, numbers: &[f64]| data(components, numbers).regions("part").unwrap_err();
        assert_eq!(fault(1, &[1.0, 1.0, 1.5]), RegionFault::Fraction { cell: 2, number: 1.5 });
        for number in [f64::NAN, f64::INFINITY, 1e17] {
            assert!(matches!(fault(1, &[number, 1.0, 1.0]), RegionFault::Fraction { cell: 0, .. }));
        }
        assert_eq!(fault(2, &[1.0; 6]), RegionFault::Components(2));
        assert_eq!(data(1, &[1.0; 3]).regions("Part"), Err(RegionFault::Missing));
    }

    #[test]
    fn a_region_is_a_group_of_tets_and_of_their_nodes() {
        let mut mesh = TetMesh::cuboid([1, 1, 1], 1.0);
        mesh.add_regions(BTreeMap::from([("1".into(), vec![0]), ("2".into(), vec![1, 2, 3, 4, 5])]));
        let mut nodes = mesh.tets[0].to_vec();
        nodes.sort_unstable();
        assert_eq!((&mesh.tet_groups["1"][..], &mesh.node_groups["1"]), (&[0][..], &nodes));
        assert_eq!(mesh.node_groups["2"].len(), 8);
    }
}
