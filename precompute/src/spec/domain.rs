//! The lattice points of one space and the transitions between them.

use std::collections::HashMap;

use palpate_core::CORNERS;

use super::{GridIndex, SpaceGrid};

/// Points to solve and the transitions between them, shared by all active nodes of a scene.
///
/// The ball consists of the lattice points within the radius: the paper's grid. The shell consists of the
/// corners outside the ball of those cells that intersect it. With the shell, each cell that contains a
/// reachable tool position has eight solved corners. Transitions start only in the ball. A shell point is
/// solved only from a point that shares such a cell with it.
#[derive(Debug)]
pub(crate) struct Domain {
    points: Vec<GridIndex>,
    ball: usize,
    position: HashMap<GridIndex, u32>,
    /// Start points of the transitions to each point, best first.
    parents: Vec<Vec<u32>>,
    /// The same transitions in the opposite direction.
    children: Vec<Vec<u32>>,
}

/// Index of the point at rest.
pub(crate) const REST: u32 = 0;

impl Domain {
    /// Points of `grid`, with the shell if `complete_cells`.
    pub(crate) fn new(grid: &SpaceGrid, complete_cells: bool) -> Self {
        let mut points = vec![[0; 3]];
        points.extend(grid.lattice.points());
        let ball = points.len();
        let cells = cells_in_reach(grid);
        if complete_cells {
            let mut shell: Vec<GridIndex> = cells
                .iter()
                .flat_map(|&cell| corners(cell))
                .filter(|&corner| corner != [0; 3] && !grid.lattice.contains(corner))
                .collect();
            shell.sort_unstable();
            shell.dedup();
            points.extend(shell);
        }
        let position: HashMap<GridIndex, u32> =
            points.iter().enumerate().map(|(i, &point)| (point, i as u32)).collect();
        let cells: std::collections::HashSet<GridIndex> = cells.into_iter().collect();
        let parents: Vec<Vec<u32>> = points
            .iter()
            .enumerate()
            .map(|(i, &point)| {
                let mut from: Vec<(i32, i32, GridIndex)> = neighbours()
                    .map(|offset| (squared(offset), plus(point, offset)))
                    .filter(|(_, other)| position.get(other).is_some_and(|&p| (p as usize) < ball))
                    .filter(|&(_, other)| i < ball || share_a_cell(point, other, &cells))
                    .map(|(distance, other)| (distance, squared(other), other))
                    .collect();
                // Order: the nearest first, then the one closest to rest, then by index.
                from.sort_unstable();
                from.into_iter().map(|(.., other)| position[&other]).collect()
            })
            .collect();
        let mut children = vec![Vec::new(); points.len()];
        for (child, from) in parents.iter().enumerate() {
            for &parent in from {
                children[parent as usize].push(child as u32);
            }
        }
        Self { points, ball, position, parents, children }
    }

    /// Number of points, including the point at rest.
    pub(crate) fn count(&self) -> usize {
        self.points.len()
    }

    /// All points, the point at rest first.
    pub(crate) fn points(&self) -> impl Iterator<Item = GridIndex> + '_ {
        self.points.iter().copied()
    }

    /// Whether a point is in the ball, that is, whether transitions may start from it.
    pub(crate) fn in_ball(&self, point: u32) -> bool {
        (point as usize) < self.ball
    }

    pub(crate) fn index(&self, point: u32) -> GridIndex {
        self.points[point as usize]
    }

    pub(crate) fn position(&self, index: GridIndex) -> Option<u32> {
        self.position.get(&index).copied()
    }

    pub(crate) fn parents(&self, point: u32) -> &[u32] {
        &self.parents[point as usize]
    }

    pub(crate) fn children(&self, point: u32) -> &[u32] {
        &self.children[point as usize]
    }
}

impl SpaceGrid {
    /// The points of a space on this lattice, rest first: those in the ball and, if `complete_cells`, the
    /// outer corners of the cells that intersect it.
    pub fn points(&self, complete_cells: bool) -> Vec<GridIndex> {
        Domain::new(self, complete_cells).points
    }
}

