//! Blobs of an analytic organ for the tests of this crate.
#![allow(
    dead_code,
    unreachable_pub,
    unused_imports,
    unused_macros,
    reason = "a module of every test binary; each uses its own part"
)]

#[macro_use]
pub mod ball;
#[macro_use]
pub mod bench;
mod body;
pub mod jets;
pub mod kernel;
mod potential;
mod writer;

pub use body::sphere;
pub use potential::{A, Monomial, force, polynomial, potential};
pub use writer::{Area, Draft, sign};

use palpate_core::flags::{self, BRANCH_JUMP, SOLVED};
use palpate_core::format::{
    self, DisplacementHeader, HermiteHeader, Preamble, RbfHeader, SpaceHeader, SurfaceHeader,
};
use palpate_core::vec3::{self, Vec3};
use palpate_core::{AlignedBytes, BallLattice, HermiteNode, RBF_LANES};

/// The contents of a blob.
#[derive(Clone)]
pub struct Recipe {
    pub spacing_m: f32,
    pub radius_m: f32,
    /// Rest positions of the active nodes.
    pub nodes: Vec<Vec3>,
    /// Outward normal of a node.
    pub normal: fn(Vec3) -> Vec3,
    /// Factor of the potential at a node.
    pub stiffer: fn(u32) -> f64,
    /// Vertices and triangles of the surface instead of a small tetrahedron; active node i is vertex i.
    pub body: Option<(Vec<Vec3>, Vec<[u32; 3]>)>,
    /// Whether a point of the ball is solved.
    pub solved: fn([i32; 3]) -> bool,
    /// Force at a slot that is not solved.
    pub ghost: fn(Vec3) -> [f64; 3],
    /// Force at a solved slot.
    pub force: fn(Vec3) -> [f64; 3],
    pub lattice_table: bool,
    pub rbf: bool,
    pub hermite: bool,
    /// Cells with a fold, by their low corner.
    pub fold: fn([i32; 3]) -> bool,
    pub displacement: bool,
    /// Number of the three modes of the displacement that have slopes.
    pub slopes: usize,
    /// Whether the surface follows the cubic [`bent`] instead of the displacement of the node.
    pub bent: bool,
    /// A solved point at which the surface has the additional displacement [`ODD`].
    pub outlier: Option<[i32; 3]>,
}

impl Default for Recipe {
    fn default() -> Self {
        Self {
            spacing_m: 0.01,
            radius_m: 0.03,
            nodes: vec![[0.0; 3]],
            normal: |_| [0.0, 0.0, 1.0],
            stiffer: |_| 1.0,
            body: None,
            solved: |_| true,
            // Wrong by a quarter: continuity must not depend on good extrapolation.
            ghost: |d| force(d).map(|h| 1.25 * h + 0.1),
            force,
            lattice_table: true,
            rbf: true,
            hermite: true,
            fold: |_| false,
            displacement: true,
            slopes: 0,
            bent: false,
            outlier: None,
        }
    }
}

/// The cubic displacement of the surface; each vertex moves by its share of it.
pub fn bent(d: Vec3) -> Vec3 {
    force(d).map(|h| (h / A) as f32)
}

/// Additional displacement of the vertices in an outlier, m.
pub const ODD: [Vec3; 4] =
    [[0.0, 0.002, -0.003], [0.004, -0.005, 0.006], [-0.007, 0.008, 0.009], [0.01, 0.0, -0.011]];
/// Unit of its table, m.
const ODD_UNIT_M: f32 = 1e-6;

impl Recipe {
    pub fn lattice(&self) -> BallLattice {
        BallLattice::new(self.spacing_m, self.radius_m).expect("a valid lattice")
    }

    /// Solved lattice points, including the rest point.
    pub fn solved_points(&self) -> Vec<[i32; 3]> {
        let lattice = self.lattice();
        let mut points: Vec<_> = lattice.points().filter(|&ijk| (self.solved)(ijk)).collect();
        points.push([0; 3]);
        points
    }

