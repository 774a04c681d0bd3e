//! A stiffer or softer part of the body, and the body with the surrounding material in its place.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use crate::fem::material::{Material, Value};
use crate::mesh::{Surface, TetMesh};
use crate::num::vector::{cross, difference, distance, norm};
use crate::scene::{MaterialRegion, ResolvedScene};

/// An inclusion: the scene with it and without it. Both have the same mesh and the same regions, so the error
/// of the discretisation is nearly the same in both and cancels in their ratio.
#[derive(Debug, Clone, PartialEq)]
pub struct Inclusion {
    /// The scene with the inclusion.
    pub with: ResolvedScene,
    /// The scene with the surrounding material in its place.
    pub without: ResolvedScene,
    /// Its tets, ascending.
    pub tets: Vec<u32>,
    /// Its volume, m^3.
    pub volume_m3: f64,
}

/// Why an inclusion cannot be examined.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InclusionError {
    /// The mesh has no such group of volumes.
    #[error("the scene has no group \"{group}\"; groups with a material of their own: {known}")]
    NoGroup {
        /// The group.
        group: String,
        /// Groups that are regions.
        known: String,
    },
    /// The group is no region of its own.
    #[error(
        "the group \"{group}\" has no [[material]] of its own; add one with group = \"{group}\" to the scene"
    )]
    NoMaterial {
        /// The group.
        group: String,
    },
    /// Nothing surrounds the inclusion.
    #[error("nothing of another material surrounds the inclusion; name a part of the body")]
    NothingAround,
    /// The ball is not inside the body.
    #[error("the ball of {} mm at the depth of {:.1} mm reaches through the skin; move it inwards or make it smaller", 1e3 * .radius_m, 1e3 * .depth_m)]
    ThroughSkin {
        /// Radius, m.
        radius_m: f64,
        /// Depth of its centre below the skin, m.
        depth_m: f64,
    },
    /// The centre of the ball is outside.
    #[error("the centre {0:?} m of the ball is outside of the body; give a point inside, in metres")]
    Outside([f64; 3]),
    /// The ball lies in more than one region.
    #[error("the ball cuts the border between two materials of the scene; move it or make it smaller")]
    TwoMaterials,
    /// The mesh with tets as small as the ball needs has too many.
    #[error("a ball of {} mm needs too many tets; make it larger, or use a finer mesh", 1e3 * .0)]
    TooSmall(f64),
    /// The law has no constants in pascals that can be multiplied.
    #[error("the law \"{law}\" cannot be made {ratio} times as stiff: {what}")]
    Law {
        /// Name of the law.
        law: &'static str,
        /// Ratio of stiffness.
        ratio: f64,
        /// Why.
        what: String,
    },
}

/// A ball of tissue of another stiffness.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ball {
    /// Centre in the undeformed body, m.
    pub centre_m: [f64; 3],
    /// Radius, m.
    pub radius_m: f64,
    /// Every constant in pascals is so many times that of the surrounding tissue.
    pub ratio: f64,
}

/// Longest edge of a tet in a ball, in its radii: then it has some hundred tets.
const EDGE_IN_RADII: f64 = 1.2;
/// Largest number of halvings of the edges near a ball.
const MAX_LEVELS: u32 = 3;

impl Inclusion {
    /// The inclusion of these groups of volumes. The surrounding material is that of the other region with
    /// the largest common surface.
    pub fn of_groups(scene: &ResolvedScene, groups: &[String]) -> Result<Self, InclusionError> {
        let regions =
            groups.iter().map(|group| region_of(scene, group)).collect::<Result<BTreeSet<_>, _>>()?;
        let around = surrounding(scene, &regions).ok_or(InclusionError::NothingAround)?;
        let mut without = scene.clone();
        for &region in &regions {
            let MaterialRegion { material, bulk_modulus_pa, .. } = scene.materials[around].clone();
            let tets = without.materials[region].tets.take();
            without.materials[region] = MaterialRegion { material, bulk_modulus_pa, tets };
        }
        let mut tets: Vec<u32> = regions
            .iter()
            .flat_map(|&region| scene.materials[region].tets.iter().flatten())
            .copied()
            .collect();
        tets.sort_unstable();
        let volume_m3 = volume_m3(&scene.mesh, &tets);
        Ok(Self { with: scene.clone(), without, tets, volume_m3 })
    }

