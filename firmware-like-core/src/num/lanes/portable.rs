//! Lanes as arrays: for any processor, and the reference that the vector registers are tested against.

use core::ops::{Add, Mul, Sub};

use crate::num::math::{self, ROUNDING_SHIFT};
use crate::num::vec3::Vec3;

/// Four f32.
#[derive(Debug, Clone, Copy)]
pub struct F32x4([f32; 4]);

/// Two f64.
#[derive(Debug, Clone, Copy)]
pub struct F64x2([f64; 2]);

/// The functions are documented in `sse2.rs`.
impl F32x4 {
    #[inline(always)]
    pub(crate) fn new(lanes: [f32; 4]) -> Self {
        Self(lanes)
    }

    #[inline(always)]
    pub(crate) fn load(lanes: &[f32; 4]) -> Self {
        Self(*lanes)
    }

    #[inline(always)]
    pub(crate) fn splat(x: f32) -> Self {
        Self([x; 4])
    }

    #[inline(always)]
    pub(crate) fn point([x, y, z]: Vec3) -> Self {
        Self([x, y, z, 0.0])
    }

    #[inline(always)]
    pub(crate) fn to_array(self) -> [f32; 4] {
        self.0
    }

    #[inline(always)]
    pub(crate) fn get<const LANE: usize>(self) -> f32 {
        self.0[LANE]
    }

    #[inline(always)]
    pub(crate) fn spread<const LANE: usize>(self) -> Self {
        Self([self.0[LANE]; 4])
    }

    // Not `f32::max` and `f32::min`: those treat NaN differently.
    #[inline(always)]
    pub(crate) fn at_least(self, low: Self) -> Self {
        self.with(low, |x, low| if x > low { x } else { low })
    }

    #[inline(always)]
    pub(crate) fn at_most(self, high: Self) -> Self {
        self.with(high, |x, high| if x < high { x } else { high })
    }

    #[inline(always)]
    pub(crate) fn sqrt(self) -> Self {
        Self(self.0.map(math::sqrt))
    }

    #[inline(always)]
    pub(crate) fn floor(self) -> (Self, [u32; 3]) {
        let of = |x: f32| {
            let shifted = x + ROUNDING_SHIFT;
            let nearest = shifted - ROUNDING_SHIFT;
            let above = nearest > x;
            let low = if above { nearest - 1.0 } else { nearest };
            (low, shifted.to_bits().wrapping_sub(u32::from(above)))
        };
        let [a, b, c, d] = self.0.map(of);
        (Self([a.0, b.0, c.0, d.0]), [a.1, b.1, c.1])
    }

    #[inline(always)]
    pub(crate) fn interleave(self, other: Self) -> (Self, Self) {
        let ([a0, a1, a2, a3], [b0, b1, b2, b3]) = (self.0, other.0);
        (Self([a0, b0, a1, b1]), Self([a2, b2, a3, b3]))
    }

    #[inline(always)]
    pub(crate) fn points([a, b, c]: [Self; 3]) -> [Self; 4] {
        let ([_, _, _, x1], [y1, z1, x2, y2], [z2, x3, y3, z3]) = (a.0, b.0, c.0);
        [a, Self([x1, y1, z1, z1]), Self([x2, y2, z2, x3]), Self([x3, y3, z3, z3])]
    }

    #[inline(always)]
    pub(crate) fn upper(self) -> Self {
        let [_, _, c, d] = self.0;
        Self([c, d, c, d])
    }

    #[inline(always)]
    fn with(self, other: Self, of: impl Fn(f32, f32) -> f32) -> Self {
        let ([a0, a1, a2, a3], [b0, b1, b2, b3]) = (self.0, other.0);
        Self([of(a0, b0), of(a1, b1), of(a2, b2), of(a3, b3)])
    }
}

impl F64x2 {
    #[inline(always)]
    pub(crate) fn new(lanes: [f64; 2]) -> Self {
        Self(lanes)
    }

    #[inline(always)]
    pub(crate) fn to_array(self) -> [f64; 2] {
        self.0
    }

    #[inline(always)]
    pub(crate) fn sqrt(self) -> Self {
        Self(self.0.map(math::sqrt_f64))
    }

    #[inline(always)]
    fn with(self, other: Self, of: impl Fn(f64, f64) -> f64) -> Self {
        let ([a0, a1], [b0, b1]) = (self.0, other.0);
        Self([of(a0, b0), of(a1, b1)])
    }
}

macro_rules! lane_by_lane {
    ($($lanes:ident: $operator:ident $name:ident $symbol:tt),* $(,)?) => {$(
        impl $operator for $lanes {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                self.with(other, |a, b| a $symbol b)
            }
        }
    )*};
}
lane_by_lane!(F32x4: Add add +, F32x4: Sub sub -, F32x4: Mul mul *);
lane_by_lane!(F64x2: Add add +, F64x2: Sub sub -, F64x2: Mul mul *);