    pub fn flags(&self) -> Vec<u8> {
        let lattice = self.lattice();
        let mut bits = vec![0; lattice.slots()];
        for ijk in self.solved_points() {
            bits[lattice.slot(ijk).expect("in the box")] = SOLVED;
        }
        for (slot, bits) in bits.iter_mut().enumerate() {
            *bits |= if (self.fold)(lattice.ijk(slot)) { BRANCH_JUMP } else { 0 };
        }
        flags::derive(&lattice, &mut bits);
        bits
    }

    /// A node for every slot; unsolved ones are as wrong as the forces.
    fn hermite_planes(&self, stiffer: f64) -> (Vec<u32>, Vec<HermiteNode>) {
        let (lattice, bits) = (self.lattice(), self.flags());
        let node = |slot: usize| {
            let d = lattice.displacement_m(lattice.ijk(slot));
            let wrong = stiffer * if bits[slot] & SOLVED != 0 { 1.0 } else { 1.25 };
            let mut node = HermiteNode::default();
            for (a, b, c) in (0..27).map(|code| (code / 9, code / 3 % 3, code % 3)) {
                let scale = f64::from(self.spacing_m).powi((a + b + c) as i32 - 1);
                node[a][b][c] = (wrong * scale * potential(d, [a, b, c])) as f32;
            }
            node
        };
        ((0..lattice.slots() as u32).collect(), (0..lattice.slots()).map(node).collect())
    }

    fn forces(&self, stiffer: f64) -> Vec<Vec3> {
        let lattice = self.lattice();
        let force = |(slot, bits): (usize, u8)| {
            let d = lattice.displacement_m(lattice.ijk(slot));
            let h = if bits & SOLVED != 0 { (self.force)(d) } else { (self.ghost)(d) };
            h.map(|h| (stiffer * h) as f32)
        };
        self.flags().into_iter().enumerate().map(force).collect()
    }

    /// Centres (cells) and weights that interpolate the solved forces, padded.
    fn rbf_planes(&self, phi: fn(f64) -> f64) -> ([Vec<f64>; 3], [Vec<f64>; 3]) {
        let points = self.solved_points();
        let lattice = self.lattice();
        let count = points.len();
        let distance = |a: [i32; 3], b: [i32; 3]| {
            let squared: i32 = a.iter().zip(b).map(|(a, b)| (a - b).pow(2)).sum();
            f64::from(squared).sqrt()
        };
        let matrix: Vec<Vec<f64>> =
            points.iter().map(|&a| points.iter().map(|&b| phi(distance(a, b))).collect()).collect();
        let padded = count.next_multiple_of(RBF_LANES);
        let mut centres = [const { Vec::new() }; 3];
        let mut weights = [const { Vec::new() }; 3];
        for axis in 0..3 {
            let values = points.iter().map(|&ijk| (self.force)(lattice.displacement_m(ijk))[axis]).collect();
            weights[axis] = solve(matrix.clone(), values);
            weights[axis].resize(padded, 0.0);
            centres[axis] = points.iter().map(|ijk| f64::from(ijk[axis])).collect();
            centres[axis].resize(padded, 0.0);
        }
        (centres, weights)
    }

    /// Unit of a coefficient, m: a thousandth of a cell, so that the linear field is exact.
    fn displacement_unit_m(&self) -> f32 {
        self.spacing_m / 1000.0
    }

