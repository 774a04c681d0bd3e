//! Packs solved spaces into a blob: fits the tables of the chosen methods and stores them as planes.

mod error;
mod fitted;
mod untabled;

pub use error::PackError;
pub use untabled::{Place, Untabled};

use bytemuck::Pod;
use palpate_core::format::{
    self, ALIGNMENT, DisplacementHeader, Fingertip, HermiteHeader, KernelHeader, PlaneRef, Preamble,
    RbfHeader, SpaceHeader, SurfaceHeader,
};
use palpate_core::{AlignedBytes, Limits, Method, Organ};

use crate::fit::{
    Centre, DisplacementFit, HermiteNodes, Kernel, KernelPlanes, fit_rbf, lattice_flags, lattice_values,
};
use crate::mesh::{Surface, TetMesh};
use crate::num::vector::{distance, unit};
use crate::space::{Store, StoreIdentity};
use crate::spec::{Charts, GridIndex, Tool};
use fitted::{Fitted, Fitter, SelectedSpace, TableInput};

/// Bulk data of a blob under construction.
#[derive(Debug, Default)]
struct PlaneArea {
    bytes: Vec<u8>,
}

impl PlaneArea {
    fn push<T: Pod>(&mut self, plane: &[T]) -> Result<PlaneRef, PackError> {
        self.bytes.resize(self.bytes.len().next_multiple_of(ALIGNMENT), 0);
        let too_large = |_| PackError::TooLarge("the table area");
        let offset = u32::try_from(self.bytes.len()).map_err(too_large)?;
        let len = u32::try_from(plane.len()).map_err(too_large)?;
        self.bytes.extend_from_slice(bytemuck::cast_slice(plane));
        Ok(PlaneRef { offset, len })
    }

    fn push3<T: Pod>(&mut self, planes: &[Vec<T>; 3]) -> Result<[PlaneRef; 3], PackError> {
        Ok([self.push(&planes[0])?, self.push(&planes[1])?, self.push(&planes[2])?])
    }
}

fn short_text<const N: usize>(text: &str, what: &'static str) -> Result<heapless::String<N>, PackError> {
    heapless::String::try_from(text).map_err(|_| PackError::TooLarge(what))
}

/// Packed tables.
#[derive(Debug)]
pub struct Packed {
    preamble: Preamble,
    spaces: Vec<SpaceHeader>,
    planes: PlaneArea,
    /// Active nodes without a solved configuration besides rest; the blob does not contain them.
    pub nodes_without_data: Vec<String>,
}

impl Packed {
    /// The file's bytes.
    pub fn bytes(&self) -> Result<Vec<u8>, PackError> {
        assemble(&self.preamble, &self.spaces, &self.planes)
    }

    /// For a blob with the method `kernel`: refuses it if a node has no kernel, because its space is a
    /// lattice or its fit exceeds the limits of the core.
    pub fn expect_kernels(&self) -> Result<(), PackError> {
        match self.spaces.iter().find(|space| space.kernel.is_none()) {
            None => Ok(()),
            Some(space) => Err(PackError::NoKernel { active: space.name.as_str().into() }),
        }
    }

    /// Reads the file with the core's reader. So a table with a non-finite value is an error of packing, not
    /// of rendering.
    fn expect_readable(&self) -> Result<(), PackError> {
        let bytes = AlignedBytes::from(&self.bytes()?[..]);
        let read: Result<Box<Organ<'_>>, _> = Organ::read_boxed(&bytes);
        read.map(drop).map_err(PackError::Refused)
    }

    /// Adds a certificate of the tables as JSON and replaces an earlier one. The bits of the tables do not
    /// change.
    pub fn certify(&mut self, certificate: &str) -> Result<(), PackError> {
        // The certificate is the last plane.
        if let Some(earlier) = self.preamble.certificate.take() {
            self.planes.bytes.truncate(earlier.offset as usize);
        }
        self.preamble.certificate = Some(self.planes.push(certificate.as_bytes())?);
        Ok(())
    }
}

/// Selection of tables and options of the fits.
#[derive(Debug, Clone, Copy)]
pub struct PackOptions<'m> {
    /// Methods whose tables are packed. An empty list packs flags alone, without surface displacements.
    pub methods: &'m [Method],
    /// Whether intermediate states of transitions, if stored, are also centres of the radial basis functions.
    pub use_intermediate_states: bool,
    /// Number of threads of the fits.
    pub threads: usize,
}

