//! The frame of a jet, checked once when it arrives.
//!
//! Integers and floats are little-endian; floats are IEEE 754 binary32.
//!
//! ```text
//! offset  bytes  content
//!  0      4      "PJET"
//!  4      2      u16 version, 3
//!  6      2      u16 length of the frame, 208
//!  8      4      u32 sequence
//! 12      2      u16 contact
//! 14      2      u16 flags: 1 joined, 2 fresh, 4 unstable, 8 flush before, 16 root, 32 coupling; the others are 0
//! 16      12     f32 control x, y, z, metres
//! 28      4      f32 W, joules
//! 32      12     f32 h x, y, z, newtons
//! 44      24     f32 S xx, xy, xz, yy, yz, zz, newtons per metre
//! 68      40     f32 third derivatives of W, xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz, zzz, N/m^2
//! 108     4      f32 trust radius, metres
//! 112     12     f32 second control q x, y, z, metres; zero without a coupling, as the next
//! 124     12     f32 dW/dq x, y, z, newtons
//! 136     36     f32 dh/dq by rows, newtons per metre
//! 172     24     f32 second derivatives of W by q, in the order of S, newtons per metre
//! 196     4      u32 model: jets of an earlier one no longer count
//! 200     4      zero
//! 204     4      u32 CRC-32 (ISO-HDLC) of all bytes before it
//! ```
//!
//! With the flag *root* W, h, S and the third derivatives are those of s = sqrt(2 W), in sqrt(J) and its quotients.
//!
//! The length is a multiple of 8, so that a ring of 64-bit words can hold frames.

use crate::blob::format::CHECKSUM;
use crate::num::vec3::{self, Vec3};
use crate::plane::LARGEST_VALUE;

const MAGIC: [u8; 4] = *b"PJET";
const VERSION: u16 = 3;
/// Where the checksum is.
const CHECKSUM_AT: usize = 204;
/// Number of floats, and of those without a coupling.
const FLOATS: usize = 45;
const OF_TOOL: usize = 24;

/// Properties of a jet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct JetFlags {
    /// Joins the jet from which it was continued: the body did not jump in between.
    pub joined: bool,
    /// Solved with a factor of its own and not with a frozen one.
    pub fresh: bool,
    /// The equilibrium is not stable.
    pub unstable: bool,
    /// The body has jumped: jets of the contact that contradict this one must be removed.
    pub flush_before: bool,
    /// The expansion is that of s = sqrt(2 W) instead of W: h = max(0, s) ds/dd. A tool that begins to touch has an s
    /// that rises from zero with a slope, and no force where s would be negative.
    pub root: bool,
    /// Most of the force is that of the fixed part, which is stiffer than tissue.
    pub fixed: bool,
}

/// The flag of a jet with a coupling.
const COUPLED: u16 = 32;

impl JetFlags {
    fn bits(self) -> u16 {
        let Self { joined, fresh, unstable, flush_before, root, fixed } = self;
        [joined, fresh, unstable, flush_before, root, false, fixed]
            .into_iter()
            .rev()
            .fold(0, |bits, flag| bits << 1 | u16::from(flag))
    }

    fn from_bits(bits: u16) -> Option<Self> {
        let flag = |bit: u16| bits & bit != 0;
        let all = Self {
            joined: flag(1),
            fresh: flag(2),
            unstable: flag(4),
            flush_before: flag(8),
            root: flag(16),
            fixed: flag(64),
        };
        (all.bits() == bits).then_some(all)
    }
}

/// How the force of a jet depends on a second control q: the displacement of a partner, another tool on the same body, in
/// the frame of the jet's; or the half axis of a capsule.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct JetCoupling {
    /// The second control that was solved, metres.
    pub control_m: Vec3,
    /// dW/dq, newtons, or that of the root.
    pub slope_n: Vec3,
    /// dh/dq: row i belongs to h_i, newtons per metre; or the mixed derivatives of the root.
    pub mixed_n_m: [Vec3; 3],
    /// d2W/dq2: xx, xy, xz, yy, yz, zz, newtons per metre, or that of the root; zero of a partner.
    pub own_n_m: [f32; 6],
}

