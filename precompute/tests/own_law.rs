//! Laws from outside the crate: they are solved like the built-in ones, the check finds an error in one, and
//! none can be stored.

use std::path::PathBuf;
use std::sync::Arc;

use palpate_precompute::fem::material::{
    Derivatives, Describe, I1, I2, Invariants, J, Kinematics, Lame, Law, LinearElastic, Mat3, Material,
    MooneyRivlin, NeoHookean, OfInvariants, Real, Tangent, Third, Value, check, no_third,
};
use palpate_precompute::fem::{Body, Configuration, Model, Order, Problem, Solver};
use palpate_precompute::mesh::TetMesh;
use palpate_precompute::pipeline::Analysis;
use palpate_precompute::scene::Scene;

const LAME: Lame = Lame { lambda_pa: 48_000.0, mu_pa: 5_300.0 };

/// W = mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2. A factor other than 1 scales fJJ and fJJJ, as a
/// deliberate error.
#[derive(Debug)]
struct Neo {
    lame: Lame,
    shares: [f64; 2],
}

const NEO: Neo = Neo { lame: LAME, shares: [1.0; 2] };

fn lame_parameters(lame: Lame) -> Vec<(&'static str, Value)> {
    vec![("lambda_pa", lame.lambda_pa.into()), ("mu_pa", lame.mu_pa.into())]
}

impl Describe for Neo {
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        lame_parameters(self.lame)
    }

    fn shear_modulus_pa(&self) -> f64 {
        self.lame.mu_pa
    }
}

impl OfInvariants for Neo {
    const CURVED: [bool; 4] = [false, false, true, false];
    const THIRD: bool = true;
    const SECOND_INVARIANT: bool = false;

    fn derivatives<R: Real>(&self, at: &Invariants<R>) -> Derivatives<R> {
        let Lame { lambda_pa, mu_pa } = self.lame;
        let (log, jacobian) = (at.j.map(f64::ln_1p), at.j + 1.0);
        let mut d = Derivatives::of_energy((at.i1 * 0.5 - log) * mu_pa + log * log * (0.5 * lambda_pa));
        d.first[I1] = log.constant(0.5 * mu_pa);
        d.first[J] = (log * lambda_pa - mu_pa) * jacobian.recip();
        d.second[J][J] = ((-log + 1.0) * lambda_pa + mu_pa) * (jacobian * jacobian).recip() * self.shares[0];
        d
    }

    fn third<R: Real>(&self, at: &Invariants<R>) -> Third<R> {
        let Lame { lambda_pa, mu_pa } = self.lame;
        let (log, jacobian) = (at.j.map(f64::ln_1p), at.j + 1.0);
        let mut third = no_third(at.j);
        third[J][J][J] = (log * (2.0 * lambda_pa) - (3.0 * lambda_pa + 2.0 * mu_pa))
            * (jacobian * jacobian * jacobian).recip()
            * self.shares[1];
        third
    }
}

/// W = C10 (I1 - 3) + C01 (I2 - 3) with the pressure p0 = 2 C10 + 4 C01 at rest.
#[derive(Debug)]
struct Mooney([f64; 2]);

impl Describe for Mooney {
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        vec![("c10_pa", self.0[0].into()), ("c01_pa", self.0[1].into())]
    }

    fn shear_modulus_pa(&self) -> f64 {
        2.0 * (self.0[0] + self.0[1])
    }

    fn rest_pressure_pa(&self) -> Option<f64> {
        Some(2.0 * self.0[0] + 4.0 * self.0[1])
    }
}

impl OfInvariants for Mooney {
    fn derivatives<R: Real>(&self, at: &Invariants<R>) -> Derivatives<R> {
        let [c10_pa, c01_pa] = self.0;
        let p0_pa = 2.0 * c10_pa + 4.0 * c01_pa;
        let mut d = Derivatives::of_energy(at.i1 * c10_pa + at.i2 * c01_pa - at.j * p0_pa);
        d.first[I1] = at.j.constant(c10_pa);
        d.first[I2] = at.j.constant(c01_pa);
        d.first[J] = at.j.constant(-p0_pa);
        d
    }
}

/// sigma = lambda (tr eps) I + 2 mu eps: a law that is not a function of the invariants of C.
#[derive(Debug)]
struct Hooke(Lame);

impl Describe for Hooke {
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        lame_parameters(self.0)
    }

    fn shear_modulus_pa(&self) -> f64 {
        self.0.mu_pa
    }
}

impl Law for Hooke {
    fn stress<R: Real>(&self, k: &Kinematics<R>, q_pa: R) -> (R, Mat3<R>) {
        let h = k.displacement_gradient;
        let strain = (h + h.transpose()) * q_pa.constant(0.5);
        let stress = strain * q_pa.constant(2.0 * self.0.mu_pa);
        let stress = stress.plus_diagonal(h.trace() * self.0.lambda_pa);
        (stress.dot(strain) * 0.5, stress)
    }

    fn response<R: Real>(&self, k: &Kinematics<R>, q_pa: R) -> (R, Mat3<R>, Tangent<R>) {
        let (energy, stress) = self.stress(k, q_pa);
        let [lambda, mu] = [self.0.lambda_pa, self.0.mu_pa].map(|modulus| q_pa.constant(modulus));
        (energy, stress, Tangent { forward: lambda, crosswise: mu, isotropic: mu, ..Tangent::zero(q_pa) })
    }