    /// Coefficient of each mode (an axis) at a point, and its slopes per cell, in units.
    fn coefficients(&self, ijk: [i32; 3]) -> [[i16; 3]; 4] {
        let d = self.lattice().displacement_m(ijk);
        let along = |axis: usize| core::array::from_fn(|i| usize::from(i == axis));
        let units = |metres: f64| (metres / f64::from(self.displacement_unit_m())).round() as i16;
        let linear = |i: usize, j: usize| if i == j { f64::from(self.spacing_m) } else { 0.0 };
        let slope = |mode: usize, axis: usize| {
            let (of, by): ([usize; 3], [usize; 3]) = (along(mode), along(axis));
            let bent = potential(d, core::array::from_fn(|i| of[i] + by[i])) / A * f64::from(self.spacing_m);
            units(if self.bent { bent } else { linear(mode, axis) })
        };
        let value = if self.bent { bent(d) } else { d };
        [
            value.map(|x| units(f64::from(x))),
            core::array::from_fn(|mode| slope(mode, 0)),
            core::array::from_fn(|mode| slope(mode, 1)),
            core::array::from_fn(|mode| slope(mode, 2)),
        ]
    }

    /// One row per solved point and a mode per axis: every vertex moves by its share.
    fn displacement_planes(&self, area: &mut Area) -> DisplacementHeader {
        let lattice = self.lattice();
        let points = self.solved_points();
        let nearest = |slot| {
            let ijk = lattice.ijk(slot);
            let squared =
                |row: &usize| points[*row].iter().zip(ijk).map(|(a, b)| (a - b).pow(2)).sum::<i32>();
            (0..points.len()).min_by_key(squared).expect("the rest point is solved") as u32
        };
        let row: Vec<u32> = (0..lattice.slots()).map(nearest).collect();
        let modes: Vec<i16> = (0..3)
            .flat_map(|mode| {
                SHARES.map(|share| [0, 1, 2].map(|i| if i == mode { (4.0 * share) as i16 } else { 0 }))
            })
            .flatten()
            .collect();
        let mut coefficients = Vec::new();
        for &ijk in &points {
            let [values, slopes @ ..] = self.coefficients(ijk);
            coefficients.extend(values);
            slopes.iter().for_each(|along| coefficients.extend(&along[..self.slopes]));
        }
        let outlier_row: Vec<u32> =
            (0..).zip(&points).filter(|(_, p)| Some(**p) == self.outlier).map(|(row, _)| row).collect();
        let odd: Vec<i16> = ODD.as_flattened().iter().map(|x| (x / ODD_UNIT_M).round() as i16).collect();
        DisplacementHeader {
            slopes: self.slopes as u32,
            row: area.push(&row),
            modes: area.push(&modes),
            scale: area.push(&[self.displacement_unit_m() / 4.0; 3]),
            coefficients: area.push(&coefficients),
            outlier_scale: area.push(&vec![ODD_UNIT_M; outlier_row.len()]),
            outliers: area.push(&odd[..odd.len() * outlier_row.len()]),
            outlier_row: area.push(&outlier_row),
        }
    }

    pub fn blob(&self) -> AlignedBytes {
        self.blob_with(|_| {})
    }

