//! Check that the pressures of a body are unique.
//!
//! If the pressure's quadratic form is zero ([`super::pressure`]), the displacements alone must determine the
//! pressures. Two kinds of boundary conditions prevent this. [`Body::check_pressures`] refuses both before
//! the solver fails with a singular matrix.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;

use crate::fem::body::{ABSENT, Body};
use crate::fem::boundary::{Handle, prescribed};
use crate::fem::element::{LINEAR, Order, Point, QUADRATIC};
use crate::mesh::surface::UnionFind;

/// Why the pressures of an incompressible part of the body are not unique.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PressureFault {
    /// No free displacement component changes the volume of the part. Any constant can then be added to its
    /// pressure, and a moving handle on its surface would prescribe an impossible change of volume.
    #[error(
        "the incompressible part around node {node} (material {region}, {law}) is held on its whole surface, so that its \
         volume cannot change and its mean pressure is undetermined; fix fewer surface nodes, or give the material a `bulk_pa`"
    )]
    Undetermined {
        /// Index of the region.
        region: u16,
        /// Name of its law.
        law: &'static str,
        /// Lowest mesh node of the part.
        node: u32,
    },
    /// The part has more volume constraints than free displacement components: it locks, and its pressures
    /// are not unique.
    #[error(
        "the incompressible part around node {node} (material {region}, {law}) has {pressures} pressure unknowns against \
         {free} free displacement components and locks; fix fewer nodes, use `order = 2`, or give the material a `bulk_pa`"
    )]
    Locked {
        /// Index of the region.
        region: u16,
        /// Name of its law.
        law: &'static str,
        /// Lowest mesh node of the part.
        node: u32,
        /// Number of pressure unknowns of the part.
        pressures: usize,
        /// Number of free displacement components of the part.
        free: usize,
    },
}

/// A volume derivative below this share of its summands is rounding error.
const ZERO_DERIVATIVE: f64 = 1e-10;

/// A part of the body whose pressures are coupled.
#[derive(Debug)]
struct Part {
    region: u16,
    /// Whether the quadratic form determines the pressures up to their mean.
    stabilised: bool,
    /// Its pressure unknowns.
    pressures: BTreeSet<u32>,
    /// For each node, the derivative of the part's volume with respect to the node's displacement, and the
    /// magnitude of the summands.
    slopes: BTreeMap<u32, (Vector3<f64>, f64)>,
}

impl Body {
    /// Checks that the pressures of all incompressible parts are unique with the tool on `handle` (`None`:
    /// for the rest state under the body force).
    ///
    /// A part is a set of movable elements coupled by pressure unknowns. In it the pressure acts through B^T
    /// q with B_va = int N_v dJ/du_a. The check detects two faults:
    ///
    /// - B^T 1 = 0 on the free components: dV/du_a = int grad N_a dV vanishes for all of them. This is the
    ///   case if every node on the part's surface is prescribed (interior nodes have a zero derivative,
    ///   because the gradients around them cancel), and also if rollers keep the faces of a box in their
    ///   planes.
    /// - More pressures than free components: B^T then has a kernel for any geometry. Stabilised pairs are
    ///   accepted, because their quadratic form determines the pressures up to the mean.
    ///
    /// A finite bulk modulus removes both faults. The check is necessary and not sufficient: P1/P1 passes it,
    /// although its pressures oscillate.
    pub fn check_pressures(&self, handle: Option<&Handle>) -> Result<(), PressureFault> {
        let parts = match self.order {
            Order::Linear => self.incompressible_parts::<4>(handle, &LINEAR),
            Order::Quadratic => self.incompressible_parts::<10>(handle, &QUADRATIC),
        };
        let held = prescribed(self, handle);
        for Part { region, stabilised, pressures, slopes } in parts {
            let free = || {
                slopes.iter().flat_map(|(&node, (slope, size))| {
                    let held = held[node as usize];
                    (0..3).filter(move |&axis| !held[axis]).map(move |axis| slope[axis].abs() / size)
                })
            };
            let law = self.regions[usize::from(region)].material.name();
            // Vertices precede mid-edge nodes, so the lowest node is a mesh node.
            let node = slopes.keys().next().copied().unwrap_or_default();
            if free().all(|slope| slope <= ZERO_DERIVATIVE) {
                return Err(PressureFault::Undetermined { region, law, node });
            }
            let (pressures, free) = (pressures.len(), free().count());
            if pressures > free && !stabilised {
                return Err(PressureFault::Locked { region, law, node, pressures, free });
            }
        }
        Ok(())
    }