    fn third_along<R: Real>(&self, _: &Kinematics<R>, q_pa: R, _: &[Mat3<R>; 3], _: &[R; 3]) -> [R; 10] {
        [q_pa.constant(0.0); 10]
    }
}

/// A beam of 40 x 20 x 20 mm, fixed at one end, with a node of the other end displaced by a quarter of its
/// length.
fn bent(law: Material, order: Order) -> Configuration {
    let mesh = TetMesh::cuboid([5, 2, 2], 0.01);
    let at_x = |x_m: f64| (0..).zip(&mesh.nodes_m).filter(move |(_, p)| p[0] == x_m).map(|(n, _)| n);
    let model = Model { order, ..Model::uniform(law, &at_x(0.0).collect::<Vec<u32>>()) };
    let body = Arc::new(Body::new(&mesh, &model).expect("every element has volume"));
    let mut solver = Solver::new(Arc::new(Problem::new(body, at_x(0.05).last().expect("a free end"))));
    let rest = solver.rest().expect("the beam is held");
    solver.advance(&rest.seed, [0.002, -0.004, 0.01]).expect("it converges")
}

fn relative<'v>(pairs: impl IntoIterator<Item = (&'v f64, &'v f64)>) -> f64 {
    let (mut difference, mut size) = (0.0, 0.0);
    for (a, b) in pairs {
        difference += (a - b) * (a - b);
        size += b * b;
    }
    f64::sqrt(difference / size)
}

#[test]
fn laws_from_outside_give_what_the_built_in_ones_give() {
    let pairs = [
        (Material::own("neo", NEO), Material::from(NeoHookean { lame: LAME })),
        (
            Material::own("mooney", Mooney([1300.0, 1280.0])),
            MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 }.into(),
        ),
        (Material::own("hooke", Hooke(LAME)), LinearElastic { lame: LAME }.into()),
    ];
    for (own, built_in) in pairs {
        for order in [Order::Linear, Order::Quadratic] {
            let (here, there) = (bent(own.clone(), order), bent(built_in.clone(), order));
            let (here, there) = (here.jet(), there.jet());
            let errors = [
                relative(here.force_n.iter().zip(&there.force_n)),
                relative([(&here.energy_j, &there.energy_j)]),
                relative(here.stiffness_n_m.iter().zip(&there.stiffness_n_m)),
            ];
            assert!(errors.iter().all(|error| *error < 1e-12), "{} {order:?}: {errors:?}", own.name());
            // The third derivatives of the linear law are zero.
            let scale = there.third_n_m2.iter().fold(1.0, |most: f64, t| most.max(t.abs()));
            let thirds = here.third_n_m2.iter().zip(&there.third_n_m2);
            let third = thirds.fold(0.0, |worst: f64, (a, b)| worst.max((a - b).abs())) / scale;
            assert!(third < 1e-11, "{} {order:?}: third {third:e}", own.name());
            println!("{} {order:?}: {errors:?}, third {third:e}", own.name());
        }
    }
}

#[test]
fn sound_laws_pass_the_check_and_a_slip_is_named() {
    assert_eq!(check(&NEO).faults(), [""; 0]);
    assert_eq!(check(&Mooney([1300.0, 1280.0])).faults(), [""; 0]);
    let named = |found: Vec<String>, wanted: &[&str]| {
        let all = found.len() == wanted.len() && found.iter().zip(wanted).all(|(f, w)| f.contains(w));
        assert!(all, "{found:?}, not {wanted:?}");
    };
    named(check(&Hooke(LAME)).faults(), &["a rotation changes"]);
    let slipped = |shares| check(&Neo { shares, ..NEO }).faults();
    named(slipped([1.0, 1.001]), &["the third derivatives"]);
    named(slipped([1.001, 1.0]), &["the elasticity is not the derivative", "the third derivatives"]);
    named(
        check(&Mooney([f64::NAN, 1.0])).faults(),
        &["stress is not", "elasticity is not", "not symmetric", "third", "differ", "rotation", "undeformed"],
    );
}

#[test]
fn a_law_of_ones_own_is_not_stored() {
    let scene = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../assets/scenes/palpation.toml");
    let mut resolved = Scene::load(&scene).and_then(|scene| scene.resolve()).expect("a bundled scene");
    resolved.materials[0].material = Material::own("neo", NEO);
    let analysis = Analysis::of_scene(&scene, resolved).expect("it has a body");
    let folder = tempfile::tempdir().expect("a folder for the test");
    let space = folder.path().join("a.space");
    for refused in [analysis.store(&space).err(), analysis.salvage(&space).err()] {
        let refused = refused.expect("no space holds it");
        assert!(refused.is_bad_input());
        let line = refused.to_string();
        assert!(
            line.contains("palpation.toml: the law \"neo\" is user-defined") && !line.contains('\n'),
            "{line}"
        );
    }
    assert!(!space.exists());
    let equal = |a: Neo, b: Neo| Material::own("neo", a) == Material::own("neo", b);
    assert!(equal(NEO, NEO) && !equal(NEO, Neo { lame: Lame { mu_pa: 1.0, ..LAME }, ..NEO }));
}