    /// A ball in a body that has none. Near it the mesh is refined; then the tets with the nearest centroids
    /// are taken, as many as have the volume of the ball most nearly. Far from an inclusion its effect is
    /// proportional to its volume, so the steps of its surface matter little.
    pub fn ball(scene: &ResolvedScene, ball: Ball) -> Result<Self, InclusionError> {
        let Ball { centre_m, radius_m, ratio } = ball;
        let home = tet_at(&scene.mesh, centre_m).ok_or(InclusionError::Outside(centre_m))?;
        let skin = Surface::of(&scene.mesh);
        let nearest = skin.nearest(&scene.mesh, centre_m).ok_or(InclusionError::Outside(centre_m))?;
        let foot_m = nearest.interpolate(|node| scene.mesh.nodes_m[node as usize]);
        let depth_m = distance(foot_m, centre_m);
        // A ball that touches the skin may differ from it by rounding.
        if depth_m < radius_m * (1.0 - 1e-9) {
            return Err(InclusionError::ThroughSkin { radius_m, depth_m });
        }
        let finest_m = EDGE_IN_RADII * radius_m;
        let edge_m = longest_edge_m(&scene.mesh, home);
        let levels = (0..=MAX_LEVELS).find(|level| edge_m <= finest_m * f64::from(1 << level));
        let levels = levels.unwrap_or(MAX_LEVELS);
        let refined = match levels {
            0 => None,
            _ => Some(
                scene
                    .refined_near(&[centre_m], radius_m, levels)
                    .ok_or(InclusionError::TooSmall(radius_m))?,
            ),
        };
        let mut without = refined.unwrap_or_else(|| scene.clone());
        let tets = nearest_tets(&without.mesh, centre_m, 4.0 / 3.0 * std::f64::consts::PI * radius_m.powi(3));
        split(&mut without, &tets)?;
        let mut with = without.clone();
        let added = with.materials.last_mut().expect("just split");
        added.material = stiffened(&added.material, ratio)?;
        added.bulk_modulus_pa = added.bulk_modulus_pa.map(|bulk| bulk * ratio);
        let volume_m3 = volume_m3(&with.mesh, &tets);
        Ok(Self { with, without, tets, volume_m3 })
    }
}

/// The region that is exactly this group.
fn region_of(scene: &ResolvedScene, group: &str) -> Result<usize, InclusionError> {
    let groups = &scene.mesh.tet_groups;
    let is_region =
        |tets: &Vec<u32>| scene.materials.iter().position(|region| region.tets.as_ref() == Some(tets));
    let Some(tets) = groups.get(group) else {
        let known: Vec<&str> = groups
            .iter()
            .filter(|(_, tets)| is_region(tets).is_some())
            .map(|(name, _)| name.as_str())
            .collect();
        let known = if known.is_empty() { "none".into() } else { known.join(", ") };
        return Err(InclusionError::NoGroup { group: group.into(), known });
    };
    is_region(tets).ok_or_else(|| InclusionError::NoMaterial { group: group.into() })
}

/// The region outside of these with the largest common surface; the first of equal ones.
fn surrounding(scene: &ResolvedScene, inside: &BTreeSet<usize>) -> Option<usize> {
    let mut region_of_tet = vec![0; scene.mesh.tets.len()];
    for (index, region) in scene.materials.iter().enumerate() {
        for &tet in region.tets.iter().flatten() {
            region_of_tet[tet as usize] = index;
        }
    }
    let mut first: HashMap<[u32; 3], usize> = HashMap::new();
    let mut common_m2: BTreeMap<usize, f64> = BTreeMap::new();
    for (corners, &region) in scene.mesh.tets.iter().zip(&region_of_tet) {
        for left_out in 0..4 {
            let mut face: Vec<u32> = (0..4).filter(|k| *k != left_out).map(|k| corners[k]).collect();
            face.sort_unstable();
            let face = [face[0], face[1], face[2]];
            let Some(other) = first.insert(face, region) else { continue };
            let outer = match (inside.contains(&region), inside.contains(&other)) {
                (true, false) => other,
                (false, true) => region,
                _ => continue,
            };
            let [a, b, c] = face.map(|node| scene.mesh.nodes_m[node as usize]);
            *common_m2.entry(outer).or_default() += 0.5 * norm(cross(difference(b, a), difference(c, a)));
        }
    }
    common_m2.into_iter().rev().max_by(|a, b| a.1.total_cmp(&b.1)).map(|(region, _)| region)
}