    /// The parts without a bulk modulus.
    fn incompressible_parts<const N: usize>(&self, handle: Option<&Handle>, rule: &[Point<N>]) -> Vec<Part> {
        let held = prescribed(self, handle);
        let moves = |index: usize| self.nodes_of(index).iter().any(|&n| held[n as usize] != [true; 3]);
        let moving: Vec<usize> = (0..self.elements.len())
            .filter(|&index| {
                let element = &self.elements[index];
                element.pressures[0] != ABSENT
                    && self.regions[usize::from(element.region)].bulk_modulus_pa.is_none()
                    && moves(index)
            })
            .collect();
        let mut sets = UnionFind::new(self.pressure_sites.len());
        for &index in &moving {
            let [first, rest @ ..] = self.elements[index].pressures;
            for pressure in rest {
                sets.join(first as usize, pressure as usize);
            }
        }
        // Mean of dN_a/dlambda_k over the element.
        let mean: [[f64; 4]; N] = std::array::from_fn(|a| {
            std::array::from_fn(|k| rule.iter().map(|p| p.weight * p.slopes[a][k]).sum())
        });
        let mut parts: BTreeMap<usize, Part> = BTreeMap::new();
        for &index in &moving {
            let element = &self.elements[index];
            let part = parts.entry(sets.root(element.pressures[0] as usize)).or_insert_with(|| Part {
                region: element.region,
                stabilised: element.pressure_block[0][0] != 0.0,
                pressures: BTreeSet::new(),
                slopes: BTreeMap::new(),
            });
            part.pressures.extend(element.pressures);
            let gradients = &element.tet.gradients;
            let size = element.tet.volume_m3 * gradients.iter().map(Vector3::norm).fold(0.0, f64::max);
            for (&node, mean) in self.nodes_of(index).iter().zip(&mean) {
                let gradient: Vector3<f64> = gradients.iter().zip(mean).map(|(g, m)| g * *m).sum();
                let (slope, sizes) = part.slopes.entry(node).or_insert((Vector3::zeros(), 0.0));
                *slope += gradient * element.tet.volume_m3;
                *sizes += size;
            }
        }
        parts.into_values().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::body::{Model, Region};
    use crate::fem::material::{Lame, Material, MooneyRivlin, NeoHookean};
    use crate::fem::pressure::{PressurePair, pressure_block};
    use crate::mesh::testing::cube;
    use crate::mesh::{Surface, TetMesh};

    const CELLS: usize = 4;

    fn incompressible() -> Material {
        Material::MooneyRivlin(MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 })
    }

    fn block() -> (TetMesh, Vec<u32>) {
        let mesh = cube(CELLS, 0.1);
        let skin = Surface::of(&mesh).nodes;
        (mesh, skin)
    }

    fn check(model: &Model, handle: Option<u32>) -> Result<(), PressureFault> {
        let body = Body::new(&block().0, model).expect("the cube is sound");
        body.check_pressures(handle.map(Handle::node).as_ref())
    }

    fn is_undetermined(outcome: Result<(), PressureFault>) -> bool {
        matches!(outcome, Err(PressureFault::Undetermined { .. }))
    }

    #[test]
    fn a_surface_held_as_a_whole_is_refused_and_one_free_node_is_enough() {
        let (_, skin) = block();
        for order in [Order::Linear, Order::Quadratic] {
            let with = |fixed: &[u32]| Model { order, ..Model::uniform(incompressible(), fixed) };
            let fault = check(&with(&skin), None).expect_err("planted fault");
            assert_eq!(fault, PressureFault::Undetermined { region: 0, law: "mooney-rivlin", node: 0 });
            let line = fault.to_string();
            assert!(line.contains("node 0") && line.contains("`bulk_pa`") && !line.contains('\n'), "{line}");
            // An interior active node is prescribed too and does not change the volume.
            let middle = (0..125).find(|n| !skin.contains(n));
            assert!(is_undetermined(check(&with(&skin), middle)), "{order:?}");
            // The tool prescribes the last surface node: the same fault, unless adjacent mid-edge nodes
            // remain free.
            let (last, others) = skin.split_last().expect("a cube has a surface");
            assert_eq!(is_undetermined(check(&with(others), Some(*last))), order == Order::Linear);
            let free = check(&with(others), None);
            assert!(!is_undetermined(free), "{order:?}: {free:?}");
            let face: Vec<u32> = skin.iter().copied().filter(|n| n % 5 == 0).collect();
            assert_eq!(check(&with(&face), Some(*last)), Ok(()));
        }
    }

