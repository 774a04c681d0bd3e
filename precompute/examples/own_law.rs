//! A user-defined law: Yeoh, W = c1 (I1 - 3) + c2 (I1 - 3)^2 + c3 (I1 - 3)^3, incompressible.
//!
//! cargo run --release -p palpate-precompute --example own_law

use std::error::Error;
use std::sync::Arc;

use palpate_precompute::fem::material::{
    Derivatives, Describe, I1, Invariants, J, Material, OfInvariants, Real, Third, Value, check, no_third,
};
use palpate_precompute::fem::{Body, Model, Problem, Solver};
use palpate_precompute::mesh::TetMesh;

/// Constants in Pa.
#[derive(Debug)]
struct Yeoh {
    c1_pa: f64,
    c2_pa: f64,
    c3_pa: f64,
}

impl Describe for Yeoh {
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        vec![("c1_pa", self.c1_pa.into()), ("c2_pa", self.c2_pa.into()), ("c3_pa", self.c3_pa.into())]
    }

    fn shear_modulus_pa(&self) -> f64 {
        2.0 * self.c1_pa
    }

    /// The undeformed body is free of stress if 2 f1 + fJ = 0, with fJ = -p0.
    fn rest_pressure_pa(&self) -> Option<f64> {
        Some(2.0 * self.c1_pa)
    }
}

/// f = c1 i1 + c2 i1^2 + c3 i1^3 - p0 j with i1 = I1 - 3 and j = J - 1.
impl OfInvariants for Yeoh {
    const CURVED: [bool; 4] = [true, false, false, false];
    const THIRD: bool = true;
    const SECOND_INVARIANT: bool = false;

    #[inline(always)]
    fn derivatives<R: Real>(&self, at: &Invariants<R>) -> Derivatives<R> {
        let Self { c1_pa, c2_pa, c3_pa } = *self;
        let (i1, p0_pa) = (at.i1, 2.0 * c1_pa);
        let mut d = Derivatives::of_energy(i1 * ((i1 * c3_pa + c2_pa) * i1 + c1_pa) - at.j * p0_pa);
        d.first[I1] = i1 * (i1 * (3.0 * c3_pa) + 2.0 * c2_pa) + c1_pa;
        d.first[J] = i1.constant(-p0_pa);
        d.second[I1][I1] = i1 * (6.0 * c3_pa) + 2.0 * c2_pa;
        d
    }

    #[inline(always)]
    fn third<R: Real>(&self, at: &Invariants<R>) -> Third<R> {
        let mut third = no_third(at.j);
        third[I1][I1][I1] = at.j.constant(6.0 * self.c3_pa);
        third
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let yeoh = Yeoh { c1_pa: 2_580.0, c2_pa: 900.0, c3_pa: 350.0 };

    // Compares stress, elasticity and third derivatives with differences. An error in one of the lines above
    // is found here.
    let found = check(&yeoh);
    println!("{found:#?}");
    if let Some(fault) = found.faults().first() {
        return Err(format!("the law is not consistent: {fault}").into());
    }

    // A cube of 60 mm, fixed at its bottom and pressed at the centre of its top.
    let mesh = TetMesh::cuboid([6, 6, 6], 0.01);
    let fixed: Vec<u32> = (0..).zip(&mesh.nodes_m).filter(|(_, p)| p[2] == 0.0).map(|(n, _)| n).collect();
    let top = mesh.nodes_m.iter().position(|p| *p == [0.03, 0.03, 0.06]).ok_or("the cube has a top")?;
    let law = Material::own("yeoh", yeoh);
    let body = Arc::new(Body::new(&mesh, &Model::uniform(law, &fixed))?);
    let mut solver = Solver::new(Arc::new(Problem::new(body, top as u32)));
    let mut last = solver.rest()?;
    for depth_mm in [2.0, 4.0, 6.0, 8.0] {
        last = solver.advance(&last.seed, [0.0, 0.0, -1e-3 * depth_mm])?;
        println!("{depth_mm} mm: {:.4} N, {:.3e} J", -last.jet().force_n[2], last.jet().energy_j);
    }
    Ok(())
}
