//! Losses: how much a residual counts.
//!
//! With z = (r / c)^2 and the scale c, the fit minimises sum c^2 rho(z) / 2:
//!
//! linear    rho = z
//! soft-l1   rho = 2 (sqrt(1 + z) - 1)
//! huber     rho = z for z <= 1, 2 sqrt(z) - 1 beyond
//!
//! It is a least-squares problem in g(r) = c sgn(r) sqrt(rho), whose slope is dg/dr = rho' (r / c) / sqrt(rho). The
//! influence of a residual is psi(r) = r rho'. Source: Huber 1981; Triggs and others 2000.

/// A loss.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Loss {
    /// Least squares.
    #[default]
    Linear,
    /// Smooth, grows like |r| for outliers.
    SoftL1,
    /// Least squares up to the scale, |r| beyond.
    Huber,
}

impl Loss {
    /// rho, rho' and rho'' at z.
    fn rho(self, z: f64) -> [f64; 3] {
        match self {
            Self::Huber if z > 1.0 => {
                let root = z.sqrt();
                [2.0 * root - 1.0, 1.0 / root, -0.5 / (z * root)]
            }
            Self::Linear | Self::Huber => [z, 1.0, 0.0],
            Self::SoftL1 => {
                let root = (1.0 + z).sqrt();
                // 2 (root - 1) without cancellation.
                [2.0 * z / (root + 1.0), 1.0 / root, -0.5 / (root * root * root)]
            }
        }
    }

    /// g and dg/dr at a residual.
    pub(super) fn transformed(self, r: f64, c: f64) -> (f64, f64) {
        let z = (r / c) * (r / c);
        let [rho, first, _] = self.rho(z);
        let root = rho.sqrt();
        if root == 0.0 { (r, 1.0) } else { (c * root.copysign(r), first * (r / c).abs() / root) }
    }

    /// psi and psi' at a residual.
    pub(super) fn influence(self, r: f64, c: f64) -> (f64, f64) {
        let z = (r / c) * (r / c);
        let [_, first, second] = self.rho(z);
        (r * first, first + 2.0 * z * second)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_those_of_the_values_by_differences() {
        let (c, step) = (0.3, 1e-6);
        for loss in [Loss::Linear, Loss::SoftL1, Loss::Huber] {
            for r in [-1.7, -0.29, -1e-3, 2e-4, 0.2, 0.31, 2.5] {
                let g = |r: f64| loss.transformed(r, c).0;
                let slope = (g(r + step) - g(r - step)) / (2.0 * step);
                assert!((slope - loss.transformed(r, c).1).abs() < 1e-7, "{loss:?} g at {r}");
                let psi = |r: f64| loss.influence(r, c).0;
                let slope = (psi(r + step) - psi(r - step)) / (2.0 * step);
                assert!((slope - loss.influence(r, c).1).abs() < 1e-7, "{loss:?} psi at {r}");
                let cost = |r: f64| 0.5 * g(r) * g(r);
                let slope = (cost(r + step) - cost(r - step)) / (2.0 * step);
                assert!((slope - loss.influence(r, c).0).abs() < 1e-7, "{loss:?} cost at {r}");
            }
            assert_eq!(loss.transformed(0.0, c), (0.0, 1.0));
        }
        assert!(Loss::Huber.transformed(30.0, c).0 < 5.0, "an outlier counts little");
    }
}
