//! The renderer for window and files: organ and record in, picture out.

use super::camera::{OrbitCamera, Projection};
use super::contact::Contact;
use super::help::Help;
use super::image::Image;
use super::inset::Inset;
use super::live::Live;
use super::mouse_tool::PickView;
use super::overlay::{Captions, Overlay};
use super::raster::Raster;
use super::regions::Regions;
use super::scene::{Scene, nice_scale_m};
use super::shade::Shader;
use super::touched::Touched;
use super::verdict::Verdict;
use super::viewpoint;
use crate::deformation::Deformation;
use core::time::Duration;
use glam::Vec2;
use palpate_core::Organ;
use palpate_host::live::SolverView;
use palpate_host::rt::TickRecord;
use std::time::Instant;

/// Size and sampling of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RendererConfig {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Samples per pixel along each axis: 1 for speed, 2 for smooth edges.
    pub samples: usize,
}

impl RendererConfig {
    /// For a window at 30 Hz.
    #[must_use]
    pub const fn live() -> Self {
        Self { width: 1280, height: 720, samples: 1 }
    }

    /// For files.
    #[must_use]
    pub const fn still() -> Self {
        Self { samples: 2, ..Self::live() }
    }
}

/// Times of the stages of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameTimes {
    /// Displacements, positions and normals of the surface.
    pub deformation: Duration,
    /// Drawing triangles into the geometry buffer.
    pub raster: Duration,
    /// Shading and background.
    pub shading: Duration,
    /// Lines, names, charts and text.
    pub overlay: Duration,
}

impl FrameTimes {
    /// Sum of all stages.
    #[must_use]
    pub fn total(&self) -> Duration {
        self.deformation + self.raster + self.shading + self.overlay
    }
}

/// Optional layers; each is switched by a key in the window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layers {
    /// The rest shape where it differs from the present one.
    pub ghost: bool,
    /// The reachable region of the touched node.
    pub reach: bool,
    /// The side view of the touch.
    pub side: bool,
    /// The help.
    pub help: Help,
    /// Time until the window's chord arms the device, while it is held.
    pub arming: Option<Duration>,
}

impl Default for Layers {
    fn default() -> Self {
        Self { ghost: true, reach: false, side: true, help: Help::Absent, arming: None }
    }
}

/// Draws an organ, the tool and the overlay; all buffers are reused.
#[derive(Debug)]
pub struct Renderer {
    camera: OrbitCamera,
    home: OrbitCamera,
    raster: Raster,
    shader: Shader,
    scene: Scene,
    surface: Deformation,
    overlay: Overlay,
    inset: Inset,
    contact: Contact,
    captions: Captions,
    image: Image,
    full_scale_m: f32,
    names_at: Vec<Option<Vec2>>,
    layers: Layers,
    times: FrameTimes,
    /// The live solver, which knows the displacements.
    solver: Option<SolverView>,
}

impl Renderer {
    /// Makes a renderer for an organ. `method` is the name of what gives the force, for the caption.
    #[must_use]
    pub fn new<const N: usize>(organ: &Organ<'_, N>, method: &str, config: RendererConfig) -> Self {
        let RendererConfig { width, height, samples } = config;
        let surface = Deformation::at_rest(organ);
        let scene = Scene::new(organ, &surface);
        let camera = viewpoint::choose(organ, &surface, width as f32 / height.max(1) as f32);
        Self {
            raster: Raster::new(width, height, samples, &camera.projection(width, height)),
            camera,
            home: camera,
            shader: Shader::new(),
            scene,
            surface,
            overlay: Overlay::default(),
            inset: Inset::new(organ),
            contact: Contact::default(),
            captions: Captions {
                scene: organ.scene.as_str().to_owned(),
                law: organ.law.as_str().to_owned(),
                method: method.to_owned(),
                spaces: organ.spaces.iter().map(|space| space.active.name.as_str().to_owned()).collect(),
                verdicts: Vec::new(),
                models: 1,
                tool: organ.tool,
                depth_m: 0.0,
                contact: None,
                force_only: false,
                note: String::new(),
            },
            image: Image::new(width, height),
            full_scale_m: nice_scale_m(0.0),
            names_at: Vec::new(),
            layers: Layers::default(),
            times: FrameTimes::default(),
            solver: None,
        }
    }

    /// Sets the number of models of the session; with several models the picture names the current one.
    pub const fn set_models(&mut self, count: usize) {
        self.captions.models = count;
    }

    /// Sets the certificate's verdict on each active node of each model. Those not set are unknown.
    pub fn set_verdicts(&mut self, verdicts: Vec<Vec<Verdict>>) {
        self.captions.verdicts = verdicts;
    }

    /// Sets the boundaries of regions inside the body, which the side view shows.
    pub fn set_regions(&mut self, regions: &Regions) {
        self.inset.set_regions(regions);
    }

