//! What the solver sees of the hand.

/// What the tool does now, as the solver sees it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Hand {
    /// Position of the tool, m.
    pub hip_m: [f64; 3],
    /// Velocity of the tool, m/s.
    pub velocity_m_s: [f64; 3],
    /// The touch, if there is one.
    pub touch: Option<Touch>,
    /// The partner, another sphere, while it feels a force of the same body.
    pub partner: Option<Partner>,
    /// The axis of a capsule.
    pub axis: Option<Axis>,
}

/// How a capsule is turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    /// The way from its centre to one end, m.
    pub half_m: [f64; 3],
    /// The velocity of that end relative to the centre, m/s.
    pub velocity_m_s: [f64; 3],
}

/// Another tool on the same body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Partner {
    /// Its position, m.
    pub position_m: [f64; 3],
    /// Its velocity, m/s.
    pub velocity_m_s: [f64; 3],
}

/// A touch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Touch {
    /// The contacts whose forces are blended, and their weights; a weight of zero does not take part.
    pub contacts: [(u16, f64); 3],
    /// The control of all three: the displacement of the tool from the place that it touched, m.
    pub control_m: [f64; 3],
}

/// A solve that takes longer than this shows how the hand goes on, s: longer than a tremor takes for its way to and fro.
const LONG_S: f64 = 0.1;

/// The way of the hand during the last solve.
#[derive(Debug, Default)]
pub(super) struct Way {
    from_m: [f64; 3],
    /// How long the solve took, s; `None` if nothing was solved.
    seconds: Option<f64>,
}

impl Way {
    /// The last step has solved for this time, s.
    pub(super) fn took(&mut self, seconds: f64) {
        self.seconds = Some(seconds);
    }

    /// The hand with the velocity by which its position is predicted over the time of a solve: that of now has the whole tremor,
    /// and the mean over the last solve lags behind, so that the mean of both is taken.
    pub(super) fn steady(&mut self, hand: &Hand) -> Hand {
        let Self { from_m, seconds } = std::mem::replace(self, Self { from_m: hand.hip_m, seconds: None });
        let Some(seconds) = seconds.filter(|seconds| *seconds > LONG_S) else { return *hand };
        let mean = |axis: usize| (hand.hip_m[axis] - from_m[axis]) / seconds;
        let velocity_m_s = std::array::from_fn(|axis| 0.5 * (hand.velocity_m_s[axis] + mean(axis)));
        Hand { velocity_m_s, ..*hand }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_velocity_of_a_long_solve_is_half_that_of_its_way() {
        let mut way = Way::default();
        let at =
            |x: f64, v: f64| Hand { hip_m: [x, 0.0, 0.0], velocity_m_s: [v, 0.0, 0.0], ..Hand::default() };
        assert_eq!(way.steady(&at(0.0, 0.03)).velocity_m_s[0], 0.03, "nothing was solved");
        way.took(0.2);
        let steady = way.steady(&at(0.002, 0.03));
        assert!((steady.velocity_m_s[0] - 0.02).abs() < 1e-15 && steady.hip_m[0] == 0.002, "{steady:?}");
        assert_eq!(way.steady(&at(0.002, 0.03)).velocity_m_s[0], 0.03, "an idle step");
        way.took(0.002);
        assert_eq!(way.steady(&at(0.003, 0.03)).velocity_m_s[0], 0.03, "a short solve");
    }
}
