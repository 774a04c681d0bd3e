//! Numbers of the element loops: one f64, or as many as a vector register of this machine holds.
//!
//! The 3 x 3 algebra of a single element does not fill a register, so several elements are processed at once,
//! one per lane. Each lane performs the same operations as a single f64: operations are not fused, and lanes
//! do not interact.
//!
//! A vector contains pulp's token for the instruction set of the dispatch, which makes its arithmetic safe
//! code. A number cannot be created without the token, so constants are created from an existing number
//! ([`Real::constant`]). All functions are `inline(always)`, because a function that is not inlined into the
//! dispatched one is compiled for the baseline instruction set.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use pulp::{Simd, WithSimd};

/// Runs `work` with the vectors of this machine.
///
/// AVX-512 is excluded, although the real-time host enables it in pulp for the whole program: the loops were
/// measured and verified with AVX2.
#[inline(always)]
pub(crate) fn dispatch<W: WithSimd>(work: W) -> W::Output {
    #[cfg(target_arch = "x86_64")]
    return match pulp::x86::V3::try_new() {
        Some(simd) => Simd::vectorize(simd, work),
        None => pulp::Arch::Scalar.dispatch(work),
    };
    #[cfg(not(target_arch = "x86_64"))]
    pulp::Arch::new().dispatch(work)
}

/// Largest number of lanes of any machine.
pub(crate) const MAX_LANES: usize = 8;

/// A real number, or several in parallel.
///
/// One implementation of a law serves both. Operators do arithmetic, with an f64 as right operand for
/// constants. [`Real::map`] applies functions, and [`Real::where_less`] selects values.
pub trait Real:
    Copy
    + Debug
    + Neg<Output = Self>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
    + Div<f64, Output = Self>
    + AddAssign
    + SubAssign
{
    /// Data needed to create the first number: the token of the instruction set.
    type Machine: Copy;

    /// Number of lanes.
    const LANES: usize;

    /// A number with the value `value(lane)` in each lane.
    fn new(machine: Self::Machine, value: impl FnMut(usize) -> f64) -> Self;

    /// `value` in every lane.
    fn constant(self, value: f64) -> Self;

    /// A number with the value `value(lane)` in each lane, for the same machine as `self`.
    fn with_lanes(self, value: impl FnMut(usize) -> f64) -> Self;

    /// One of the lanes.
    fn lane(&self, lane: usize) -> f64;

    /// Applies a function to each lane.
    fn map(self, function: impl Fn(f64) -> f64) -> Self;

    /// 1 / x.
    fn recip(self) -> Self;

    /// `yes` in the lanes with self < other, `no` in all others, including those with a NaN.
    fn where_less(self, other: Self, yes: Self, no: Self) -> Self;

    /// The smaller of two numbers; NaN if either is NaN, unlike `min`.
    #[inline(always)]
    fn lesser(self, other: Self) -> Self {
        // If neither is less, they are equal or one is NaN; their mean is the correct result for both cases.
        let mean = (self + other) * 0.5;
        other.where_less(self, other, self.where_less(other, self, mean))
    }
}

impl Real for f64 {
    type Machine = ();

    const LANES: usize = 1;

    #[inline(always)]
    fn new(_: (), mut value: impl FnMut(usize) -> f64) -> Self {
        value(0)
    }

    #[inline(always)]
    fn constant(self, value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn with_lanes(self, mut value: impl FnMut(usize) -> f64) -> Self {
        value(0)
    }

    #[inline(always)]
    fn lane(&self, _: usize) -> f64 {
        *self
    }

    #[inline(always)]
    fn map(self, function: impl Fn(f64) -> f64) -> Self {
        function(self)
    }

    #[inline(always)]
    fn recip(self) -> Self {
        1.0 / self
    }

    #[inline(always)]
    fn where_less(self, other: Self, yes: Self, no: Self) -> Self {
        if self < other { yes } else { no }
    }
}

/// The numbers of one vector register.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lanes<S: Simd> {
    values: S::f64s,
    machine: S,
}

impl<S: Simd> Lanes<S> {
    #[inline(always)]
    fn with(self, values: S::f64s) -> Self {
        Self { values, machine: self.machine }
    }
}

impl<S: Simd> Real for Lanes<S> {
    type Machine = S;

    const LANES: usize = S::F64_LANES;

    #[inline(always)]
    fn new(machine: S, mut value: impl FnMut(usize) -> f64) -> Self {
        let mut values = machine.splat_f64s(0.0);
        let lanes: &mut [f64] = bytemuck::cast_slice_mut(std::slice::from_mut(&mut values));
        for (index, lane) in lanes.iter_mut().enumerate() {
            *lane = value(index);
        }
        Self { values, machine }
    }

    #[inline(always)]
    fn constant(self, value: f64) -> Self {
        self.with(self.machine.splat_f64s(value))
    }

    #[inline(always)]
    fn with_lanes(self, value: impl FnMut(usize) -> f64) -> Self {
        Self::new(self.machine, value)
    }

    #[inline(always)]
    fn lane(&self, lane: usize) -> f64 {
        bytemuck::cast_slice::<_, f64>(std::slice::from_ref(&self.values))[lane]
    }

    #[inline(always)]
    fn map(self, function: impl Fn(f64) -> f64) -> Self {
        Self::new(self.machine, |lane| function(self.lane(lane)))
    }

    #[inline(always)]
    fn recip(self) -> Self {
        self.with(self.machine.div_f64s(self.machine.splat_f64s(1.0), self.values))
    }

    #[inline(always)]
    fn where_less(self, other: Self, yes: Self, no: Self) -> Self {
        let less = self.machine.less_than_f64s(self.values, other.values);
        self.with(self.machine.select_f64s(less, yes.values, no.values))
    }
}

/// An operator between vectors, and between a vector and a number.
macro_rules! operator {
    ($trait:ident, $method:ident, $instruction:ident) => {
        impl<S: Simd> $trait for Lanes<S> {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                self.with(self.machine.$instruction(self.values, other.values))
            }
        }

        impl<S: Simd> $trait<f64> for Lanes<S> {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: f64) -> Self {
                self.$method(self.constant(other))
            }
        }
    };
}

operator!(Add, add, add_f64s);
operator!(Sub, sub, sub_f64s);
operator!(Mul, mul, mul_f64s);
operator!(Div, div, div_f64s);

impl<S: Simd> Neg for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        self.with(self.machine.neg_f64s(self.values))
    }
}

impl<S: Simd> AddAssign for Lanes<S> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<S: Simd> SubAssign for Lanes<S> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}