    /// Sets the live solver that shows the displacements of the surface; the organ then needs no table of them.
    pub fn set_solver(&mut self, solver: Option<SolverView>) {
        self.solver = solver;
    }

    /// Sets a line under the title.
    pub fn set_note(&mut self, note: String) {
        self.captions.note = note;
    }

    /// The camera.
    pub const fn camera_mut(&mut self) -> &mut OrbitCamera {
        &mut self.camera
    }

    /// Restores the initial view.
    pub const fn reset_view(&mut self) {
        self.camera = self.home;
    }

    /// The displayed scene, for picking.
    pub(super) fn view(&self) -> PickView<'_> {
        PickView { projection: self.projection(), surface: &self.surface }
    }

    /// The last picture.
    #[must_use]
    pub const fn image(&self) -> &Image {
        &self.image
    }

    /// The optional layers.
    pub const fn layers_mut(&mut self) -> &mut Layers {
        &mut self.layers
    }

    /// Times of the last frame.
    #[must_use]
    pub const fn times(&self) -> FrameTimes {
        self.times
    }

    /// Draws the state of one tick.
    pub fn render<const N: usize>(
        &mut self,
        organ: &Organ<'_, N>,
        record: &TickRecord,
        live: &mut Live,
    ) -> &Image {
        let mut watch = Stopwatch(Instant::now());
        // The session may have switched to another model.
        for (shown, now) in
            [(&mut self.captions.law, organ.law.as_str()), (&mut self.captions.scene, organ.scene.as_str())]
        {
            if shown != now {
                now.clone_into(shown);
            }
        }
        self.captions.force_only =
            self.solver.is_none() && organ.spaces.iter().all(|space| space.displacement().is_none());
        self.deform(organ, record);
        self.times.deformation = watch.lap();

        let projection = self.projection();
        self.raster.begin(&projection);
        self.scene.draw_solids(&mut self.raster, organ, &self.surface, record, self.full_scale_m);
        self.times.raster = watch.lap();

        self.shader.resolve(&self.raster, &mut self.image);
        self.times.shading = watch.lap();

        if self.layers.ghost {
            let scale_m = self.full_scale_m;
            self.scene.draw_ghost(&self.raster, &projection, &self.surface, scale_m, &mut self.image);
        }
        if self.layers.reach {
            self.scene.draw_reach((&self.raster, &projection), organ, record, &mut self.image);
        }
        let view = (&self.raster, &projection);
        let half_m = self.scene.tool().half_m();
        let touched = Touched::of(organ, record, half_m);
        if let Some(touched) = &touched {
            self.scene.draw_tool(view, touched, &mut self.image);
        }
        self.captions.contact = None;
        if let Some(sphere) = organ.tool.sphere().filter(|_| !self.captions.force_only) {
            let skin = (&self.surface, organ.surface.triangles);
            let patch = self.contact.update(skin, (sphere, half_m), record);
            self.captions.contact = patch.map(|patch| patch.to_string());
            self.contact.draw(&projection, &mut self.image);
        }
        self.scene.visible_nodes(organ, view, &self.surface, record, &mut self.names_at);
        self.overlay.draw_names(&mut self.image, &self.captions, &self.names_at);
        let legend = (self.scene.map(), self.full_scale_m);
        self.captions.depth_m = touched.map_or(0.0, |touched| touched.depth_m().max(0.0));
        self.overlay.draw(&mut self.image, &self.captions, record, live, legend);
        if let (Some(touched), true) = (&touched, self.layers.side) {
            let skin = (&self.surface, organ.surface.triangles);
            self.inset.draw((touched, self.scene.tool()), skin, &projection, &mut self.image);
        }
        self.overlay.draw_help(&mut self.image, self.layers.help);
        self.overlay.draw_arming(&mut self.image, self.layers.arming);
        self.times.overlay = watch.lap();
        &self.image
    }

    /// Updates the surface to the configuration of a tick.
    fn deform<const N: usize>(&mut self, organ: &Organ<'_, N>, record: &TickRecord) {
        match &mut self.solver {
            Some(solver) => self.surface.show(organ.surface.triangles, |displacements_m| {
                solver.surface(displacements_m);
            }),
            None => self.surface.update(organ, &record.shares, record.displacement_m),
        }
        // The scale only increases, so the colours of a run are comparable and do not flicker.
        self.full_scale_m = self.full_scale_m.max(nice_scale_m(self.surface.largest_m()));
    }

    /// The projection with the organ left of and above the middle: text is on the right, charts and
    /// side view are below.
    fn projection(&self) -> Projection {
        let mut projection = self.camera.projection(self.image.width(), self.image.height());
        projection.centre_px.x -= 0.06 * self.image.width() as f32;
        projection.centre_px.y -= 0.045 * self.image.height() as f32;
        projection
    }
}

/// Measures the time between laps.
struct Stopwatch(Instant);

impl Stopwatch {
    fn lap(&mut self) -> Duration {
        let now = Instant::now();
        now - core::mem::replace(&mut self.0, now)
    }
}
