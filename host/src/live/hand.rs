//! What the loop tells the solver in every tick: where the tool is, how it moves and what it touches.

use super::partner::Partner;
use palpate_core::{NodeWeight, Vec3, vec3};

/// The hand in one tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Hand {
    /// Number of the tick.
    pub tick: u64,
    /// Time of the tick since the start of the loop, us.
    pub t_us: u64,
    /// The engaged contacts; every weight is 0 while the tool is free.
    pub engaged: [NodeWeight; 3],
    /// Control d of the engaged contacts, m; zero while the tool is free.
    pub displacement_m: Vec3,
    /// Velocity of the HIP, filtered, m/s.
    pub velocity_m_s: Vec3,
    /// HIP, model frame, m.
    pub hip_m: Vec3,
    /// Whether the tool touches the body.
    pub is_engaged: bool,
    /// Whether the jets of the loop do not cover the control: the solver is late.
    pub is_extrapolated: bool,
    /// Which of the engaged contacts have no jet in the loop: it never got one, or gave its place to another.
    pub missing: [bool; 3],
    /// Frames that the loop has taken so far.
    pub taken: u32,
    /// Frames among them that were no valid jet, or had no room.
    pub refused: u32,
    /// Sequence number of the last jet that was kept.
    pub sequence: u32,
    /// Whether the tool feels a force.
    pub presses: bool,
    /// Another tool that presses the same body.
    pub partner: Option<Partner>,
    /// The axis of a capsule, which has no partner.
    pub axis: Option<Axis>,
}

/// How a capsule is turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    /// The way from its centre to one end, model frame, m.
    pub half_m: Vec3,
    /// The velocity of that end relative to the centre, m/s.
    pub velocity_m_s: Vec3,
}

/// Words of a hand in shared memory.
pub(super) const HAND_WORDS: usize = 15;

const ENGAGED: u32 = 1;
const EXTRAPOLATED: u32 = 2;
const MISSING: [u32; 3] = [4, 8, 16];
const PRESSES: u32 = 32;
const PARTNER: u32 = 64;
const AXIS: u32 = 128;

const fn pair(low: u32, high: u32) -> u64 {
    low as u64 | (high as u64) << 32
}

const fn halves(word: u64) -> (u32, u32) {
    (word as u32, (word >> 32) as u32)
}

impl Hand {
    /// The words of the hand.
    pub(super) fn words(&self) -> [u64; HAND_WORDS] {
        let share = |index: usize| {
            let NodeWeight { space, weight } = self.engaged[index];
            pair(weight.to_bits(), space.into())
        };
        let [dx, dy, dz] = self.displacement_m.map(f32::to_bits);
        let [vx, vy, vz] = self.velocity_m_s.map(f32::to_bits);
        let [x, y, z] = self.hip_m.map(f32::to_bits);
        let flag = |is_set: bool, bit: u32| if is_set { bit } else { 0 };
        let mut flags = flag(self.is_engaged, ENGAGED) | flag(self.is_extrapolated, EXTRAPOLATED);
        for (is_missing, bit) in self.missing.into_iter().zip(MISSING) {
            flags |= flag(is_missing, bit);
        }
        flags |= flag(self.presses, PRESSES) | flag(self.partner.is_some(), PARTNER);
        flags |= flag(self.axis.is_some(), AXIS);
        let other = match self.axis {
            Some(Axis { half_m, velocity_m_s }) => {
                Partner { position_m: half_m, velocity_m_s, presses: true }
            }
            None => self.partner.unwrap_or_default(),
        };
        let [place, place_and_velocity, velocity] = other.words();
        [
            self.tick,
            self.t_us,
            share(0),
            share(1),
            share(2),
            pair(dx, dy),
            pair(dz, vx),
            pair(vy, vz),
            pair(x, y),
            pair(z, flags),
            pair(self.taken, self.refused),
            pair(self.sequence, 0),
            place,
            place_and_velocity,
            velocity,
        ]
    }

    /// The hand of some words.
    pub(super) fn of_words(words: [u64; HAND_WORDS]) -> Self {
        let [tick, t_us, first, second, third, rest @ .., place, place_and_velocity, velocity] = words;
        let share = |word| {
            let (weight, space) = halves(word);
            NodeWeight { space: space as u16, weight: f32::from_bits(weight) }
        };
        let [(dx, dy), (dz, vx), (vy, vz), (x, y), (z, flags), (taken, refused), (sequence, _)] =
            rest.map(halves);
        let other = Partner::of_words([place, place_and_velocity, velocity], true);
        Self {
            tick,
            t_us,
            engaged: [first, second, third].map(share),
            displacement_m: [dx, dy, dz].map(f32::from_bits),
            velocity_m_s: [vx, vy, vz].map(f32::from_bits),
            hip_m: [x, y, z].map(f32::from_bits),
            is_engaged: flags & ENGAGED != 0,
            is_extrapolated: flags & EXTRAPOLATED != 0,
            missing: MISSING.map(|bit| flags & bit != 0),
            taken,
            refused,
            sequence,
            presses: flags & PRESSES != 0,
            partner: (flags & PARTNER != 0).then_some(other),
            axis: (flags & AXIS != 0)
                .then_some(Axis { half_m: other.position_m, velocity_m_s: other.velocity_m_s }),
        }
    }
}

/// Share of the residual by which the filter corrects its position, and its velocity.
const ALPHA: f32 = 0.4;
const BETA: f32 = 0.06;
/// Longest time between two samples over which the filter predicts, us.
const MAX_GAP_US: u64 = 20_000;
/// A residual that no hand makes within the gap: the filter starts again there, m.
const MAX_RESIDUAL_M: f32 = 0.05;