/// Packs every solved space of `store`.
pub fn pack(store: &Store, options: &PackOptions<'_>) -> Result<Packed, PackError> {
    let identity = store.identity()?;
    let (mut mesh, fixed) = store.body()?;
    // The rest shape of the surface includes the sag under the body force. It comes from the first solved
    // rest point.
    let first = (0..store.active()?.len()).find_map(|active| store.displacements(active, REST, 0).ok());
    for (x, rest) in mesh.nodes_m.iter_mut().zip(first.iter().flatten()) {
        *x = std::array::from_fn(|axis| x[axis] + f64::from(rest[axis]));
    }
    let surface = Surface::of(&mesh).seen(&mesh);
    if identity.charts.is_some() && options.methods.iter().any(|method| *method != Method::Energy) {
        return Err(PackError::OnlyEnergy);
    }
    let visual = identity.visual && !options.methods.is_empty();
    let visual = visual.then_some(identity.displacement_bound);
    let mut selected = Vec::new();
    let mut nodes_without_data = Vec::new();
    for (active, (name, node)) in store.active()?.into_iter().enumerate() {
        let records = store.records(active)?;
        // The rest point alone does not make a space.
        if records.iter().filter(|record| record.tag().is_solved()).count() > 1 {
            selected.push(SelectedSpace { active, name, node, records });
        } else {
            nodes_without_data.push(name);
        }
    }
    let fitter =
        Fitter { sampling: identity.sampling, nodes: &surface.nodes, methods: options.methods, visual };
    let fitted = fitter.all(store, &selected, options.threads)?;
    let mut packer =
        Packer { store, identity: &identity, mesh, surface: &surface, options, planes: PlaneArea::default() };
    let surface_header = self::surface(&mut packer.planes, &surface, &packer.mesh, &fixed)?;
    let spaces = selected.iter().zip(fitted).map(|(selected, fitted)| packer.space(selected, &fitted));
    let spaces = spaces.collect::<Result<Vec<SpaceHeader>, PackError>>()?;
    if spaces.len() > Limits::PC.spaces {
        return Err(PackError::TooLarge("the number of active nodes"));
    }
    if spaces.is_empty() {
        return Err(PackError::Empty);
    }
    let contact = packer.contact(&selected, &spaces)?;
    let preamble = Preamble {
        scene: short_text(&identity.scene_name, "the scene's name")?,
        law: short_text(&identity.law, "the law's name")?,
        max_force_n: identity.max_force_n as f32,
        mesh_hash: identity.mesh_hash,
        surface: surface_header,
        contact,
        tool: stated(&identity.tool()),
        certificate: None,
        space_count: spaces.len() as u32,
    };
    let packed = Packed { preamble, spaces, planes: packer.planes, nodes_without_data };
    packed.expect_readable()?;
    Ok(packed)
}

/// The rest point.
const REST: GridIndex = [0; 3];

/// The planes of a surface.
fn surface(
    planes: &mut PlaneArea,
    surface: &Surface,
    mesh: &TetMesh,
    fixed: &[u32],
) -> Result<SurfaceHeader, PackError> {
    let position = |axis: usize| -> Vec<f32> {
        surface.nodes.iter().map(|&n| mesh.nodes_m[n as usize][axis] as f32).collect()
    };
    let vertex =
        |node: u32| surface.nodes.binary_search(&node).expect("a triangle's nodes are surface nodes") as u32;
    let triangles: Vec<[u32; 3]> = surface.triangles.iter().map(|t| t.map(vertex)).collect();
    let held: Vec<u8> = surface.nodes.iter().map(|n| u8::from(fixed.binary_search(n).is_ok())).collect();
    Ok(SurfaceHeader {
        node: planes.push(&surface.nodes)?,
        position_m: planes.push3(&[position(0), position(1), position(2)])?,
        triangles: planes.push(&triangles)?,
        fixed: planes.push(&held)?,
    })
}

/// A tool as the blob states it.
fn stated(tool: &Tool) -> format::Tool {
    match tool {
        Tool::Point => format::Tool::Point,
        Tool::Fingertip(tip) => format::Tool::Fingertip(fingertip(tip)),
        Tool::Sphere(it) => format::Tool::Sphere(sphere(it)),
        Tool::Capsule(capsule) => format::Tool::Capsule(format::Capsule {
            sphere: sphere(&capsule.sphere),
            half_axis_m: capsule.half_axis_m.map(|x| x as f32),
        }),
    }
}

/// A sphere as the blob states it.
fn sphere(sphere: &crate::fem::Sphere) -> format::Sphere {
    let layer_m = (sphere.reach_m() - sphere.radius_m) as f32;
    format::Sphere { radius_m: sphere.radius_m as f32, layer_m }
}

/// A fingertip as the blob states it.
pub(crate) fn fingertip(tip: &crate::fem::Fingertip) -> Fingertip {
    Fingertip { radius_m: tip.radius_m as f32, stiffness_n_m: tip.stiffness_on_a_plane_n_m() as f32 }
}

