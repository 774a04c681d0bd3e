//! Quadrature points of the reference tetrahedron, and the shape functions at them.

use super::EDGES;

/// One quadrature point of an element with N nodes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Point<const N: usize> {
    /// Weight as a share of the volume; the weights of a rule add up to 1.
    pub weight: f64,
    /// Barycentric coordinates, which are also the values of the four linear (pressure) shape functions.
    pub barycentric: [f64; 4],
    /// N_a.
    pub values: [f64; N],
    /// dN_a/dlambda_k.
    pub slopes: [[f64; 4]; N],
}

/// One point, exact for linear integrands; sufficient for constant-strain elements.
pub(crate) static LINEAR: [Point<4>; 1] = [Point {
    weight: 1.0,
    barycentric: [0.25; 4],
    values: [0.25; 4],
    slopes: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]],
}];

/// Fourteen points with positive weights, exact to degree 5 (Walkington 2000). With quadratic shape functions
/// the force of St. Venant-Kirchhoff and of unreduced Mooney-Rivlin has degree 4, so that its integral is
/// exact.
pub(crate) static QUADRATIC: [Point<10>; 14] = quadratic();

/// Orbit of (a, a, a, 1 - 3a): a and the weight of each of its four points.
const VERTEX_ORBITS: [(f64, f64); 2] = [
    (0.310_885_919_263_300_6, 0.112_687_925_718_015_85),
    (0.092_735_250_310_891_23, 0.073_493_043_116_361_95),
];
/// Orbit of (a, a, 1/2 - a, 1/2 - a): a and the weight of each of its six points.
const EDGE_ORBIT: (f64, f64) = (0.045_503_704_125_649_65, 0.042_546_020_777_081_466);

const fn quadratic() -> [Point<10>; 14] {
    let mut rule = [quadratic_point([0.25; 4], 0.0); 14];
    let mut at = 0;
    let mut orbit = 0;
    while orbit < 2 {
        let (a, weight) = VERTEX_ORBITS[orbit];
        let mut k = 0;
        while k < 4 {
            let mut barycentric = [a; 4];
            barycentric[k] = 1.0 - 3.0 * a;
            rule[at] = quadratic_point(barycentric, weight);
            at += 1;
            k += 1;
        }
        orbit += 1;
    }
    let (a, weight) = EDGE_ORBIT;
    let mut edge = 0;
    while edge < 6 {
        let mut barycentric = [a; 4];
        barycentric[EDGES[edge][0]] = 0.5 - a;
        barycentric[EDGES[edge][1]] = 0.5 - a;
        rule[at] = quadratic_point(barycentric, weight);
        at += 1;
        edge += 1;
    }
    rule
}

/// Vertices: N_k = lambda_k (2 lambda_k - 1). Mid-edge nodes: N = 4 lambda_i lambda_j.
const fn quadratic_point(barycentric: [f64; 4], weight: f64) -> Point<10> {
    let mut values = [0.0; 10];
    let mut slopes = [[0.0; 4]; 10];
    let mut k = 0;
    while k < 4 {
        values[k] = barycentric[k] * (2.0 * barycentric[k] - 1.0);
        slopes[k][k] = 4.0 * barycentric[k] - 1.0;
        k += 1;
    }
    let mut edge = 0;
    while edge < 6 {
        let [i, j] = EDGES[edge];
        values[4 + edge] = 4.0 * barycentric[i] * barycentric[j];
        slopes[4 + edge][i] = 4.0 * barycentric[j];
        slopes[4 + edge][j] = 4.0 * barycentric[i];
        edge += 1;
    }
    Point { weight, barycentric, values, slopes }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Integral of prod lambda_k^e_k over the tetrahedron, over its volume: 6 prod e_k! / (3 + sum e_k)!.
    fn exact(exponents: [u32; 4]) -> f64 {
        let factorial = |n: u32| (1..=n).map(f64::from).product::<f64>();
        6.0 * exponents.map(factorial).iter().product::<f64>() / factorial(3 + exponents.iter().sum::<u32>())
    }

    fn worst<const N: usize>(rule: &[Point<N>], degree: u32) -> f64 {
        let mut worst = 0.0f64;
        for code in 0..(degree + 1).pow(4) {
            let exponents = [0, 1, 2, 3].map(|k| code / (degree + 1).pow(k) % (degree + 1));
            if exponents.iter().sum::<u32>() <= degree {
                let monomial = |l: &[f64; 4]| -> f64 {
                    l.iter().zip(exponents).map(|(l, e)| l.powi(e as i32)).product()
                };
                let sum: f64 = rule.iter().map(|p| p.weight * monomial(&p.barycentric)).sum();
                worst = worst.max((sum - exact(exponents)).abs());
            }
        }
        worst
    }

    #[test]
    fn rules_are_exact_to_their_degree_and_no_further() {
        assert!(worst(&LINEAR, 1) < 1e-16 && worst(&LINEAR, 2) > 1e-3);
        assert!(worst(&QUADRATIC, 5) < 1e-15, "{:e}", worst(&QUADRATIC, 5));
        assert!(worst(&QUADRATIC, 6) > 1e-6);
    }

    #[test]
    fn shape_functions_are_a_partition_of_unity() {
        for point in &QUADRATIC {
            assert!((point.values.iter().sum::<f64>() - 1.0).abs() < 1e-15);
            for k in 1..4 {
                // Along X only differences of the lambdas change, so all sums of slopes must agree.
                let sum = |k: usize| point.slopes.iter().map(|s| s[k]).sum::<f64>();
                assert!((sum(k) - sum(0)).abs() < 1e-14);
            }
        }
    }
}
