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

impl<V: Lanes> Add for Pair<V> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1)
    }
}

impl<V: Lanes> Sub for Pair<V> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.0 - other.0, self.1 - other.1)
    }
}

impl<V: Lanes> Mul for Pair<V> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(self.0 * other.0, self.1 * other.1)
    }
}

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
mod tests {
    use super::{portable, sse2};

    /// Finite numbers of every size, infinities and NaN.
    fn numbers() -> impl Iterator<Item = [f32; 4]> {
        let odd = [0.0, -0.0, 1.0, -1.0, 1e-42, f32::MAX, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 0.5];
        let mut bits = 1_u32;
        let mut next = move || {
            bits = bits.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            match (bits >> 8) % 16 {
                0 => odd[(bits >> 16) as usize % odd.len()],
                _ => f32::from_bits(bits.rotate_left(7)),
            }
        };
        core::iter::repeat_with(move || [next(), next(), next(), next()]).take(20_000)
    }

    /// Any NaN equals any NaN: sign and payload depend on the processor.
    fn same(a: [f32; 4], b: [f32; 4]) -> bool {
        a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan()))
    }

    /// Compares an expression on both implementations; `V` names the type in it.
    macro_rules! agree {
        ($a:expr, $b:expr, |$x:ident, $y:ident, $v:ident| $of:expr) => {{
            let wide = {
                use sse2::F32x4 as $v;
                let ($x, $y) = ($v::new($a), $v::load(&$b));
                $of.to_array()
            };
            let plain = {
                use portable::F32x4 as $v;
                let ($x, $y) = ($v::new($a), $v::load(&$b));
                $of.to_array()
            };
            assert!(same(wide, plain), "{}: {:?} {:?}: {wide:?} {plain:?}", stringify!($of), $a, $b);
        }};
    }

    #[test]
    #[allow(unused_variables, unused_imports, reason = "not every expression uses both vectors and the type")]
    fn registers_and_arrays_agree() {
        let mut b = [0.25, -3.0, 1e10, -0.0];
        for a in numbers() {
            agree!(a, b, |x, y, V| x + y);
            agree!(a, b, |x, y, V| x - y);
            agree!(a, b, |x, y, V| x * y);
            agree!(a, b, |x, y, V| x.sqrt());
            agree!(a, b, |x, y, V| x.at_least(y));
            agree!(a, b, |x, y, V| x.at_most(y));
            agree!(a, b, |x, y, V| x.spread::<0>());
            agree!(a, b, |x, y, V| x.spread::<1>());
            agree!(a, b, |x, y, V| x.spread::<2>());
            agree!(a, b, |x, y, V| x.spread::<3>());
            agree!(a, b, |x, y, V| V::splat(x.get::<1>()));
            agree!(a, b, |x, y, V| V::point([x.get::<0>(), y.get::<1>(), y.get::<2>()]));
            agree!(a, b, |x, y, V| x.interleave(y).0);
            agree!(a, b, |x, y, V| x.interleave(y).1);
            // Only the lower two lanes are defined.
            agree!(a, b, |x, y, V| x.upper());
            for point in 0..4 {
                agree!(a, b, |x, y, V| {
                    let [px, py, pz, _] = V::points([x, y, x * y])[point].to_array();
                    V::point([px, py, pz])
                });
            }
            let small = a.map(|x| if x.abs() < 4e6 { x } else { 2.5 });
            agree!(small, b, |x, y, V| x.floor().0);
            agree!(small, b, |x, y, V| {
                let [i, j, k] = x.floor().1.map(|index| index as f32);
                V::point([i, j, k])
            });
            b = a;
        }
    }

    #[test]
    fn floor_agrees_with_the_standard_library() {
        let values = [-3.0, -2.5, -0.5, -0.0, 0.49, 1.5, 0.999_999_94, 7.5, -1e-40, 1e-40, 4e6, -4e6_f32];
        let steps = (-100_000..100_000).map(|step| step as f32 * 1.27e-3);
        for x in values.into_iter().chain(steps) {
            let (low, [index, ..]) = sse2::F32x4::splat(x).floor();
            assert_eq!(low.get::<1>(), x.floor(), "{x}");
            let unshifted = index.wrapping_sub(crate::num::math::ROUNDING_SHIFT.to_bits()) as i32;
            assert_eq!(unshifted, x.floor() as i32, "{x}");
        }
    }

    #[test]
    fn pairs_of_f64_agree() {
        for ([a, b, ..], [c, d, ..]) in numbers().zip(numbers().skip(1)) {
            let [a, b, c, d] = [a, b, c, d].map(f64::from);
            macro_rules! of {
                ($lanes:ident) => {{
                    let (x, y) = ($lanes::F64x2::new([a, b]), $lanes::F64x2::new([c, d]));
                    [x + y, x - y, x * y, x.sqrt()].map(|lanes| lanes.to_array()).concat()
                }};
            }
            let (wide, plain): (Vec<f64>, Vec<f64>) = (of!(sse2), of!(portable));
            for (wide, plain) in wide.iter().zip(&plain) {
                assert!(
                    wide.to_bits() == plain.to_bits() || (wide.is_nan() && plain.is_nan()),
                    "{wide} {plain}"
                );
            }
        }
    }
}
