//! Where the controller gets the force of the body: packed tables, or the jets of a live solver.

use crate::blob::Organ;
use crate::method::{Coverage, ForceSample, Method};
use crate::num::vec3::{self, Vec3};
use crate::space::Space;
use crate::touch::NodeWeight;

/// What the tool holds in one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Touch {
    /// Time of the tick, microseconds.
    pub now_us: u64,
    /// The engaged contact points (spaces) and their weights.
    pub weights: [NodeWeight; 3],
    /// Displacement of all of them, metres. Of a sphere it is that from the first touch.
    pub displacement_m: Vec3,
    /// HIP, model frame, metres. The displacement of a sphere's space is that of the HIP from its rest position.
    pub hip_m: Vec3,
    /// The way from the centre of a capsule to one of its ends, model frame, metres.
    pub half_axis_m: Option<Vec3>,
}

/// A source of the reaction force.
pub trait Field {
    /// h = sum w_i h_i(d) at a touch, finite; `None` if a space has no data, which is a fault of the caller.
    fn force(&mut self, touch: &Touch) -> Option<ForceSample>;

    /// W of one space, joules, where the force is its gradient; called after [`Field::force`] in a tick.
    fn energy_j(&self, space: u16, displacement_m: Vec3) -> Option<f32>;

    /// Whether the touch may slip in this tick; called after [`Field::force`].
    fn slips(&self) -> bool {
        true
    }

    /// dW/da of a capsule with the half axis a, newtons: its moment is the vector product of a and this; called after
    /// [`Field::force`] in a tick.
    fn turning_n(&self) -> Vec3 {
        vec3::ZERO
    }

    /// The tool touches nothing in this tick.
    fn released(&mut self, _now_us: u64) {}

    /// Largest stiffness of what it has got so far at forces up to this one, N/m, with that of the fixed part while the tool
    /// touches it; 0 where the controller has found it at the start.
    fn stiffest_n_m(&self, _force_n: f32) -> f32 {
        0.0
    }

    /// Whether the source has ended and its force has faded out.
    fn is_lost(&self) -> bool {
        false
    }
}

/// The tables of an organ, with the caller's evaluation of them.
pub(crate) struct Packed<'o, 'a, const N: usize, F> {
    pub(crate) organ: &'o Organ<'a, N>,
    pub(crate) method: Option<Method>,
    pub(crate) evaluate: F,
}

impl<const N: usize, F: Fn(&Space<'_>, &Vec3) -> Option<ForceSample>> Field for Packed<'_, '_, N, F> {
    /// The coverage is `Extrapolated` if that of any space is, else that of the first space.
    fn force(&mut self, touch: &Touch) -> Option<ForceSample> {
        let mut sum: Option<ForceSample> = None;
        let is_sphere = self.organ.tool.sphere().is_some();
        for node in touch.weights.iter().filter(|node| node.weight > 0.0) {
            let space = self.organ.spaces.get(usize::from(node.space))?;
            let one = if is_sphere {
                (self.evaluate)(space, &vec3::sub(touch.hip_m, space.active.rest_position_m))?
            } else {
                (self.evaluate)(space, &touch.displacement_m)?
            };
            // A single space has weight 1, so the product keeps the bits.
            let force_n = vec3::scale(one.force_n, node.weight);
            sum = Some(match sum {
                None => ForceSample { force_n, ..one },
                Some(others) => ForceSample {
                    force_n: vec3::add(others.force_n, force_n),
                    coverage: if one.coverage == Coverage::Extrapolated {
                        one.coverage
                    } else {
                        others.coverage
                    },
                },
            });
        }
        sum
    }

    fn energy_j(&self, space: u16, displacement_m: Vec3) -> Option<f32> {
        self.organ.spaces.get(usize::from(space))?.energy_j(self.method?, displacement_m)
    }
}
