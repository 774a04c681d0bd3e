//! Bodies with the nodes and the state of another one: with quadratic elements near a place only, and a part of its
//! elements.

use std::sync::OnceLock;

use super::{ABSENT, Body, Element, Follower, Region};
use crate::fem::element::{EDGES, Order};
use crate::fem::material::Material;
use crate::fem::pressure::{PressurePair, pressure_block};
use crate::num::vector::distance;

impl Body {
    /// A body of second order with quadratic shape functions only in the tetrahedra with a vertex within `reach_m`
    /// of a place of the undeformed body, and linear ones beyond.
    ///
    /// State, nodes and faces are those of this body. On an edge of a linear element the mid-edge node is the mean
    /// of the ends, so the displacement is continuous. The pressures of linear elements are stabilised
    /// ([`PressurePair::Stabilised`]), because equal orders are not stable by themselves.
    ///
    /// # Panics
    ///
    /// If the body is of first order, or has a body force: its rest state would be another one.
    pub fn quadratic_near(&self, place_m: [f64; 3], reach_m: f64) -> Self {
        assert!(self.order == Order::Quadratic && self.followers.is_empty() && !self.is_loaded());
        let near: Vec<bool> = self.nodes_m.iter().map(|&x| distance(x, place_m) <= reach_m).collect();
        let is_near = |nodes: &[u32]| nodes[..4].iter().any(|&node| near[node as usize]);
        let mut follows = vec![false; self.nodes_m.len()];
        let mut followers = Vec::new();
        for nodes in self.element_nodes().filter(|nodes| !is_near(nodes)) {
            for (&node, ends) in nodes[4..].iter().zip(EDGES) {
                if !std::mem::replace(&mut follows[node as usize], true) {
                    followers.push(Follower { node, ends: ends.map(|end| nodes[end]) });
                }
            }
        }
        let is_linear = |&index: &usize| self.nodes_of(index)[4..].iter().all(|&node| follows[node as usize]);
        let (linear, quadratic): (Vec<_>, Vec<_>) = (0..self.elements.len()).partition(is_linear);
        let order = [linear.as_slice(), &quadratic].concat();
        let element = |(number, &index): (usize, &usize)| {
            let mut element = self.elements[index];
            if number >= linear.len() {
                element.follows = std::array::from_fn(|e| follows[self.nodes_of(index)[4 + e] as usize]);
            } else if element.pressures[0] != ABSENT {
                let Region { material, bulk_modulus_pa } = &self.regions[usize::from(element.region)];
                let (shear_pa, pair) = (material.shear_modulus_pa(), PressurePair::Stabilised);
                element.pressure_block =
                    pressure_block(element.tet.volume_m3, shear_pa, *bulk_modulus_pa, pair);
            }
            element
        };
        let elements: Vec<Element> = order.iter().enumerate().map(element).collect();
        let has_pressure_blocks = elements.iter().any(|element| element.pressure_block[0][0] != 0.0);
        let body = self.of_elements(&order, elements, linear.len(), self.regions.clone());
        Self { has_pressure_blocks, followers, external_force_n: self.external_force_n.clone(), ..body }
    }

    /// These elements alone, in ascending order, all of one law without a pressure and without a body force.
    pub(crate) fn part(&self, order: &[usize], law: Material) -> Self {
        let of_law = |&index: &usize| Element {
            region: 0,
            pressures: [ABSENT; 4],
            pressure_block: [[0.0; 4]; 4],
            ..self.elements[index]
        };
        let linear = order.partition_point(|&index| index < self.linear);
        self.of_elements(order, order.iter().map(of_law).collect(), linear, vec![law.into()])
    }

    /// A body of these elements, numbered in `order` in this body, without a body force.
    fn of_elements(
        &self,
        order: &[usize],
        elements: Vec<Element>,
        linear: usize,
        regions: Vec<Region>,
    ) -> Self {
        Self {
            order: self.order,
            elements,
            linear,
            followers: self.followers.clone(),
            connectivity: order.iter().flat_map(|&index| self.nodes_of(index)).copied().collect(),
            nodes_m: self.nodes_m.clone(),
            regions,
            pressure_sites: self.pressure_sites.clone(),
            has_pressure_blocks: false,
            fixed: self.fixed.clone(),
            external_force_n: vec![0.0; self.external_force_n.len()],
            edge_m: self.edge_m,
            rest_state: self.rest_state.clone(),
            rest_energy_j: self.rest_energy_j,
            mean_shear_pa: self.mean_shear_pa,
            elimination_order: OnceLock::new(),
            skin: OnceLock::new(),
        }
    }
}