/// Data that all spaces of a blob share while they are packed.
struct Packer<'s> {
    store: &'s Store,
    identity: &'s StoreIdentity,
    mesh: TetMesh,
    surface: &'s Surface,
    options: &'s PackOptions<'s>,
    planes: PlaneArea,
}

impl Packer<'_> {
    /// The triangles between contact points that have a space.
    fn contact(
        &mut self,
        selected: &[SelectedSpace],
        spaces: &[SpaceHeader],
    ) -> Result<SurfaceHeader, PackError> {
        if let Some(charts) = &self.identity.charts {
            return self.charted(charts, selected);
        }
        let Some(contacts) = &self.identity.contacts else { return Ok(SurfaceHeader::default()) };
        let vertex = |active: &u32| selected.iter().position(|space| space.active == *active as usize);
        let corners = |triangle: &[u32; 3]| -> Option<[u32; 3]> {
            let [a, b, c] = triangle.each_ref().map(vertex);
            Some([a? as u32, b? as u32, c? as u32])
        };
        let triangles: Vec<[u32; 3]> = contacts.triangles.iter().filter_map(corners).collect();
        if triangles.is_empty() {
            return Ok(SurfaceHeader::default());
        }
        let position =
            |axis: usize| -> Vec<f32> { spaces.iter().map(|space| space.rest_position_m[axis]).collect() };
        let planes = &mut self.planes;
        Ok(SurfaceHeader {
            node: planes.push(&(0..spaces.len() as u32).collect::<Vec<u32>>())?,
            position_m: planes.push3(&[position(0), position(1), position(2)])?,
            triangles: planes.push(&triangles)?,
            fixed: planes.push(&vec![0_u8; spaces.len()])?,
        })
    }

    /// The surface of the first touch, with the chart of each vertex as its space; a chart without a space is replaced by
    /// the nearest one.
    fn charted(&mut self, charts: &Charts, selected: &[SelectedSpace]) -> Result<SurfaceHeader, PackError> {
        let centre = |chart: usize| charts.charts[chart].centre_m;
        let space_of = |&owner: &u32| -> u32 {
            let away_m = |space: &usize| distance(centre(owner as usize), centre(selected[*space].active));
            let spaces = 0..selected.len();
            spaces.min_by(|a, b| away_m(a).total_cmp(&away_m(b))).expect("a blob has a space") as u32
        };
        let spaces: Vec<u32> = charts.owners.iter().map(space_of).collect();
        let position =
            |axis: usize| -> Vec<f32> { charts.places_m.iter().map(|place| place[axis] as f32).collect() };
        let position_m = [position(0), position(1), position(2)];
        Ok(SurfaceHeader {
            node: self.planes.push(&spaces)?,
            position_m: self.planes.push3(&position_m)?,
            triangles: self.planes.push(&charts.triangles)?,
            fixed: self.planes.push(&vec![0_u8; spaces.len()])?,
        })
    }

    fn space(&mut self, selected: &SelectedSpace, fitted: &Fitted) -> Result<SpaceHeader, PackError> {
        let SelectedSpace { active, name, node, .. } = selected;
        let (active, node) = (*active, *node);
        let Fitted { known, hermite, kernel, displacement } = fitted;
        let TableInput { grid, samples, branch_jumps, .. } = known;
        let on_lattice = [Method::Trilinear, Method::Tricubic, Method::Hybrid];
        let has_lattice = self.options.methods.iter().any(|m| on_lattice.contains(m));
        let (flags, force_n) = if has_lattice {
            let values = lattice_values(grid, samples, branch_jumps);
            (values.flags, Some(values.force_n))
        } else {
            (lattice_flags(grid, samples, branch_jumps), None)
        };
        let flags = self.planes.push(&flags)?;
        let force_n = force_n.map(|force_n| self.planes.push(&force_n)).transpose()?;
        let centres = self.centres(active, known)?;
        let rbf_linear = self.rbf((Method::RbfLinear, Kernel::Linear), name, &centres, |x| x as f32)?;
        let rbf_cubic = self.rbf((Method::RbfCubic, Kernel::Cubic), name, &centres, |x| x)?;
        let hermite = match hermite {
            Some(HermiteNodes { row, nodes }) => {
                Some((row, HermiteHeader { row: self.planes.push(row)?, nodes: self.planes.push(nodes)? }))
            }
            None => None,
        };
        let displacement = match displacement {
            Some(fit) => {
                Some(self.displacement(fit, hermite.as_ref().map(|(row, header)| (&row[..], header.row)))?)
            }
            None => None,
        };
        let hermite = hermite.map(|(_, header)| header);
        let kernel = match kernel {
            Some(KernelPlanes { scalars, blocks, reach }) => Some(KernelHeader {
                scalars: self.planes.push(scalars)?,
                blocks: self.planes.push(blocks)?,
                reach: self.planes.push(reach)?,
            }),
            None => None,
        };
        let surface_normal = |node| self.surface.normal(node).expect("an active node is on the surface");
        let normal = self.identity.at_active(active, node, surface_normal);
        let normal = if self.identity.contacts.is_some() { unit(normal) } else { normal };
        let rest_m = self.identity.at_active(active, node, |node| self.mesh.nodes_m[node as usize]);
        let chart = self.identity.charts.as_ref().map(|charts| charts.charts[active]);
        let (rest_m, normal) = chart.map_or((rest_m, normal), |chart| (chart.centre_m, chart.normal));
        Ok(SpaceHeader {
            name: short_text(name, "an active node's name")?,
            node,
            rest_position_m: rest_m.map(|x| x as f32),
            outward_normal: normal.map(|x| x as f32),
            spacing_m: grid.spacing_m as f32,
            radius_m: grid.radius_m as f32,
            flags,
            force_n,
            rbf_linear,
            rbf_cubic,
            hermite,
            displacement,
            kernel,
        })
    }

    /// Centres of the radial basis functions: the grid points and, if requested, the intermediate states of
    /// their accepted transitions.
    fn centres(&self, active: usize, known: &TableInput) -> Result<Vec<Centre>, PackError> {
        let samples = &known.samples;
        let mut centres: Vec<Centre> = samples.iter().map(Centre::from).collect();
        if self.options.use_intermediate_states {
            let cells = |d: [f64; 3]| d.map(|x| x / known.grid.spacing_m);
            for (index, attempt, state) in self.store.intermediate(active)? {
                let counts = samples.binary_search_by_key(&index, |s| s.index);
                if counts.is_ok_and(|at| samples[at].attempt == attempt) {
                    centres.push(Centre { position: cells(state.control_m), force_n: state.force_n });
                }
            }
            // Two transitions can share an intermediate position; the first one is used.
            let mut seen = std::collections::HashSet::new();
            centres.retain(|c| seen.insert(c.position.map(|x| (x * 1e6).round() as i64)));
        }
        Ok(centres)
    }

    /// The planes of a kernel in the number format of the core; `None` if its method is not requested.
    fn rbf<T: Pod>(
        &mut self,
        (method, kernel): (Method, Kernel),
        name: &str,
        centres: &[Centre],
        convert: fn(f64) -> T,
    ) -> Result<Option<RbfHeader>, PackError> {
        if !self.options.methods.contains(&method) {
            return Ok(None);
        }
        let fit = fit_rbf(kernel, centres, self.options.threads);
        let fit = fit.map_err(|error| PackError::Fit { active: name.into(), error })?;
        let mut push = |planes: [Vec<f64>; 3]| {
            self.planes.push3(&planes.map(|plane| plane.into_iter().map(convert).collect()))
        };
        Ok(Some(RbfHeader { centres: push(fit.centres)?, weights: push(fit.weights)? }))
    }

    /// `row` is the row of the Hermite table and its plane.
    fn displacement(
        &mut self,
        fit: &DisplacementFit,
        row: Option<(&[u32], PlaneRef)>,
    ) -> Result<DisplacementHeader, PackError> {
        let planes = &mut self.planes;
        let row = row.filter(|(rows, _)| *rows == &fit.row[..]).map(|(_, plane)| plane);
        Ok(DisplacementHeader {
            slopes: fit.slopes as u32,
            row: row.map_or_else(|| planes.push(&fit.row), Ok)?,
            modes: planes.push(&fit.modes)?,
            scale: planes.push(&fit.scale)?,
            coefficients: planes.push(&fit.coefficients)?,
            outlier_row: planes.push(&fit.outlier_row)?,
            outlier_scale: planes.push(&fit.outlier_scale)?,
            outliers: planes.push(&fit.outliers)?,
        })
    }
}

fn assemble(preamble: &Preamble, spaces: &[SpaceHeader], planes: &PlaneArea) -> Result<Vec<u8>, PackError> {
    let encode =
        |result: Result<Vec<u8>, postcard::Error>| result.map_err(|_| PackError::TooLarge("the header"));
    let mut header = encode(postcard::to_stdvec(preamble))?;
    for space in spaces {
        header.extend(encode(postcard::to_stdvec(space))?);
    }
    let mut blob = Vec::with_capacity(header.len() + planes.bytes.len() + 128);
    format::write(&header, &planes.bytes, |piece| blob.extend_from_slice(piece))
        .ok_or(PackError::TooLarge("the header"))?;
    Ok(blob)
}
