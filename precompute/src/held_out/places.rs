//! Places of uniform positions between contact points.
//!
//! Where a hand slides over contact points, it rarely is at one of them. So a uniform position of a contact
//! point is at a random place of a random triangle round it. Its solution has the error of the interpolation
//! in the displacement and the error of the blend between the contact points.

use super::positions::{Draw, place_numbers};
use crate::mesh::{SkinPoint, Surface, TetMesh};
use crate::spec::ContactSurface;

/// A place between contact points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Active nodes at the corners of its triangle.
    pub corners: [u32; 3],
    /// Barycentric weight of each corner.
    pub weights: [f64; 3],
}

/// The contact points of a body, and its skin.
#[derive(Debug, Clone)]
pub struct Places {
    contacts: ContactSurface,
    /// Numbers of the triangles round each contact point.
    around: Vec<Vec<usize>>,
    mesh: TetMesh,
    skin: Surface,
}

impl Places {
    /// The places between these contact points of a mesh; `None` if they have no triangles.
    pub fn of(contacts: Option<ContactSurface>, mesh: &TetMesh) -> Option<Self> {
        let contacts = contacts.filter(|contacts| !contacts.triangles.is_empty())?;
        let mut around = vec![Vec::new(); contacts.points.len()];
        for (number, corners) in contacts.triangles.iter().enumerate() {
            for &corner in corners {
                around[corner as usize].push(number);
            }
        }
        Some(Self { contacts, around, mesh: mesh.clone(), skin: Surface::of(mesh) })
    }

    /// The place of uniform position `number` of the active node number `active`, `name`. `None` if it is no
    /// corner of a triangle.
    pub fn drawn(&self, draw: &Draw, active: usize, name: &str, number: u32) -> Option<Place> {
        let [which, a, b] = place_numbers(draw, name, number);
        let around = self.around.get(active)?;
        let chosen = (which * around.len() as f64) as usize;
        let corners = self.contacts.triangles[*around.get(chosen)?];
        // Uniform over the triangle: the half of the parallelogram beyond its diagonal is reflected.
        let [a, b] = if a + b > 1.0 { [1.0 - a, 1.0 - b] } else { [a, b] };
        Some(Place { corners, weights: [1.0 - a - b, a, b] })
    }

    /// The point of the skin nearest to a place of the triangles between the contact points.
    pub fn on_skin(&self, place: &Place) -> Option<SkinPoint> {
        let corner = |active: u32| {
            self.contacts.points[active as usize].interpolate(|node| self.mesh.nodes_m[node as usize])
        };
        let flat = SkinPoint { triangle: place.corners, weights: place.weights }.interpolate(corner);
        self.skin.nearest(&self.mesh, flat)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::{Fingertip, PadProfile};

    fn places() -> Places {
        let mesh = TetMesh::cuboid([4, 4, 1], 0.01);
        let skin = Surface::of(&mesh);
        let top: Vec<[u32; 3]> = skin
            .triangles
            .iter()
            .filter(|corners| corners.iter().all(|&node| mesh.nodes_m[node as usize][2] > 0.009))
            .copied()
            .collect();
        let fingertip = Fingertip { radius_m: 0.01, stiffness_pa_m: 5e6, profile: PadProfile::Quartic };
        let mut nodes: Vec<u32> = top.iter().flatten().copied().collect();
        nodes.sort_unstable();
        nodes.dedup();
        let number = |node: u32| nodes.binary_search(&node).expect("a corner") as u32;
        let point = |&node: &u32| {
            let triangle = *top.iter().find(|corners| corners.contains(&node)).expect("a triangle");
            let weights = triangle.map(|corner| f64::from(u8::from(corner == node)));
            SkinPoint { triangle, weights }
        };
        let points = nodes.iter().map(point).collect();
        let triangles = top.iter().map(|corners| corners.map(number)).collect();
        Places::of(Some(ContactSurface { fingertip, points, triangles }), &mesh).expect("triangles")
    }

    #[test]
    fn places_fill_the_triangles_round_their_contact_point() {
        let places = places();
        let (mut mean, count) = ([0.0; 3], 2_000);
        let centre = 12;
        let mut visited = vec![0; places.contacts.triangles.len()];
        for number in 0..count {
            let place = places.drawn(&Draw::PAPER, centre, "T", number).expect("a corner");
            let triangle = places.contacts.triangles.iter().position(|corners| *corners == place.corners);
            visited[triangle.expect("a triangle")] += 1;
            assert!(place.corners.contains(&(centre as u32)) && place.weights.iter().all(|w| *w >= 0.0));
            assert!((place.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            let at = places.on_skin(&place).expect("skin");
            let at_m = at.interpolate(|node| places.mesh.nodes_m[node as usize]);
            let flat = SkinPoint { triangle: place.corners, weights: place.weights }.interpolate(|active| {
                places.contacts.points[active as usize].interpolate(|node| places.mesh.nodes_m[node as usize])
            });
            assert!(crate::num::vector::distance(at_m, flat) < 1e-12, "the top is plane");
            for (mean, x) in mean.iter_mut().zip(place.weights) {
                *mean += x / f64::from(count);
            }
        }
        assert!(mean.iter().all(|x| (x - 1.0 / 3.0).abs() < 0.02), "{mean:?}");
        let round = &places.around[centre];
        assert!(
            round.len() > 3 && round.iter().all(|&n| visited[n] > 2_000 / (2 * round.len())),
            "{visited:?}"
        );
        let drawn = |name, number| places.drawn(&Draw::PAPER, centre, name, number);
        assert!(drawn("T", 3) == drawn("T", 3) && drawn("T", 3) != drawn("U", 3));
        assert_eq!(places.drawn(&Draw::PAPER, 999, "T", 3), None);
    }
}
