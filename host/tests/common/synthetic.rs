//! A synthetic organ for tests: an ellipsoid on springs, packed as a real blob, without a solver.
//!
//! h = k d (1 + |d|^2 / l^2). The surface follows the active node with a smooth fall-off. Included by path.
#![allow(dead_code)]

use palpate_core::format::{self, DisplacementHeader, PlaneRef, Preamble, SpaceHeader, SurfaceHeader};
use palpate_core::{AlignedBytes, BallLattice, Vec3, flags, vec3};
use std::collections::HashMap;

/// Parameters of the ellipsoid.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shape {
    /// Half axes, m.
    pub(crate) half_axes_m: Vec3,
    /// Stiffness at rest, N/m.
    pub(crate) stiffness_n_m: f32,
    /// Displacement at which the secant stiffness is doubled, m.
    pub(crate) hardening_m: f32,
    /// Subdivisions of the icosahedron: 3 gives 642 vertices, 4 gives 2562.
    pub(crate) subdivisions: u32,
    /// Radius of the dent, m.
    pub(crate) reach_m: f32,
    /// Largest force of the scene, N.
    pub(crate) max_force_n: f32,
    /// Number of vertices round the first active node that are active too, so that a tool can slide.
    pub(crate) patch: usize,
}

impl Default for Shape {
    fn default() -> Self {
        Self {
            half_axes_m: [0.085, 0.060, 0.045],
            stiffness_n_m: 250.0,
            hardening_m: 0.04,
            subdivisions: 3,
            reach_m: 0.024,
            max_force_n: 8.0,
            patch: 0,
        }
    }
}

/// Directions of the active nodes from the centre of the ellipsoid.
const ACTIVE: [(&str, Vec3); 3] =
    [("A1", [0.35, -0.75, 0.6]), ("A2", [0.9, -0.2, 0.35]), ("A3", [-0.5, -0.3, 0.85])];

/// The blob.
pub(crate) fn organ(shape: &Shape) -> AlignedBytes {
    certified_organ(shape, |_| Vec::new())
}

/// The blob with the certificate for these active nodes.
pub(crate) fn certified_organ(shape: &Shape, certificate: impl Fn(&[String]) -> Vec<u8>) -> AlignedBytes {
    let (vertices, triangles) = ellipsoid(shape);
    let lattice = BallLattice::new(0.010, 0.040).expect("valid sizes");
    let mut planes = Planes::default();
    let low = -0.55 * shape.half_axes_m[2];
    let fixed: Vec<u8> = vertices.iter().map(|vertex| u8::from(vertex[2] < low)).collect();
    let surface = SurfaceHeader {
        node: planes.put(&(0..vertices.len() as u32).collect::<Vec<u32>>()),
        position_m: [0, 1, 2]
            .map(|axis: usize| planes.put(&vertices.iter().map(|vertex| vertex[axis]).collect::<Vec<f32>>())),
        triangles: planes.put(&triangles),
        fixed: planes.put(&fixed),
    };
    let mut active =
        ACTIVE.map(|(name, direction)| (name.to_string(), vertex_along(&vertices, direction))).to_vec();
    let ((_, first), mut round) = (active[0].clone(), (0..vertices.len()).collect::<Vec<_>>());
    round.retain(|&vertex| active.iter().all(|(_, known)| *known != vertex));
    let away = |vertex: &usize| vec3::distance(vertices[*vertex], vertices[first]);
    round.sort_by(|one, other| away(one).total_cmp(&away(other)));
    active.extend(round.iter().take(shape.patch).map(|&vertex| (format!("P{vertex}"), vertex)));
    let spaces: Vec<SpaceHeader> = active
        .iter()
        .map(|(name, node)| space(shape, &lattice, &vertices, (name, *node), &mut planes))
        .collect();
    let names: Vec<String> = active.into_iter().map(|(name, _)| name).collect();
    let certificate = Some(certificate(&names)).filter(|text| !text.is_empty());
    let preamble = Preamble {
        scene: "synthetic ellipsoid".try_into().expect("short"),
        law: "spring".try_into().expect("short"),
        max_force_n: shape.max_force_n,
        mesh_hash: [0; 32],
        surface,
        contact: SurfaceHeader::default(),
        tool: palpate_core::format::Tool::Point,
        certificate: certificate.map(|text| planes.put(&text)),
        space_count: spaces.len() as u32,
    };
    pack(&preamble, &spaces, &planes.bytes)
}

/// The vertex nearest to a direction from the centre.
fn vertex_along(vertices: &[Vec3], direction: Vec3) -> usize {
    let nearness =
        |vertex: &Vec3| vec3::dot(vec3::normalize_or_zero(*vertex), vec3::normalize_or_zero(direction));
    let nearest = vertices.iter().enumerate().max_by(|(_, a), (_, b)| nearness(a).total_cmp(&nearness(b)));
    nearest.expect("an ellipsoid has vertices").0
}

