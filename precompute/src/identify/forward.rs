//! The forward problem: the reactions at the measured places, and their derivatives by the free constants.
//!
//! Each distinct place is solved once. The first time a test is followed row by row from rest. Later, with other
//! constants, each place starts from its own last equilibrium, so that all are independent of each other.

use std::sync::atomic::{AtomicUsize, Ordering};

use super::data::{Data, Places};
use super::error::IdentifyError;
use crate::error::InputError;
use crate::fem::Pose;
use crate::fem::body::Region;
use crate::fem::constant::Constant;
use crate::mesh::Surface;
use crate::num::parallel::in_parallel;
use crate::num::vector::dot;
use crate::pipeline::{Analysis, Equilibrium, Loading, PipelineError, Run};
use crate::scene::{ActiveNode, ResolvedScene, Scene, SceneConstant};

/// Places that one solver solves one after the other, after the first time.
const BLOCK: usize = 6;

/// A place with its reaction.
#[derive(Debug, Clone)]
pub(super) struct Reaction {
    /// The force of the tool on the body, N.
    pub force_n: [f64; 3],
    /// dh/dtheta of each free constant, N per unit.
    pub by_constants: Vec<[f64; 3]>,
}

/// A distinct place.
#[derive(Debug)]
struct Site {
    /// Index of the active node; zero for a sphere.
    active: usize,
    place_m: [f64; 3],
    /// Where a sphere begins its way to this place: the first one of its test, or beside the body if it overlaps
    /// there.
    start_m: [f64; 3],
    /// First row that measured it.
    row: usize,
    last: Option<Equilibrium>,
}

/// The forward problem of a table of measurements.
#[derive(Debug)]
pub(super) struct Forward<'a> {
    scene: &'a Scene,
    resolved: ResolvedScene,
    free: Vec<SceneConstant>,
    run: Run<'a>,
    sites: Vec<Site>,
    /// Sites of each test in the order of its rows.
    chains: Vec<Vec<usize>>,
    /// Site of each row.
    site_of_row: Vec<usize>,
    /// Displacement of each row from rest, or from the first row of its test for a sphere, m.
    moved_m: Vec<[f64; 3]>,
    /// Lines of the rows, for messages.
    lines: Vec<usize>,
    /// Number of solved equilibria.
    pub solves: usize,
}

/// A place without an equilibrium.
struct Unsolved {
    row: usize,
    why: IdentifyError,
}

