//! Which vector instructions the force is interpolated with: asked of the processor once, before the loop runs.
//!
//! The program is built for any x86-64. The core's interpolants are inlined here into functions that are compiled for AVX2 and
//! AVX-512 as well, one for each method, and an [`Interpolator`] points at the one to call. All give the same bits: the core
//! fuses nothing and writes out the order of its sums, and a test compares them.

use core::fmt;
use palpate_core::lanes::Baseline;
use palpate_core::{ForceSample, Method, Space, Vec3};
#[cfg(target_arch = "x86_64")]
use pulp::x86::{V3, V4};

/// The instance of a function for a method; its parameter is the place in [`Method::ALL`].
macro_rules! of_method {
    ($method:expr, $function:ident) => {
        match $method {
            Method::Trilinear => $function::<0>,
            Method::Tricubic => $function::<1>,
            Method::Hybrid => $function::<2>,
            Method::RbfLinear => $function::<3>,
            Method::RbfCubic => $function::<4>,
            Method::Hermite => $function::<5>,
            Method::Energy => $function::<6>,
            Method::Kernel => $function::<7>,
        }
    };
}

/// A set of vector instructions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Instructions {
    /// What the program is built for.
    Baseline,
    /// x86-64-v3: 256 bits wide.
    Avx2,
    /// x86-64-v4: 256 bits wide here too, with twice as many registers.
    Avx512,
}

impl Instructions {
    /// All of them, the best last.
    pub const ALL: [Self; 3] = [Self::Baseline, Self::Avx2, Self::Avx512];

    /// Whether this processor has them.
    #[must_use]
    pub fn are_available(self) -> bool {
        self.force(Method::Trilinear).is_some()
    }

    /// The best that this processor has.
    #[must_use]
    pub fn best() -> Self {
        let best = Self::ALL.into_iter().rfind(|instructions| instructions.are_available());
        best.unwrap_or(Self::Baseline)
    }

    /// What the program is built for: more than x86-64 asks only where it was compiled so.
    #[must_use]
    pub const fn built_for() -> &'static str {
        if cfg!(all(target_arch = "x86_64", target_feature = "avx512vl")) {
            "x86-64 with AVX-512"
        } else if cfg!(all(target_arch = "x86_64", target_feature = "avx2")) {
            "x86-64 with AVX2"
        } else if cfg!(target_arch = "x86_64") {
            "any x86-64"
        } else {
            std::env::consts::ARCH
        }
    }

    /// The name used in reports and on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Baseline => "baseline",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }

    /// The function for a method; `None` if the processor would not understand it.
    fn force(self, method: Method) -> Option<Force> {
        match self {
            Self::Baseline => Some(of_method!(method, baseline)),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => V3::is_available().then_some(of_method!(method, avx2)),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => V4::is_available().then_some(of_method!(method, avx512)),
            #[cfg(not(target_arch = "x86_64"))]
            _ => None,
        }
    }
}

impl fmt::Display for Instructions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (built for {})", self.name(), Self::built_for())
    }
}

