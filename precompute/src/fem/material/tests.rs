//! Difference tests of every law: those of [`check`], S = dW/dgamma and dS/dgamma.

use super::check::matrix;
use super::*;
use nalgebra::Matrix3;

/// The paper's Mooney-Rivlin liver.
pub(crate) fn mooney_rivlin() -> Material {
    MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 }.into()
}

/// Every law of [`LAWS`], with constants similar to those of a liver.
pub(crate) fn livers() -> Vec<Material> {
    let given = |law: &str| -> Vec<(&str, Value)> {
        match law {
            "mooney-rivlin" | "mooney-rivlin-reduced" => {
                vec![("c10_pa", Value::Number(1300.0)), ("c01_pa", Value::Number(1280.0))]
            }
            "holzapfel-gasser-ogden" => vec![
                ("c10_pa", Value::Number(2500.0)),
                ("k1_pa", Value::Number(3000.0)),
                ("k2", Value::Number(2.0)),
                ("dispersion", Value::Number(0.1)),
                ("fibre", Value::Vector([0.8, 0.0, 0.6])),
            ],
            "st-venant-kirchhoff" => {
                vec![("young_pa", Value::Number(15480.0)), ("poisson", Value::Number(0.49))]
            }
            _ => vec![("young_pa", Value::Number(15480.0)), ("poisson", Value::Number(0.45))],
        }
    };
    let liver = |law: &&str| Material::from_parameters(law, &given(law)).expect("constants of the law");
    LAWS.iter().map(liver).collect()
}

/// Evaluation at one point.
impl Material {
    /// Energy density with the multiplier term of the excess pressure `q`, J/m^3, and first Piola stress, Pa.
    pub(crate) fn stress(&self, k: &Kinematics, q_pa: f64) -> (f64, Matrix3<f64>) {
        let (energy, stress) = self.erased().stress_at(k, q_pa);
        (energy, stress.into())
    }

    /// [`Material::stress`] with the tangent dP/dF at fixed pressure.
    fn response(&self, k: &Kinematics, q_pa: f64) -> (f64, Matrix3<f64>, Tangent) {
        let (energy, stress, tangent) = self.erased().response_at(k, q_pa);
        (energy, stress.into(), tangent)
    }
}

fn laws() -> Vec<Material> {
    let mut laws = livers();
    laws.extend([hgo(0.0), hgo(0.2)]);
    laws
}

fn hgo(dispersion: f64) -> Material {
    Material::HolzapfelGasserOgden(HolzapfelGasserOgden {
        c10_pa: 1300.0,
        k1_pa: 900.0,
        k2: 1.7,
        dispersion,
        fibre: [0.6, -0.48, 0.64],
    })
}

#[test]
fn every_law_is_the_derivatives_of_one_energy() {
    for law in laws() {
        let found = check(law.erased());
        let objective = !matches!(law, Material::LinearElastic(_));
        let faults = if objective { found } else { LawCheck { rotation: 0.0, ..found } }.faults();
        assert_eq!(faults, [""; 0], "{law:?}");
        assert!(objective || found.rotation > 1e-3, "a rotation strains the linear law: {found:?}");
        // The smooth switch of the fibres is narrow. The difference has an error proportional to its fourth
        // derivative, which is large.
        assert!(found.third < 1e-7 || law.name() == "holzapfel-gasser-ogden", "{law:?}: {found:?}");
        // The check skips an inverted state without an energy. Only ln J and fractional powers of J
        // justify that.
        let has_barrier = matches!(law, Material::ReducedMooneyRivlin(_) | Material::NeoHookean(_));
        let inverted = Kinematics::of(&Matrix3::from_diagonal(&nalgebra::Vector3::new(-1.2, 0.2, 0.2)));
        assert_eq!(law.stress(&inverted, 0.0).0.is_finite(), !has_barrier, "{law:?}");
        println!("{}: {found:?}", law.name());
    }
}

#[test]
fn parameters_make_the_same_law_again() {
    for law in laws() {
        assert_eq!(Material::from_parameters(law.name(), &law.parameters()), Ok(law.clone()));
    }
    assert_eq!(livers().iter().map(Material::name).collect::<Vec<_>>(), LAWS);
    let unknown = Material::from_parameters("hooke", &[]).expect_err("no such law");
    assert_eq!((unknown.key, unknown.what.as_str()), (None, "unknown law \"hooke\""));
}

const Q_PA: f64 = 333.0;

