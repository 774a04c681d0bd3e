//! Vectors and 3 x 3 matrices of [`Real`] numbers.
//!
//! nalgebra's products are loops behind function calls, which the compiler does not inline if a number is a
//! whole vector register. The products here are unrolled. The order of each sum is that of nalgebra, so that
//! both give the same bits.

use std::ops::{Add, AddAssign, Mul, Sub};

use nalgebra::{Matrix3, Vector3};

use crate::num::lanes::Real;

/// A vector with three components.
#[derive(Debug, Clone, Copy)]
pub struct Vec3<R>(pub [R; 3]);

/// A second-order tensor, stored by columns.
#[derive(Debug, Clone, Copy)]
pub struct Mat3<R>(pub [Vec3<R>; 3]);

impl<R: Real> Vec3<R> {
    /// A vector with the same value in each lane; `like` is any number.
    #[inline(always)]
    pub(crate) fn constant(like: R, [x, y, z]: [f64; 3]) -> Self {
        Self([like.constant(x), like.constant(y), like.constant(z)])
    }

    /// Scalar product.
    #[inline(always)]
    pub(crate) fn dot(self, other: Self) -> R {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        a * x + b * y + c * z
    }

    /// Vector product.
    #[inline(always)]
    pub(crate) fn cross(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Self([b * z - c * y, c * x - a * z, a * y - b * x])
    }

    /// Dyadic product, with the entries self_i other_j.
    #[inline(always)]
    pub(crate) fn outer(self, other: Self) -> Mat3<R> {
        let [x, y, z] = other.0;
        Mat3([self * x, self * y, self * z])
    }
}

impl<R: Real> Mat3<R> {
    /// Zero; `like` is any number.
    #[inline(always)]
    pub(crate) fn zeros(like: R) -> Self {
        Self([Vec3::constant(like, [0.0; 3]); 3])
    }

    /// The identity; `like` is any number.
    #[inline(always)]
    pub(crate) fn identity(like: R) -> Self {
        Self::zeros(like).plus_diagonal(like.constant(1.0))
    }

    /// The matrix of one lane.
    #[inline(always)]
    pub(crate) fn lane(&self, lane: usize) -> Mat3<f64> {
        Mat3(self.0.map(|column| Vec3(column.0.map(|entry| entry.lane(lane)))))
    }

    /// The matrix that `value` gives for each lane; `like` is any number.
    #[inline(always)]
    pub(crate) fn from_lanes<'m>(like: R, value: impl Fn(usize) -> &'m Mat3<f64>) -> Self {
        let entry = |i: usize, j: usize| like.with_lanes(|lane| value(lane).at(i, j));
        Self([0, 1, 2].map(|j| Vec3([0, 1, 2].map(|i| entry(i, j)))))
    }

    /// Entry of row `i` and column `j`.
    #[inline(always)]
    pub(crate) fn at(&self, i: usize, j: usize) -> R {
        self.0[j].0[i]
    }

    /// Transpose.
    #[inline(always)]
    pub fn transpose(self) -> Self {
        let [Vec3(a), Vec3(b), Vec3(c)] = self.0;
        Self([Vec3([a[0], b[0], c[0]]), Vec3([a[1], b[1], c[1]]), Vec3([a[2], b[2], c[2]])])
    }

    /// Trace.
    #[inline(always)]
    pub fn trace(self) -> R {
        self.at(0, 0) + self.at(1, 1) + self.at(2, 2)
    }

    /// Double contraction A : B.
    #[inline(always)]
    pub fn dot(self, other: Self) -> R {
        let mut sum = self.at(0, 0) * other.at(0, 0);
        for entry in 1..9 {
            let (i, j) = (entry % 3, entry / 3);
            sum += self.at(i, j) * other.at(i, j);
        }
        sum
    }

    /// A : A, summed column by column.
    #[inline(always)]
    pub(crate) fn norm_squared(self) -> R {
        let [a, b, c] = self.0;
        a.dot(a) + b.dot(b) + c.dot(c)
    }

    /// A + s I.
    #[inline(always)]
    pub fn plus_diagonal(mut self, value: R) -> Self {
        for axis in 0..3 {
            self.0[axis].0[axis] += value;
        }
        self
    }
}

/// The operators that act on each of the three parts of a vector or matrix.
macro_rules! elementwise {
    ($type:ident) => {
        impl<R: Real> Add for $type<R> {
            type Output = Self;

            #[inline(always)]
            fn add(self, other: Self) -> Self {
                let ([a, b, c], [x, y, z]) = (self.0, other.0);
                Self([a + x, b + y, c + z])
            }
        }

        impl<R: Real> Sub for $type<R> {
            type Output = Self;

            #[inline(always)]
            fn sub(self, other: Self) -> Self {
                let ([a, b, c], [x, y, z]) = (self.0, other.0);
                Self([a - x, b - y, c - z])
            }
        }

        impl<R: Real> Mul<R> for $type<R> {
            type Output = Self;

            #[inline(always)]
            fn mul(self, factor: R) -> Self {
                let [a, b, c] = self.0;
                Self([a * factor, b * factor, c * factor])
            }
        }

        impl<R: Real> AddAssign for $type<R> {
            #[inline(always)]
            fn add_assign(&mut self, other: Self) {
                *self = *self + other;
            }
        }
    };
}

elementwise!(Vec3);
elementwise!(Mat3);

impl<R: Real> Mul<Vec3<R>> for Mat3<R> {
    type Output = Vec3<R>;

    #[inline(always)]
    fn mul(self, vector: Vec3<R>) -> Vec3<R> {
        let ([a, b, c], [x, y, z]) = (self.0, vector.0);
        a * x + b * y + c * z
    }
}

impl<R: Real> Mul for Mat3<R> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        let [a, b, c] = other.0;
        Self([self * a, self * b, self * c])
    }
}

impl From<Vector3<f64>> for Vec3<f64> {
    fn from(vector: Vector3<f64>) -> Self {
        Self(vector.into())
    }
}

impl From<&Matrix3<f64>> for Mat3<f64> {
    fn from(matrix: &Matrix3<f64>) -> Self {
        Self(matrix.data.0.map(Vec3))
    }
}

impl From<Mat3<f64>> for Matrix3<f64> {
    fn from(matrix: Mat3<f64>) -> Self {
        Self::from(matrix.0.map(|column| column.0))
    }
}
