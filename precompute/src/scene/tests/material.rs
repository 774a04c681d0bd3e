//! Materials in scene files.

use super::*;

#[test]
fn every_law_is_read_with_its_parameters() {
    let bench = Bench::new();
    let from = "law = \"mooney-rivlin\"\nc10_pa = 1300.0\nc01_pa = 1280.0";
    let material = |to: &str| bench.with(from, to).expect("sound").materials[0].clone();
    for law in ["linear", "st-venant-kirchhoff", "modified-st-venant-kirchhoff", "neo-hookean"] {
        let region = material(&format!("law = \"{law}\"\nlambda_pa = 2e4\nmu_pa = 1e4"));
        assert_eq!((region.material.name(), region.material.numbers()), (law, vec![2e4, 1e4]));
    }
    for law in ["mooney-rivlin", "mooney-rivlin-reduced"] {
        let region = material(&format!("law = \"{law}\"\nc10_pa = 1e3\nc01_pa = 2e3\nbulk_pa = 5e6"));
        assert_eq!((region.material.name(), region.material.numbers()), (law, vec![1e3, 2e3]));
        assert_eq!(region.bulk_modulus_pa, Some(5e6));
    }
    let law = "holzapfel-gasser-ogden";
    let fibres = "c10_pa = 1e3\nk1_pa = 2e3\nk2 = 1.5\nfibre = [0.0, 3.0, 4.0]";
    let region = material(&format!("law = \"{law}\"\n{fibres}\ndispersion = 0.1"));
    assert_eq!(region.material.numbers(), [1e3, 2e3, 1.5, 0.1, 0.0, 0.6, 0.8]);

    let refuses = |to: &str, line: usize, what, fix| {
        bench.refuses(from, to, &format!("block.toml:{line}"), what, fix);
    };
    refuses(&format!("law = \"{law}\"\nc10_pa = 1\nk1_pa = 1\nk2 = 1"), 7, "lacks `fibre`", "direction");
    let zero = fibres.replace("[0.0, 3.0, 4.0]", "[0.0, 0.0, 0.0]");
    refuses(&format!("law = \"{law}\"\n{zero}"), 11, "is not a direction", "not zero");
    let wide = format!("law = \"{law}\"\n{fibres}\ndispersion = 0.5");
    refuses(&wide, 12, "must be from 0 to 1/3", "isotropic");
    let bulk = "law = \"neo-hookean\"\nlambda_pa = 2e4\nmu_pa = 1e4\nbulk_pa = 1e6";
    refuses(bulk, 10, "which has no pressure", "remove it");
}

#[test]
fn material_parameters_must_make_sense() {
    let bench = Bench::new();
    let refuses = |from, to, place, what, fix| bench.refuses(from, to, place, what, fix);
    refuses(
        "\"mooney-rivlin\"",
        "\"mooney rivlin\"",
        "block.toml:7",
        "unknown law",
        "did you mean \"mooney-rivlin\"",
    );
    refuses(
        "\"mooney-rivlin\"",
        "\"ogden\"",
        "block.toml:7",
        "unknown law \"ogden\"",
        "choose one of linear",
    );
    refuses("c01_pa = 1280.0", "", "block.toml:7", "lacks `c01_pa`", "`c10_pa` and `c01_pa`");
    refuses("c01_pa = 1280.0", "c01_pa = nan", "block.toml:9", "`c01_pa` = NaN must be a finite", "correct");
    refuses(
        "c01_pa = 1280.0",
        "c01_pa = -1300",
        "block.toml:8",
        "must have a positive sum",
        "positive constants",
    );
    let both = "c01_pa = 1280.0\nyoung_pa = 1.0";
    refuses(
        "c01_pa = 1280.0",
        both,
        "block.toml:10",
        "`young_pa` does not belong to the law",
        "`c10_pa` and",
    );

    let elastic = |lines: &str, line: usize, what: &str, fix: &str| {
        let from = "\"mooney-rivlin\"\nc10_pa = 1300.0\nc01_pa = 1280.0";
        let to = format!("\"st-venant-kirchhoff\"\n{lines}");
        bench.refuses(from, &to, &format!("block.toml:{line}"), what, fix);
    };
    elastic(
        "young_pa = 0\npoisson = 0.3",
        8,
        "`young_pa` = 0 must be positive",
        "Young's modulus in pascals",
    );
    elastic("young_pa = inf\npoisson = 0.3", 8, "must be a finite number", "correct the value");
    elastic("young_pa = 1e4\npoisson = 0.5", 9, "`poisson` = 0.5 must be above -1 and below 0.5", "0.49");
    elastic("young_pa = 1e4\npoisson = -1", 9, "must be above -1", "ratio below 0.5");
    elastic("young_pa = 1e4", 7, "lacks `poisson`", "either `young_pa` and `poisson`, or");
    elastic("young_pa = 1e4\nmu_pa = 3e3", 9, "`mu_pa` does not belong", "either `young_pa`");
    elastic("young_pa = 1e4\npoisson = 0.3\nmu_pa = 3e3", 10, "`mu_pa` does not belong", "either `young_pa`");
    elastic("lambda_pa = 1e4\nmu_pa = 0.0", 9, "`mu_pa` = 0 must be positive", "shear modulus");
    elastic("lambda_pa = -1e4\nmu_pa = 1e4", 8, "bulk modulus", "larger `lambda_pa`");
    elastic("c10_pa = 1.0", 8, "`c10_pa` does not belong", "either `young_pa`");
    elastic("", 7, "lacks `lambda_pa`", "either `young_pa` and `poisson`, or `lambda_pa` and `mu_pa`");
}

#[test]
fn young_and_poisson_become_lame_constants() {
    let bench = Bench::new();
    let from = "\"mooney-rivlin\"\nc10_pa = 1300.0\nc01_pa = 1280.0";
    let to = "\"st-venant-kirchhoff\"\nyoung_pa = 15480\npoisson = 0.49";
    let scene = bench.with(from, to).expect("sound");
    let Material::StVenantKirchhoff(StVenantKirchhoff { lame: Lame { lambda_pa, mu_pa } }) =
        scene.materials[0].material
    else {
        panic!("{:?}", scene.materials);
    };
    // The paper's liver: mu = E / 2.98, lambda = 0.49 E / (1.49 * 0.02).
    assert!((lambda_pa / 254_536.912_751_677_9 - 1.0).abs() < 1e-14, "{lambda_pa}");
    assert!((mu_pa / 5_194.630_872_483_221 - 1.0).abs() < 1e-14, "{mu_pa}");
    let direct = bench.with(from, "\"st-venant-kirchhoff\"\nlambda_pa = 2.0\nmu_pa = 3.0").expect("sound");
    let lame = Lame { lambda_pa: 2.0, mu_pa: 3.0 };
    assert_eq!(direct.materials[0].material, Material::StVenantKirchhoff(StVenantKirchhoff { lame }));
}
