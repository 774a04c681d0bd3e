//! Vectors of eight floats, for shading several samples at once.

/// Number of samples shaded at once.
pub(super) const LANES: usize = 8;

#[inline(always)]
pub(super) fn dot(a: [Lanes; 3], b: [Lanes; 3]) -> Lanes {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(super) fn unit(a: [Lanes; 3]) -> [Lanes; 3] {
    let inverse = Lanes::of(1.0) / dot(a, a).at_least(1e-30).root();
    [a[0] * inverse, a[1] * inverse, a[2] * inverse]
}

/// A vector of floats. Every operation is a loop that the compiler vectorises.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lanes(pub(super) [f32; LANES]);

impl Lanes {
    #[inline(always)]
    pub(super) fn of(value: f32) -> Self {
        Self([value; LANES])
    }

    #[inline(always)]
    fn map2(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        let mut out = [0.0; LANES];
        for lane in 0..LANES {
            out[lane] = f(self.0[lane], other.0[lane]);
        }
        Self(out)
    }

    #[inline(always)]
    pub(super) fn root(self) -> Self {
        self.map2(self, |a, _| a.sqrt())
    }

    /// Larger of two values in one instruction; `f32::max` needs more because it does not propagate NaN.
    #[inline(always)]
    pub(super) fn at_least(self, low: f32) -> Self {
        self.map2(Self::of(low), |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    pub(super) fn at_most(self, high: f32) -> Self {
        self.map2(Self::of(high), |a, b| if a < b { a } else { b })
    }
}

impl core::ops::Add for Lanes {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.map2(other, |a, b| a + b)
    }
}

impl core::ops::Sub for Lanes {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.map2(other, |a, b| a - b)
    }
}

impl core::ops::Mul for Lanes {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.map2(other, |a, b| a * b)
    }
}

impl core::ops::Div for Lanes {
    type Output = Self;

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.map2(other, |a, b| a / b)
    }
}
