//! Active nodes that a tool can reach.
//!
//! The nodes of a group that a tool cannot reach are excluded: nodes outside the workspace or hidden behind
//! the body's own surface. A node that is named by itself is refused with an error if it lies outside the
//! workspace or on the wall of a cavity.

use serde::{Deserialize, Serialize};

use super::file::GridTable;
use super::place::{Place, finite};
use crate::error::InputError;
use crate::mesh::{Surface, TetMesh};
use crate::num::sequence::on_sphere;
use crate::num::vector::{cross, difference, dot};
use crate::spec::Workspace;

/// Numbers of excluded nodes of groups.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Unreachable {
    /// Number of nodes outside the workspace.
    pub outside: usize,
    /// Number of nodes that are not visible from outside the body.
    pub hidden: usize,
}

impl std::fmt::Display for Unreachable {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { outside, hidden } = self;
        write!(f, "{} active nodes are left out: ", outside + hidden)?;
        write!(f, "{outside} outside the workspace, {hidden} behind the body's own surface")
    }
}

impl Unreachable {
    /// Whether any node is excluded.
    pub fn any(&self) -> bool {
        self.outside + self.hidden > 0
    }
}

/// The workspace of a scene, or `None`.
pub(super) fn workspace(place: &Place, table: &GridTable) -> Result<Option<Workspace>, InputError> {
    let (min, max) = match (&table.workspace_min_m, &table.workspace_max_m) {
        (None, None) => return Ok(None),
        (Some(min), Some(max)) => (min, max),
        (Some(one), None) | (None, Some(one)) => {
            let what = "`workspace_min_m` and `workspace_max_m` belong together";
            return Err(place.error(one.span(), what, "add the other corner of the box, in metres"));
        }
    };
    let [low, high] =
        [("workspace_min_m", min), ("workspace_max_m", max)].map(|(key, at)| finite(place, key, at));
    let (low, high) = (low?, high?);
    if (0..3).all(|axis| low[axis] < high[axis]) {
        return Ok(Some([low, high]));
    }
    let what = format!("the workspace is empty: {low:?} is not below {high:?}");
    Err(place.error(max.span(), what, "swap the corners (metres, in the mesh's frame)"))
}

/// Number of approach directions that are tested; they are about ten degrees apart.
const DIRECTIONS: u32 = 400;

/// Whether every tested ray from a surface node intersects the undeformed body: the node is in a cavity, or
/// in a crevice narrower than the distance between the directions.
pub(super) fn is_blocked(mesh: &TetMesh, skin: &Surface, node: u32) -> bool {
    let along_normal = skin.normal(node).unwrap_or_default();
    let is_free = |direction: [f64; 3]| {
        let away = skin.triangles.iter().filter(|triangle| !triangle.contains(&node));
        let from = mesh.nodes_m[node as usize];
        away.map(|triangle| triangle.map(|n| difference(mesh.nodes_m[n as usize], from)))
            .all(|[a, b, c]| !is_hit(direction, a, b, c))
    };
    // Most nodes are visible along their normal, so that one ray per node usually suffices.
    !std::iter::once(along_normal).chain((0..DIRECTIONS).map(direction)).any(is_free)
}

/// Whether a ray from the origin intersects a triangle, edges included (Moller and Trumbore 1997).
fn is_hit(direction: [f64; 3], a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> bool {
    const RIM: f64 = 1e-9;
    let (ab, ac) = (difference(b, a), difference(c, a));
    let across = cross(direction, ac);
    let determinant = dot(ab, across);
    if determinant == 0.0 {
        return false;
    }
    let from = a.map(|x| -x);
    let u = dot(from, across) / determinant;
    let turned = cross(from, ab);
    let v = dot(direction, turned) / determinant;
    u >= -RIM && v >= -RIM && u + v <= 1.0 + RIM && dot(ac, turned) / determinant > 0.0
}

/// Direction `n` of an even distribution on the sphere (Fibonacci lattice).
fn direction(n: u32) -> [f64; 3] {
    const TURN: f64 = 0.618_033_988_749_894_8;
    let z = 1.0 - (2.0 * f64::from(n) + 1.0) / f64::from(DIRECTIONS);
    on_sphere(z, libm::sincos(std::f64::consts::TAU * (f64::from(n) * TURN).fract()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::cube;

    /// A cube of 5^3 small cubes without the central one; `is_open` adds a tunnel to the side.
    fn hollow(is_open: bool) -> (TetMesh, [Vec<u32>; 2]) {
        let whole = cube(5, 5.0);
        let centre = |tet: &[u32; 4]| -> [f64; 3] {
            std::array::from_fn(|axis| {
                tet.iter().map(|&n| whole.nodes_m[n as usize][axis]).sum::<f64>() / 4.0
            })
        };
        let inside = |x: f64| (2.0..3.0).contains(&x);
        let is_out = |tet: &&[u32; 4]| {
            let [x, y, z] = centre(tet);
            !(inside(y) && inside(z) && (inside(x) || is_open && x > 2.0))
        };
        let tets: Vec<[u32; 4]> = whole.tets.iter().filter(is_out).copied().collect();
        let mesh = TetMesh::new(whole.nodes_m.clone(), tets).expect("sound");
        let is_rim = |x: f64| x == 2.0 || x == 3.0;
        let nodes = |wanted: bool| -> Vec<u32> {
            (0..mesh.nodes_m.len() as u32)
                .filter(|&n| mesh.nodes_m[n as usize].iter().all(|&x| is_rim(x)) == wanted)
                .collect()
        };
        let both = [nodes(true), nodes(false)];
        (mesh, both)
    }

    #[test]
    fn a_cavity_hides_its_nodes_and_a_tunnel_does_not() {
        for is_open in [false, true] {
            let (mesh, [inner, outer]) = hollow(is_open);
            let skin = Surface::of(&mesh);
            assert_eq!(inner.len(), 8);
            // The visible surface excludes the walls of a cavity and includes those of a tunnel.
            let seen = skin.clone().seen(&mesh);
            assert_eq!(skin.nodes.len() - seen.nodes.len(), if is_open { 0 } else { 8 });
            assert_eq!(skin.triangles.len() - seen.triangles.len(), if is_open { 0 } else { 12 });
            assert!(inner.iter().all(|&node| seen.contains(node) == is_open));
            assert_eq!(seen == skin, is_open);
            for node in inner {
                assert_eq!(is_blocked(&mesh, &skin, node), !is_open, "node {node}");
            }
            for node in outer.into_iter().filter(|&n| skin.normal(n).is_some()) {
                assert!(!is_blocked(&mesh, &skin, node), "node {node} at {:?}", mesh.nodes_m[node as usize]);
            }
        }
    }
}