/// Low corners of the cells whose interior intersects the ball. No cell crosses a coordinate plane, so its
/// point closest to rest is a corner.
fn cells_in_reach(grid: &SpaceGrid) -> Vec<GridIndex> {
    let cells = grid.radius_m / grid.spacing_m;
    // The quotient of a radius of a whole number of cells can exceed that number by rounding.
    let strictly_inside = cells * cells * (1.0 - 1e-6);
    let reach = grid.lattice.reach();
    let mut found = Vec::new();
    for i in -reach..reach {
        for j in -reach..reach {
            for k in -reach..reach {
                let nearest = corners([i, j, k]).map(squared).into_iter().min().unwrap_or(0);
                if f64::from(nearest) < strictly_inside {
                    found.push([i, j, k]);
                }
            }
        }
    }
    found
}

fn share_a_cell(a: GridIndex, b: GridIndex, cells: &std::collections::HashSet<GridIndex>) -> bool {
    // Low corners of the cells that contain both points: on axes where the two are equal, also one below.
    let low: GridIndex = std::array::from_fn(|axis| a[axis].min(b[axis]));
    corners([0; 3]).into_iter().any(|shift| {
        let fits = (0..3).all(|axis| shift[axis] == 0 || a[axis] == b[axis]);
        fits && cells.contains(&std::array::from_fn(|axis| low[axis] - shift[axis]))
    })
}

/// The corners of a cell, in the order of [`CORNERS`].
pub(crate) fn corners(cell: GridIndex) -> [GridIndex; 8] {
    CORNERS.map(|corner| plus(cell, corner))
}

/// Offsets to the 26 neighbours of a lattice point.
pub(crate) fn neighbours() -> impl Iterator<Item = GridIndex> {
    (0..27).filter(|&code| code != 13).map(|code| [code / 9 - 1, code / 3 % 3 - 1, code % 3 - 1])
}

pub(crate) fn squared(index: GridIndex) -> i32 {
    index.iter().map(|n| n * n).sum()
}

/// a + b
pub(crate) fn plus(a: GridIndex, b: GridIndex) -> GridIndex {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(cells: i32) -> SpaceGrid {
        SpaceGrid::new(0.05 / f64::from(cells), 0.05).unwrap()
    }

    #[test]
    fn the_paper_s_grids_and_their_completions() {
        for (cells, ball, whole) in [(5, 514, 1014), (7, 1418, 2398), (10, 4168, 6204), (15, 14146, 18534)] {
            assert_eq!(Domain::new(&grid(cells), false).count(), ball + 1);
            assert_eq!(Domain::new(&grid(cells), true).count(), whole + 1);
        }
    }

    #[test]
    fn every_cell_that_reaches_into_the_ball_has_its_corners() {
        let grid = grid(4);
        let domain = Domain::new(&grid, true);
        let mut random = 1u64;
        for _ in 0..20_000 {
            let mut next = || {
                random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (random >> 11) as f64 / (1u64 << 53) as f64 * 8.0 - 4.0
            };
            let x = [next(), next(), next()];
            if x.iter().map(|v| v * v).sum::<f64>() < 16.0 {
                let cell = x.map(|v| v.floor() as i32);
                assert!(corners(cell).iter().all(|c| domain.position(*c).is_some()), "{x:?}");
            }
        }
    }

    #[test]
    fn transitions_start_in_the_ball_and_reach_everything() {
        let domain = Domain::new(&grid(3), true);
        assert_eq!(domain.index(REST), [0; 3]);
        for point in 1..domain.count() as u32 {
            let parents = domain.parents(point);
            assert!(!parents.is_empty(), "{:?}", domain.index(point));
            for &parent in parents {
                assert!(domain.in_ball(parent));
                assert!(domain.children(parent).contains(&point));
                let (a, b) = (domain.index(parent), domain.index(point));
                assert!((0..3).all(|axis| (a[axis] - b[axis]).abs() <= 1));
            }
        }
        // Nearest first: a face neighbour in the ball precedes an edge neighbour.
        let first = domain.parents(domain.position([2, 0, 0]).unwrap())[0];
        assert_eq!(domain.index(first), [1, 0, 0]);
    }
}