impl<'a> Forward<'a> {
    /// Converts places to displacements of the active nodes. `active` names the place of a table without that column.
    pub(super) fn new(
        (scene, resolved): (&'a Scene, &ResolvedScene),
        free: &[SceneConstant],
        data: &Data,
        active: Option<&str>,
        run: Run<'a>,
    ) -> Result<Self, IdentifyError> {
        let mut resolved = resolved.clone();
        if resolved.body_force.is_some() {
            let what = "the rest state under [body_force] depends on the constants";
            let fix = "remove it: take the measured body at rest as free of stress";
            return Err(InputError::new(scene.path(), what, fix).into());
        }
        let is_sphere = resolved.tool.sphere().is_some();
        if is_sphere && data.places != Places::Positions {
            let what = "the tool of the scene is a sphere or capsule, which has no place of rest";
            return Err(InputError::new(&data.path, what, "give positions of its centre, x_m,y_m,z_m").into());
        }
        // Contact points that are to cover the skin are not needed.
        resolved.cover = None;
        if resolved.active.is_empty() && !is_sphere {
            let what = "the scene names no place that the tool touches";
            return Err(InputError::new(
                scene.path(),
                what,
                "add an [[active]] with the point of the indentation",
            )
            .into());
        }
        let mut forward = Self {
            scene,
            free: free.to_vec(),
            run,
            sites: Vec::new(),
            chains: Vec::new(),
            site_of_row: Vec::new(),
            moved_m: Vec::new(),
            lines: data.rows.iter().map(|row| row.line).collect(),
            solves: 0,
            resolved,
        };
        forward.collect(data, active)?;
        Ok(forward)
    }

    fn collect(&mut self, data: &Data, active: Option<&str>) -> Result<(), IdentifyError> {
        let is_sphere = self.resolved.tool.sphere().is_some();
        let mut tests: Vec<(&str, usize)> = Vec::new();
        let mut first_m: Vec<[f64; 3]> = Vec::new();
        for (index, row) in data.rows.iter().enumerate() {
            let name = row.active.as_deref().or(active);
            let active = if is_sphere { 0 } else { self.active(data, row.line, name)? };
            let rest_m = match data.places {
                Places::Positions if !is_sphere => self.resolved.active[active].place_m(&self.resolved.mesh),
                _ => [0.0; 3],
            };
            let place_m: [f64; 3] = std::array::from_fn(|k| row.place_m[k] - rest_m[k]);
            let test =
                tests.iter().position(|test| *test == (row.test.as_str(), active)).unwrap_or_else(|| {
                    tests.push((&row.test, active));
                    self.chains.push(Vec::new());
                    first_m.push(if is_sphere { place_m } else { [0.0; 3] });
                    tests.len() - 1
                });
            self.moved_m.push(std::array::from_fn(|k| place_m[k] - first_m[test][k]));
            let same = |site: &Site| site.active == active && site.place_m == place_m;
            let site = self.sites.iter().position(same).unwrap_or_else(|| {
                self.sites.push(Site { active, place_m, start_m: place_m, row: index, last: None });
                self.chains[test].push(self.sites.len() - 1);
                self.sites.len() - 1
            });
            self.site_of_row.push(site);
        }
        self.chains.retain(|chain| !chain.is_empty());
        for chain in &self.chains {
            let start_m = self.sites[chain[0]].place_m;
            chain.iter().for_each(|&site| self.sites[site].start_m = start_m);
        }
        Ok(())
    }

    fn active(&self, data: &Data, line: usize, name: Option<&str>) -> Result<usize, InputError> {
        let known = &self.resolved.active;
        known.iter().position(|active| name.is_none_or(|name| active.name == name)).ok_or_else(|| {
            let names: Vec<&str> = known.iter().map(|active: &ActiveNode| active.name.as_str()).collect();
            let what = format!("the scene has no active node \"{}\"", name.unwrap_or_default());
            InputError::at(&data.path, line, what, format!("it has {}", names.join(", ")))
        })
    }

    /// Number of distinct places.
    pub(super) fn places(&self) -> usize {
        self.sites.len()
    }

    /// A warning if depths lead out of the body at a place that they touch.
    pub(super) fn doubt_of_direction(&self, data: &Data) -> Option<String> {
        let direction = data.direction.filter(|_| data.places == Places::Depths)?;
        let skin = Surface::of(&self.resolved.mesh);
        let out = self
            .sites
            .iter()
            .map(|site| &self.resolved.active[site.active])
            .find(|active| active.normal(&skin).is_some_and(|normal| dot(normal, direction) > 0.0))?;
        Some(format!(
            "the direction points out of the body at \"{}\", so positive depths pull; if the tool pushes, change the signs of the \
             direction",
            out.name
        ))
    }

    /// Displacement of each row, m.
    pub(super) fn moved_m(&self) -> &[[f64; 3]] {
        &self.moved_m
    }

    /// The reactions of all rows with these values of the free constants; `progress` gets the number of solved
    /// places and of all.
    ///
    /// # Errors
    ///
    /// If the law refuses the values, or a place has no equilibrium.
    pub(super) fn reactions(
        &mut self,
        values: &[f64],
        progress: &(impl Fn(usize, usize) + Sync),
    ) -> Result<Vec<Reaction>, IdentifyError> {
        let stated: Vec<(&SceneConstant, f64)> = self.free.iter().zip(values.iter().copied()).collect();
        let regions = self.scene.with_constants(&stated)?.laws()?;
        let analysis = self.with(regions)?;
        let first = self.sites.iter().any(|site| site.last.is_none());
        let units = if first { self.chains.clone() } else { self.blocks() };
        let done = AtomicUsize::new(0);
        let tick = || progress(done.fetch_add(1, Ordering::Relaxed) + 1, self.sites.len());
        let unit = |unit: &Vec<usize>| self.unit(&analysis, unit, first, &tick);
        let solved = in_parallel(&units, self.run.threads, unit).map_err(PipelineError::from)?;
        let mut reactions: Vec<Option<Reaction>> = vec![None; self.sites.len()];
        let mut unsolved: Vec<Unsolved> = Vec::new();
        for (unit, solved) in units.iter().zip(solved) {
            let solved = solved.unwrap_or_else(|failed| {
                unsolved.push(failed);
                Vec::new()
            });
            for (&site, (reaction, last)) in unit.iter().zip(solved) {
                reactions[site] = Some(reaction);
                self.sites[site].last = Some(last);
            }
        }
        if let Some(first) = unsolved.into_iter().min_by_key(|failed| failed.row) {
            return Err(first.why);
        }
        self.solves += self.sites.len();
        let of_row = |&site: &usize| reactions[site].clone().expect("every site is in a unit");
        Ok(self.site_of_row.iter().map(of_row).collect())
    }

    /// The scene with other materials.
    fn with(&self, regions: Vec<Region>) -> Result<Analysis, IdentifyError> {
        let mut scene = self.resolved.clone();
        for (own, region) in scene.materials.iter_mut().zip(regions) {
            (own.material, own.bulk_modulus_pa) = (region.material, region.bulk_modulus_pa);
        }
        Ok(Analysis::of_scene(self.scene.path(), scene)?)
    }

    /// Sites of one active node, a few at a time.
    fn blocks(&self) -> Vec<Vec<usize>> {
        let mut order: Vec<usize> = (0..self.sites.len()).collect();
        order.sort_by_key(|&site| self.sites[site].active);
        let same = |a: &usize, b: &usize| self.sites[*a].active == self.sites[*b].active;
        order.chunk_by(same).flat_map(|of_active| of_active.chunks(BLOCK)).map(<[usize]>::to_vec).collect()
    }

    /// Solves some places, one after the other.
    fn unit(
        &self,
        analysis: &Analysis,
        unit: &[usize],
        first: bool,
        tick: &impl Fn(),
    ) -> Result<Vec<(Reaction, Equilibrium)>, Unsolved> {
        let row = self.sites[unit[0]].row;
        let begun = self.begin(analysis, unit).map_err(|error| Unsolved { row, why: error.into() });
        let mut loading = begun?;
        let constants = self.constants(&loading);
        let mut solved = Vec::with_capacity(unit.len());
        for site in unit.iter().map(|&site| &self.sites[site]) {
            if self.run.stop.load(Ordering::Relaxed) {
                return Err(Unsolved { row: site.row, why: IdentifyError::Interrupted });
            }
            let found = match &site.last {
                Some(last) if !first => loading.again(last),
                _ => loading.advance(&Pose::translation(site.place_m)),
            };
            found.map_err(|failure| {
                let line = self.lines[site.row];
                Unsolved { row: site.row, why: IdentifyError::Unsolved { line, failure } }
            })?;
            let here = loading.here();
            let by_constants = constants.iter().map(|constant| constant.by_constant(&here.seed)).collect();
            solved.push((Reaction { force_n: here.jet().force_n, by_constants }, loading.equilibrium()));
            tick();
        }
        Ok(solved)
    }

    /// A solver at rest, for a sphere where its way begins.
    fn begin(&self, analysis: &Analysis, unit: &[usize]) -> Result<Loading, PipelineError> {
        let Site { active, start_m, .. } = self.sites[unit[0]];
        let active = analysis.scene.active.get(active).map(|active| active.name.as_str());
        Loading::begin(analysis, active, start_m, false)
    }

    /// The free constants on the elements of a solver.
    fn constants(&self, loading: &Loading) -> Vec<Constant> {
        let body = loading.body();
        let of = |free: &SceneConstant| {
            Constant::of(body, free.region as u16, free.key).expect("checked before the first solve")
        };
        self.free.iter().map(of).collect()
    }
}

/// Whether the reaction has a derivative by this constant.
pub(super) fn has_derivative(regions: &[Region], constant: &SceneConstant) -> bool {
    Constant::exists(&regions[constant.region], constant.key)
}
