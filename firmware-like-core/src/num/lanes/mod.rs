//! Vectors of floats (SIMD lanes) for the interpolants.
//!
//! Without this module the compiler packs values of different rows and components together, and shuffles more
//! than it computes. x86-64 always has SSE2, which `safe_arch` makes available as safe code; elsewhere the
//! lanes are an array.
//!
//! The results do not depend on the registers: every lane computes what a single float would, the order of
//! every sum is fixed, and no multiplication is fused with an addition.

use core::ops::{Add, Mul, Sub};

use super::vec3::Vec3;

#[cfg(any(test, not(all(target_arch = "x86_64", target_feature = "sse2"))))]
#[cfg_attr(test, allow(unreachable_pub, reason = "in tests the registers are compared with it"))]
mod portable;
#[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
mod sse2;

#[cfg(not(all(target_arch = "x86_64", target_feature = "sse2")))]
pub(crate) use portable::{F32x4, F64x2};
#[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
pub(crate) use sse2::{F32x4, F64x2};

/// Arithmetic lane by lane.
pub trait Lanes: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {}

impl<V: Copy + Add<Output = V> + Sub<Output = V> + Mul<Output = V>> Lanes for V {}

/// The widest registers that the interpolants use, and how they are filled.
///
/// [`Baseline`] has the registers that the crate is compiled for. A caller that has detected wider registers
/// at run time may implement this trait for them. Then everything has to be inlined into functions compiled
/// for these instructions. For this reason all functions on this path are `inline(always)` and no closure
/// captures lanes. `palpate bench core` measures the gain.
pub trait Machine: Copy {
    /// Eight f32: two rows of a table.
    type F32x8: Lanes;
    /// Four f64.
    type F64x4: Lanes;

    /// Two rows of a table, by reference.
    fn rows(self, low: &[f32; 4], high: &[f32; 4]) -> Self::F32x8;
    /// Two rows, by value.
    fn join(self, low: [f32; 4], high: [f32; 4]) -> Self::F32x8;
    /// One number in all lanes.
    fn splat(self, x: f32) -> Self::F32x8;
    /// Square roots, correctly rounded.
    fn sqrt(self, x: Self::F32x8) -> Self::F32x8;
    /// The lower and the upper row.
    fn halves(self, x: Self::F32x8) -> [[f32; 4]; 2];

    /// Four consecutive numbers.
    fn load_f64(self, lanes: &[f64; 4]) -> Self::F64x4;
    /// One number in all lanes.
    fn splat_f64(self, x: f64) -> Self::F64x4;
    /// Square roots, correctly rounded.
    fn sqrt_f64(self, x: Self::F64x4) -> Self::F64x4;
    /// The lanes as an array.
    fn to_array_f64(self, x: Self::F64x4) -> [f64; 4];
}

/// The instructions that the crate is compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Baseline;

/// Two registers as one.
#[derive(Debug, Clone, Copy)]
pub struct Pair<V>(V, V);

macro_rules! half_by_half {
    ($($operator:ident $name:ident $symbol:tt),*) => {$(
        impl<V: Lanes> $operator for Pair<V> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self(self.0 $symbol other.0, self.1 $symbol other.1)
            }
        }
    )*};
}
half_by_half!(Add add +, Sub sub -, Mul mul *);

impl Machine for Baseline {
    type F32x8 = Pair<F32x4>;
    type F64x4 = Pair<F64x2>;

    #[inline(always)]
    fn rows(self, low: &[f32; 4], high: &[f32; 4]) -> Pair<F32x4> {
        Pair(F32x4::load(low), F32x4::load(high))
    }

    #[inline(always)]
    fn join(self, low: [f32; 4], high: [f32; 4]) -> Pair<F32x4> {
        Pair(F32x4::new(low), F32x4::new(high))
    }

    #[inline(always)]
    fn splat(self, x: f32) -> Pair<F32x4> {
        Pair(F32x4::splat(x), F32x4::splat(x))
    }

    #[inline(always)]
    fn sqrt(self, Pair(low, high): Pair<F32x4>) -> Pair<F32x4> {
        Pair(low.sqrt(), high.sqrt())
    }

    #[inline(always)]
    fn halves(self, Pair(low, high): Pair<F32x4>) -> [[f32; 4]; 2] {
        [low.to_array(), high.to_array()]
    }

    #[inline(always)]
    fn load_f64(self, [a, b, c, d]: &[f64; 4]) -> Pair<F64x2> {
        Pair(F64x2::new([*a, *b]), F64x2::new([*c, *d]))
    }

    #[inline(always)]
    fn splat_f64(self, x: f64) -> Pair<F64x2> {
        Pair(F64x2::new([x, x]), F64x2::new([x, x]))
    }

    #[inline(always)]
    fn sqrt_f64(self, Pair(low, high): Pair<F64x2>) -> Pair<F64x2> {
        Pair(low.sqrt(), high.sqrt())
    }

    #[inline(always)]
    fn to_array_f64(self, Pair(low, high): Pair<F64x2>) -> [f64; 4] {
        let ([a, b], [c, d]) = (low.to_array(), high.to_array());
        [a, b, c, d]
    }
}

/// The sums of the lanes of x, y and z, each as (0 + 2) + (1 + 3).
#[inline(always)]
pub(crate) fn sums(x: F32x4, y: F32x4, z: F32x4) -> Vec3 {
    let (low, high) = x.interleave(y);
    let xy = low + high;
    let xy = xy + xy.upper();
    let z = z + z.upper();
    [xy.get::<0>(), xy.get::<1>(), z.get::<0>() + z.get::<1>()]
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests;