/// The expansion of the energy W at one displacement of a contact point, or of its root ([`JetFlags::root`]).
///
/// [`Jet::decode`] returns only jets whose numbers are finite and in range; the fields are public for the
/// solver, which makes jets. [`super::JetMemory::insert`] refuses others.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Jet {
    /// The contact point: a space of the organ.
    pub contact: u16,
    /// Number of the jet in the session.
    pub sequence: u32,
    /// Properties.
    pub flags: JetFlags,
    /// The displacement that was solved, metres.
    pub control_m: Vec3,
    /// W, joules; zero at rest.
    pub energy_j: f32,
    /// h = dW/dd, newtons.
    pub force_n: Vec3,
    /// S = dh/dd: xx, xy, xz, yy, yz, zz, newtons per metre.
    pub stiffness_n_m: [f32; 6],
    /// dS/dd: xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz, zzz, newtons per square metre.
    pub third_n_m2: [f32; 10],
    /// Distance from `control_m` up to which the expansion is used, metres.
    pub trust_m: f32,
    /// The coupling, if there is a second control.
    pub coupling: Option<JetCoupling>,
    /// Number of the model of the body; it rises when the session changes the model.
    pub model: u32,
}

impl Jet {
    /// Length of a frame, bytes.
    pub const FRAME_LEN: usize = 208;
    /// Largest trust radius, metres.
    pub const MAX_TRUST_M: f32 = 0.025;
    /// Largest distance of the control from rest, metres.
    pub const MAX_CONTROL_M: f32 = 1.0;
    /// Distance of a second control from none, metres: larger than that of two of them.
    pub const PARTED_M: f32 = 2.0;

    /// The frame of this jet, whatever its numbers are.
    pub fn encode(&self) -> [u8; Self::FRAME_LEN] {
        let mut frame = [0; Self::FRAME_LEN];
        let mut rest = frame.as_mut_slice();
        let mut put = |bytes: &[u8]| {
            if let Some((place, after)) = core::mem::take(&mut rest).split_at_mut_checked(bytes.len()) {
                place.copy_from_slice(bytes);
                rest = after;
            }
        };
        put(&MAGIC);
        put(&VERSION.to_le_bytes());
        put(&(Self::FRAME_LEN as u16).to_le_bytes());
        put(&self.sequence.to_le_bytes());
        put(&self.contact.to_le_bytes());
        put(&(self.flags.bits() | if self.coupling.is_some() { COUPLED } else { 0 }).to_le_bytes());
        let numbers = [&self.control_m[..], &[self.energy_j], &self.force_n, &self.stiffness_n_m];
        let JetCoupling { control_m, slope_n, mixed_n_m, own_n_m } = self.coupling.unwrap_or_default();
        let mixed = mixed_n_m.as_flattened();
        let last = [&self.third_n_m2[..], &[self.trust_m], &control_m, &slope_n, mixed, &own_n_m];
        for number in numbers.into_iter().chain(last).flatten() {
            put(&number.to_le_bytes());
        }
        put(&self.model.to_le_bytes());
        put(&[0; 4]);
        if let Some((body, checksum)) = frame.split_at_mut_checked(CHECKSUM_AT) {
            checksum.copy_from_slice(&CHECKSUM.checksum(body).to_le_bytes());
        }
        frame
    }

