//! Run-time choice of the vector instructions that evaluate the force, made once before the loop runs.
//!
//! The program is built for any x86-64. The core's interpolants are inlined into functions that are also
//! compiled for AVX2 and AVX-512, one per method. An [`Interpolator`] holds a pointer to one of them. All
//! give the same bits: the core uses no fused multiply-add and fixes the order of its sums. A test compares
//! them.

use core::fmt;
use palpate_core::lanes::Baseline;
use palpate_core::{ForceSample, Method, Space, Vec3};
#[cfg(target_arch = "x86_64")]
use pulp::x86::{V3, V4};

/// Instantiates a function for a method. Its const parameter is the index in [`Method::ALL`].
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
    /// The target that the program is built for.
    Baseline,
    /// x86-64-v3: 256-bit registers.
    Avx2,
    /// x86-64-v4: also 256-bit registers, and twice as many.
    Avx512,
}

impl Instructions {
    /// All instruction sets, in ascending order of preference.
    pub const ALL: [Self; 3] = [Self::Baseline, Self::Avx2, Self::Avx512];

    /// Whether this processor supports them.
    #[must_use]
    pub fn are_available(self) -> bool {
        self.force(Method::Trilinear).is_some()
    }

    /// The best set that this processor supports.
    #[must_use]
    pub fn best() -> Self {
        let best = Self::ALL.into_iter().rfind(|instructions| instructions.are_available());
        best.unwrap_or(Self::Baseline)
    }

    /// The target of the build, for reports.
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

    /// The function for a method; `None` if the processor does not support the instructions.
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

/// Takes the displacement by reference to avoid a copy.
type Force = fn(&Space<'_>, &Vec3) -> Option<ForceSample>;

/// One method with one set of instructions.
#[derive(Debug, Clone, Copy)]
pub struct Interpolator {
    method: Method,
    instructions: Instructions,
    force: Force,
}

impl Interpolator {
    /// Uses the best instructions available.
    #[must_use]
    pub fn new(method: Method) -> Self {
        let (instructions, force) = (Instructions::Baseline, of_method!(method, baseline));
        Self::with_instructions(Instructions::best(), method).unwrap_or(Self { method, instructions, force })
    }

    /// Uses the given instructions; `None` if the processor lacks them.
    #[must_use]
    pub fn with_instructions(instructions: Instructions, method: Method) -> Option<Self> {
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
        // `try_new` is one load of the cached detection. This function is called only where AVX2 is present.
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

    /// The query that pulp inlines into code compiled for the wider registers.
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

    /// 256-bit registers. The token proves that the processor has them.
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