/// S = F^-1 P and its tangent as functions of the strain gamma: F is the square root of C = I + 2 gamma.
#[test]
fn second_piola_and_material_tangent_are_derivatives_by_the_strain() {
    let root = |gamma: &Matrix3<f64>| {
        let c = Matrix3::identity() + gamma * 2.0;
        let eigen = c.symmetric_eigen();
        let stretch = eigen.eigenvalues.map(f64::sqrt);
        eigen.eigenvectors * Matrix3::from_diagonal(&stretch) * eigen.eigenvectors.transpose()
    };
    let at = |gamma: &Matrix3<f64>| Kinematics::of(&(root(gamma) - Matrix3::identity()));
    let second_piola = |law: &Material, gamma: &Matrix3<f64>| {
        let k = at(gamma);
        let inverse = Matrix3::from(k.deformation_gradient).try_inverse().expect("C is positive definite");
        inverse * law.stress(&k, Q_PA).1
    };
    let gamma = Matrix3::new(0.21, -0.07, 0.03, -0.07, -0.18, 0.11, 0.03, 0.11, 0.09);
    let mut worst = [0.0f64; 2];
    for law in laws().into_iter().filter(|law| !matches!(law, Material::LinearElastic(_))) {
        let s = second_piola(&law, &gamma);
        assert!((s - s.transpose()).norm() < 1e-12 * s.norm(), "{}", law.name());
        let k = at(&gamma);
        let inverse = Matrix3::from(k.deformation_gradient).try_inverse().expect("C is positive definite");
        let elasticity = matrix(&law.response(&k, Q_PA).2);
        for (m, n) in [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)] {
            let mut unit = Matrix3::zeros();
            unit[(m, n)] = 1.0;
            unit[(n, m)] = 1.0;
            let step = 1e-6;
            let energy = |x: f64| law.stress(&at(&(gamma + unit * x)), Q_PA).0;
            let slope = (energy(step) - energy(-step)) / (2.0 * step);
            let error = (slope - s.dot(&unit)).abs() / s.norm();
            worst[0] = worst[0].max(error);
            assert!(error < 1e-7, "{} S[{m}{n}]", law.name());
            // dS along the unit strain: C_MKNL = F^-1_Mi (A_iKjL - d_ij S_KL) F^-1_Nj.
            let slope = (second_piola(&law, &(gamma + unit * step))
                - second_piola(&law, &(gamma - unit * step)))
                / (2.0 * step);
            let mut tangent = Matrix3::zeros();
            for (row, entries) in elasticity.iter().enumerate() {
                for (column, entry) in entries.iter().enumerate() {
                    let ((i, big_k), (j, big_l)) = ((row % 3, row / 3), (column % 3, column / 3));
                    let material = entry - if i == j { s[(big_k, big_l)] } else { 0.0 };
                    for (p, q) in [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (2, 0), (2, 1), (2, 2)] {
                        tangent[(p, big_k)] +=
                            inverse[(p, i)] * material * inverse[(q, j)] * unit[(q, big_l)];
                    }
                }
            }
            let error = (slope - tangent).norm() / elasticity[0][0].abs();
            worst[1] = worst[1].max(error);
            assert!(error < 1e-7, "{} dS/dgamma[{m}{n}]", law.name());
        }
    }
    println!("S = dW/dgamma {:.1e}, dS/dgamma {:.1e}", worst[0], worst[1]);
}

/// dP/dtheta of the derivative law against central differences, at a state with shear, stretch and a change of
/// volume. The laws are linear in their constants, so that the differences are exact but for rounding; only the
/// stress as a function of Poisson's ratio has higher derivatives.
#[test]
fn a_derivative_law_is_the_change_of_the_stress_with_a_number_of_the_scene() {
    let k = Kinematics::of(&Matrix3::new(0.12, 0.2, -0.05, 0.03, -0.07, 0.1, -0.08, 0.06, 0.02));
    let mut numbers = 0;
    for law in livers() {
        let given: Vec<(&str, Value)> = match law.name() {
            "linear" | "neo-hookean" => {
                vec![("young_pa", Value::Number(15480.0)), ("poisson", Value::Number(0.45))]
            }
            _ => law.parameters(),
        };
        for (key, value) in &given {
            let Value::Number(number) = *value else { continue };
            let Some(derivative) = law.derivative(key) else {
                assert!(["k2", "dispersion"].contains(key), "{} has no derivative by {key}", law.name());
                continue;
            };
            let stress_at = |number: f64| {
                let given: Vec<_> = given
                    .iter()
                    .map(|&(other, value)| (other, if other == *key { Value::Number(number) } else { value }))
                    .collect();
                Material::from_parameters(law.name(), &given).expect("constants of the law").stress(&k, 0.0).1
            };
            let step = 1e-4 * number;
            let difference = (stress_at(number + step) - stress_at(number - step)) / (2.0 * step);
            let error = (derivative.stress(&k, 0.0).1 - difference).norm() / difference.norm();
            assert!(error < if *key == "poisson" { 1e-6 } else { 1e-9 }, "{} {key}: {error:.1e}", law.name());
            numbers += 1;
        }
    }
    assert_eq!(numbers, 2 * 4 + 2 * 2 + 2, "numbers of the seven laws");
}