    /// The jet of a frame.
    ///
    /// Errors: [`JetError`], also if a number is NaN, infinite or out of its range.
    pub fn decode(frame: &[u8]) -> Result<Self, JetError> {
        let length = JetError::Length { have: frame.len() };
        let (magic, rest) = frame.split_first_chunk::<4>().ok_or(length)?;
        let (version, rest) = rest.split_first_chunk::<2>().ok_or(length)?;
        if *magic != MAGIC {
            return Err(JetError::Magic);
        }
        // First, because the length may depend on it.
        let found = u16::from_le_bytes(*version);
        if found != VERSION {
            return Err(JetError::Version { found });
        }
        let frame: &[u8; Self::FRAME_LEN] = frame.try_into().map_err(|_| length)?;
        let (body, stored) = frame.split_last_chunk::<4>().ok_or(length)?;
        let (stored, computed) = (u32::from_le_bytes(*stored), CHECKSUM.checksum(body));
        if stored != computed {
            return Err(JetError::Checksum { stored, computed });
        }
        let (stated, rest) = rest.split_first_chunk::<2>().ok_or(length)?;
        let have = usize::from(u16::from_le_bytes(*stated));
        if have != Self::FRAME_LEN {
            return Err(JetError::Length { have });
        }
        let (sequence, rest) = rest.split_first_chunk::<4>().ok_or(length)?;
        let (contact, rest) = rest.split_first_chunk::<2>().ok_or(length)?;
        let (flags, rest) = rest.split_first_chunk::<2>().ok_or(length)?;
        let bits = u16::from_le_bytes(*flags);
        let flags = JetFlags::from_bits(bits & !COUPLED).ok_or(JetError::Reserved)?;
        let mut numbers = [0.0; FLOATS];
        let mut words = rest.chunks_exact(4);
        for (number, word) in numbers.iter_mut().zip(&mut words) {
            *number = f32::from_le_bytes(*word.first_chunk().ok_or(length)?);
        }
        let model = *words.next().and_then(|word| word.first_chunk()).ok_or(length)?;
        if words.next().is_none_or(|word| word != [0; 4]) {
            return Err(JetError::Reserved);
        }
        let (numbers, of_coupling) = numbers.split_first_chunk::<OF_TOOL>().ok_or(length)?;
        let (place, mixed) = of_coupling.split_first_chunk::<3>().ok_or(length)?;
        let (slope, mixed) = mixed.split_first_chunk::<3>().ok_or(length)?;
        let mut coupling = JetCoupling { control_m: *place, slope_n: *slope, ..JetCoupling::default() };
        let (mixed, own) = mixed.split_at_checked(9).ok_or(length)?;
        let numbers_of = coupling.mixed_n_m.as_flattened_mut().iter_mut().zip(mixed);
        for (number, of) in numbers_of.chain(coupling.own_n_m.iter_mut().zip(own)) {
            *number = *of;
        }
        let is_coupled = bits & COUPLED != 0;
        if !is_coupled && of_coupling.iter().any(|number| number.to_bits() != 0) {
            return Err(JetError::Reserved);
        }
        let coupling = Some(coupling).filter(|_| is_coupled);
        let [x, y, z, energy_j, fx, fy, fz, xx, xy, xz, yy, yz, zz, third_n_m2 @ .., trust_m] = *numbers;
        let jet = Self {
            contact: u16::from_le_bytes(*contact),
            sequence: u32::from_le_bytes(*sequence),
            flags,
            control_m: [x, y, z],
            energy_j,
            force_n: [fx, fy, fz],
            stiffness_n_m: [xx, xy, xz, yy, yz, zz],
            third_n_m2,
            trust_m,
            coupling,
            model: u32::from_le_bytes(model),
        };
        jet.check().map(|()| jet)
    }

    /// Checks the range of every number: no later result of the jet overflows.
    pub(super) fn check(&self) -> Result<(), JetError> {
        // NaN fails every comparison.
        let sound = |numbers: &[f32]| numbers.iter().all(|number| number.abs() <= LARGEST_VALUE);
        let near = |x: f32| x.abs() <= Self::MAX_CONTROL_M;
        let [x, y, z] = self.control_m;
        let control = near(x) && near(y) && near(z) && vec3::norm(self.control_m) <= Self::MAX_CONTROL_M;
        let coupling = self.coupling.unwrap_or_default();
        let checks = [
            (
                "coupling",
                coupling.control_m.iter().all(|&x| near(x))
                    && sound(&coupling.slope_n)
                    && sound(coupling.mixed_n_m.as_flattened())
                    && sound(&coupling.own_n_m),
            ),
            ("control", control),
            ("energy", sound(&[self.energy_j])),
            ("force", sound(&self.force_n)),
            ("stiffness", sound(&self.stiffness_n_m)),
            ("third derivatives", sound(&self.third_n_m2)),
            ("trust radius", self.trust_m > 0.0 && self.trust_m <= Self::MAX_TRUST_M),
        ];
        match checks.into_iter().find(|(_, is_sound)| !is_sound) {
            None => Ok(()),
            Some((what, _)) => Err(JetError::Value { what }),
        }
    }
}

/// Why a frame was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum JetError {
    /// It has, or states, another length than a frame of this version.
    #[error("a frame of {have} bytes is no jet ({} are needed)", Jet::FRAME_LEN)]
    Length {
        /// Bytes given or stated.
        have: usize,
    },
    /// It does not begin with "PJET".
    #[error("the frame is no jet (it does not begin with PJET)")]
    Magic,
    /// It has another version.
    #[error(
        "the jet has version {found}, this program reads version {VERSION}: use a solver of the same build"
    )]
    Version {
        /// Version of the frame.
        found: u16,
    },
    /// The bytes are not those that were written.
    #[error("checksum mismatch: the jet is damaged (stored {stored:08x}, computed {computed:08x})")]
    Checksum {
        /// Checksum in the frame.
        stored: u32,
        /// Checksum of the bytes.
        computed: u32,
    },
    /// A bit that must be zero is not.
    #[error("the jet has bits without a meaning in this version")]
    Reserved,
    /// A number is NaN, infinite or out of its range.
    #[error("the {what} of the jet is NaN, infinite or out of its range")]
    Value {
        /// The field.
        what: &'static str,
    },
}
