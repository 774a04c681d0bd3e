//! What a session renders: one organ, or several of which one is under the hand, each with its surface ready to be touched.

use palpate_core::controller::ControllerError;
use palpate_core::{Config, Controller, Organ, TouchSurface};

/// Memory for the surfaces of some organs; the lists of [`TouchSurface`] live here.
#[derive(Debug, Default)]
pub struct TouchMemory(Vec<Vec<u32>>);

/// A controller for each organ, all with the same settings.
pub fn controllers<'o, 'a, const N: usize>(
    organs: &[&'o Organ<'a, N>],
    config: Config,
    memory: &'o mut TouchMemory,
) -> Result<Vec<Controller<'o, 'a, N>>, ControllerError> {
    memory.0 = organs.iter().map(|organ| vec![0; TouchSurface::words(organ)]).collect();
    let with_surface = |(organ, memory): (&&'o Organ<'a, N>, &'o mut Vec<u32>)| {
        Ok(Controller::new(*organ, config)?.on_surface(TouchSurface::new(*organ, memory)))
    };
    organs.iter().zip(&mut memory.0).map(with_surface).collect()
}
