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