fn space(
    shape: &Shape,
    lattice: &BallLattice,
    vertices: &[Vec3],
    (name, node): (&str, usize),
    planes: &mut Planes,
) -> SpaceHeader {
    let rest = &vertices[node];
    let normal = vec3::normalize_or_zero(core::array::from_fn(|i| rest[i] / shape.half_axes_m[i].powi(2)));

    let mut bits = vec![0; lattice.slots()];
    for point in lattice.points() {
        bits[lattice.slot(point).expect("points are in the box")] = flags::SOLVED;
    }
    bits[lattice.slot([0; 3]).expect("the middle")] = flags::SOLVED;
    flags::derive(lattice, &mut bits);

    let force = |slot: usize| {
        let d = lattice.displacement_m(lattice.ijk(slot));
        let secant = shape.stiffness_n_m * (1.0 + vec3::dot(d, d) / shape.hardening_m.powi(2));
        vec3::scale(d, secant)
    };
    let force_n = planes.put(&(0..lattice.slots()).map(force).collect::<Vec<_>>());

    // One row per solved configuration; a ghost uses the row of the nearest.
    let solved: Vec<[i32; 3]> = core::iter::once([0; 3]).chain(lattice.points()).collect();
    let nearest = |ijk: [i32; 3]| {
        let distance = |other: &[i32; 3]| (0..3).map(|i| (ijk[i] - other[i]).pow(2)).sum::<i32>();
        let found =
            solved.iter().enumerate().min_by_key(|(_, other)| distance(other)).expect("the rest point");
        found.0 as u32
    };
    let row: Vec<u32> = (0..lattice.slots()).map(|slot| nearest(lattice.ijk(slot))).collect();
    // One mode per axis: every vertex follows the node by its weight. A coefficient counts thousandths of a
    // cell.
    let low = -0.55 * shape.half_axes_m[2];
    let share = |vertex: &Vec3| {
        let away = vec3::distance(*vertex, *rest) / shape.reach_m;
        let held = ((vertex[2] - low) / shape.half_axes_m[2]).clamp(0.0, 1.0);
        held.sqrt() / (1.0 + away * away)
    };
    let shares: Vec<i16> =
        vertices.iter().map(|vertex| (f32::from(i16::MAX) * share(vertex)) as i16).collect();
    let along = |axis: usize, share: i16| [0, 1, 2].map(|i| if i == axis { share } else { 0 });
    let modes: Vec<[i16; 3]> =
        (0..3).flat_map(|axis| shares.iter().map(move |&share| along(axis, share))).collect();
    let coefficients: Vec<[i16; 3]> = solved.iter().map(|ijk| ijk.map(|n| 1000 * n as i16)).collect();
    let scale = [lattice.spacing_m() / 1000.0 / f32::from(i16::MAX); 3];
    SpaceHeader {
        name: name.try_into().expect("short"),
        node: node as u32,
        rest_position_m: *rest,
        outward_normal: normal,
        spacing_m: lattice.spacing_m(),
        radius_m: lattice.radius_m(),
        flags: planes.put(&bits),
        force_n: Some(force_n),
        rbf_linear: None,
        rbf_cubic: None,
        hermite: None,
        displacement: Some(DisplacementHeader {
            slopes: 0,
            row: planes.put(&row),
            modes: planes.put(modes.as_flattened()),
            scale: planes.put(&scale),
            coefficients: planes.put(coefficients.as_flattened()),
            outlier_row: planes.put::<u32>(&[]),
            outlier_scale: planes.put::<f32>(&[]),
            outliers: planes.put::<i16>(&[]),
        }),
        kernel: None,
    }
}

#[derive(Default)]
struct Planes {
    bytes: Vec<u8>,
}

impl Planes {
    fn put<T: bytemuck::NoUninit>(&mut self, elements: &[T]) -> PlaneRef {
        self.bytes.resize(self.bytes.len().next_multiple_of(format::ALIGNMENT), 0);
        let offset = self.bytes.len() as u32;
        self.bytes.extend_from_slice(bytemuck::cast_slice(elements));
        PlaneRef { offset, len: elements.len() as u32 }
    }
}

fn pack(preamble: &Preamble, spaces: &[SpaceHeader], planes: &[u8]) -> AlignedBytes {
    let mut header = Vec::new();
    let mut scratch = [0; 1024];
    header.extend_from_slice(postcard::to_slice(preamble, &mut scratch).expect("fits"));
    for space in spaces {
        header.extend_from_slice(postcard::to_slice(space, &mut scratch).expect("fits"));
    }
    let mut bytes = Vec::new();
    format::write(&header, planes, |piece| bytes.extend_from_slice(piece)).expect("a short header");
    AlignedBytes::from(&bytes)
}

/// Subdivided icosahedron, scaled; counter-clockwise seen from outside.
fn ellipsoid(shape: &Shape) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let g = (1.0 + 5.0_f32.sqrt()) / 2.0;
    let mut points: Vec<Vec3> = vec![
        [-1.0, g, 0.0],
        [1.0, g, 0.0],
        [-1.0, -g, 0.0],
        [1.0, -g, 0.0],
        [0.0, -1.0, g],
        [0.0, 1.0, g],
        [0.0, -1.0, -g],
        [0.0, 1.0, -g],
        [g, 0.0, -1.0],
        [g, 0.0, 1.0],
        [-g, 0.0, -1.0],
        [-g, 0.0, 1.0],
    ];
    let mut triangles: Vec<[u32; 3]> = vec![
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ];
    points.iter_mut().for_each(|point| *point = vec3::normalize_or_zero(*point));
    for _ in 0..shape.subdivisions {
        let mut middles = HashMap::new();
        let mut finer = Vec::with_capacity(triangles.len() * 4);
        for [a, b, c] in triangles {
            let mut middle = |i: u32, j: u32| {
                *middles.entry((i.min(j), i.max(j))).or_insert_with(|| {
                    let sum = vec3::add(points[i as usize], points[j as usize]);
                    points.push(vec3::normalize_or_zero(sum));
                    points.len() as u32 - 1
                })
            };
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            finer.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
        }
        triangles = finer;
    }
    let scaled =
        points.iter().map(|point| core::array::from_fn(|i| point[i] * shape.half_axes_m[i])).collect();
    (scaled, triangles)
}