/// Makes these tets, which must lie in one region, a region of their own with the same material: the last
/// one.
fn split(scene: &mut ResolvedScene, tets: &[u32]) -> Result<(), InclusionError> {
    let is_in =
        |of: &MaterialRegion, tet: &u32| of.tets.as_ref().is_none_or(|all| all.binary_search(tet).is_ok());
    let first = tets.first().expect("a ball has tets");
    let home =
        scene.materials.iter().position(|region| is_in(region, first)).expect("the regions cover the body");
    if !tets.iter().all(|tet| is_in(&scene.materials[home], tet)) {
        return Err(InclusionError::TwoMaterials);
    }
    let whole = || (0..scene.mesh.tets.len() as u32).collect();
    let mut rest = scene.materials[home].tets.clone().unwrap_or_else(whole);
    rest.retain(|tet| tets.binary_search(tet).is_err());
    if rest.is_empty() {
        return Err(InclusionError::NothingAround);
    }
    let mut own = scene.materials[home].clone();
    own.tets = Some(tets.to_vec());
    scene.materials[home].tets = Some(rest);
    scene.materials.push(own);
    Ok(())
}

/// The material with every constant in pascals multiplied.
fn stiffened(material: &Material, ratio: f64) -> Result<Material, InclusionError> {
    let scaled: Vec<(&'static str, Value)> = material
        .parameters()
        .into_iter()
        .map(|(name, value)| match value {
            Value::Number(number) if name.ends_with("_pa") => (name, Value::Number(number * ratio)),
            other => (name, other),
        })
        .collect();
    let refused = |what: String| InclusionError::Law { law: material.name(), ratio, what };
    Material::from_parameters(material.name(), &scaled).map_err(|error| refused(error.what))
}

/// The tets with the centroids nearest to a point, as many as have a volume most nearly; ascending, at least
/// one.
fn nearest_tets(mesh: &TetMesh, centre_m: [f64; 3], wanted_m3: f64) -> Vec<u32> {
    let away_m = |tet: &u32| distance(centroid_m(mesh, *tet as usize), centre_m);
    let mut order: Vec<(f64, u32)> = (0..mesh.tets.len() as u32).map(|tet| (away_m(&tet), tet)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let (mut tets, mut taken_m3) = (Vec::new(), 0.0);
    for (_, tet) in order {
        let own_m3 = mesh.signed_volume_m3(tet as usize);
        if !tets.is_empty() && taken_m3 + 0.5 * own_m3 > wanted_m3 {
            break;
        }
        taken_m3 += own_m3;
        tets.push(tet);
    }
    tets.sort_unstable();
    tets
}

fn centroid_m(mesh: &TetMesh, tet: usize) -> [f64; 3] {
    let corners = mesh.vertices_m(tet);
    std::array::from_fn(|axis| 0.25 * corners.iter().map(|corner| corner[axis]).sum::<f64>())
}

fn volume_m3(mesh: &TetMesh, tets: &[u32]) -> f64 {
    tets.iter().map(|&tet| mesh.signed_volume_m3(tet as usize)).sum()
}

fn longest_edge_m(mesh: &TetMesh, tet: usize) -> f64 {
    let corners = mesh.vertices_m(tet);
    let pairs = (0..4).flat_map(|a| (0..a).map(move |b| (a, b)));
    pairs.map(|(a, b)| distance(corners[a], corners[b])).fold(0.0, f64::max)
}

/// The tet that contains a point; the first one of several at a common face.
fn tet_at(mesh: &TetMesh, point_m: [f64; 3]) -> Option<usize> {
    (0..mesh.tets.len()).find(|&tet| {
        let corners = mesh.vertices_m(tet);
        (0..4).all(|k| {
            let mut part = corners;
            part[k] = point_m;
            crate::mesh::tetrahedral::six_volume(&part) >= 0.0
        })
    })
}
