//! Lanes as SSE2 registers, which every x86-64 has.

use core::ops::{Add, Mul, Sub};

use safe_arch::{
    add_i32_m128i, add_m128, add_m128d, bitand_m128, cast_to_m128_from_m128d, cast_to_m128i_from_m128,
    cmp_gt_mask_m128, load_unaligned_m128, m128, m128d, max_m128, min_m128, move_high_low_m128, mul_m128,
    mul_m128d, set_m128d, set_reversed_m128, set_reversed_m128d, set_splat_m128, shuffle_abi_f32_all_m128,
    sqrt_m128, sqrt_m128d, sub_m128, sub_m128d, unpack_high_m128, unpack_low_m128,
};

use crate::num::math::ROUNDING_SHIFT;
use crate::num::vec3::Vec3;

/// Four f32.
#[derive(Debug, Clone, Copy)]
pub struct F32x4(m128);

impl F32x4 {
    /// From single numbers.
    #[inline(always)]
    pub(crate) fn new([a, b, c, d]: [f32; 4]) -> Self {
        Self(set_reversed_m128(a, b, c, d))
    }

    /// Four consecutive numbers.
    #[inline(always)]
    pub(crate) fn load(lanes: &[f32; 4]) -> Self {
        Self(load_unaligned_m128(lanes))
    }

    /// One number in all lanes.
    #[inline(always)]
    pub(crate) fn splat(x: f32) -> Self {
        Self(set_splat_m128(x))
    }

    /// x, y, z and 0.
    ///
    /// Loaded in pairs: otherwise the compiler loads y and z together, which stalls where x and y were stored
    /// together.
    #[inline(always)]
    pub(crate) fn point([x, y, z]: Vec3) -> Self {
        let [low, high] = [[x, y], [z, 0.0]].map(bytemuck::must_cast);
        Self(cast_to_m128_from_m128d(set_m128d(high, low)))
    }

    /// The lanes as an array.
    #[inline(always)]
    pub(crate) fn to_array(self) -> [f32; 4] {
        self.0.to_array()
    }

    /// One lane.
    #[inline(always)]
    pub(crate) fn get<const LANE: usize>(self) -> f32 {
        self.0.to_array()[LANE]
    }

    /// One lane in all four.
    #[inline(always)]
    pub(crate) fn spread<const LANE: usize>(self) -> Self {
        Self(match LANE {
            0 => shuffle_abi_f32_all_m128::<0x00>(self.0, self.0),
            1 => shuffle_abi_f32_all_m128::<0x55>(self.0, self.0),
            2 => shuffle_abi_f32_all_m128::<0xaa>(self.0, self.0),
            _ => shuffle_abi_f32_all_m128::<0xff>(self.0, self.0),
        })
    }

    /// The larger of each two; `low` where self is NaN.
    #[inline(always)]
    pub(crate) fn at_least(self, low: Self) -> Self {
        Self(max_m128(self.0, low.0))
    }

    /// The smaller of each two; `high` where self is NaN.
    #[inline(always)]
    pub(crate) fn at_most(self, high: Self) -> Self {
        Self(min_m128(self.0, high.0))
    }

    /// Square roots.
    #[inline(always)]
    pub(crate) fn sqrt(self) -> Self {
        Self(sqrt_m128(self.0))
    }

    /// The largest integers not above the lanes, for magnitudes below 2^22; the first three also as integers,
    /// plus the bits of [`ROUNDING_SHIFT`], modulo 2^32.
    #[inline(always)]
    pub(crate) fn floor(self) -> (Self, [u32; 3]) {
        let shift = set_splat_m128(ROUNDING_SHIFT);
        let shifted = add_m128(self.0, shift);
        let nearest = sub_m128(shifted, shift);
        // All bits are set, which is the integer -1, where the nearest integer is too large.
        let above = cmp_gt_mask_m128(nearest, self.0);
        let one = bitand_m128(above, set_splat_m128(1.0));
        let [i, j, k, _] =
            add_i32_m128i(cast_to_m128i_from_m128(shifted), cast_to_m128i_from_m128(above)).into();
        (Self(sub_m128(nearest, one)), [i, j, k])
    }

    /// (a0, b0, a1, b1) and (a2, b2, a3, b3).
    #[inline(always)]
    pub(crate) fn interleave(self, other: Self) -> (Self, Self) {
        (Self(unpack_low_m128(self.0, other.0)), Self(unpack_high_m128(self.0, other.0)))
    }

    /// Twelve consecutive values as four points of x, y and z; their fourth lanes are undefined.
    #[inline(always)]
    pub(crate) fn points([a, b, c]: [Self; 3]) -> [Self; 4] {
        let second = shuffle_abi_f32_all_m128::<0x0f>(a.0, b.0);
        [
            a,
            Self(shuffle_abi_f32_all_m128::<0x58>(second, b.0)),
            Self(shuffle_abi_f32_all_m128::<0x0e>(b.0, c.0)),
            Self(shuffle_abi_f32_all_m128::<0xf9>(c.0, c.0)),
        ]
    }

    /// (a2, a3, a2, a3).
    #[inline(always)]
    pub(crate) fn upper(self) -> Self {
        Self(move_high_low_m128(self.0, self.0))
    }
}

/// Two f64.
#[derive(Debug, Clone, Copy)]
pub struct F64x2(m128d);

impl F64x2 {
    #[inline(always)]
    pub(crate) fn new([a, b]: [f64; 2]) -> Self {
        Self(set_reversed_m128d(a, b))
    }

    #[inline(always)]
    pub(crate) fn to_array(self) -> [f64; 2] {
        self.0.to_array()
    }

    #[inline(always)]
    pub(crate) fn sqrt(self) -> Self {
        Self(sqrt_m128d(self.0))
    }
}

macro_rules! lane_by_lane {
    ($($lanes:ident: $operator:ident $name:ident $instruction:ident),* $(,)?) => {$(
        impl $operator for $lanes {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self($instruction(self.0, other.0))
            }
        }
    )*};
}
lane_by_lane!(F32x4: Add add add_m128, F32x4: Sub sub sub_m128, F32x4: Mul mul mul_m128);
lane_by_lane!(F64x2: Add add add_m128d, F64x2: Sub sub sub_m128d, F64x2: Mul mul mul_m128d);
