//! Palpate, offline half: scene -> mesh + material -> static hyperelastic solves -> configuration space
//! -> blob.
//!
//! Inputs: a scene file and its mesh. Outputs: a store of solved configurations (`.space`) and a blob fitted
//! to it, which `palpate-core` reads. All numbers are f64 and deterministic: the same scene gives the same
//! bits for any number of threads.
//!
//! From a scene to a force command for the haptic device ([`pipeline`] describes the single steps):
//!
//! ```
//! use palpate_core::{AlignedBytes, Config, Controller, Method, Organ, Sample, State, vec3};
//! use palpate_precompute::pipeline::{Analysis, Run, certified_blob};
//!
//! # let folder = tempfile::tempdir()?;
//! # let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/scenes/palpation.toml");
//! let space = folder.path().join("organ.space");
//! let analysis = Analysis::load(scene.as_ref())?;
//! analysis.solve_all(&space, Run::run_to_end())?;
//! // Fitted, measured at 20 fresh solves, and packed. `None` solves the 299 that certify 99 %.
//! let blob = certified_blob(&space, &[Method::Energy], Some(20), Run::run_to_end())?;
//!
//! let blob = AlignedBytes::from(&blob);
//! let organ: Organ = Organ::read(&blob)?;
//! let controller = Controller::new(&organ, Config::new(Method::Energy))?;
//! let (mut state, node) = (State::new(), &organ.spaces[0].active);
//! state.arm();
//! for tick in 0..300 {
//!     // From 1 mm above the organ to 2 mm below its surface, one sample per millisecond.
//!     let height_m = 1e-3 - 1e-5 * tick as f32;
//!     let position_m = vec3::add(node.rest_position_m, vec3::scale(node.outward_normal, height_m));
//!     let sample = Sample { t_us: 1_000 * tick, position_m, ..Sample::default() };
//!     let command = controller.tick(&mut state, sample.t_us, Some(&sample));
//!     # if tick == 299 { assert!(vec3::norm(command.hand_force_n) > 0.05, "{command:?}"); }
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Conventions: SI units. Node indices are 0-based in file order. h is the force of the tool on the body,
//! h = dW/dd. Displacements are relative to the active node at rest.
#![deny(unsafe_code)]

pub mod adaptive;
pub mod certificate;
mod error;
pub mod fem;
mod files;
pub mod fit;
pub mod held_out;
pub mod identify;
pub mod live;
pub mod map;
pub mod mesh;
pub mod num;
pub mod pack;
pub mod pipeline;
pub mod plan;
pub mod scene;
pub mod space;
pub mod spec;

pub use error::InputError;
pub use files::write_atomically;