/// By reference, or the displacement would be copied once more.
type Force = fn(&Space<'_>, &Vec3) -> Option<ForceSample>;

/// One method on one set of instructions.
#[derive(Debug, Clone, Copy)]
pub struct Interpolator {
    method: Method,
    instructions: Instructions,
    force: Force,
}

impl Interpolator {
    /// With the best instructions there are.
    #[must_use]
    pub fn new(method: Method) -> Self {
        let (instructions, force) = (Instructions::Baseline, of_method!(method, baseline));
        Self::on(Instructions::best(), method).unwrap_or(Self { method, instructions, force })
    }

    /// With these, if the processor has them.
    #[must_use]
    pub fn on(instructions: Instructions, method: Method) -> Option<Self> {
        Some(Self { method, instructions, force: instructions.force(method)? })
    }

    /// The method.
    #[must_use]
    pub const fn method(&self) -> Method {
        self.method
    }

    /// The instructions.
    #[must_use]
    pub const fn instructions(&self) -> Instructions {
        self.instructions
    }

    /// [`Space::force`], bit for bit.
    #[inline]
    #[must_use]
    pub fn force(&self, space: &Space<'_>, displacement_m: &Vec3) -> Option<ForceSample> {
        (self.force)(space, displacement_m)
    }
}

fn baseline<const METHOD: usize>(space: &Space<'_>, displacement_m: &Vec3) -> Option<ForceSample> {
    space.force_on(Baseline, Method::ALL[METHOD], *displacement_m)
}

#[cfg(target_arch = "x86_64")]
use x86_64::{avx2, avx512};

#[cfg(target_arch = "x86_64")]
mod x86_64 {
    use super::baseline;
    use core::arch::x86_64::{__m256, __m256d};
    use core::ops::{Add, Mul, Sub};
    use palpate_core::lanes::Machine;
    use palpate_core::{ForceSample, Method, Space, Vec3};
    use pulp::NullaryFnOnce;
    use pulp::x86::{V3, V4};

    pub(super) fn avx2<const METHOD: usize>(space: &Space<'_>, displacement_m: &Vec3) -> Option<ForceSample> {
        // One load of what was found out before; the pointer to this function is given out only where it is there.
        let Some(simd) = V3::try_new() else { return baseline::<METHOD>(space, displacement_m) };
        simd.vectorize(Query::<METHOD> { machine: Wide(simd), space, displacement_m })
    }

    pub(super) fn avx512<const METHOD: usize>(
        space: &Space<'_>,
        displacement_m: &Vec3,
    ) -> Option<ForceSample> {
        let Some(simd) = V4::try_new() else { return baseline::<METHOD>(space, displacement_m) };
        simd.vectorize(Query::<METHOD> { machine: Wide(*simd), space, displacement_m })
    }

    /// What is inlined into code compiled for the wider registers.
    struct Query<'q, 'a, const METHOD: usize> {
        machine: Wide,
        space: &'q Space<'a>,
        displacement_m: &'q Vec3,
    }

    impl<const METHOD: usize> NullaryFnOnce for Query<'_, '_, METHOD> {
        type Output = Option<ForceSample>;

        #[inline(always)]
        fn call(self) -> Option<ForceSample> {
            self.space.force_on(self.machine, Method::ALL[METHOD], *self.displacement_m)
        }
    }

    /// Registers of 256 bits; the token says that they are there.
    #[derive(Clone, Copy)]
    struct Wide(V3);

    #[derive(Clone, Copy)]
    struct F32x8(V3, __m256);

    #[derive(Clone, Copy)]
    struct F64x4(V3, __m256d);

    impl Machine for Wide {
        type F32x8 = F32x8;
        type F64x4 = F64x4;

        #[inline(always)]
        fn rows(self, low: &[f32; 4], high: &[f32; 4]) -> F32x8 {
            self.join(*low, *high)
        }

        #[inline(always)]
        fn join(self, low: [f32; 4], high: [f32; 4]) -> F32x8 {
            let avx = self.0.avx;
            let low = avx._mm256_castps128_ps256(pulp::cast(low));
            F32x8(self.0, avx._mm256_insertf128_ps::<1>(low, pulp::cast(high)))
        }

        #[inline(always)]
        fn splat(self, x: f32) -> F32x8 {
            F32x8(self.0, self.0.avx._mm256_set1_ps(x))
        }

        #[inline(always)]
        fn sqrt(self, x: F32x8) -> F32x8 {
            F32x8(self.0, self.0.avx._mm256_sqrt_ps(x.1))
        }

        #[inline(always)]
        fn halves(self, x: F32x8) -> [[f32; 4]; 2] {
            let avx = self.0.avx;
            [pulp::cast(avx._mm256_castps256_ps128(x.1)), pulp::cast(avx._mm256_extractf128_ps::<1>(x.1))]
        }

        #[inline(always)]
        fn load_f64(self, lanes: &[f64; 4]) -> F64x4 {
            F64x4(self.0, pulp::cast(*lanes))
        }

        #[inline(always)]
        fn splat_f64(self, x: f64) -> F64x4 {
            F64x4(self.0, self.0.avx._mm256_set1_pd(x))
        }

        #[inline(always)]
        fn sqrt_f64(self, x: F64x4) -> F64x4 {
            F64x4(self.0, self.0.avx._mm256_sqrt_pd(x.1))
        }

        #[inline(always)]
        fn to_array_f64(self, x: F64x4) -> [f64; 4] {
            pulp::cast(x.1)
        }
    }

    macro_rules! lane_by_lane {
        ($($lanes:ident: $operator:ident $name:ident $instruction:ident),* $(,)?) => {$(
            impl $operator for $lanes {
                type Output = Self;
                #[inline(always)]
                fn $name(self, other: Self) -> Self {
                    Self(self.0, self.0.avx.$instruction(self.1, other.1))
                }
            }
        )*};
    }
    lane_by_lane!(F32x8: Add add _mm256_add_ps, F32x8: Sub sub _mm256_sub_ps, F32x8: Mul mul _mm256_mul_ps);
    lane_by_lane!(F64x4: Add add _mm256_add_pd, F64x4: Sub sub _mm256_sub_pd, F64x4: Mul mul _mm256_mul_pd);
}