/// Velocity of the HIP by an alpha-beta filter.
///
/// x' = x + v dt, r = p - x', x = x' + alpha r, v = v + beta r / dt, with alpha = 0.4 and beta = 0.06. At 1 kHz
/// it follows a change of the velocity within 20 ms, and passes a seventh of the noise of a difference.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct VelocityFilter {
    /// Time of the last sample, us, and the filtered position.
    last: Option<(u64, Vec3)>,
    velocity_m_s: Vec3,
}

impl VelocityFilter {
    /// Takes a sample; the filtered velocity, m/s. A sample that is not finite, or not newer than the last, is
    /// ignored.
    pub fn update(&mut self, t_us: u64, position_m: Vec3) -> Vec3 {
        if !vec3::is_finite(position_m) {
            return self.velocity_m_s;
        }
        let Some((last_us, last_m)) = self.last else { return self.start(t_us, position_m) };
        let Some(elapsed_us) = t_us.checked_sub(last_us).filter(|elapsed_us| *elapsed_us > 0) else {
            return self.velocity_m_s;
        };
        let elapsed_s = elapsed_us as f32 * 1e-6;
        let predicted_m = vec3::add(last_m, vec3::scale(self.velocity_m_s, elapsed_s));
        let residual_m = vec3::sub(position_m, predicted_m);
        if elapsed_us > MAX_GAP_US || vec3::norm(residual_m) > MAX_RESIDUAL_M {
            return self.start(t_us, position_m);
        }
        self.last = Some((t_us, vec3::add(predicted_m, vec3::scale(residual_m, ALPHA))));
        self.velocity_m_s = vec3::add(self.velocity_m_s, vec3::scale(residual_m, BETA / elapsed_s));
        self.velocity_m_s
    }

    /// The velocity after the last sample, m/s.
    #[must_use]
    pub const fn velocity_m_s(&self) -> Vec3 {
        self.velocity_m_s
    }

    fn start(&mut self, t_us: u64, position_m: Vec3) -> Vec3 {
        (self.last, self.velocity_m_s) = (Some((t_us, position_m)), vec3::ZERO);
        vec3::ZERO
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_field_survives_its_words() {
        let hand = Hand {
            tick: u64::MAX - 3,
            t_us: 1 << 50,
            engaged: [(9, 0.25), (511, 0.75), (u16::MAX, 0.0)]
                .map(|(space, weight)| NodeWeight { space, weight }),
            displacement_m: [0.001, -0.002, 1e-30],
            velocity_m_s: [0.3, -0.0, -7.5],
            hip_m: [-0.1, 0.2, 0.3],
            is_engaged: true,
            is_extrapolated: false,
            missing: [false, true, false],
            taken: 17,
            refused: 3,
            sequence: u32::MAX,
            presses: true,
            partner: Some(Partner {
                position_m: [0.1, -0.0, 7.0],
                velocity_m_s: [1.0, 2.0, -3.0],
                presses: true,
            }),
            axis: None,
        };
        let axis = Some(Axis { half_m: [0.01, -0.0, 2.0], velocity_m_s: [1.0, 2.0, -3.0] });
        for hand in [
            hand,
            Hand { is_engaged: false, is_extrapolated: true, missing: [true, false, true], ..hand },
            Hand { presses: false, partner: None, ..hand },
            Hand { partner: None, axis, ..hand },
            Hand::default(),
        ] {
            assert_eq!(Hand::of_words(hand.words()), hand);
        }
    }

    /// Two velocities, each held for 0.1 s: within 2 % after 50 ms, no sample twice the step.
    #[test]
    fn the_filter_follows_a_change_of_the_velocity() {
        let (mut filter, mut x_m, mut largest) = (VelocityFilter::default(), 0.0, 0.0_f32);
        let mut at = |tick: u64, speed_m_s: f32| {
            x_m += speed_m_s * 1e-3;
            let [x, y, z] = filter.update(1_000 * tick, [x_m, 0.0, -2.0 * x_m]);
            assert!(y == 0.0 && (z + 2.0 * x).abs() < 1e-3);
            largest = largest.max(x);
            x
        };
        let mut last = 0.0;
        for (begin, speed_m_s) in [(1, 0.3), (101, -0.1)] {
            for tick in begin..begin + 100 {
                last = at(tick, speed_m_s);
                if tick >= begin + 50 {
                    assert!((last - speed_m_s).abs() < 0.02 * 0.4, "{tick}: {last}");
                }
            }
        }
        assert!(last < 0.0 && largest < 0.4, "{largest}");
    }

    #[test]
    fn noise_is_damped_and_a_jump_or_a_gap_starts_again() {
        let mut filter = VelocityFilter::default();
        let mut largest = 0.0_f32;
        for tick in 0..1_000 {
            // Resolution of a device, 0.03 mm: a difference of two samples would say 30 mm/s.
            let x_m = if tick % 2 == 0 { 0.0 } else { 3e-5 };
            let [x, ..] = filter.update(1_000 * tick, [x_m, 0.0, 0.0]);
            largest = largest.max(if tick > 100 { x.abs() } else { 0.0 });
        }
        assert!(largest < 3e-3, "{largest}");
        assert_eq!(filter.update(1_000_000, [0.2, 0.0, 0.0]), vec3::ZERO);
        assert!(filter.update(1_001_000, [0.201, 0.0, 0.0])[0] > 0.0);
        assert_eq!(filter.update(1_100_000, [0.202, 0.0, 0.0]), vec3::ZERO);
        let before = filter.update(1_101_000, [0.203, 0.0, 0.0]);
        assert_eq!(filter.update(1_101_000, [0.204, 0.0, 0.0]), before, "no time has passed");
        assert_eq!(filter.update(1_102_000, [f32::NAN, 0.0, 0.0]), before);
    }
}