    #[test]
    fn a_bulk_modulus_or_a_compressible_law_may_be_held_all_round() {
        let (_, skin) = block();
        let mut model = Model::uniform(incompressible(), &skin);
        model.regions = vec![Region { material: incompressible(), bulk_modulus_pa: Some(1e6) }];
        assert_eq!(check(&model, None), Ok(()));
        let lame = Lame::from_young_poisson(15480.0, 0.49);
        model.regions = vec![Material::NeoHookean(NeoHookean { lame }).into()];
        assert_eq!(check(&model, None), Ok(()));
    }

    #[test]
    fn rollers_on_every_side_keep_the_volume_as_well_as_fixing_does() {
        let (mesh, _) = block();
        let side = |c: f64| c == 0.0 || (c - 0.1).abs() < 1e-12;
        let mut model = Model::uniform(incompressible(), &[]);
        model.rollers = (0u32..).zip(&mesh.nodes_m).map(|(n, x)| (n, x.map(side))).collect();
        assert!(is_undetermined(check(&model, None)));
        // Without the lid the box can swell.
        for ((_, held), x) in model.rollers.iter_mut().zip(&mesh.nodes_m) {
            held[2] = x[2] == 0.0;
        }
        assert_eq!(check(&model, None), Ok(()));
    }

    #[test]
    fn an_incompressible_core_in_a_soft_shell_is_let_through_and_in_a_held_one_refused() {
        let (mesh, skin) = block();
        let inside = |x: [f64; 3]| x.iter().all(|c| (0.0249..0.0751).contains(c));
        let lame = Lame::from_young_poisson(15480.0, 0.45);
        let mut model = Model::uniform(incompressible(), &skin);
        model.regions.push(Material::NeoHookean(NeoHookean { lame }).into());
        let core = |tet: &[u32; 4]| tet.iter().all(|&n| inside(mesh.nodes_m[n as usize]));
        model.region_of_tet = mesh.tets.iter().map(|tet| u16::from(!core(tet))).collect();
        assert_eq!(check(&model, None), Ok(()));
        // All nodes except the middle one: the surface of the core is fixed.
        model.fixed = (0..125).filter(|&n| n != 62).collect();
        assert!(check(&model, None).is_err());
    }

    #[test]
    fn more_pressures_than_free_components_are_refused() {
        let (mesh, _) = block();
        // All surface nodes except one and its inner neighbours.
        let far = |x: &[f64; 3]| x.iter().any(|c| *c > 0.026);
        let mut model = Model::uniform(incompressible(), &[]);
        model.fixed = (0u32..).zip(&mesh.nodes_m).filter(|(_, x)| far(x)).map(|(n, _)| n).collect();
        let fault = check(&model, None).expect_err("planted fault");
        let PressureFault::Locked { pressures, free, .. } = fault else { panic!("{fault}") };
        assert!(pressures > free && free > 0, "{fault}");
        assert!(fault.to_string().contains("`order = 2`"), "{fault}");
        model.pressure_pair = PressurePair::Stabilised;
        assert_eq!(check(&model, None), Ok(()));
        model.pressure_pair = PressurePair::Plain;
        model.order = Order::Quadratic;
        assert_eq!(check(&model, None), Ok(()));
    }

    #[test]
    fn a_constant_pressure_feels_the_bulk_modulus_and_not_the_projection() {
        let sum = |block: [[f64; 4]; 4]| block.iter().flatten().sum::<f64>();
        let bulk = pressure_block(2.0, 100.0, Some(50.0), PressurePair::Plain);
        assert!((sum(bulk) + 2.0 / 50.0).abs() < 1e-16);
        let projected = pressure_block(2.0, 100.0, None, PressurePair::Stabilised);
        assert!(sum(projected).abs() < 1e-16);
        // A linear pressure with the vertex values 1, 0, 0, 0 has the variance 1/10 - 1/16 over the tet.
        assert!((projected[0][0] + 0.5 / 100.0 * 2.0 * (0.1 - 1.0 / 16.0)).abs() < 1e-16);
        assert_eq!(pressure_block(2.0, 100.0, None, PressurePair::Plain), [[0.0; 4]; 4]);
    }
}