    /// Writes a blob; `spoil` may change it before the checksum is computed.
    pub fn blob_with(&self, spoil: impl FnOnce(&mut Draft)) -> AlignedBytes {
        let mut area = Area::default();
        let tetrahedron = || {
            let vertices = vec![[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]];
            (vertices, vec![[0_u32, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
        };
        let (vertices, triangles) = self.body.clone().unwrap_or_else(tetrahedron);
        let plane = |axis: usize| vertices.iter().map(|vertex: &Vec3| vertex[axis]).collect::<Vec<f32>>();
        let fixed: Vec<u8> = (0..vertices.len()).map(|vertex| u8::from(vertex == 0)).collect();
        let surface = SurfaceHeader {
            node: area.push(&(10..10 + vertices.len() as u32).collect::<Vec<u32>>()),
            position_m: [area.push(&plane(0)), area.push(&plane(1)), area.push(&plane(2))],
            triangles: area.push(&triangles),
            fixed: area.push(&fixed),
        };
        let spaces = (0..)
            .zip(&self.nodes)
            .map(|(index, &rest_position_m)| self.space(&mut area, index, rest_position_m))
            .collect::<Vec<_>>();
        let preamble = Preamble {
            scene: "test".try_into().expect("short"),
            law: "potential".try_into().expect("short"),
            max_force_n: 8.0,
            mesh_hash: [7; 32],
            surface,
            contact: SurfaceHeader::default(),
            tool: palpate_core::format::Tool::Point,
            certificate: None,
            space_count: spaces.len() as u32,
        };
        let mut draft = Draft { preamble, spaces, area };
        spoil(&mut draft);
        draft.write()
    }

    fn space(&self, area: &mut Area, index: u32, rest_position_m: Vec3) -> SpaceHeader {
        let three = |area: &mut Area, planes: &[Vec<f32>; 3]| planes.each_ref().map(|plane| area.push(plane));
        let flags = area.push(&self.flags());
        let force_n = self.lattice_table.then(|| area.push(&self.forces((self.stiffer)(index))));
        let rbf_linear = self.rbf.then(|| {
            let (centres, weights) = self.rbf_planes(|r| r);
            let narrow =
                |planes: [Vec<f64>; 3]| planes.map(|plane| plane.iter().map(|&x| x as f32).collect());
            RbfHeader { centres: three(area, &narrow(centres)), weights: three(area, &narrow(weights)) }
        });
        let rbf_cubic = self.rbf.then(|| {
            let (centres, weights) = self.rbf_planes(|r| r * r * r);
            let mut three = |planes: [Vec<f64>; 3]| planes.map(|plane| area.push(&plane));
            RbfHeader { centres: three(centres), weights: three(weights) }
        });
        let hermite = self.hermite.then(|| {
            let (row, nodes) = self.hermite_planes((self.stiffer)(index));
            HermiteHeader { row: area.push(&row), nodes: area.push(&nodes) }
        });
        let displacement = self.displacement.then(|| self.displacement_planes(area));
        SpaceHeader {
            name: format!("A{}", index + 1).as_str().try_into().expect("short"),
            node: 10 + index,
            rest_position_m,
            outward_normal: (self.normal)(rest_position_m),
            spacing_m: self.spacing_m,
            radius_m: self.radius_m,
            flags,
            force_n,
            rbf_linear,
            rbf_cubic,
            hermite,
            displacement,
            kernel: None,
        }
    }
}

/// Share of the displacement of the node by which each surface vertex moves; vertex 0 is fixed.
pub const SHARES: [f32; 4] = [0.0, 1.0, 0.5, 0.25];

/// Gaussian elimination with partial pivoting.
fn solve(mut matrix: Vec<Vec<f64>>, mut right: Vec<f64>) -> Vec<f64> {
    let n = right.len();
    for column in 0..n {
        let pivot = (column..n)
            .max_by(|&a, &b| matrix[a][column].abs().total_cmp(&matrix[b][column].abs()))
            .expect("rows remain");
        matrix.swap(column, pivot);
        right.swap(column, pivot);
        for row in column + 1..n {
            let factor = matrix[row][column] / matrix[column][column];
            let (above, below) = matrix.split_at_mut(row);
            for (value, pivot) in below[0][column..].iter_mut().zip(&above[column][column..]) {
                *value -= factor * pivot;
            }
            right[row] -= factor * right[column];
        }
    }
    for row in (0..n).rev() {
        let known: f64 = (row + 1..n).map(|column| matrix[row][column] * right[column]).sum();
        right[row] = (right[row] - known) / matrix[row][row];
    }
    right
}

/// Reproducible random numbers.
pub struct Random(pub u64);

impl Random {
    /// Uniform in [-1, 1).
    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1_u64 << 23) as f32 - 1.0
    }

    /// Uniform in a cube of half-width `size`.
    pub fn point(&mut self, size: f32) -> Vec3 {
        [self.next() * size, self.next() * size, self.next() * size]
    }
}

pub fn distance(a: Vec3, b: Vec3) -> f32 {
    palpate_core::vec3::distance(a, b)
}
